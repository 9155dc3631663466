"""The `zenostat` command: real processes, from a folder that is not the project's."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.nodes import SMALL, NodeProgram, command_of, free_port, interrupted, programs_of, until

import agent_sdk

ZENOSTAT = [sys.executable, "-P", "-m", "cli.main"]
COMMANDS = (
    "node", "run", "evaluate", "monitor", "status", "read", "watch", "write", "relinquish", "points", "buildings",
    "weathers", "asyncapi", "demo", "pace", "pause", "resume", "step", "faults", "reset", "stop",
)  # fmt: skip
DAY = ["--building", "ref-small-office", "--weather", "USA_CO_Denver", "--begin", "07-03", "--end", "07-03"]


def _zenostat(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*ZENOSTAT, *arguments], capture_output=True, text=True, cwd=cwd, timeout=120)


def _plain(text: str) -> str:
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", text).split())


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_that_the_command_takes(command):
    done = _zenostat(command, "--help")
    assert done.returncode == 0
    example = re.search(rf"Example: zenostat ({command}[^│╭]*?)(?=\s╭|\s│|$)", _plain(done.stdout.replace("`", "")))
    assert example, done.stdout
    words = example[1].split()
    assert words[0] == command
    for option in (word for word in words if word.startswith("--")):
        assert option in done.stdout.split("Options")[1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_is_ended_while_it_starts_leaves_nothing(scratch: Path, number: signal.Signals) -> None:
    """When its engine has begun, which takes EnergyPlus some tenths of a second."""
    command = [*ZENOSTAT, "node", *DAY, "--listen", f"tcp/127.0.0.1:{free_port()}", "--affinity", "off"]

    def simulates() -> bool:
        return any("eplus_node.engine" in command_of(program) for program in programs_of(scratch))

    interrupted(command, simulates, "its engine runs", cwd=scratch, number=number)


def test_three_terminals(scratch):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    node = subprocess.Popen(
        [*ZENOSTAT, "node", *DAY, "--name", "office", "--listen", endpoint, "--affinity", "off"],
        stdout=subprocess.PIPE,
        text=True,
        cwd=scratch,
    )
    try:
        said = node.stdout.readline()
        while "Ctrl-C" not in said:
            said += node.stdout.readline()
        assert "96 timesteps of 60 min" not in _plain(said)
        monitor = subprocess.Popen(
            [*ZENOSTAT, "monitor", "--connect", endpoint, "--save", "run.rrd"],
            stdout=subprocess.PIPE,
            text=True,
            cwd=scratch,
        )
        assert f"connected to {endpoint}; press Ctrl-C" in monitor.stdout.readline()
        status = _plain(_zenostat("status", "--connect", endpoint).stdout)
        assert "waiting (lockstep)" in status
        assert "no controllers" in status
        ran = _zenostat("run", "--node", "office", "--controller", "rbc", "--connect", endpoint, cwd=scratch)
        assert ran.returncode == 0, ran.stderr
        assert "1 episode controlled by rbc" in ran.stdout
        assert re.search(r"^electricity \(kWh\) +\d+$", ran.stdout, re.M)
        assert re.search(r"^peak \(kW\) +\d+\.\d$", ran.stdout, re.M)
        assert re.search(r"^timesteps +144$", ran.stdout, re.M)
        assert "━" not in ran.stdout  # no bars in a pipe
        status = _plain(_zenostat("status", "--connect", endpoint).stdout)
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
        said, _ = node.communicate(timeout=60)
    assert node.returncode == 0
    assert "office: ended" in said


def test_ctrl_c_in_a_controller_leaves_the_node_waiting(scratch):
    year = SMALL | {"begin": "01-01", "end": "12-31"}
    with NodeProgram(scratch / "node", **year) as node, agent_sdk.connect(node.endpoint, affinity="off") as bus:
        run = subprocess.Popen(
            [*ZENOSTAT, "run", "--node", "office", "--controller", "baseline", "--connect", node.endpoint],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        until(lambda: bus.status("office").step[0] > 5, "the controller has begun")
        run.send_signal(signal.SIGINT)
        _, said = run.communicate(timeout=60)
        assert run.returncode == 130
        assert "Traceback" not in said
        until(lambda: [c.state for c in bus.status("office").controllers] == ["disconnected"], "the node misses it")
        until(lambda: bus.status("office").state == "waiting", "its last command is simulated")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["node", "--building", "ofice-small", "--weather", "USA_CO_Denver"],
            ["no building 'ofice-small'", "office-small"],
        ),
        (
            ["node", "--building", "office-small", "--weather", "USA_CO"],
            ["matches several", "USA_CO_Denver", "USA_CO_Golden"],
        ),
        (["node", *DAY[:4], "--begin", "02-30"], ["begin '02-30' is not a calendar date"]),
        (["node", *DAY, "--steps-per-hour", "7"], ["7 does not divide the hour"]),
        (["node", *DAY, "--name", "my office"], ["'my office' is not valid in a topic", "'my_office'"]),
        (["node", *DAY, "--listen", "tcp/0.0.0.0:7447"], ["can be reached from other machines", "--expose"]),
        (["node", *DAY, "--listen", "7447"], ["is not an endpoint", "tcp/127.0.0.1:7447"]),
        (["run", "--node", "office", "--controller", "rb"], ["no controller 'rb'", "'rbc'"]),
        (["monitor", "--save", "nowhere/run.rrd"], ["there is no folder", "nowhere"]),
        (["monitor", "--screenshot", "run.jpg"], ["--screenshot run.jpg", "expected a .png file"]),
    ],
)
def test_mistakes_in_the_call_are_named_before_anything_starts(scratch, arguments, words):
    done = _zenostat(*arguments, cwd=scratch)
    assert done.returncode == 2
    for word in words:
        assert word in _plain(done.stderr)
    assert "Traceback" not in done.stderr


def test_no_display_says_what_to_use_instead(scratch, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    done = _zenostat("monitor", cwd=scratch)
    assert done.returncode == 2
    assert "--web, --save FILE.rrd or --screenshot FILE.png" in _plain(done.stderr)


def test_port_taken_and_name_taken(scratch):
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with NodeProgram(scratch / "node", **SMALL, listen=[endpoint]):
        taken = _zenostat("node", *DAY, "--name", "other", "--listen", endpoint)
        assert taken.returncode == 1
        assert f"another program listens on {endpoint}" in _plain(taken.stderr)
        assert taken.stdout == ""  # no bar of something that is dead
        other = f"tcp/127.0.0.1:{free_port()}"
        twice = _zenostat("node", *DAY, "--name", "office", "--listen", other, "--connect", endpoint)
        assert twice.returncode == 1
        assert "a node named 'office' is on this bus already" in _plain(twice.stderr)
        missing = _zenostat("run", "--node", "offce", "--connect", endpoint)
        assert missing.returncode == 1
        assert "no node 'offce'" in _plain(missing.stderr)
        assert "'office'" in missing.stderr


def test_nobody_there():
    done = _zenostat("status", "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert done.returncode == 1
    assert "nobody listens" in done.stderr


def test_points_tell_units():
    done = _zenostat("points", "ref-small-office", "--match", "core_zn", "--json")
    points = {(p["kind"], p["name"], p["key"]): p["unit"] for p in json.loads(done.stdout)}
    assert points["sensor", "Zone Air Temperature", "CORE_ZN"] == "degC"
    assert points["actuator", "Zone Temperature Control / Cooling Setpoint", "CORE_ZN"] == "degC"
    meters = json.loads(_zenostat("points", "ref-small-office", "--kind", "meter", "--json").stdout)
    facility = next(meter for meter in meters if meter["name"] == "Electricity:Facility")
    assert (facility["unit"], facility["low"], facility["high"], facility["where"]) == ("J", 0.0, None, "facility")
    default = json.loads(_zenostat("points", "ref-small-office", "--default", "--json").stdout)
    assert len({p["key"] for p in default if p["name"] == "Zone Air Temperature"}) >= 5


@pytest.mark.parametrize("more", [[], ["--json"], ["--kind", "actuator"]], ids=str)
def test_points_that_match_nothing_are_told_with_near_names(more):
    done = _zenostat("points", "ref-small-office", "--match", "cor_zn", *more)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.search(r"no (point|actuator) of \S+ matches 'cor_zn'; did you mean 'core_zn'", _plain(done.stderr), re.I)
    nothing = _zenostat("points", "ref-small-office", "--match", "Dresser Coil", "--kind", "internal")
    assert (nothing.returncode, nothing.stdout) == (1, "")


def test_points_tell_bounds_and_places():
    rows = json.loads(_zenostat("points", "ref-small-office", "--match", "perimeter_zn_1", "--json").stdout)
    heating = next(row for row in rows if row["name"] == "Zone Temperature Control / Heating Setpoint")
    assert (heating["low"], heating["high"], heating["where"]) == (15.0, 22.5, "Perimeter_ZN_1")
    internal = _zenostat("points", "ref-small-office", "--kind", "internal").stdout.splitlines()
    assert internal[0].split() == ["kind", "name", "key", "where", "unit", "low", "high"]
    assert all(line.startswith("internal") for line in internal[1:])
    assert len({line.index("m2") for line in internal if "Zone Floor Area" in line}) == 1  # columns stand straight


def test_the_table_of_buildings():
    lines = _zenostat("buildings").stdout.splitlines()
    assert lines[0].split()[0] == "building"
    rows = {line.split()[0]: line for line in lines[1:]}
    assert {"office-medium", "ref-warehouse"} <= rows.keys()
    assert len(rows) >= 32
    assert "chiller" in rows["hospital"]
    assert "natural gas" in rows["hospital"]
    (one,) = json.loads(_zenostat("buildings", "office-medium", "--json").stdout)
    assert one["name"] == "office-medium"
    assert one["ems_programs"] > 0
    assert one["steps_per_hour"] == 4


def test_a_building_of_the_users_own_is_listed(scratch):
    (scratch / "house.epJSON").write_text('{"Building": {"b": {}}, "Zone": {"a": {"floor_area": 12.5}}}')
    (house,) = json.loads(_zenostat("buildings", "house.epJSON", "--json", cwd=scratch).stdout)
    assert (house["name"], house["floor_area_m2"], house["zones"], house["hvac"]) == ("house", 12.5, 1, "none")
    (scratch / "house.epJSON").write_text("{}")
    done = _zenostat("buildings", "house.epJSON", cwd=scratch)
    assert done.returncode == 2
    assert "it has no 'Building' object" in _plain(done.stderr)


def test_the_table_of_weathers():
    rows = {line.split()[0]: line for line in _zenostat("weathers").stdout.splitlines()[1:]}
    assert len(rows) >= 16
    assert re.search(r"39\.72\s+-104\.75\s+1726\s+5\s", rows["USA_CO_Denver"])
    (miami,) = json.loads(_zenostat("weathers", "miami", "--json").stdout)
    assert (miami["climate_zone"], miami["first"], miami["last"]) == ("1", [1, 1], [12, 31])
    assert 24 < miami["mean_temperature_degC"] < 25


def test_demo(scratch):
    done = _zenostat("demo", "--building", "ref-small-office", "--end", "07-01", "--folder", "out", cwd=scratch)
    assert done.returncode == 0, done.stderr
    said = _plain(done.stdout)
    for row in ("electricity (kWh)", "peak (kW)", "timesteps/s"):
        assert row in said
    assert (scratch / "out" / "run.rrd").exists()
    assert "rerun out/run.rrd" in said
    assert (scratch / "out" / "run.png").exists() or "mesa-vulkan-drivers" in said
    counts = re.search(r"(\d+) samples logged, 0 missed", said)
    steps = int(re.search(r"timesteps (\d+) (\d+)", said)[1])
    assert int(counts[1]) == 2 * (steps + 1)
