"""All alarms of a node: rules applied to points, samples in, events out."""

from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples

from zenostat.bridge.alarms.monitor import AlarmMonitor
from zenostat.bridge.alarms.rules import applies_at, point_alarms, read_rules
from zenostat.bridge.alarms.state_machine import Alarm
from zenostat.bridge.node.plant import PlantDescription, RunPeriod
from zenostat.topics.alarm_rules import AlarmRule, AlarmRules
from zenostat.topics.energyplus_names import OCCUPANTS
from zenostat.topics.errors import InvalidConfig, RequestRejected, UnknownName
from zenostat.topics.messages import (
    Acknowledge,
    AlarmState,
    AlarmTransition,
    EventKind,
    EventState,
    Meter,
    NotifyType,
    RemoveFromService,
    ReturnToService,
    Sensor,
    Shelve,
    Unshelve,
    Versions,
)

STEP_S = 900.0
MONDAY = datetime(2017, 7, 3)


def plant(step_s: float = STEP_S, begin: datetime = MONDAY) -> PlantDescription:
    """Points: temperatures of a core and a north zone, occupants of the core, electricity."""
    air = "Zone Mean Air Temperature"
    return PlantDescription(
        "x",
        RunPeriod(begin, step_s, 1000),
        (
            Sensor(name="core_air", variable=air, key="Core", unit="degC"),
            Sensor(name="north_air", variable=air, key="North", unit="degC"),
            Sensor(name="core_people", variable=OCCUPANTS, key="CORE", unit="1", observed=False),
        ),
        (Meter(name="electricity", unit="J"),),
        (),
        Versions(zenostat="1"),
    )


class Node:
    """Feeds samples of one or more slots to a monitor, one step after the other."""

    def __init__(self, *rules: dict[str, Any], slots: int = 1, **period: Any) -> None:
        self.slots, self.step = slots, -1
        parsed = AlarmRules.model_validate({"alarms": list(rules)})
        self.monitor = AlarmMonitor(parsed, plant(**period), slots)

    def sample(self, core: float = 22.0, north: float = 22.0, people: float = 1.0, joules: float = 0.0) -> list[Any]:
        self.step += 1
        values = np.array([[core, north, people, joules]] * self.slots)
        return self.monitor.update(values.tobytes(), [0] * self.slots, [self.step] * self.slots)

    def state(self, slot: int = 0) -> dict[str, str]:
        return {alarm.alarm: str(alarm.state) for alarm in self.monitor.status(slot).alarms}


WARM = {"name": "warm", "points": "core_air", "high": 26.0, "unit": "degC"}


def test_an_event__reports_the_transition() -> None:
    node = Node(WARM)
    assert node.sample(26.0) == []
    (event,) = node.sample(26.5)
    assert (event.kind, event.step, event.text) == (EventKind.ALARM, 1, "warm: core_air is above 26 degC: 26.5")
    change = event.alarm
    assert (change.alarm, change.point, change.value, change.limit, change.unit) == (
        "warm",
        "core_air",
        26.5,
        26.0,
        "degC",
    )
    assert (change.transition, change.event_state) == (AlarmTransition.TO_OFFNORMAL, EventState.HIGH_LIMIT)
    assert (change.state, change.time) == (AlarmState.ACTIVE, "2017-07-03T00:15:00")
    assert node.sample(27.0) == []  # it is known
    (event,) = node.sample(25.9)
    assert event.text == "warm: core_air is normal again: 25.9 degC"
    assert event.alarm.state is AlarmState.RETURNED


@pytest.mark.parametrize("when", [{}, {"suppress_when": {"point": "core_people", "above": 0.5}}])
def test_meters__have_alarms_from_the_first_timestep_on(when: dict[str, Any]) -> None:
    """At step 0 no timestep has been measured."""
    node = Node({"name": "idle", "points": "electricity", "low": 1e6, **when})
    assert node.sample(people=1.0) == []
    assert node.state() == {"idle": "normal"}
    events = node.sample(people=1.0)
    assert node.state() == {"idle": "suppressed" if when else "active"}
    assert len(events) == 1 + bool(when)


def test_a_missing_value__is_a_fault() -> None:
    node = Node(WARM)
    (event,) = node.sample(float("nan"))
    assert event.text == "warm: core_air has no value"
    assert (event.alarm.value, event.alarm.transition) == (None, AlarmTransition.TO_FAULT)
    assert node.sample(float("nan")) == []


@pytest.mark.parametrize(("delay_s", "step_s", "raised_at"), [(0, 900, 0), (1, 900, 1), (900, 900, 1), (901, 900, 2)])
def test_a_delay__is_in_simulated_time(delay_s: float, step_s: float, raised_at: int) -> None:
    node = Node(WARM | {"delay_s": float(delay_s)}, step_s=float(step_s))
    assert [bool(node.sample(27.0)) for _ in range(4)] == [step == raised_at for step in range(4)]


def test_a_delay_of_whole_timesteps__is_not_lengthened_by_rounding() -> None:
    node = Node(WARM | {"delay_s": 0.3}, step_s=0.1)  # 0.3 / 0.1 is 2.9999999999999996 or 3.0000000000000004
    assert [bool(node.sample(27.0)) for _ in range(4)] == [False, False, False, True]


def test_several_points__have_an_alarm_each() -> None:
    node = Node(WARM | {"points": "*_air"})
    assert list(node.state()) == ["warm/core_air", "warm/north_air"]
    node.sample(22.0, 27.0)
    assert node.state() == {"warm/core_air": "normal", "warm/north_air": "active"}


def test_occupied__is_by_the_zone_of_the_point() -> None:
    node = Node(WARM | {"occupied": True, "deadband": 0.5})
    assert node.sample(27.0, people=0.0) == []
    assert node.monitor.status(0).alarms[0].inhibited
    assert len(node.sample(27.0, people=2.0)) == 1
    (event,) = node.sample(27.0, people=0.0)
    assert "the rule does not apply now" in event.text
    assert len(node.sample(27.0, people=float("nan"))) == 1  # unknown counts as occupied


def test_alarms__hours_and_weekdays() -> None:
    node = Node(WARM | {"hours": [8, 18], "weekdays": ["mon"]}, step_s=3600.0)
    active = [step for step in range(48) if (node.sample(27.0), node.state()["warm"] == "active")[1]]
    assert active == list(range(8, 18))  # Monday from 8:00, and not on Tuesday


def test_an_acknowledgment__is_kept_with_its_source_and_comment() -> None:
    node = Node(WARM, WARM | {"name": "info", "high": 25.0, "notify": "event"})
    node.sample(27.0)
    (event,) = node.monitor.request(Acknowledge(alarm="warm", source="ann", comment="a fan"))
    assert (event.source, event.text) == ("ann", "warm: core_air is acknowledged by ann: a fan")
    assert event.alarm.transition is AlarmTransition.ACKNOWLEDGE
    assert node.state() == {"warm": "acknowledged", "info": "acknowledged"}
    row = node.monitor.status(0).alarms[0]
    assert (row.acknowledged_by, row.comment, row.times_raised) == ("ann", "a fan", 1)
    with pytest.raises(RequestRejected, match="warm was acknowledged by ann at 2017-07-03T00:00:00"):
        node.monitor.request(Acknowledge(alarm="warm"))
    with pytest.raises(RequestRejected, match="info needs no acknowledgment"):
        node.monitor.request(Acknowledge(alarm="info"))
    node.sample(22.0)
    with pytest.raises(RequestRejected, match="warm is normal"):
        node.monitor.request(Acknowledge(alarm="warm"))
    with pytest.raises(UnknownName, match="no alarm 'wram'; did you mean 'warm'"):
        node.monitor.request(Acknowledge(alarm="wram"))
    node.sample(27.0)
    assert node.monitor.status(0).alarms[0].acknowledged_by == ""  # it is a new occurrence


@pytest.mark.parametrize(("name", "count"), [("warm", 2), ("warm/north_air", 1), ("*core*", 1), ("*", 2)])
def test_an_acknowledgment__is_of_an_alarm_a_rule_or_a_pattern(name: str, count: int) -> None:
    node = Node(WARM | {"points": ["core_air", "north_air"]})
    node.sample(27.0, 27.0)
    assert len(node.monitor.request(Acknowledge(alarm=name))) == count


def test_slots__have_alarms_of_their_own() -> None:
    node = Node(WARM | {"delay_s": STEP_S}, slots=2)

    def update(cores: list[float], steps: list[int]) -> list[tuple[int, str]]:
        values = np.array([[core, 22.0, 1.0, 0.0] for core in cores])
        return [(e.alarm.slot, e.text) for e in node.monitor.update(values.tobytes(), [0, 0], steps)]

    assert update([27.0, 27.0], [0, 0]) == []
    # Only the first slot steps: the sample of the other one is published again, which is no passing of its time.
    assert update([27.0, 27.0], [1, 0]) == [(0, "slot 0: warm: core_air is above 26 degC: 27")]
    assert update([27.0, 27.0], [1, 1]) == [(1, "slot 1: warm: core_air is above 26 degC: 27")]
    node.monitor.request(Acknowledge(alarm="warm", slot=1))
    assert (node.state(0), node.state(1)) == ({"warm": "active"}, {"warm": "acknowledged"})
    node.monitor.reset([1])
    assert (node.state(0), node.state(1)) == ({"warm": "active"}, {"warm": "normal"})


# Set aside


SHELVED, ACTIVE = AlarmState.SHELVED, AlarmState.ACTIVE


def changes(events: list[Any]) -> list[tuple[str, str]]:
    return [(str(event.alarm.transition), str(event.alarm.state)) for event in events]


def test_a_shelved_alarm__alerts_nobody_until_its_time_is_over() -> None:
    node = Node(WARM)  # a timestep has 900 s
    node.sample(22.0)
    (event,) = node.monitor.request(Shelve(alarm="warm", duration_s=1801.0, source="ann", comment="doors are open"))
    assert event.text == "warm: core_air is shelved until 2017-07-03T00:45:00 by ann: doors are open"
    assert (event.source, event.alarm.until, event.alarm.state) == ("ann", "2017-07-03T00:45:00", SHELVED)
    (event,) = node.sample(27.0)  # it is in the log, and alerts nobody
    assert event.text == "warm: core_air is above 26 degC (shelved): 27"
    assert (event.alarm.state, event.alarm.event_state) == (SHELVED, EventState.HIGH_LIMIT)
    row = node.monitor.status(0).alarms[0]
    assert (row.set_aside, row.set_aside_by, row.set_aside_comment) == ("2017-07-03T00:00:00", "ann", "doors are open")
    assert (row.set_aside_until, row.raised, row.times_raised) == ("2017-07-03T00:45:00", "", 0)
    assert node.sample(27.0) == []
    over, raised = node.sample(27.5)  # 00:45, the first timestep that is not before the end
    assert over.text == "warm: core_air is no longer shelved, as its time is over"
    assert raised.text == "warm: core_air is above 26 degC: 27.5"
    assert changes([over, raised]) == [("expire", "normal"), ("to_offnormal", "active")]
    row = node.monitor.status(0).alarms[0]
    assert (row.set_aside, row.set_aside_by, row.set_aside_until) == ("", "", "")
    assert (row.raised, row.times_raised) == ("2017-07-03T00:45:00", 1)


@pytest.mark.parametrize("duration_s", [900.0, 1.0, 1e-12])
def test_a_time_limit__is_rounded_up_to_whole_timesteps(duration_s: float) -> None:
    node = Node(WARM)
    node.sample(27.0)
    (event,) = node.monitor.request(Shelve(alarm="warm", duration_s=duration_s))
    assert event.alarm.until == "2017-07-03T00:15:00"
    assert changes(node.sample(27.0)) == [("expire", "normal"), ("to_offnormal", "active")]


def test_unshelving__raises_what_is_off_normal() -> None:
    node = Node(WARM, WARM | {"name": "hot", "high": 30.0})
    node.sample(27.0)
    node.monitor.request(Acknowledge(alarm="warm"))
    node.monitor.request(Shelve(alarm="*", duration_s=3600.0, source="ann"))
    assert node.state() == {"warm": "shelved", "hot": "shelved"}
    events = node.monitor.request(Unshelve(alarm="*", source="ben"))
    assert [(e.text, e.source) for e in events] == [
        ("warm: core_air is no longer shelved by ben", "ben"),
        ("warm: core_air is above 26 degC: 27", ""),
        ("hot: core_air is no longer shelved by ben", "ben"),
    ]
    assert node.state() == {"warm": "active", "hot": "normal"}
    assert [node.sample(27.0) for _ in range(5)] == [[]] * 5  # the time limit went with the shelving


def test_out_of_service__has_no_limit_unless_one_is_requested() -> None:
    node = Node(WARM)
    node.sample(27.0)
    (event,) = node.monitor.request(RemoveFromService(alarm="warm", source="ann"))
    assert event.text == "warm: core_air is out of service by ann"
    assert [node.sample(27.0) for _ in range(9)] == [[]] * 9
    with pytest.raises(RequestRejected, match="warm is out of service since 2017-07-03T00:00:00, by ann"):
        node.monitor.request(Shelve(alarm="warm", duration_s=60.0))
    with pytest.raises(RequestRejected, match="warm is out of service since"):
        node.monitor.request(Acknowledge(alarm="warm"))
    assert node.monitor.request(RemoveFromService(alarm="warm", duration_s=900.0))[0].alarm.until
    over, raised = node.sample(27.0)
    assert over.text == "warm: core_air is back in service, as its time is over"
    assert raised.alarm.state is ACTIVE
    node.monitor.request(RemoveFromService(alarm="warm"))
    returned, raised = node.monitor.request(ReturnToService(alarm="warm", source="ann", comment="replaced"))
    assert returned.text == "warm: core_air is back in service by ann: replaced"
    assert raised.alarm.state is ACTIVE


def test_alarms__operators_decision_prevails_over_shelving_and_conditions() -> None:
    condition = {"suppress_when": {"point": "core_people", "below": 0.5}}
    node = Node(WARM | condition)
    node.sample(22.0, people=0.0)
    node.monitor.request(Shelve(alarm="warm", duration_s=9000.0))
    node.monitor.request(RemoveFromService(alarm="warm"))
    assert node.sample(27.0, people=1.0)[0].alarm.state is AlarmState.OUT_OF_SERVICE
    node.sample(27.0, people=0.0)
    events = node.monitor.request(ReturnToService(alarm="warm"))
    assert changes(events) == [("return_to_service", "normal"), ("suppress", "suppressed")]


@pytest.mark.parametrize(
    "when", [{"suppress_when": {"point": "electricity", "below": 1.0}}, {"occupied": "electricity"}]
)
def test_conditions__meter_is_missing_before_the_first_timestep(when: dict[str, Any]) -> None:
    node = Node(WARM | when)
    (event,) = node.sample(27.0)
    assert event.alarm.transition is AlarmTransition.TO_OFFNORMAL
    assert node.state() == {"warm": "active"}
    node.sample(27.0)  # now it has measured 0 J
    assert node.state() != {"warm": "active"}


def test_a_condition__suppresses_while_it_holds() -> None:
    node = Node(WARM | {"suppress_when": {"point": "core_people", "above": 1.0, "below": 5.0}})
    assert node.sample(27.0, people=1.0)[0].alarm.state is ACTIVE  # the limit itself does not suppress
    (event,) = node.sample(27.0, people=2.0)
    assert event.text == "warm: core_air is suppressed (core_people is above 1 and below 5)"
    assert (event.alarm.state, event.alarm.event_state) == (AlarmState.SUPPRESSED, EventState.HIGH_LIMIT)
    assert changes(node.sample(27.0, people=5.0)) == [("unsuppress", "normal"), ("to_offnormal", "active")]
    node.sample(22.0, people=2.0)
    assert changes(node.sample(22.0, people=float("nan"))) == [("unsuppress", "normal")]  # unknown does not suppress


def test_a_value_that_changes_with_the_condition__raises_no_alarm() -> None:
    node = Node(WARM | {"suppress_when": {"point": "core_people", "above": 1.0}})
    node.sample(22.0, people=0.0)
    assert changes(node.sample(27.0, people=2.0)) == [("suppress", "suppressed"), ("to_offnormal", "suppressed")]
    assert changes(node.sample(22.0, people=0.0)) == [("to_normal", "suppressed"), ("unsuppress", "normal")]
    assert node.monitor.status(0).alarms[0].times_raised == 0


def test_requests_without_an_effect__state_why() -> None:
    node = Node(WARM | {"max_shelve_s": 3600.0}, WARM | {"name": "vital", "max_shelve_s": 0.0})
    with pytest.raises(RequestRejected, match="no episode has begun"):
        node.monitor.request(Shelve(alarm="warm", duration_s=60.0))
    node.sample(22.0)
    for request, text in (
        (Unshelve(alarm="warm"), "warm is not shelved"),
        (ReturnToService(alarm="warm"), "warm is in service"),
        (Shelve(alarm="warm", duration_s=3601.0), "warm can be shelved for at most 3600 s, not for 3601 s"),
        (Shelve(alarm="warm", duration_s=3600.0000001), "for at most 3600 s, not for 3600.0000001 s"),
        (Shelve(alarm="*", duration_s=60.0), "vital cannot be shelved"),
    ):
        with pytest.raises(RequestRejected, match=text):
            node.monitor.request(request)
    with pytest.raises(UnknownName, match="no alarm 'wram'; did you mean 'warm'"):
        node.monitor.request(Shelve(alarm="wram", duration_s=60.0))
    assert set(node.state().values()) == {"normal"}


def test_a_new_episode__has_nothing_set_aside() -> None:
    node = Node(WARM)
    node.sample(22.0)
    node.monitor.request(Shelve(alarm="warm", duration_s=9000.0))
    node.monitor.reset([0])
    assert node.state() == {"warm": "normal"}
    assert node.sample(27.0)[0].alarm.state is ACTIVE


def test_a_snapshot_and_a_branch__keep_what_is_set_aside() -> None:
    node = Node(WARM, WARM | {"name": "gone"}, slots=2)
    node.sample(22.0)
    node.monitor.request(Shelve(alarm="warm", slot=1, duration_s=1800.0, source="ann"))
    node.monitor.request(RemoveFromService(alarm="gone", slot=1))
    saved = node.monitor.capture()
    for branch in (node.monitor.of_branch(1, 3, None), node.monitor.of_branch(1, 3, saved)):
        values = np.array([[27.0, 22.0, 1.0, 0.0]] * 3)
        assert branch.update(values.tobytes(), [0] * 3, [0] * 3) == []  # the branch's first sample is the parent's
        assert [branch.status(slot).alarms[0].set_aside_by for slot in range(3)] == ["ann"] * 3
        branch.update(values.tobytes(), [0] * 3, [1] * 3)
        events = branch.update(values.tobytes(), [0] * 3, [2] * 3)
        assert changes(events) == [("expire", "normal"), ("to_offnormal", "active")] * 3
        assert {alarm.alarm: str(alarm.state) for alarm in branch.status(2).alarms}["gone"] == "out_of_service"
    assert node.state(1) == {"warm": "shelved", "gone": "out_of_service"}  # the parent's own have not changed
    node.monitor.request(Unshelve(alarm="warm"))
    node.monitor.restore(saved)
    assert node.monitor.status(1).alarms[0].set_aside_until == "2017-07-03T00:30:00"


RULES = (
    {"name": "range", "points": "*_air", "low": 18.0, "high": 26.0, "deadband": 0.5, "delay_s": 1800.0},
    {"name": "occupied", "points": "core_air", "high": 25.0, "occupied": True, "return_delay_s": 900.0},
    {"name": "night", "points": "core_air", "low": 20.0, "hours": [22, 6], "notify": "event"},
    {"name": "party", "points": "core_air", "high": 25.0, "suppress_when": {"point": "core_people", "above": 0.5}},
)
SAMPLES = st.lists(
    st.tuples(st.sampled_from([17.0, 18.2, 19.0, 22.0, 25.2, 25.7, 27.0, float("nan")]), st.sampled_from([0.0, 1.0])),
    min_size=1,
    max_size=50,
)


def test_applies_at__hours_include_their_start_and_not_their_end() -> None:
    """Each multiple of 0.005 h is a whole second: 0.675 is 0:40:30, which the sum of its parts is not exactly."""
    for thousandths in range(0, 23_000, 5):
        start = datetime(2017, 7, 3) + timedelta(seconds=thousandths * 3.6)
        hours = [thousandths / 1000, (thousandths + 500) / 1000]
        rule = AlarmRule.model_validate({"name": "r", "points": ["x"], "high": 1.0, "hours": hours})
        assert applies_at(rule, start)
        assert not applies_at(rule, start + timedelta(minutes=30))


@settings(max_examples=examples(50))
@given(SAMPLES)
def test_the_screening__misses_nothing(samples: list[tuple[float, float]]) -> None:
    """Each alarm has the states of a state machine that gets every value."""
    node = Node(*RULES)
    points = point_alarms(AlarmRules.model_validate({"alarms": list(RULES)}), plant())
    machines = [Alarm(point.limits, point.rule.notify is NotifyType.ALARM) for point in points]
    for step, (core, people) in enumerate(samples):
        events = node.sample(core, 22.0, people)
        moment, transitions = plant().run_period.time(step), []
        for point, machine in zip(points, machines, strict=True):
            inhibited = not applies_at(point.rule, moment) or (point.occupants is not None and people <= 0)
            value = (core, 22.0)[point.column]
            suppressed = point.suppressor is not None and people > 0.5
            changes = machine.update(value, step, inhibited=inhibited, suppressed=suppressed)
            transitions += [(point.name, change.transition, change.event_state, change.state) for change in changes]
        alarms = [event.alarm for event in events]
        assert [(a.alarm, a.transition, a.event_state, a.state) for a in alarms] == transitions


@settings(max_examples=examples(50))
@given(SAMPLES, SAMPLES)
def test_a_snapshot__continues_with_the_same_events(
    first: list[tuple[float, float]], second: list[tuple[float, float]]
) -> None:
    node = Node(*RULES)
    for core, people in first:
        node.sample(core, 22.0, people)
    saved, step = node.monitor.capture(), node.step
    expected = [[e.text for e in node.sample(core, 22.0, people)] for core, people in second]
    node.monitor.reset([0])
    node.monitor.restore(saved)
    node.step = step - 1
    assert node.sample(first[-1][0], 22.0, first[-1][1]) == []  # the snapshot's own sample is published again
    assert [[e.text for e in node.sample(core, 22.0, people)] for core, people in second] == expected


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        ({"points": "core_ear"}, "warm: no sensor or meter 'core_ear'; did you mean 'core_air'"),
        ({"points": "*_earth"}, "warm: no sensor or meter matches '*_earth'"),
        ({"points": "*_people"}, "no sensor or meter matches '*_people'"),  # it is there only for pictures
        ({"unit": "K"}, "warm: core_air is in degC, not in K"),
        ({"points": "*", "unit": None}, "different units, for which one limit is not right: "),
        ({"points": "north_air", "occupied": True}, "the occupants of the zone of north_air are not measured"),
        ({"occupied": "people"}, "occupied: no sensor 'people'; did you mean 'core_people'"),
        (
            {"suppress_when": {"point": "poeple", "above": 1}},
            "suppress_when: no sensor or meter 'poeple'; did you mean",
        ),
        (
            {"suppress_when": {"point": "core_air", "above": 1, "unit": "K"}},
            "suppress_when: core_air is in degC, not in K",
        ),
    ],
)
def test_rules_that_do_not_fit_the_plant__are_named(rule: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig) as raised:
        Node(WARM | rule)
    assert text in str(raised.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("alarms: [{name: a, points: x, hihg: 3}]", ["alarms.0: there is no field 'hihg'; did you mean 'high'"]),
        ("alarms: [{name: a, points: x}]", ["a rule needs a limit: high, low or both"]),
        ("alarms: [{name: a, points: x, low: 5, high: 4}]", ["low 5 is not below high 4"]),
        ("alarms: [{name: a, points: x, low: 4, high: 5, deadband: 1}]", ["deadband 1 leaves no normal values"]),
        ("alarms: [{name: a b, points: x, low: 5}]", ["alarms.0.name", "such as zone_too_warm"]),
        ("alarms: [{name: a, points: x, low: 5}, {name: a, points: y, low: 5}]", ["used more than once: 'a'"]),
        ("alarms: [{name: a, points: x, low: 5, delay_s: -1}]", ["alarms.0.delay_s"]),
        ("alarms: [{name: a, points: x, low: 5, weekdays: [monday]}]", ["alarms.0.weekdays.0"]),
        ("alarms: [{name: a, points: x, low: 5, suppress_when: {pont: y, above: 1}}]",
            ["alarms.0.suppress_when: there is no field 'pont'; did you mean 'point'"]),
        ("alarms: [{name: a, points: x, low: 5, suppress_when: {point: y}}]",
            ["a condition needs a limit: above, below"]),
        ("alarms: [{name: a, points: x, low: 5, suppress_when: {point: y, above: 2, below: 1}}]",
            ["above 2 and below 1 at once: no value is both"]),
        ("alarms: [{name: a, points: x, low: 5, max_shelve_s: -1}]", ["alarms.0.max_shelve_s"]),
        ("alarms: []", ["expected 1 to 1000 rules, got 0"]),
        ("alarm: []", ["alarms: it is missing", "did you mean 'alarms'"]),
    ],
)  # fmt: skip
def test_a_file_with_errors__is_named_with_each_of_them(folder: Path, text: str, words: list[str]) -> None:
    path = folder / "alarms.yaml"
    path.write_text(text)
    with pytest.raises(InvalidConfig, match=r"alarms\.yaml") as raised:
        read_rules(path)
    for word in words:
        assert word in str(raised.value)


def test_alarms__file_that_is_not_there_is_named(folder: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"there is no file .*nowhere\.yaml"):
        read_rules(folder / "nowhere.yaml")


def test_alarms__page_shows_the_example() -> None:
    root = Path(__file__).parents[2]
    assert (root / "examples/alarms.yaml").read_text() in (root / "docs/alarms.md").read_text()
