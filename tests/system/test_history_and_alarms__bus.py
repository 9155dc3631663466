"""History and alarms of a running node, on the bus, in its recording, and on the command line."""

import json
import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from support.nodes import NodeProgram, node_on_bus, until
from support.run_cli import plain
from support.run_cli import run_in_process as run

import zenostat
from zenostat import recording
from zenostat.bridge.transport.access_control import Permission, may
from zenostat.bridge.transport.session import open_session
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics import keys
from zenostat.topics.errors import EpisodeChanged, InvalidConfig, RequestRejected, UnknownName
from zenostat.topics.keys import Role
from zenostat.topics.messages import AlarmState, CreateBranch, EventKind, HistorySeries, Reset
from zenostat.views.live.stream import RerunStream

OVEN = """
class Oven:
    step_s, steps, begin = 60, 200, "2017-07-03"
    sensors = {"temperature": "degC", "people": "count"}
    meters = {"energy": "J"}
    actuators = {"heater": ("W", 0.0, 1000.0, 0.0)}

    def reset(self, seed):
        self.temperature = 20.0
        return {"temperature": 20.0, "people": 1.0, "energy": 0.0}

    def step(self, commands):
        self.temperature += commands["heater"] / 100.0 - 1.0
        return {"temperature": self.temperature, "people": 1.0, "energy": 60.0 * commands["heater"]}

    def save(self):
        return self.temperature

    def restore(self, state):
        self.temperature = state
"""
"""A minute at 200 W warms it by 1 K, at 0 W cools it by 1 K."""

ALARMS = """
alarms:
  - {name: hot, points: temperature, high: 25.0, unit: degC, deadband: 1.0, delay_s: 120, text: Open it.}
  - {name: any_heat, points: energy, high: 1000.0, notify: event}
"""


@pytest.fixture(scope="module")
def oven(module_scratch: Path) -> Iterator[NodeProgram]:
    (module_scratch / "oven.py").write_text(OVEN)
    (module_scratch / "alarms.yaml").write_text(ALARMS)
    settings = {"plant": f"{module_scratch}/oven.py:Oven", "alarms": str(module_scratch / "alarms.yaml")}
    with NodeProgram(module_scratch / "node", name="oven", **settings) as program:
        yield program


@pytest.fixture
def bus(oven: NodeProgram) -> Iterator[zenostat.Bus]:
    with zenostat.connect(oven.endpoint, affinity="off") as connected:
        until(lambda: not connected.controllers(), "all controllers have left")
        connected.reset("oven", Reset())
        yield connected


def heat(bus: zenostat.Bus, *watts: float) -> list[float]:
    """Simulate a timestep for each power; return the temperatures, that of the first sample included."""
    with bus.controller("oven", name="cook") as link:
        temperatures = [link.current()["temperature"]]
        for power in watts:
            link.send({"heater": power})
            temperatures.append(link.receive()["temperature"])
    return temperatures


# History


def test_history__has_the_samples_of_the_episode(bus: zenostat.Bus) -> None:
    temperatures = heat(bus, 200.0, 200.0, 0.0, 300.0)
    history = bus.history("oven", ["heater", "temperature"])
    assert history["temperature"].tolist() == temperatures == [20.0, 21.0, 22.0, 21.0, 23.0]
    assert history["heater"][1:].tolist() == [200.0, 200.0, 0.0, 300.0]
    assert history.units == ("W", "degC")
    assert history.step.tolist() == [0, 1, 2, 3, 4]
    assert history.time[-1] == np.datetime64("2017-07-03T00:04:00")
    assert (history.stride, history.oldest_step, history.lows) == (1, 0, None)
    with pytest.raises(UnknownName, match="no point 'heatr' in this history; did you mean 'heater'"):
        history["heatr"]


def test_history__of_all_points_and_of_a_range(bus: zenostat.Bus) -> None:
    heat(bus, *[200.0] * 9)
    assert bus.history("oven").points == ("temperature", "people", "energy", "heater")
    part = bus.history("oven", ["temperature"], start="07-03T00:02:30", end=datetime(2017, 7, 3, 0, 5))
    assert part["temperature"].tolist() == [23.0, 24.0, 25.0]
    thin = bus.history("oven", ["temperature"], max_samples=4, extremes=True)
    assert thin.stride == 3
    assert thin.step.tolist() == [0, 3, 6, 9]
    assert thin.lows[:, 0].tolist() == [20.0, 21.0, 24.0, 27.0]
    assert thin.highs[:, 0].tolist() == [20.0, 23.0, 26.0, 29.0]


@pytest.mark.parametrize("options", [{}, {"max_samples": 3, "extremes": True}, {"start": "07-03T00:02"}])
def test_history__of_more_points_than_a_query_has_is_the_same(
    bus: zenostat.Bus, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]
) -> None:
    heat(bus, *[200.0] * 9)
    whole = bus.history("oven", **options)
    monkeypatch.setattr("zenostat.bridge.client.history.MAX_HISTORY_POINTS", 3)
    parts = bus.history("oven", **options)
    assert (parts.points, parts.units, parts.stride) == (whole.points, whole.units, whole.stride)
    for name in ("step", "values", "lows", "highs"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_a_history_larger_than_a_reply__is_read_in_parts(bus: zenostat.Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    temperatures = heat(bus, *[200.0] * 7)
    ask, asked = bus.ask, []

    def limited(topic: keys.Topic, node: str, request: object, *more: object, **names: object) -> object:
        """Reply as a node whose replies have at most three samples."""
        reply = ask(topic, node, request, *more, **names)
        if isinstance(reply, HistorySeries):
            asked.append(request)
            rows = len(reply.values) // 8
            update = {"values": reply.values[:24], "remaining": max(0, rows - 3)}
            return reply.model_copy(update=update)
        return reply

    monkeypatch.setattr(bus, "ask", limited)
    assert bus.history("oven", ["temperature"])["temperature"].tolist() == temperatures
    assert len(asked) == 3
    number = iter(range(9))
    monkeypatch.setattr(
        bus,
        "ask",
        lambda *words, **names: (
            reply.model_copy(update={"episode": next(number)})
            if isinstance(reply := limited(*words, **names), HistorySeries)
            else reply
        ),
    )
    with pytest.raises(EpisodeChanged, match="began a new episode while its history was read"):
        bus.history("oven", ["temperature"])


def test_a_new_episode__has_a_history_of_its_own(bus: zenostat.Bus) -> None:
    heat(bus, 200.0)
    bus.reset("oven", Reset())
    assert bus.history("oven", ["temperature"])["temperature"].tolist() == [20.0]


def test_history_and_alarms__mistakes_in_a_request_for_history(bus: zenostat.Bus) -> None:
    with pytest.raises(UnknownName, match="no point 'temprature'; did you mean 'temperature'"):
        bus.history("oven", ["temprature"])
    with pytest.raises(RequestRejected, match="no slot 3"):
        bus.history("oven", slot=3)
    with pytest.raises(RequestRejected, match="the node keeps steps 0 to 0"):
        bus.history("oven", start="07-04")
    with pytest.raises(InvalidConfig, match="start 'noon': expected a date and time"):
        bus.history("oven", start="noon")
    with pytest.raises(InvalidConfig, match="end 07-02 is before the episode"):
        bus.history("oven", end="07-02")
    with pytest.raises(InvalidConfig, match="max_samples"):
        bus.history("oven", max_samples=1)
    with pytest.raises(InvalidConfig, match="a list of names expected"):
        bus.history("oven", "temperature")


def test_the_manifest__states_the_memory(bus: zenostat.Bus) -> None:
    manifest = bus.manifest("oven")
    assert manifest.history_samples == manifest.steps + 1
    assert manifest.history_bytes == manifest.history_samples * 8 * (3 + 1 + 2)


def test_history_and_alarms__branch_has_no_history(bus: zenostat.Bus) -> None:
    branch = bus.branch("oven", CreateBranch())
    assert bus.manifest(branch).history_samples == 0
    with pytest.raises(RequestRejected, match="branches keep no history; ask 'oven'"):
        bus.history(branch)
    bus.stop(branch)


@pytest.mark.slow
def test_history_and_alarms__node_without_history_is_reported(scratch: Path) -> None:
    (scratch / "oven.py").write_text(OVEN)
    with node_on_bus(scratch / "node", name="oven", plant=f"{scratch}/oven.py:Oven", history_mb=0) as (node, bus):
        assert bus.manifest("oven").history_bytes == 0
        with pytest.raises(RequestRejected, match="the node keeps no history"):
            bus.history("oven")
        done = run("alarms", "oven", "--connect", node.endpoint)
        assert "oven has no alarms; `zenostat node --alarms FILE` gives a node some" in plain(done.stdout)
        with pytest.raises(UnknownName, match="no alarm 'hot'; node 'oven' has none"):
            bus.acknowledge("oven", "hot")


# Alarms


def states(bus: zenostat.Bus, node: str = "oven") -> dict[str, str]:
    return {alarm.alarm: str(alarm.state) for alarm in bus.alarms(node).alarms}


def test_an_alarm__from_its_limit_to_its_return(bus: zenostat.Bus) -> None:
    heat(bus, *[200.0] * 7)  # 27 degC; above 25 since a minute
    assert states(bus) == {"hot": "normal", "any_heat": "acknowledged"}
    heat(bus, 200.0)
    assert states(bus)["hot"] == "active"
    ack = bus.acknowledge("oven", "hot", source="ann", comment="bread")
    assert ack.text == "hot: temperature is acknowledged by ann: bread"
    heat(bus, *[0.0] * 5)  # 23 degC; below 24 for no time yet
    assert states(bus) == {"hot": "acknowledged", "any_heat": "normal"}
    heat(bus, 0.0, 0.0)
    assert states(bus)["hot"] == "normal"
    (hot, _) = bus.alarms("oven").alarms
    assert (hot.raised, hot.changed) == ("2017-07-03T00:08:00", "2017-07-03T00:15:00")


def test_a_reset__begins_with_normal_alarms(bus: zenostat.Bus) -> None:
    heat(bus, *[200.0] * 9)
    assert states(bus)["hot"] == "active"
    bus.reset("oven", Reset())
    assert states(bus) == {"hot": "normal", "any_heat": "normal"}


def test_a_snapshot__contains_the_alarms(bus: zenostat.Bus) -> None:
    heat(bus, *[200.0] * 9)
    bus.acknowledge("oven", "hot", source="ann")
    snapshot = bus.snapshot("oven").snapshot
    heat(bus, *[0.0] * 9)
    assert states(bus)["hot"] == "normal"
    bus.reset("oven", Reset(snapshot=snapshot))
    assert states(bus) == {"hot": "acknowledged", "any_heat": "acknowledged"}
    assert bus.history("oven", ["temperature"]).step.tolist() == [9]
    bus.drop("oven", snapshot)


@pytest.mark.slow
def test_a_monitor__shows_alarms_and_faults_that_go_on_without_an_event(bus: zenostat.Bus, scratch: Path) -> None:
    bias = {"name": "bias", "kind": "bias", "points": "temperature", "offset": 0.5}
    with (
        open_session(connect=[bus.endpoint], role=Role.MONITOR) as session,
        RerunStream(session, "oven", [rr.FileSink(str(scratch / "run.rrd"))]) as stream,
    ):

        def shown(alarms: tuple[str, ...], faults: tuple[str, ...]) -> bool:
            stream.pump()
            numbers = stream._nodes["oven"].numbers()
            return (*numbers.alarms, "-", *numbers.faults) == (*alarms, "-", *faults)

        bus.faults("oven", {"faults": [bias]})
        heat(bus, *[200.0] * 9)
        until(lambda: shown(("any_heat", "hot"), ("bias",)), "alarms and faults are shown")
        snapshot = bus.snapshot("oven").snapshot
        bus.faults("oven", {"faults": [bias, bias | {"name": "late", "when": {"from_step": 150}}]})
        heat(bus, *[0.0] * 9)
        until(lambda: shown((), ("bias",)), "the alarms are gone, and the fault goes on")
        bus.faults("oven", None)
        until(lambda: shown((), ()), "the fault is gone")
        bus.reset("oven", Reset(snapshot=snapshot))
        until(lambda: shown(("hot", "any_heat"), ("bias",)), "those of the snapshot are shown")
    bus.drop("oven", snapshot)
    bus.faults("oven", None)


@pytest.mark.slow
def test_what_is_set_aside__is_kept_by_snapshots_and_branches_and_ends_with_its_time(bus: zenostat.Bus) -> None:
    heat(bus, *[200.0] * 9)  # 29 degC at 00:09
    ack = bus.shelve("oven", "hot", 120, source="ann", comment="bread")
    assert ack.text == "hot: temperature is shelved until 2017-07-03T00:11:00 by ann: bread"
    bus.remove_from_service("oven", "any_heat", source="ann")
    snapshot = bus.snapshot("oven").snapshot
    branch = bus.branch("oven", CreateBranch(slots=2))
    bus.unshelve("oven", "hot")
    assert states(bus) == {"hot": "active", "any_heat": "out_of_service"}
    assert states(bus, branch) == {"hot": "shelved", "any_heat": "out_of_service"}
    with pytest.raises(RequestRejected, match=r"hot is shelved since 2017-07-03T00:09:00 until .*00:11:00, by ann"):
        bus.acknowledge(branch, "hot")
    bus.stop(branch)
    heat(bus, 0.0, 0.0)
    bus.reset("oven", Reset(snapshot=snapshot))
    (hot, _) = bus.alarms("oven").alarms
    assert (hot.state, hot.set_aside_by, hot.set_aside_until) == (AlarmState.SHELVED, "ann", "2017-07-03T00:11:00")
    heat(bus, 200.0)
    assert states(bus)["hot"] == "shelved"
    heat(bus, 200.0)
    assert states(bus) == {"hot": "active", "any_heat": "out_of_service"}
    bus.return_to_service("oven", "*")
    assert states(bus) == {"hot": "active", "any_heat": "acknowledged"}
    bus.drop("oven", snapshot)


def test_a_monitor__reads_alarms_and_history_and_decides_nothing() -> None:
    assert may(Role.MONITOR, keys.ALARMS) == may(Role.MONITOR, keys.HISTORY) == (Permission.ASK,)
    decisions = (keys.ACKNOWLEDGE, keys.SHELVE, keys.UNSHELVE, keys.REMOVE_FROM_SERVICE, keys.RETURN_TO_SERVICE)
    for topic in decisions:
        assert may(Role.MONITOR, topic) == ()
        assert may(Role.OPERATOR, topic) == (Permission.ASK,)


def test_a_recording__has_the_alarms_and_is_verified(bus: zenostat.Bus, module_scratch: Path) -> None:
    path = module_scratch / "oven.mcap"
    bus.record("oven", path)
    bus.reset("oven", Reset())
    heat(bus, *[200.0] * 9)
    bus.acknowledge("oven", "hot", source="ann", comment="bread")
    bus.alarms("oven")
    bus.history("oven")
    heat(bus, *[0.0] * 9)
    bus.shelve("oven", "hot", 60, source="ann")
    heat(bus, *[0.0] * 2)
    bus.stop_recording("oven")
    loaded = recording.load(path)
    changes = [(e.step, e.alarm.alarm, e.alarm.state, e.source) for _, e in loaded.events if e.kind is EventKind.ALARM]
    assert changes == [
        (1, "any_heat", AlarmState.ACKNOWLEDGED, ""),
        (8, "hot", AlarmState.ACTIVE, ""),
        (9, "hot", AlarmState.ACKNOWLEDGED, "ann"),
        (10, "any_heat", AlarmState.NORMAL, ""),
        (17, "hot", AlarmState.NORMAL, ""),
        (18, "hot", AlarmState.SHELVED, "ann"),
        (19, "hot", AlarmState.NORMAL, ""),
    ]
    kinds = ("alarm", "acknowledge", "alarms", "shelve")
    log = [(e.kind, e.source, e.subject, e.result) for e in loaded.log if e.kind in kinds]
    assert log == [
        ("alarm", "", "any_heat: energy is above 1000 J: 12000", "acknowledged"),
        ("alarm", "", "hot: temperature is above 25 degC: 28", "active"),
        ("acknowledge", "ann", "alarm hot, comment bread", "accepted"),
        ("alarm", "", "any_heat: energy is normal again: 0 J", "normal"),
        ("alarm", "", "hot: temperature is normal again: 21 degC", "normal"),
        ("shelve", "ann", "alarm hot, duration_s 60.0", "accepted"),
        ("alarm", "", "hot: temperature is no longer shelved, as its time is over", "normal"),
    ]
    assert all(entry.is_accepted for entry in loaded.log)
    assert verify(path, plant=f"{module_scratch}/oven.py:Oven").passed


# On the command line


def test_history_and_alarms__zenostat_shelve_and_remove_from_service(bus: zenostat.Bus, oven: NodeProgram) -> None:
    at = ("--connect", oven.endpoint, "--source", "ann")
    heat(bus, *[200.0] * 9)
    done = run("shelve", "oven", "hot", "--duration", "5min", "--comment", "bread", *at)
    assert done.stdout == "oven: hot: temperature is shelved until 2017-07-03T00:14:00 by ann: bread\n"
    done = run("remove-from-service", "oven", "any_heat", *at)
    assert done.stdout == "oven: any_heat: energy is out of service by ann\n"
    listed = plain(run("alarms", "oven", *at[:2]).stdout)
    assert "shelved until 07-03 00:14 by ann: bread, high limit" in listed
    assert "out of service by ann, high limit" in listed
    too_long = run("shelve", "oven", "hot", "--duration", "2d", *at)
    assert (too_long.returncode, "at most 86400 s" in too_long.stderr) == (1, True)
    no_time = run("shelve", "oven", "hot", "--duration", "soon", *at)
    assert (no_time.returncode, "expected a number above 0 and s, min, h or d" in no_time.stderr) == (2, True)
    assert run("return-to-service", "oven", "any_heat", *at).stdout.startswith(
        "oven: any_heat: energy is back in service by ann\n"
    )
    assert run("unshelve", "oven", "hot", *at).stdout.splitlines() == [
        "oven: hot: temperature is no longer shelved by ann",
        "oven: hot: temperature is above 25 degC: 29",
    ]


def test_history_and_alarms__zenostat_alarms_and_acknowledge(bus: zenostat.Bus, oven: NodeProgram) -> None:
    at = ("--connect", oven.endpoint)
    assert plain(run("alarms", "oven", *at).stdout) == "oven at 2017-07-03T00:00:00: 2 normal"
    heat(bus, *[200.0] * 9)
    (_, row, info) = run("alarms", "oven", *at).stdout.splitlines()
    assert row.split("  ")[0] == "active, high limit"
    assert "29 degC" in row
    assert "07-03 00:08" in row
    assert info.startswith("acknowledged")
    done = run("acknowledge", "oven", "hot", "--source", "ann", "--comment", "bread; hot", *at)
    assert done.stdout == "oven: hot: temperature is acknowledged by ann: bread; hot\n"
    again = run("acknowledge", "oven", "hot", *at)
    assert (again.returncode, "was acknowledged by ann" in again.stderr) == (1, True)
    wrong = run("acknowledge", "oven", "hott", *at)
    assert (wrong.returncode, "did you mean 'hot'" in wrong.stderr) == (2, True)
    listed = json.loads(run("alarms", "oven", "--json", *at).stdout)
    (hot,) = [alarm for alarm in listed["alarms"] if alarm["alarm"] == "hot"]
    assert (hot["state"], hot["acknowledged_by"], hot["value"]) == ("acknowledged", "ann", 29.0)


def test_history_and_alarms__zenostat_plot(bus: zenostat.Bus, oven: NodeProgram) -> None:
    heat(bus, *[200.0] * 20)
    at = ("--connect", oven.endpoint)
    done = run("plot", "oven", "temperature", "energy", *at)
    assert done.returncode == 0
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "\x1b" not in done.stdout
    assert "temperature: 20 to 40 degC, latest 40" in done.stdout
    assert "00:10" in done.stdout
    data = json.loads(run("plot", "oven", "temperature", "--from", "07-03T00:19", "--json", *at).stdout)
    assert data["points"] == {"temperature": {"unit": "degC", "values": [39.0, 40.0]}}
    assert data["time"] == ["2017-07-03T00:19:00", "2017-07-03T00:20:00"]
    wrong = run("plot", "oven", "temprature", *at)
    assert (wrong.returncode, "did you mean 'temperature'" in wrong.stderr) == (2, True)
    wrong = run("plot", "oven", "temperature", "--from", "noon", *at)
    assert (wrong.returncode, "--from 'noon': expected a date" in wrong.stderr) == (2, True)


@pytest.mark.parametrize("is_colored", [True, False])
def test_zenostat_plot__in_a_terminal(
    bus: zenostat.Bus, oven: NodeProgram, monkeypatch: pytest.MonkeyPatch, is_colored: bool
) -> None:
    from rich.console import Console

    from zenostat.cli import plot

    heat(bus, *[200.0] * 3)
    with open(os.devnull, "w") as nowhere:
        console = Console(file=nowhere, force_terminal=True, width=80, no_color=not is_colored, record=True)
        monkeypatch.setattr(plot, "out", console)
        assert run("plot", "oven", "temperature", "people", "energy", "--connect", oven.endpoint).returncode == 0
        text = console.export_text(styles=True)
    assert ("\x1b[96m" in text) is is_colored  # the color of the first line


def test_a_rule_that_does_not_fit__stops_the_node_before_anything_starts(scratch: Path) -> None:
    (scratch / "oven.py").write_text(OVEN)
    (scratch / "alarms.yaml").write_text("alarms: [{name: hot, points: temprature, high: 25}]")
    with pytest.raises(InvalidConfig, match="hot: no sensor or meter 'temprature'; did you mean 'temperature'"):
        NodeProgram(scratch / "node", plant=f"{scratch}/oven.py:Oven", alarms=str(scratch / "alarms.yaml"))
