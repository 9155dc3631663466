"""Recording of one node's messages."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from support import builders
from support.monitor import BEGIN, STEP, logged, office, rows, samples, static, times, two_storeys

from zenostat.metrics.comfort import default_comfort
from zenostat.topics.errors import BadMessage, InvalidConfig
from zenostat.topics.messages import (
    AlarmChange,
    AlarmPriority,
    AlarmState,
    AlarmTransition,
    Event,
    EventKind,
    EventState,
    Geometry,
    Manifest,
    NotifyType,
)
from zenostat.views.display.colors import comfort_color
from zenostat.views.live.layout import blueprint
from zenostat.views.live.node_stream import NodeStream
from zenostat.views.live.summary import NodeStatus

EPISODE = "/office/episode_0000"


@contextmanager
def _node(
    path: Path,
    manifest: Manifest,
    geometry: Geometry | None = None,
    reward: Any = None,
    history: Any = None,
    status: Any = None,
) -> Iterator[NodeStream]:
    rr.set_strict_mode(True)
    recording = rr.RecordingStream("zenostat")
    recording.set_sinks(rr.FileSink(str(path)))
    node = NodeStream(recording, manifest, geometry, default_comfort, reward, history, status)
    yield node
    node.flush()
    node.draw()
    recording.send_blueprint(blueprint([(node.model, node.view)]))
    recording.flush()
    recording.disconnect()


def _add(node: NodeStream, *args: Any, **kwargs: Any) -> None:
    for sample in samples(*args, **kwargs):
        node.add_sample(sample)


def test_rerun_node_stream__values_colors_and_times_are_those_of_the_samples(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    table = rows(8, core_air_temperature=[22, 22, 28, 28, 28.01, 17, 17, 22], outdoor_temperature=np.arange(8.0))
    with _node(path, manifest, two_storeys()) as node:
        _add(node, manifest, table[:5])
        node.flush()
        _add(node, manifest, table[5:], first=5)
    scalars = logged(path, "Scalars:scalars")
    assert [scalars[f"{EPISODE}/temperatures"][step] for step in range(8)] == table[:, 1:3].tolist()
    assert [scalars[f"{EPISODE}/outdoors"][step] for step in range(8)] == [[n] for n in range(8)]
    assert times(path, f"{EPISODE}/temperatures") == {step: BEGIN + step * STEP for step in range(8)}
    colors = logged(path, "Mesh3D:albedo_factor")
    packed = {k: (r << 24) + (g << 16) + (b << 8) + 255 for k, (r, g, b) in ((k, comfort_color(k)) for k in (0, 2, -3))}
    core = f"{EPISODE}/building/zones/Core"
    assert colors[core] == {0: [packed[0]], 2: [packed[2]], 5: [packed[-3]], 7: [packed[0]]}
    assert colors[f"{EPISODE}/building/zones/Perimeter_1"] == {0: [packed[0]]}
    assert "Mesh3D:albedo_factor" not in static(path, "Mesh3D:albedo_factor")  # it would hide the colors over time
    assert core not in static(path, "Mesh3D:albedo_factor")
    assert core in static(path, "Mesh3D:vertex_positions")


def test_rerun_node_stream__sun_is_south_of_the_building_at_noon_and_absent_at_night(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest, two_storeys()) as node:
        _add(node, manifest, rows(97))
        center, radius_m = node.model.building.center, node.model.building.radius_m
    sun = logged(path, "Points3D:positions")[f"{EPISODE}/building/sun"]
    assert sorted(sun) == list(range(0, 97, 2))
    assert sun[0] == sun[96] == []  # midnight
    east, north, up = np.array(sun[48][0]) - center
    assert north < -0.2 * radius_m
    assert abs(east) < 0.2 * radius_m  # noon in Denver is five minutes before the sun's
    assert up > radius_m
    assert sun[28][0][0] > center[0]  # in the morning it is in the east
    assert sun[70][0][0] < center[0]


def test_rerun_node_stream__events_have_the_simulated_time_of_their_step(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest) as node:
        _add(node, manifest, rows(1))
        node.add_event(Event(kind=EventKind.FAULT, text="stuck damper begins", step=10))
        assert node.numbers().faults == ("stuck damper",)
        node.add_event(Event(kind=EventKind.CONNECTED, text="rbc controls", source="rbc", step=12))
        node.add_event(Event(kind=EventKind.FAULT, text="stuck damper ends", step=20))
        assert node.numbers().faults == ()
    events = f"{EPISODE}/events"
    assert times(path, events) == {step: BEGIN + step * STEP for step in (10, 12, 20)}
    assert logged(path, "TextLog:level")[events] == {10: ["WARN"], 12: ["INFO"], 20: ["WARN"]}
    assert logged(path, "TextLog:text")[events][12] == ["1 Jul 03:00  connected: rbc controls (rbc)"]


def test_rerun_node_stream__event_of_a_step_after_the_year_9999_is_unreadable(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest) as node:
        _add(node, manifest, rows(1))
        with pytest.raises(BadMessage, match="after the year 9999"):
            node.add_event(Event(kind=EventKind.FAULT, text="forged begins", step=2**40))
        assert node.numbers().faults == ()


def test_rerun_node_stream__events_are_those_of_their_episode(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest) as node:
        for episode in (0, 1):
            node.add_event(Event(kind=EventKind.STARTED, text="begins", episode=episode))
            _add(node, manifest, rows(1), episode=episode)
        views = _views(blueprint([(node.model, node.view)]).root_container)
        (contents,) = {tuple(view.contents) for view in views if isinstance(view, rrb.TextLogView)}
    assert sorted(logged(path, "TextLog:text")) == [f"{EPISODE}/events", "/office/episode_0001/events"]
    assert contents == ("+ /office/episode_0001/events", "+ /office/events")


def _views(part: Any) -> list[Any]:
    return [view for child in part.contents for view in _views(child)] if isinstance(part, rrb.Container) else [part]


def test_rerun_node_stream__each_episode_has_entities_of_its_own_and_the_layout_the_newest(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest) as node:
        for episode in (0, 1):
            _add(node, manifest, rows(3, core_air_temperature=20.0 + episode), episode=episode)
        assert node.take_layout_change()
        assert not node.take_layout_change()
        assert node.view.log.root == "/office/episode_0001"
    scalars = logged(path, "Scalars:scalars")
    for episode in (0, 1):
        vectors = scalars[f"/office/episode_000{episode}/temperatures"]
        assert [vectors[step][0] for step in range(3)] == [20.0 + episode] * 3


def test_rerun_node_stream__lost_samples_are_counted_and_old_ones_ignored(scratch: Path) -> None:
    manifest = office()
    all_samples = samples(manifest, rows(10))
    with _node(scratch / "run.rrd", manifest) as node:
        assert node.add_sample(all_samples[4], queried=True) == 1
        assert [node.add_sample(all_samples[step]) for step in (3, 4, 5, 5, 8)] == [0, 0, 1, 0, 1]
        assert node.missed == 4 + 2  # before the first one and between two


@pytest.mark.parametrize("begins_at", [0, 7])
def test_rerun_node_stream__samples_before_the_first_one_count_from_the_episodes_first_step(
    scratch: Path, begins_at: int
) -> None:
    """An episode that goes on from a snapshot at step 7 has no earlier samples."""
    manifest = office()
    with _node(scratch / "run.rrd", manifest) as node:
        node.add_event(Event(kind=EventKind.STARTED, text="begins", step=begins_at))
        node.add_sample(samples(manifest, rows(11))[10])
        assert node.missed == 10 - begins_at


@pytest.mark.parametrize(("kept", "missed"), [(4, 2), (100, 0)])
def test_rerun_node_stream__history_of_the_node_precedes_the_first_sample(
    scratch: Path, kept: int, missed: int
) -> None:
    """A node that keeps four samples has replaced two; one that keeps a hundred began its episode at step 2."""
    path, manifest = scratch / "run.rrd", office()
    table = rows(8, core_air_temperature=20.0 + np.arange(8))
    asked = []

    def history(of: Manifest, episode: int, last_step: int) -> tuple[int, Any]:
        asked.append((of.node, episode, last_step))
        return 2, np.concatenate([table[2:5], np.tile([20.0, 25.0], (3, 1))], axis=1)  # it has lost two

    with _node(path, manifest.model_copy(update={"history_samples": kept}), history=history) as node:
        assert node.add_sample(samples(manifest, table)[5], queried=True) == 1 + 3
        assert node.add_sample(samples(manifest, table)[6]) == 1
        assert node.missed == missed
    assert asked == [("office", 0, 4)]
    temperatures = logged(path, "Scalars:scalars")[f"{EPISODE}/temperatures"]
    assert {step: values[0] for step, values in temperatures.items()} == {step: 20.0 + step for step in range(2, 7)}
    texts = logged(path, "TextDocument:text")[f"{EPISODE}/numbers"]
    assert ["not recorded" in texts[step][0] for step in range(2, 7)] == [True] * 3 + [False] * 2


def test_sample__has_its_counters_and_value_sources(scratch: Path) -> None:
    """Whatever the length of the episode; a controller that has disconnected still set what it set."""
    path, manifest = scratch / "run.rrd", office(steps=35040, end="2018-07-01T00:00:00")
    by = [("", ""), ("rbc", "rbc"), ("rbc", "operator"), ("", "")]
    with _node(path, manifest) as node:
        _add(node, manifest, rows(4), sources=by)
    texts = logged(path, "TextDocument:text")[f"{EPISODE}/numbers"]
    assert sorted(texts) == [0, 1, 2, 3]
    for step, (setters, clock) in enumerate(
        (("baseline control", "00:00"), ("rbc", "00:15"), ("rbc, operator", "00:30"), ("baseline control", "00:45"))
    ):
        assert f"**{setters}**" in texts[step][0]
        assert f"Sat 1 Jul 2017, {clock}" in texts[step][0]


def test_rerun_node_stream__alarms_and_faults_are_those_of_each_step_though_events_follow_their_sample(
    scratch: Path,
) -> None:
    path, manifest = scratch / "run.rrd", office()
    table = rows(5)
    with _node(path, manifest) as node:
        _add(node, manifest, table[:2])
        node.add_event(_alarm(1, AlarmState.ACTIVE))
        node.add_event(_alarm(1, AlarmState.ACTIVE, slot=1))
        _add(node, manifest, table[2:3], first=2)
        node.flush()
        node.add_event(_alarm(2, AlarmState.ACKNOWLEDGED))  # its sample has been logged
        node.add_event(Event(kind=EventKind.FAULT, text="stuck damper begins", step=2))
        _add(node, manifest, table[3:], first=3)
        node.add_event(_alarm(4, AlarmState.NORMAL))
    texts = logged(path, "TextDocument:text")[f"{EPISODE}/numbers"]
    assert ["too warm" in texts[step][0] for step in range(5)] == [False, True, True, True, False]
    assert ["stuck damper" in texts[step][0] for step in range(5)] == [False, False, True, True, True]
    assert len(logged(path, "TextLog:text")[f"{EPISODE}/events"]) == 3  # of steps 1, 2 and 4; slot 1 is not shown


def _alarm(step: int, state: AlarmState, slot: int = 0) -> Event:
    change = AlarmChange(
        alarm="too warm", point="core_air_temperature", slot=slot, transition=AlarmTransition.TO_OFFNORMAL,
        event_state=EventState.HIGH_LIMIT, state=state, priority=AlarmPriority.HIGH, notify=NotifyType.ALARM,
        unit="degC", time="2017-07-01T00:15:00",
    )  # fmt: skip
    return Event(kind=EventKind.ALARM, text="too warm", step=step, alarm=change)


def test_rerun_node_stream__what_holds_for_a_timestep_begins_with_sample_1(scratch: Path) -> None:
    """The timestep that sample 0 closes belongs to the warmup, whose setpoints may be far from the episode's."""
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest) as node:
        _add(node, manifest, rows(1), effective=(15.6, 15.6))
        _add(node, manifest, rows(2), first=1)
    scalars = logged(path, "Scalars:scalars")
    assert scalars[f"{EPISODE}/actuators/0"] == {1: [20.0], 2: [20.0]}
    assert sorted(scalars[f"{EPISODE}/temperatures"]) == [0, 1, 2]


def test_rerun_node_stream__numbers_of_the_newest_sample(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    table = rows(3, core_air_temperature=28.0, electricity=3.6e6, core_occupants=[0, 2, 2], outdoor_temperature=31.5)
    with _node(path, manifest) as node:
        _add(node, manifest, table, sources=[("rbc", "rbc")] * 3)
        node.flush()
        numbers = node.numbers()
    assert (numbers.low_degc, numbers.high_degc, numbers.outdoor_degc) == (22.0, 28.0, 31.5)
    assert (numbers.zones, numbers.zones_outside, numbers.people) == (2, 1, 2.0)
    assert (numbers.facility_kw, numbers.facility_kwh) == pytest.approx((4.0, 2.0))
    assert (numbers.outside_kh, numbers.occupied_kh) == pytest.approx((1.0, 1.0))
    assert numbers.sources == ("rbc",)
    assert numbers.peak_kw == pytest.approx(4.0)
    assert numbers.band_degc == (20.0, 26.0)
    (text,) = logged(path, "TextDocument:text")[f"{EPISODE}/numbers"][2]
    for shown in (
        "Sat 1 Jul 2017, 00:30",
        "31.5 °C",
        "22.0 to 28.0 °C",
        "1 of 2 zones",
        "4.0 kW, 2 kWh",
        "1.0 K h",
        "rbc",
    ):
        assert f"**{shown}**" in text


def test_rerun_node_stream__reward_terms_are_those_of_each_timestep(scratch: Path) -> None:
    path, manifest, begins = scratch / "run.rrd", office(), []

    def terms(values: Any, begin: Any) -> dict[str, float]:
        begins.append(np.datetime64(begin, "ns"))
        return {"energy": -values[5], "comfort": values[1]}

    with _node(path, manifest, reward=lambda _: terms) as node:
        _add(node, manifest, rows(3, electricity=[1.0, 2.0, 3.0]))
    assert logged(path, "Scalars:scalars")[f"{EPISODE}/reward"] == {1: [-2.0, 22.0], 2: [-3.0, 22.0]}
    assert begins == [BEGIN, BEGIN + STEP]
    assert static(path, "SeriesLines:names")[f"{EPISODE}/reward"] == ["Energy", "Comfort"]


def test_rerun_node_stream__reward_that_cannot_be_bound_is_left_out(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()

    def unbound(_: Manifest) -> None:
        raise InvalidConfig("the node lacks a point")

    with _node(path, manifest, reward=unbound) as node:
        _add(node, manifest, rows(2))
    assert f"{EPISODE}/reward" not in logged(path, "Scalars:scalars")


@pytest.mark.parametrize("days", [1, 60])
def test_rerun_node_stream__zones_and_value_sources_are_pictures_with_the_cursor(scratch: Path, days: int) -> None:
    path = scratch / "run.rrd"
    with _node(path, manifest := office(steps=96 * days, end="2017-08-30T00:00:00")) as node:
        _add(node, manifest, rows(9))
    pictures = static(path, "EncodedImage:blob")
    cursors = logged(path, "LineStrips2D:strips")
    for name in ("zones_over_time", "sources"):
        assert f"{EPISODE}/{name}" in pictures
        places = [strips[0][0][0] for _, strips in sorted(cursors[f"{EPISODE}/{name}/cursor"].items())]
        assert len(places) == (9 if days == 1 else 2)  # a column has five timesteps in two months
        assert places == sorted(set(places))


@pytest.mark.parametrize(
    "manifest",
    [
        builders.manifest(),
        builders.manifest(sensors=[builders.sensor("level", "", unit="m").model_copy(update={"key": ""})]),
        builders.manifest(actuators=[builders.actuator("valve")]),
    ],
    ids=["empty", "sensor", "actuator"],
)
def test_rerun_node_stream__plant_without_zones_has_a_layout(scratch: Path, manifest: Manifest) -> None:
    path = scratch / "run.rrd"
    with _node(path, manifest) as node:
        _add(node, manifest, np.ones((3, len(manifest.points))))
    entities = {entity for entity, _ in logged(path, "Scalars:scalars").items()}
    assert len(entities) == bool(manifest.points) + 2 * bool(manifest.actuators)  # commanded and effective values


def test_rerun_node_stream__only_the_first_slot_is_shown(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office(slots=2)
    with _node(path, manifest) as node:
        for sample in samples(office(), rows(2, core_air_temperature=21.5)):
            doubled = {name: 2 * getattr(sample, name) for name in ("values", "effective", "source_index")}
            node.add_sample(sample.model_copy(update=doubled))
    assert logged(path, "Scalars:scalars")[f"{EPISODE}/temperatures"][1] == [21.5, 22.0]


def test_rerun_node_stream__fault_that_is_in_the_new_plan_too_goes_on(scratch: Path) -> None:
    path, manifest = scratch / "run.rrd", office()
    with _node(path, manifest) as node:
        _add(node, manifest, rows(1))
        for text, expected in (
            ("stuck, very begins", ("stuck, very",)),
            ("bias begins", ("stuck, very", "bias")),
            ("faults are set: stuck, very, drift", ("stuck, very",)),
            ("faults are set: very", ()),
        ):
            node.add_event(Event(kind=EventKind.FAULT, text=text))
            assert node.numbers().faults == expected


def test_rerun_node_stream__episode_from_a_snapshot_has_its_alarms_and_faults(scratch: Path) -> None:
    path, manifest, reads = scratch / "run.rrd", office(), []
    present = NodeStatus(("too warm",), ("stuck",))

    def status(of: Manifest) -> NodeStatus:
        reads.append(of.node)
        return present if len(reads) > 1 else NodeStatus()

    with _node(path, manifest, status=status) as node:
        _add(node, manifest, rows(1))
        node.add_event(_alarm(0, AlarmState.ACTIVE))
        node.add_event(Event(kind=EventKind.STARTED, text="begins", episode=1))
        _add(node, manifest, rows(1), episode=1)
        assert (node.numbers().alarms, len(reads)) == ((), 1)  # a reset clears them
        node.add_event(Event(kind=EventKind.STARTED, text="begins", episode=2, step=7))
        _add(node, manifest, rows(2), episode=2, first=7)
        assert (node.numbers().alarms, node.numbers().faults, len(reads)) == (*present, 2)
        node.add_event(_alarm(8, AlarmState.NORMAL))
        assert node.numbers().alarms == ()
