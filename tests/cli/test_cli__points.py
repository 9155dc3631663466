"""Single points by hand: write, release, read and watch, on a real node."""

import json
import os
import re
import signal
import subprocess
import threading
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from support.nodes import NodeProgram, new_episode, until
from support.run_cli import ZENOSTAT, run_in_process, run_program

import zenostat
from zenostat.cli.write import seconds
from zenostat.topics.errors import InvalidAction, InvalidConfig, NodeLost, RequestRejected, UnknownName
from zenostat.topics.messages import Manifest

POINT = "core_zn_cooling_setpoint"
AIR = "core_zn_air_temperature"


def run_zenostat(endpoint: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return run_in_process(*arguments, "--connect", endpoint, columns=200)


@pytest.fixture
def bus(shared_bus: zenostat.Bus) -> zenostat.Bus:
    """The bus of the node that the tests of this module share, at the begin of an episode."""
    new_episode(shared_bus)
    return shared_bus


def sources(link: zenostat.ControllerLink, steps: int) -> list[tuple[float, str]]:
    """Return the point's effective value and source in the next timesteps; the controller keeps all as it is."""
    sample, values = link.current(), []
    place = [a.name for a in link.manifest.actuators].index(POINT)
    for _ in range(steps):
        sample.send()
        sample = link.receive()
        values.append((sample.effective[place], sample.value_source[POINT]))
    return values


def actuator_of(endpoint: str) -> dict[str, Any]:
    read = json.loads(run_zenostat(endpoint, "read", "office", POINT, "--json").stdout)
    return next(row for row in read["points"] if row["kind"] == "actuator")


# write and release


@pytest.mark.slow
def test_cli__write_rules_until_it_is_released(bus: zenostat.Bus) -> None:
    """ann writes 26 → node@1 → ann releases → node@2; by programs"""
    connect = ("--connect", bus.endpoint)
    written = run_program("write", "office", POINT, "26", "--source", "ann", *connect)
    assert (written.returncode, written.stdout) == (0, f"office: {POINT} = 26 degC at priority 8\n"), written.stderr
    with bus.controller("office") as link:
        assert sources(link, 1) == [(26.0, "ann")]
        read = actuator_of(bus.endpoint)
        assert (read["value"], read["unit"], read["value_source"]) == (26.0, "degC", "ann")
        relinquished = run_program("relinquish", "office", POINT, *connect)
        assert (relinquished.returncode, relinquished.stdout) == (0, f"office: {POINT} relinquished at priority 8\n")
        ((value, source),) = sources(link, 1)
        assert (value != 26.0, source) == (True, "")
        assert actuator_of(bus.endpoint)["value_source"] == ""


@pytest.mark.slow
def test_cli__write_for_half_an_hour_rules_two_quarters(bus: zenostat.Bus) -> None:
    written = run_zenostat(bus.endpoint, "write", "office", POINT, "26", "--duration", "30min", "--source", "ann")
    assert written.stdout == f"office: {POINT} = 26 degC at priority 8 for 30min\n"
    with bus.controller("office") as link:
        assert [source for _, source in sources(link, 4)] == ["ann", "ann", "", ""]


@pytest.mark.slow
def test_cli__higher_priority_rules_and_a_release_is_of_one_level(bus: zenostat.Bus) -> None:
    for value, priority, source in (("25", "9", "low"), ("27", "3", "high")):
        done = run_zenostat(bus.endpoint, "write", "office", POINT, value, "--priority", priority, "--source", source)
        assert done.returncode == 0, done.stderr
    with bus.controller("office") as link:
        assert sources(link, 1) == [(27.0, "high")]
        assert run_zenostat(bus.endpoint, "relinquish", "office", POINT, "--priority", "3").returncode == 0
        assert sources(link, 1) == [(25.0, "low")]


def test_write__has_user_and_host_as_default_source(bus: zenostat.Bus) -> None:
    assert run_zenostat(bus.endpoint, "write", "office", POINT, "26").returncode == 0
    with bus.controller("office") as link:
        ((_, source),) = sources(link, 1)
    assert re.fullmatch(r"[^@.]+\.[^@]+", source)


def test_cli__what_the_node_refuses_ends_with_1_and_its_reason(bus: zenostat.Bus) -> None:
    before = bus.status("office").rejected
    low, high = next((a.low, a.high) for a in bus.manifest("office").actuators if a.name == POINT)
    for value in ("99", "-5"):
        done = run_zenostat(bus.endpoint, "write", "office", POINT, value)
        assert (done.returncode, done.stdout) == (1, "")
        assert f"{POINT} = {value}; its bounds are {low:g} to {high:g} degC" in done.stderr
    with bus.controller("office", name="holder", priority=8) as link:
        done = run_zenostat(bus.endpoint, "write", "office", POINT, "26")
        assert done.returncode == 1
        assert f"priority 8 of '{POINT}' is claimed by '{link.name}'" in done.stderr
    assert bus.status("office").rejected == before + 3


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["write", "ofice", POINT, "26"], 1, ["no node 'ofice'", "'office'"]),
        (["write", "office", "core_zn_coling_setpoint", "26"], 2, ["no actuator", f"did you mean '{POINT}'"]),
        (["write", "office", AIR, "26"], 2, [f"no actuator '{AIR}'"]),
        (["relinquish", "office", "core_zn_coling_setpoint"], 2, ["no actuator", f"did you mean '{POINT}'"]),
        (["write", "office", POINT, "nan"], 2, [f"{POINT}: value"]),
        (["write", "office", POINT, "warm"], 2, ["Invalid value"]),
        (["write", "office", POINT, "26", "--duration", "2 weeks"], 2, ["--duration 2 weeks", "90s, 15min, 2h, 1d"]),
        (["write", "office", POINT, "26", "--priority", "17"], 2, ["Invalid value", "16"]),
        (["read", "office", "core_zn_air", "outdor_temperature"], 2, [f"'{AIR}'", "'outdoor_temperature'"]),
        (["read", "office", "--slot", "1"], 2, ["no slot 1", "0 to 0"]),
        (["watch", "office", "core_zn_air"], 2, [f"'{AIR}'"]),
        (["watch", "ofice"], 1, ["no node 'ofice'", "'office'"]),
    ],
)
def test_cli__mistakes_are_named_before_anything_is_sent(
    bus: zenostat.Bus, arguments: list[str], code: int, words: list[str]
) -> None:
    before = bus.status("office").rejected
    done = run_zenostat(bus.endpoint, *arguments)
    assert (done.returncode, done.stdout) == (code, "")
    for word in words:
        assert word in done.stderr
    assert "Traceback" not in done.stderr
    assert bus.status("office").rejected == before


@pytest.mark.parametrize(
    ("text", "expected"),
    [("90s", 90.0), ("15min", 900.0), ("2h", 7200.0), ("1d", 86400.0), ("1.5h", 5400.0), ("2 h", 7200.0)],
)
def test_cli__times(text: str, expected: float) -> None:
    assert seconds(text) == expected


@pytest.mark.parametrize("text", ["", "2", "h", "0h", "-1h", "2H", "1e3s", "15m"])
def test_cli__times_that_are_none(text: str) -> None:
    with pytest.raises(InvalidConfig, match="90s, 15min, 2h, 1d"):
        seconds(text)


# From Python


def test_cli__each_writer_hears_of_its_own_write(bus: zenostat.Bus) -> None:
    """Four write at once under one name, some of it refused; each is told what it wrote."""
    values = [20.0, 26.0, 27.0, 40.0]
    replies: dict[float, list[str]] = {value: [] for value in values}
    episode = bus.status("office").episode

    def write(value: float) -> None:
        for _ in range(5):
            try:
                ack = bus.write("office", POINT, value, source="somebody")
                assert (ack.episode, ack.step) == (episode, [0])
                replies[value].append(ack.text)
            except RequestRejected as refused:
                replies[value].append(str(refused))

    threads = [threading.Thread(target=write, args=(value,)) for value in values]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for value, texts in replies.items():
        assert len(texts) == 5
        assert all(f"{POINT} = {value:g}" in text for text in texts)
        assert all(("its bounds are" in text) == (value in (20.0, 40.0)) for text in texts)


@pytest.mark.parametrize(
    "wrong",
    [
        {"value": float("inf")},
        {"value": 26.0, "priority": 0},
        {"value": 26.0, "duration_s": 0.0},
        {"value": 26.0, "source": "x" * 129},
    ],
    ids=str,
)
def test_cli__write_that_cannot_be_is_not_sent(bus: zenostat.Bus, wrong: dict[str, Any]) -> None:
    before = bus.status("office").rejected
    with pytest.raises(InvalidAction, match=POINT):
        bus.write("office", POINT, **wrong)
    with pytest.raises(UnknownName, match=f"did you mean '{POINT}'"):
        bus.write("office", POINT.upper(), 26.0)
    assert bus.status("office").rejected == before


@pytest.mark.slow
def test_cli__node_that_dies_under_a_write_is_named(node: NodeProgram, monkeypatch: pytest.MonkeyPatch) -> None:
    with zenostat.connect(node.endpoint, affinity="off") as bus:
        manifest = bus.manifest

        def and_dies(name: str) -> Manifest:
            known = manifest(name)
            node.kill()
            return known

        monkeypatch.setattr(bus, "manifest", and_dies)
        with pytest.raises(NodeLost, match="node 'office' is gone"):
            bus.write("office", POINT, 26.0)


# read


def test_cli__read_shows_the_latest_sample(bus: zenostat.Bus) -> None:
    with bus.controller("office") as link:
        sample = link.current()
        sample.send()
        sample = link.receive()
        output = json.loads(run_zenostat(bus.endpoint, "read", "office", "--json").stdout)
        assert (output["node"], output["episode"], output["step"]) == ("office", bus.status("office").episode[0], 1)
        assert output["time"] == sample.time.isoformat()
        kinds = {
            kind: [row for row in output["points"] if row["kind"] == kind] for kind in ("sensor", "meter", "actuator")
        }
        assert {row["name"]: row["value"] for row in kinds["sensor"] + kinds["meter"]} == sample.as_dict()
        manifest = link.manifest
        for kind, points in (
            ("sensor", manifest.sensors),
            ("meter", manifest.meters),
            ("actuator", manifest.actuators),
        ):
            shown = [(row["name"], row["unit"], row["low"], row["high"]) for row in kinds[kind]]
            assert shown == [(point.name, point.unit, point.low, point.high) for point in points]
        effective = [float("nan") if row["value"] is None else row["value"] for row in kinds["actuator"]]
        assert np.array_equal(effective, sample.effective, equal_nan=True)
        assert {row["name"]: row["value_source"] for row in kinds["actuator"]} == sample.value_source
        lines = run_zenostat(bus.endpoint, "read", "office", AIR).stdout.splitlines()
        assert lines[0].split() == ["kind", "name", "value", "unit", "low", "high", "value", "source"]
        assert lines[1].split()[:4] == ["sensor", AIR, f"{sample[AIR]:.6g}", "degC"]
        people = "core_zn_occupants"
        lines = run_zenostat(bus.endpoint, "read", "office", people).stdout.splitlines()
        assert lines[1].split() == ["sensor", people, f"{sample[people]:.6g}", "0"], "no unit, but its low bound"
        assert len(lines) == 2


# watch


def watching(endpoint: str, *arguments: str) -> subprocess.Popen[str]:
    command = [*ZENOSTAT, "watch", "office", *arguments, "--connect", endpoint]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "COLUMNS": "200", "PYTHONUNBUFFERED": "1"},
    )


def test_cli__watch_tells_each_sample_once_from_the_present_one_on(bus: zenostat.Bus) -> None:
    with watching(bus.endpoint, AIR, POINT, "--json", "--steps", "6") as watch, bus.controller("office") as link:
        first = json.loads(watch.stdout.readline())
        sample = link.current()
        samples = [sample]
        for _ in range(8):
            sample.send()
            sample = link.receive()
            samples.append(sample)
        rest, err = watch.communicate()
        assert (watch.returncode, err) == (0, "")
    lines = [first, *map(json.loads, rest.splitlines())]
    (episode,) = bus.status("office").episode
    assert [(line["episode"], line["step"]) for line in lines] == [(episode, step) for step in range(6)]
    place = [a.name for a in link.manifest.actuators].index(POINT)
    for line, seen in zip(lines, samples, strict=False):
        assert line["time"] == seen.time.isoformat()
        assert line["points"] == {name: seen[name] for name in (AIR, POINT) if name in link.manifest.names}
        effective = seen.effective[place]
        assert line["actuators"] == {POINT: None if np.isnan(effective) else effective}


def test_cli__table_has_the_extremes_since_it_began(bus: zenostat.Bus) -> None:
    (episode,) = bus.status("office").episode
    screen, terminal = os.openpty()
    drawn = bytearray()

    def look() -> None:
        with suppress(OSError):  # the terminal is gone with its last program
            while piece := os.read(screen, 65536):
                drawn.extend(piece)

    looking = threading.Thread(target=look)
    looking.start()
    command = [*ZENOSTAT, "watch", "office", AIR, "--steps", "97", "--connect", bus.endpoint]
    size = {"COLUMNS": "150", "LINES": "40", "TERM": "xterm"}
    with subprocess.Popen(command, stdout=terminal, stderr=terminal, env={**os.environ, **size}) as watch:
        os.close(terminal)
        until(lambda: b"sample 0 of episode %d" % episode in drawn, "the table shows the present sample")
        with bus.controller("office") as link:
            values = [sample[AIR] for sample in link]
        assert watch.wait() == 0
    looking.join()
    os.close(screen)
    assert len(values) == 97
    last = drawn.decode().rpartition(f"sample 96 of episode {episode}")[2]
    row = next(line for line in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", last).splitlines() if AIR in line)
    assert re.findall(r"-?\d+\.\d+", row) == [f"{value:.6g}" for value in (values[-1], min(values), max(values))]


@pytest.mark.slow
def test_cli__watch_ends_with_the_node(node: NodeProgram) -> None:
    with watching(node.endpoint, "--json") as watch:
        assert json.loads(watch.stdout.readline())["step"] == 0
        node.interrupt()
        out, err = watch.communicate()
    assert (watch.returncode, out) == (0, "")
    assert "node 'office' is gone" in err


def test_cli__watch_ends_with_ctrl_c(bus: zenostat.Bus) -> None:
    with watching(bus.endpoint, "--json") as watch:
        assert json.loads(watch.stdout.readline())["step"] == 0
        watch.send_signal(signal.SIGINT)
        assert watch.communicate() == ("", "")
    assert watch.returncode == 0
    assert bus.status("office").state == "waiting"
