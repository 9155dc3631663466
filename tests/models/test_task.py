"""Actions of an agent, from a scenario and the points of a model that this file defines."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.models.building.model import Building
from zenostat.models.points.selection import Points
from zenostat.models.scenario.registry import expanded
from zenostat.models.scenario.schema import Scenario, read_scenario
from zenostat.models.scenario.task import task_of
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Action, Actuator, DiscreteAction, Task, TimeField

THERMOSTAT = "Zone Temperature Control"


def setpoint(zone: str, kind: str, low: float | None = None, high: float | None = None) -> Actuator:
    usual = (15.0, 22.5) if kind == "Heating" else (22.5, 30.0)
    return Actuator(
        name=f"{zone}_{kind.lower()}",
        component_type=THERMOSTAT,
        control_type=f"{kind} Setpoint",
        key=zone.upper(),
        unit="degC",
        low=usual[0] if low is None else low,
        high=usual[1] if high is None else high,
    )


def flow(name: str, low: float | None = 0.0, high: float | None = 2.0, unit: str = "kg/s") -> Actuator:
    return Actuator(
        name=name, component_type="Fan", control_type="Fan Air Mass Flow Rate", key=name, unit=unit, low=low, high=high
    )


NORTH = setpoint("north", "Heating"), setpoint("north", "Cooling")
SOUTH = setpoint("south", "Heating"), setpoint("south", "Cooling")
FAN = flow("fan")
ALL = (*NORTH, *SOUTH, FAN)


def points(*actuators: Actuator) -> Points:
    return Points(sensors=(), meters=(), actuators=actuators, system=(), meter_parts=())


def scenario(**fields: Any) -> Scenario:
    return read_scenario({"building": "b", "weather": "w", **fields})


def task(*actuators: Actuator, **fields: Any) -> Task:
    return task_of(scenario(**fields), points(*(actuators or ALL)))


def refused(*actuators: Actuator, **fields: Any) -> list[str]:
    """The lines of the report."""
    with pytest.raises(InvalidConfig) as raised:
        task(*actuators, **fields)
    return str(raised.value).splitlines()


def plain(actions: tuple[Action, ...]) -> list[tuple[str, float | None, float | None, tuple[str, ...]]]:
    return [(a.name, a.low, a.high, a.actuators) for a in actions]


# Found in the model


@pytest.mark.parametrize("control", ["point", "zone"])
def test_task__each_actuator_has_a_dimension_of_its_own(control: str) -> None:
    built = task(control=control)
    assert plain(built.actions) == [(a.name, a.low, a.high, (a.name,)) for a in ALL]
    assert [a.unit for a in built.actions] == [a.unit for a in ALL]
    assert built.discrete_actions == ()


def test_task__building_has_one_pair_for_all_thermostats_and_the_rest_as_it_is() -> None:
    assert plain(task(control="building").actions) == [
        ("heating_setpoint", 15.0, 22.5, ("north_heating", "south_heating")),
        ("cooling_setpoint", 22.5, 30.0, ("north_cooling", "south_cooling")),
        ("fan", 0.0, 2.0, ("fan",)),
    ]


def test_task__without_actuators_there_is_nothing_to_decide() -> None:
    for control in ("point", "zone", "building"):
        built = task_of(scenario(control=control), points())
        assert (built.actions, built.discrete_actions) == ((), ())


def test_task__two_things_of_one_name_are_not_joined() -> None:
    """The joined heating setpoints are called as an actuator that the user named."""
    named = flow("heating_setpoint", 0.0, 20.0)
    try:
        built = task(*NORTH, *SOUTH, named, control="building")
    except InvalidConfig:
        return
    together = next(a.actuators for a in built.actions if "north_heating" in a.actuators)
    assert named.name not in together


bounds = st.tuples(st.none() | st.integers(0, 20), st.none() | st.integers(20, 40))


@given(st.lists(bounds, min_size=1, max_size=5))
def test_task__joined_action_has_the_bounds_that_all_its_actuators_have(
    each: list[tuple[int | None, int | None]],
) -> None:
    members = [flow(f"f{i}", low, high) for i, (low, high) in enumerate(each)]
    names = [a.name for a in members]
    lows, highs = [b[0] for b in each if b[0] is not None], [b[1] for b in each if b[1] is not None]
    meets = not (lows and highs and max(lows) == min(highs))
    if not meets:
        assert "is not below" in refused(*members, actions={"all": {"actuators": names}})[0]
        return
    (joined,) = task(*members, actions={"all": {"actuators": names}}).actions
    for value in (-1, *range(41), 99):
        everywhere = all((low is None or value >= low) and (high is None or value <= high) for low, high in each)
        within = (joined.low is None or value >= joined.low) and (joined.high is None or value <= joined.high)
        assert within == everywhere


def test_task__joined_thermostats_take_what_all_of_them_take() -> None:
    wide, narrow = setpoint("a", "Heating", 12.0, 23.0), setpoint("b", "Heating", 16.0, 21.0)
    (joined,) = task(wide, narrow, control="building").actions
    assert (joined.low, joined.high) == (16.0, 21.0)


def test_task__thermostats_that_have_no_value_in_common_cannot_be_joined() -> None:
    apart = setpoint("a", "Heating", 12.0, 16.0), setpoint("b", "Heating", 18.0, 21.0)
    assert "heating_setpoint" in refused(*apart, control="building")[0]


# Named


def test_task__actions_are_those_that_are_named_in_their_order() -> None:
    built = task(actions={"cool": {"actuators": ["south_cooling"], "low": 24, "high": 28}, "f": {"actuators": ["fan"]}})
    assert plain(built.actions) == [("cool", 24.0, 28.0, ("south_cooling",)), ("f", 0.0, 2.0, ("fan",))]


def test_task__one_bound_alone_narrows_one_side() -> None:
    (above,) = task(actions={"f": {"actuators": ["fan"], "low": 0.5}}).actions
    (below,) = task(actions={"f": {"actuators": ["fan"], "high": 0.5}}).actions
    assert [(above.low, above.high), (below.low, below.high)] == [(0.5, 2.0), (0.0, 0.5)]


def test_task__bounds_for_actuators_that_have_none() -> None:
    free = flow("free", None, None)
    (action,) = task(free, actions={"f": {"actuators": ["free"], "low": -5, "high": 5}}).actions
    assert (action.low, action.high) == (-5.0, 5.0)


def test_task__no_actions_is_not_the_same_as_actions_left_out() -> None:
    assert task(actions={}).actions == ()


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "unknown": ({"a": {"actuators": ["nort_heating"]}}, "action 'a'.*no actuator 'nort_heating'.*'north_heating'"),
    "in two": ({"a": {"actuators": ["fan"]}, "b": {"actuators": ["fan"]}}, "action 'b'.*'fan' belongs to action 'a'"),
    "twice in one": ({"a": {"actuators": ["fan", "fan"]}}, "action 'a'.*'fan'"),
    "below": ({"a": {"actuators": ["fan"], "low": -0.5}}, r"'a': low -0\.5 is outside .* 0 to 2 kg/s"),
    "above": ({"a": {"actuators": ["fan"], "high": 2.5}}, r"'a': high 2\.5 is outside .* 0 to 2 kg/s"),
    "upside down": ({"a": {"actuators": ["fan"], "low": 1.5, "high": 1}}, r"'a'.*lower bound 1\.5 .*upper bound 1\b"),
    "empty": ({"a": {"actuators": ["fan"], "low": 1, "high": 1}}, "'a'.*is not below"),
    "a slash": ({"a/b": {"actuators": ["fan"]}}, "'a/b' is not valid in a topic"),
}


@pytest.mark.parametrize(("actions", "words"), WRONG.values(), ids=WRONG)
def test_task__action_that_cannot_be_is_refused(actions: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        task(actions=actions)


def test_task_of__reports_all_errors_of_actions_at_once() -> None:
    lines = refused(
        actions={
            "a": {"actuators": ["nowhere", "fan", "fan"]},
            "b": {"actuators": ["north_heating"], "low": 10, "high": 25},
            "c": {"actuators": ["south_cooling"], "low": 29, "high": 24},
            "d/e": {"actuators": ["south_heating"]},
        }
    )
    assert [name for name in ("'nowhere'", "'fan'", "low 10", "high 25", "29", "'d/e'") if name not in str(lines)] == []


# Equal steps


def rows(task: Task) -> list[dict[str, list[float]]]:
    """For each choice dimension: action to its column."""
    return [dict(zip(c.actions, map(list, zip(*c.values, strict=True)), strict=True)) for c in task.discrete_actions]


def test_task__steps_go_from_the_widest_to_the_tightest_pair() -> None:
    (columns,) = rows(task(*NORTH, *SOUTH, control="building", discrete=4))
    assert columns["heating_setpoint"] == pytest.approx([15.0, 17.5, 20.0, 22.5])
    assert columns["cooling_setpoint"] == pytest.approx([30.0, 27.5, 25.0, 22.5])


def test_task__each_zone_chooses_on_its_own() -> None:
    north, south, fan = rows(task(control="zone", discrete=2))
    assert north == {"north_heating": [15.0, 22.5], "north_cooling": [30.0, 22.5]}
    assert south == {"south_heating": [15.0, 22.5], "south_cooling": [30.0, 22.5]}
    assert fan == {"fan": [0.0, 2.0]}


def test_task__zones_need_not_stand_side_by_side() -> None:
    mixed = (NORTH[0], SOUTH[1], FAN, SOUTH[0], NORTH[1])
    choices = rows(task(*mixed, control="zone", discrete=2))
    assert [set(columns) for columns in choices] == [
        {"north_heating", "north_cooling"},
        {"south_heating", "south_cooling"},
        {"fan"},
    ]


def test_task__each_point_chooses_on_its_own() -> None:
    choices = rows(task(control="point", discrete=3))
    assert [list(columns) for columns in choices] == [[a.name] for a in ALL]
    assert choices[0] == {"north_heating": [15.0, 18.75, 22.5]}
    assert choices[1] == {"north_cooling": [30.0, 26.25, 22.5]}
    assert choices[4] == {"fan": [0.0, 1.0, 2.0]}


@given(st.sampled_from(["point", "zone", "building"]), st.integers(2, 30))
def test_task__steps_are_equal_reach_both_ends_and_set_each_action_once(control: str, count: int) -> None:
    built = task(control=control, discrete=count)
    columns = {name: column for choice in rows(built) for name, column in choice.items()}
    assert sorted(name for choice in built.discrete_actions for name in choice.actions) == sorted(
        a.name for a in built.actions
    )
    for action in built.actions:
        column = columns[action.name]
        downwards = "cooling" in action.name
        assert column[0] == (action.high if downwards else action.low)
        assert column[-1] == (action.low if downwards else action.high)
        assert len(column) == count
        width = (column[-1] - column[0]) / (count - 1)
        assert [after - before for before, after in pairwise(column)] == pytest.approx([width] * (count - 1))


@pytest.mark.parametrize("bounds", [(None, None), (0.0, None), (None, 1.0)], ids=str)
def test_task__without_bounds_there_are_no_steps(bounds: tuple[float | None, float | None]) -> None:
    (line,) = refused(FAN, flow("free", *bounds), discrete=5)
    assert "'free' has no bounds" in line


# Named choices

PAIRS = {"heat": {"actuators": ["north_heating"]}, "cool": {"actuators": ["north_cooling"]}}


def test_task__choices_are_those_that_are_named() -> None:
    table = [{"actions": ["cool", "heat"], "values": [[30, 15], [24, 21], [24, 21]]}]
    built = task(actions=PAIRS, discrete=table)
    rows = ((30.0, 15.0), (24.0, 21.0), (24.0, 21.0))
    assert built.discrete_actions == (DiscreteAction(actions=("cool", "heat"), values=rows),)


def test_task__ends_of_an_action_may_be_chosen() -> None:
    table = [{"actions": ["fan"], "values": [[0], [2]]}]
    assert task(FAN, discrete=table).discrete_actions[0].values == ((0.0,), (2.0,))


CHOICES: dict[str, tuple[list[dict[str, Any]], str]] = {
    "short": ([{"actions": ["heat", "cool"], "values": [[15, 30], [15]]}], r"discrete\.0: row 1 has 1 values for 2"),
    "long": ([{"actions": ["heat", "cool"], "values": [[15, 30, 1]]}], r"discrete\.0: row 0 has 3 values for 2"),
    "below": ([{"actions": ["heat", "cool"], "values": [[14.9, 30]]}], r"row 0: heat = 14\.9 is outside 15 to 22\.5"),
    "above": ([{"actions": ["heat", "cool"], "values": [[20, 25], [15, 31]]}], r"row 1: cool = 31 is outside 22\.5"),
    "missing": ([{"actions": ["heat"], "values": [[15]]}], "no choices for cool"),
    "unknown": ([{"actions": ["heat", "col"], "values": [[15, 1]]}], r"discrete\.0: .*no action 'col'.*'cool'"),
    "in two": (
        [{"actions": ["heat", "cool"], "values": [[15, 30]]}, {"actions": ["heat"], "values": [[16]]}],
        r"discrete\.1: .*'heat'",
    ),
    "twice in one": ([{"actions": ["heat", "heat", "cool"], "values": [[15, 16, 30]]}], r"discrete\.0: .*'heat'"),
    "none": ([], "no choices for heat, cool"),
}


@pytest.mark.parametrize(("choices", "words"), CHOICES.values(), ids=CHOICES)
def test_task__choices_that_cannot_be_are_refused(choices: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        task(actions=PAIRS, discrete=choices)


def test_task_of__reports_all_errors_of_choices_at_once() -> None:
    lines = refused(
        actions={**PAIRS, "f": {"actuators": ["fan"]}},
        discrete=[
            {"actions": ["heat"], "values": [[14], [23], [16, 17]]},
            {"actions": ["heat", "cooll"], "values": [[15, 25]]},
        ],
    )
    expected = (
        "heat = 14", "heat = 23", "row 2 has 2", "'cooll'", "discrete.1: action 'heat'", "no choices for cool, f",
    )  # fmt: skip
    assert [words for words in expected if words not in "\n".join(lines)] == []
    assert len(lines) == len(expected)


def test_task_of__reports_errors_of_actions_and_choices_at_once() -> None:
    lines = refused(
        actions={"heat": {"actuators": ["north_heating"]}, "f": {"actuators": ["fam"]}},
        discrete=[{"actions": ["heat"], "values": [[14], [15, 16]]}, {"actions": ["f"], "values": [[1]]}],
    )
    message = "\n".join(lines)
    assert [words for words in ("'fam'", "heat = 14", "row 1 has 2") if words not in message] == []
    assert "no action 'f'" not in message, "it is there, though its actuator is not"


# The rest of the task


def test_task__task_has_what_the_scenario_states() -> None:
    reward = {"kind": "linear", "weight": 0.3}
    built = task(id="mine", time=["hour", "month"], reward=reward)
    assert (built.scenario, built.time, built.reward) == ("mine", (TimeField.HOUR, TimeField.MONTH), reward)
    assert task(reward=None).reward is None


@pytest.mark.parametrize("control", ["point", "zone", "building"])
@pytest.mark.parametrize("discrete", [None, 2, 10])
def test_task__scenario_written_out_in_full_is_the_same_task(control: str, discrete: int | None) -> None:
    building = Building("b", {"Building": {"b": {}}}, "0")
    short = scenario(id="mine", control=control, discrete=discrete)
    catalog = points(*ALL)
    task = task_of(short, catalog)
    full = expanded(short, building, catalog, task)
    assert task_of(full, catalog) == task
    assert None not in (full.begin, full.end, full.steps_per_hour, full.sensors, full.meters, full.actuators)
