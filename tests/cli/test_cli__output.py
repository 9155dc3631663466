"""Output of `zenostat`: help, tables, and the mistakes in a call.

The commands run within the test's process; of each kind one runs as a program, too.
"""

import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console
from support.run_cli import DAY, error_of, output_of, plain, run_in_process, run_program

from zenostat.controllers import CONTROLLERS

COMMANDS = (
    "node", "run", "evaluate", "monitor", "status", "read", "watch", "write", "relinquish", "points", "buildings",
    "weathers", "asyncapi", "demo", "pace", "pause", "resume", "step", "faults", "reset", "stop", "plot", "alarms",
    "acknowledge", "shelve", "unshelve", "remove-from-service", "return-to-service",
)  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_help__has_an_example_that_the_command_takes(command: str) -> None:
    output = output_of(command, "--help")
    example = re.search(rf"Example: zenostat ({command}[^│╭]*?)(?=\s╭|\s│|$)", plain(output.replace("`", "")))
    assert example, output
    words = example[1].split()
    assert words[0] == command
    for option in (word for word in words if word.startswith("--")):
        assert option in output.split("Options")[1]


def test_help_of_run__names_each_bundled_controller() -> None:
    words = set(re.findall(r"[a-z]+(?:-[a-z]+)*", plain(output_of("run", "--help").replace("│", " "))))
    assert CONTROLLERS.keys() <= words


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["node", "--building", "ofice-small", "--weather", "USA_CO_Denver"],
            ["no building 'ofice-small'", "office-small"]),
        (["node", "--building", "office-small", "--weather", "USA_CO"],
            ["matches several", "USA_CO_Denver", "USA_CO_Golden"]),
        (["node", *DAY[:4], "--begin", "02-30"], ["begin '02-30' is not a calendar date"]),
        (["node", *DAY, "--steps-per-hour", "7"], ["7 does not divide the hour"]),
        (["node", *DAY, "--name", "my office"], ["'my office' is not valid in a topic", "'my_office'"]),
        (["node", *DAY, "--listen", "tcp/0.0.0.0:7447"], ["can be reached from other machines", "--expose"]),
        (["node", *DAY, "--listen", "7447"], ["is not an endpoint", "tcp/127.0.0.1:7447"]),
        (["run", "--node", "office", "--controller", "rb"], ["no controller 'rb'", "'rbc'"]),
        (["monitor", "--save", "nowhere/run.rrd"], ["there is no folder", "nowhere"]),
        (["monitor", "--node", "a", "--node", "b", "--save", "run.rrd"], ["--node: one node expected", "not a, b"]),
        (["gateway", "zeromq", "--node", "a", "--node", "b"], ["--node: one node expected", "not a, b"]),
        (["monitor", "--screenshot", "run.jpg"], ["--screenshot run.jpg", "expected a .png file"]),
    ],
)  # fmt: skip
def test_mistakes__are_named_before_anything_starts(scratch: Path, arguments: list[str], words: list[str]) -> None:
    error = error_of(*arguments, cwd=scratch)
    for word in words:
        assert word in error


@pytest.mark.parametrize("name", ["a b", "-x", ".x", "a/b", "ä", "x" * 129, ""])
@pytest.mark.parametrize(
    "command",
    [
        ["node", *DAY],
        ["node", "--plant", "tank.py:Tank"],
        ["node", "--fmu", "tank.fmu"],
        ["node", "--grid", "feeder.yaml"],
    ],
    ids=lambda command: command[1],
)
def test_node__name_that_cannot_be_in_a_key_is_refused_for_each_plant(
    scratch: Path, command: list[str], name: str
) -> None:
    error = error_of(*command, f"--name={name}", cwd=scratch)
    assert error.startswith(f"error: the node's name {name[:32]!r}"[:-1])
    assert "is not valid in a topic: use up to 128 letters, digits, '_', '.' and '-'" in error


def test_mistakes__a_program_ends_as_the_call_within_this_process(scratch: Path) -> None:
    call = ["node", *DAY, "--steps-per-hour", "7"]
    program, in_process = run_program(*call, cwd=scratch), run_in_process(*call, cwd=scratch)
    assert (program.returncode, program.stdout, program.stderr) == (
        in_process.returncode,
        in_process.stdout,
        in_process.stderr,
    )
    assert in_process.returncode == 2


def test_output__characters_that_the_locale_lacks_are_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}.items():
        monkeypatch.setenv(name, value)
    done = run_program("buildings")
    assert (done.returncode, done.stderr) == (0, "")
    assert "m?" in done.stdout.splitlines()[0]


def test_monitor__without_a_display_names_the_alternatives(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "--web, --save FILE.rrd or --screenshot FILE.png" in error_of("monitor", cwd=scratch)


def test_texts__are_in_one_line_however_narrow_the_output(scratch: Path) -> None:
    printed = output_of("keys", "init", "keys", cwd=scratch, columns=40).splitlines()
    assert printed[-1].startswith("Written to keys.")
    assert printed[-1].endswith("it can sign new certificates.")


def test_keys__names_and_hosts_are_not_cut(scratch: Path) -> None:
    name, host = "controller-of-the-second-floor", "building-automation.lab.example.org"
    run_in_process("keys", "init", "keys", "--host", host, cwd=scratch)
    run_in_process("keys", "add", name, "--role", "controller", "--folder", "keys", cwd=scratch)
    shown = output_of("keys", "show", "keys", cwd=scratch)
    rows = {row[1]: row for row in (re.split(" {2,}", line) for line in shown.splitlines())}
    assert rows[name][0] == "controller"
    assert host in rows["node"][3]


def test_keys__renewed_certificate_of_a_revoked_name_is_revoked(scratch: Path) -> None:
    run_in_process("keys", "init", "keys", cwd=scratch)
    run_in_process("keys", "revoke", "trainer", "--folder", "keys", cwd=scratch)
    shown = output_of("keys", "add", "trainer", "--role", "controller", "--folder", "keys", "--force", cwd=scratch)
    assert re.search(r"^controller +trainer .* revoked$", shown, re.MULTILINE)
    assert "to accept it again, remove its line from keys/revoked.txt" in shown


@pytest.mark.slow
def test_points__have_units_and_bounds() -> None:
    done = run_program("points", "ref-small-office", "--match", "core_zn", "--json")
    points = {(p["kind"], p["name"], p["key"]): p["unit"] for p in json.loads(done.stdout)}
    assert points["sensor", "Zone Air Temperature", "CORE_ZN"] == "degC"
    assert points["actuator", "Zone Temperature Control / Cooling Setpoint", "CORE_ZN"] == "degC"
    meters = json.loads(run_in_process("points", "ref-small-office", "--kind", "meter", "--json").stdout)
    facility = next(meter for meter in meters if meter["name"] == "Electricity:Facility")
    assert (facility["unit"], facility["low"], facility["high"], facility["where"]) == ("J", 0.0, None, "facility")
    default = json.loads(run_in_process("points", "ref-small-office", "--default", "--json").stdout)
    assert len({p["key"] for p in default if p["name"] == "Zone Air Temperature"}) >= 5


def test_points__without_a_unit_show_none() -> None:
    done = run_in_process("points", "ref-small-office", "--default", "--match", "occupant", columns=200)
    cells = done.stdout.splitlines()[1].split()
    assert cells[:2] == ["sensor", "core_zn_occupants"]
    assert cells[-2:] == ["CORE_ZN", "0"], "its key, no unit, and the low bound"


@pytest.mark.parametrize("more", [[], ["--json"], ["--kind", "actuator"]], ids=str)
def test_points__that_match_nothing_are_an_error_with_near_names(more: list[str]) -> None:
    done = run_in_process("points", "ref-small-office", "--match", "cor_zn", *more)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.search(r"no (point|actuator) of \S+ matches 'cor_zn'; did you mean 'core_zn'", plain(done.stderr), re.I)


def test_points__that_match_nothing_and_have_no_near_names_are_an_error() -> None:
    nothing = run_in_process("points", "ref-small-office", "--match", "Dresser Coil", "--kind", "internal")
    assert (nothing.returncode, nothing.stdout) == (1, "")


def test_points__have_bounds_and_places() -> None:
    rows = json.loads(run_in_process("points", "ref-small-office", "--match", "perimeter_zn_1", "--json").stdout)
    heating = next(row for row in rows if row["name"] == "Zone Temperature Control / Heating Setpoint")
    assert (heating["low"], heating["high"], heating["where"]) == (15.0, 22.5, "Perimeter_ZN_1")
    internal = run_in_process("points", "ref-small-office", "--kind", "internal").stdout.splitlines()
    assert internal[0].split() == ["kind", "name", "key", "(location)", "unit", "low", "high"]
    assert all(line.startswith("internal") for line in internal[1:])
    assert len({line.index("m2") for line in internal if "Zone Floor Area" in line}) == 1  # columns stand straight


def test_points__show_a_location_once_and_nothing_is_cut_at_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    select = ("points", "ref-small-office", "--default")
    rows = json.loads(run_in_process(*select, "--json").stdout)
    terminal = Console(width=80, force_terminal=True, color_system=None, file=io.StringIO())
    monkeypatch.setattr("zenostat.cli.tables.out", terminal)
    run_in_process(*select)
    printed = terminal.file.getvalue().splitlines()
    rule = next(number for number, line in enumerate(printed) if line.startswith("─"))
    heading, lines = printed[rule - 1], printed[rule + 1 :]  # its last line: that of a heading of one line
    assert max(map(len, lines)) <= 80
    place, unit = heading.index("(location)"), heading.index("unit")
    name = heading.rindex("name", 0, place)  # after `bus name`
    cells: list[tuple[str, str]] = []
    for line in lines:  # a row goes on in the lines that have no kind
        begun = cells.pop() if line[0] == " " else ("", "")
        cells.append((begun[0] + line[name:place].replace(" ", ""), begun[1] + line[place:unit].replace(" ", "")))
    expected = [
        (row["name"], row["key"] if row["where"].upper() == row["key"].upper() else f"{row['key']} ({row['where']})")
        for row in rows
    ]
    assert cells == [(first.replace(" ", ""), second.replace(" ", "")) for first, second in expected]
    assert {"CORE_ZN", "WHOLEBUILDING(facility)", "(facility)"} <= {second for _, second in cells}


def test_buildings__are_a_table() -> None:
    lines = run_in_process("buildings").stdout.splitlines()
    assert lines[0].split()[0] == "building"
    rows = {line.split()[0]: line for line in lines[1:]}
    assert {"office-medium", "ref-warehouse"} <= rows.keys()
    assert len(rows) >= 32
    assert "chiller" in rows["hospital"]
    assert "natural gas" in rows["hospital"]
    (one,) = json.loads(run_program("buildings", "office-medium", "--json").stdout)
    assert one["name"] == "office-medium"
    assert one["ems_programs"] > 0
    assert one["steps_per_hour"] == 4


def test_buildings__of_the_users_own_are_listed(scratch: Path) -> None:
    (scratch / "house.epJSON").write_text('{"Building": {"b": {}}, "Zone": {"a": {"floor_area": 12.5}}}')
    (house,) = json.loads(run_in_process("buildings", "house.epJSON", "--json", cwd=scratch).stdout)
    assert (house["name"], house["floor_area_m2"], house["zones"], house["hvac"]) == ("house", 12.5, 1, "none")
    (scratch / "house.epJSON").write_text("{}")
    assert "it has no 'Building' object" in error_of("buildings", "house.epJSON", cwd=scratch)


def test_weathers__are_a_table() -> None:
    rows = {line.split()[0]: line for line in run_in_process("weathers").stdout.splitlines()[1:]}
    assert len(rows) >= 16
    assert re.search(r"39\.72\s+-104\.75\s+1726\s+5\s", rows["USA_CO_Denver"])
    (miami,) = json.loads(run_program("weathers", "miami", "--json").stdout)
    assert (miami["climate_zone"], miami["first"], miami["last"]) == ("1", [1, 1], [12, 31])
    assert 24 < miami["mean_temperature_degC"] < 25
