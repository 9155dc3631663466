"""Commands that reset, stop, step and write report what the node did; a second node on the same port."""

import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from support.nodes import SMALL, NodeProgram, free_port
from support.run_cli import ZENOSTAT, run_program

import zenostat

POINT = "core_zn_cooling_setpoint"


@pytest.mark.slow
def test_cli__reset_begins_an_episode_and_stop_ends_the_node(node: NodeProgram, bus: zenostat.Bus) -> None:
    at = ("--connect", node.endpoint)
    done = run_program("reset", "office", "--seed", "3", *at)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"office: episode 1, 96 timesteps, USA_CO_Denver\S*\n", done.stdout)
    assert bus.status("office").episode == [1]
    done = run_program("stop", "office", *at)
    assert (done.returncode, done.stdout, done.stderr) == (0, "office: ended\n", "")
    assert node.process.wait() == 0
    gone = run_program("stop", "office", *at)
    assert (gone.returncode, gone.stdout) == (1, "")


@pytest.mark.slow
def test_relinquish__reports_whether_a_value_was_held(shared_node: NodeProgram) -> None:
    at = ("--connect", shared_node.endpoint)
    nothing = f"office: {POINT} had nothing to relinquish at priority 8\n"
    assert run_program("relinquish", "office", POINT, *at).stdout == nothing
    assert run_program("write", "office", POINT, "26", *at).returncode == 0
    assert run_program("relinquish", "office", POINT, *at).stdout == f"office: {POINT} relinquished at priority 8\n"
    assert run_program("relinquish", "office", POINT, *at).stdout == nothing


@pytest.mark.slow
def test_step__reports_the_timestep_that_it_reached(episode_bus: zenostat.Bus) -> None:
    at = ("--connect", episode_bus.endpoint)
    for arguments in (("pause", "office"), ("pace", "office", "free")):
        assert run_program(*arguments, *at).returncode == 0
    assert "free; paused; step 4 of 96" in run_program("step", "office", "4", *at).stdout
    assert "free; paused; step 5 of 96" in run_program("step", "office", *at).stdout
    assert run_program("pace", "office", "lockstep", *at).returncode == 0
    output = run_program("step", "office", "2", *at).stdout
    assert "lockstep; paused; step 5 of 96" in output
    assert "2 of 2 timesteps left: waiting for a controller" in output


def second_node(endpoint: str, *arguments: str, cwd: Path) -> subprocess.Popen[str]:
    """`zenostat node` on a machine whose default endpoint is `endpoint`."""
    elsewhere = f"from zenostat.bridge.transport import session; session.DEFAULT_ENDPOINT = {endpoint!r}"
    program = f"{elsewhere}; from zenostat.cli.main import main; main()"
    day = ("--building", SMALL["building"], "--weather", SMALL["weather"], "--begin", "07-03", "--end", "07-03")
    command = [sys.executable, "-P", "-u", "-c", program, "node", *day, "--name", "annex", "--affinity", "off"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*command, *arguments], text=True, cwd=cwd, **pipes)


@pytest.mark.slow
def test_cli__second_node_on_the_default_port_joins_the_bus_of_the_first(scratch: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        NodeProgram(scratch / "node", **SMALL, listen=[endpoint]),
        second_node(endpoint, cwd=scratch) as second,
        zenostat.connect(endpoint, affinity="off") as bus,
    ):
        try:
            line = second.stdout.readline()
            assert f"{endpoint} is in use by another program, so annex does not listen; it shares the bus at" in line
            assert "--listen tcp/127.0.0.1:" in line
            assert "annex" in second.stdout.readline()
            assert bus.nodes() == ["annex", "office"]
            bus.stop("annex")
            assert "annex: ended" in second.communicate(timeout=60)[0]
            assert second.returncode == 0
        finally:
            second.terminate()


@pytest.mark.slow
def test_cli__port_of_a_program_that_is_on_no_bus_is_refused(scratch: Path) -> None:
    with socket.socket() as stranger:
        stranger.bind(("127.0.0.1", 0))
        stranger.listen()
        endpoint = f"tcp/127.0.0.1:{stranger.getsockname()[1]}"
        with second_node(endpoint, cwd=scratch) as second:
            out, err = second.communicate(timeout=100)
    assert (second.returncode, out) == (1, "")
    assert f"another program listens on {endpoint}; name another port (--listen tcp/" in err
    assert f"--no-listen --connect {endpoint}" in err


@pytest.mark.slow
def test_monitor__names_the_node_that_it_waits_for(shared_node: NodeProgram, scratch: Path) -> None:
    command = [*ZENOSTAT, "monitor", "--node", "ofice", "--save", "run.rrd", "--connect", shared_node.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=scratch) as monitor:
        line = monitor.stdout.readline()
        assert line == (
            f"connected to {shared_node.endpoint}; waiting for node 'ofice', which is not on this bus "
            "(did you mean 'office'?); press Ctrl-C to stop\n"
        )
        monitor.send_signal(signal.SIGINT)
        rest, _ = monitor.communicate(timeout=60)
    assert "open it with: " in rest
    assert "view run.rrd" in rest


FAST = """
class Fast:
    step_s, duration_s = 60.0, 180000.0
    sensors = {"temperature": "degC"}
    meters = {"electricity": "J"}
    actuators = {"heater": ("W", 0.0, 3000.0, 0.0)}

    def reset(self, seed):
        return {"temperature": 20.0, "electricity": 0.0}

    def step(self, commands):
        return {"temperature": 20.0, "electricity": 3.6e6}
"""

SLOW = """
import time, zenostat

class Slow(zenostat.controllers.Controller):
    def __init__(self, manifest, endpoint):
        self.bus, self.is_waiting = zenostat.connect(endpoint, affinity="off"), True

    def act(self, sample):
        if self.is_waiting:
            self.is_waiting = False
            self.bus.pace("fast", mode="free")
            while self.bus.status("fast").state != "ended":
                time.sleep(0.01)
        return {}
"""


@pytest.mark.slow
def test_run__names_samples_that_a_slow_controller_lost(scratch: Path) -> None:
    """It sleeps until the episode is over; its inbox has room for 1,024 samples."""
    (scratch / "fast.py").write_text(FAST)
    (scratch / "slow.py").write_text(SLOW)
    with NodeProgram(scratch / "node", name="fast", plant=f"{scratch / 'fast.py'}:Fast") as node:
        done = run_program(
            "run", "--node", "fast", "--controller", f"{scratch / 'slow.py'}:Slow", "--connect", node.endpoint,
            "--set", f"endpoint={node.endpoint}", "--reset", "--report", str(scratch / "run.html"),
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (lost,) = re.findall(r"([\d,]+) samples of fast were lost; the totals lack their timesteps", done.stderr)
    kept = 3000 - int(lost.replace(",", ""))
    assert 900 < kept < 1100
    assert re.search(rf"electricity \(kWh\) +{kept:,}", done.stdout)
    assert "were lost; its totals lack their timesteps" in (scratch / "run.html").read_text()
