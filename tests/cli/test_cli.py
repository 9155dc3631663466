"""The `zenostat` command as programs beside each other: nodes, controllers, monitors, signals, the demo."""

import re
import signal
import subprocess
from pathlib import Path

import pytest
from support.nodes import SMALL, NodeProgram, command_of, free_port, interrupted, node_on_bus, programs_of, until
from support.run_cli import DAY, ZENOSTAT, error_of, plain, run_program


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_node__that_is_ended_while_it_starts_leaves_nothing(scratch: Path, number: signal.Signals) -> None:
    """It ends once its engine has begun, which takes EnergyPlus some tenths of a second."""
    command = [*ZENOSTAT, "node", *DAY, "--listen", f"tcp/127.0.0.1:{free_port()}", "--affinity", "off"]

    def simulates() -> bool:
        return any("zenostat.eplus_node.engine" in command_of(program) for program in programs_of(scratch))

    interrupted(command, simulates, "its engine runs", cwd=scratch, number=number)


@pytest.mark.slow
def test_node_controller_and_monitor__are_three_programs(scratch: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    node = subprocess.Popen(
        [*ZENOSTAT, "node", *DAY, "--name", "office", "--listen", endpoint, "--affinity", "off"],
        stdout=subprocess.PIPE,
        text=True,
        cwd=scratch,
    )
    try:
        printed = node.stdout.readline()
        while "Ctrl-C" not in printed:
            printed += node.stdout.readline()
        assert "96 timesteps of 60 min" not in plain(printed)
        monitor = subprocess.Popen(
            [*ZENOSTAT, "monitor", "--connect", endpoint, "--save", "run.rrd"],
            stdout=subprocess.PIPE,
            text=True,
            cwd=scratch,
        )
        assert f"connected to {endpoint}; press Ctrl-C" in monitor.stdout.readline()
        status = plain(run_program("status", "--connect", endpoint).stdout)
        assert "waiting (lockstep)" in status
        assert "no controllers" in status
        ran = run_program("run", "--node", "office", "--controller", "rbc", "--connect", endpoint, cwd=scratch)
        assert ran.returncode == 0, ran.stderr
        assert "1 episode controlled by rbc" in ran.stdout
        assert re.search(r"^electricity \(kWh\) +\d+$", ran.stdout, re.M)
        assert re.search(r"^peak \(kW\) +\d+\.\d$", ran.stdout, re.M)
        assert re.search(r"^timesteps +144$", ran.stdout, re.M)
        assert "━" not in ran.stdout  # no bars in a pipe
        status = plain(run_program("status", "--connect", endpoint).stdout)
        assert re.search(r"ended \(lockstep\)", status)
        assert re.search(r"(\d+) accepted, 0 rejected, 0 late, 0 duplicate", status)
        assert "rbc-" in status
        monitor.send_signal(signal.SIGINT)
        logged, _ = monitor.communicate(timeout=60)
        steps = int(re.search(r"step (\d+) of", status)[1])
        assert f"{steps + 1} samples logged, 0 missed" in logged
        assert monitor.returncode == 0
        assert (scratch / "run.rrd").stat().st_size > 0
    finally:
        node.send_signal(signal.SIGINT)
        printed, _ = node.communicate(timeout=60)
    assert node.returncode == 0
    assert "office: ended" in printed


@pytest.mark.slow
def test_run__ctrl_c_leaves_the_node_waiting(scratch: Path) -> None:
    year = SMALL | {"begin": "01-01", "end": "12-31"}
    with node_on_bus(scratch / "node", **year) as (node, bus):
        run = subprocess.Popen(
            [*ZENOSTAT, "run", "--node", "office", "--controller", "baseline", "--connect", node.endpoint],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        until(lambda: bus.status("office").step[0] > 5, "the controller has begun")
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=60)
        assert run.returncode == 130
        assert "Traceback" not in errors
        until(lambda: [c.state for c in bus.status("office").controllers] == ["disconnected"], "the node misses it")
        until(lambda: bus.status("office").state == "waiting", "its last command is simulated")


@pytest.mark.slow
def test_node__port_taken_and_name_taken(scratch: Path) -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with NodeProgram(scratch / "node", **SMALL, listen=[endpoint]):
        taken = run_program("node", *DAY, "--name", "other", "--listen", endpoint)
        assert taken.returncode == 1
        assert f"another program listens on {endpoint}" in plain(taken.stderr)
        assert taken.stdout == ""  # no bar of something that is dead
        other = f"tcp/127.0.0.1:{free_port()}"
        twice = run_program("node", *DAY, "--name", "office", "--listen", other, "--connect", endpoint)
        assert twice.returncode == 1
        assert "a node named 'office' is on this bus already" in plain(twice.stderr)
        error = error_of("run", "--node", "offce", "--connect", endpoint, code=1)
        assert "no node 'offce'" in error
        assert "'office'" in error


@pytest.mark.slow
def test_status__nobody_listens() -> None:
    assert "nobody listens" in error_of("status", "--connect", f"tcp/127.0.0.1:{free_port()}", code=1)


@pytest.mark.slow
def test_demo__compares_two_controllers_and_records_both(scratch: Path) -> None:
    done = run_program("demo", "--building", "ref-small-office", "--end", "07-01", "--folder", "out", cwd=scratch)
    assert done.returncode == 0, done.stderr
    printed = plain(done.stdout)
    for row in ("electricity (kWh)", "peak (kW)", "timesteps/s"):
        assert row in printed
    assert (scratch / "out" / "run.rrd").exists()
    assert "zenostat view out/run.rrd" in printed
    assert (scratch / "out" / "run.png").exists() or "mesa-vulkan-drivers" in printed
    counts = re.search(r"(\d+) samples logged, 0 missed", printed)
    steps = int(re.search(r"timesteps (\d+) (\d+)", printed)[1])
    assert int(counts[1]) == 2 * (steps + 1)
    assert f"{steps} timesteps of" in (scratch / "out" / "report.html").read_text(encoding="utf-8")
