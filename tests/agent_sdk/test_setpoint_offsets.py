"""The rule `offsets`, which shifts the building's own setpoints."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import actuator, manifest, meter, sensor, view
from support.controller_nodes import PEOPLE, ROOM, node

from zenostat.agent_sdk.controllers import Agent, BaselineController, SetpointOffsets, action_of
from zenostat.agent_sdk.controllers.agent import values_of
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.lab.evaluate import run_episode
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Action, Manifest

MONDAY = datetime(2017, 1, 16)
OWN = {"heating_own": 15.0, "cooling_own": 30.0}
"""What the building sets in the next timestep, degC."""
TARIFF: dict[str, Any] = {
    "kind": "occupied_cost", "gas_price": None, "threshold_kw": 0.0,
    "price": {"table": [{"value": 0.3, "hours": [12, 20]}], "otherwise": 0.1, "unit": "EUR/kWh"},
}  # fmt: skip


def office(bound: float = 8.0, highest: float = 22.5) -> Manifest:
    """One room whose two setpoints are offsets of at most `bound` to the building's own."""
    actuators = (
        actuator("heating_setpoint", 5.0, highest).model_copy(update={"baseline_sensor": "heating_own"}),
        actuator("cooling_setpoint", 22.5, 40.0).model_copy(update={"baseline_sensor": "cooling_own"}),
    )
    own = (sensor("heating_own", "Schedule Value", "HEATING"), sensor("cooling_own", "Schedule Value", "COOLING"))
    of = manifest(sensors=(ROOM, PEOPLE, *own), actuators=actuators, meters=[meter("electricity")])
    actions = tuple(
        action.model_copy(update={"low": -bound, "high": bound, "unit": "K", "relative": True})
        for action in of.task.actions
    )
    return of.model_copy(update={"task": of.task.model_copy(update={"reward": TARIFF, "actions": actions})})


def setpoints(rules: SetpointOffsets, hour: int, *, people: float, day: int = 16) -> tuple[float | None, float | None]:
    at = MONDAY.replace(day=day, hour=hour)
    result = rules.act(view(rules.manifest, at, people=people, **OWN))
    return result["heating_setpoint"], result["cooling_setpoint"]


def test_setpoint_offsets__zeros_leave_the_building_to_itself() -> None:
    rules = SetpointOffsets(office())
    assert [setpoints(rules, hour, people=hour % 2) for hour in range(24)] == [(None, None)] * 24


def test_setpoint_offsets__occupied_and_empty_zones_have_their_own() -> None:
    rules = SetpointOffsets(
        office(), heating_occupied=-0.5, cooling_occupied=1.0, heating_empty=-4.0, cooling_empty=5.0, lead=2.0
    )
    assert setpoints(rules, 5, people=0.0) == (11.0, 35.0)
    assert setpoints(rules, 7, people=0.0) == (14.5, 31.0)  # assumed, as nobody was observed yet
    assert setpoints(rules, 9, people=3.0) == (14.5, 31.0)  # so they came at 8:55, five minutes before
    assert setpoints(rules, 20, people=0.0) == (11.0, 35.0)
    assert setpoints(rules, 6, people=0.0, day=17) == (11.0, 35.0)
    assert setpoints(rules, 7, people=0.0, day=17) == (14.5, 31.0)  # two hours before
    rules.begin(view(rules.manifest, MONDAY, people=0.0, **OWN))
    assert setpoints(rules, 12, people=0.0) == (14.5, 31.0)  # assumed again


def test_setpoint_offsets__zones_are_cooled_before_high_prices_and_less_during_them() -> None:
    rules = SetpointOffsets(office(), cooling_occupied=1.0, precooling=3.0, shed_cooling=2.0, price_lead=2.0)
    assert [setpoints(rules, hour, people=1.0)[1] for hour in (9, 10, 11, 12, 19, 20)] == [31, 28, 28, 33, 33, 31]


def test_setpoint_offsets__setpoints_do_not_come_closer_and_keep_their_bounds() -> None:
    rules = SetpointOffsets(office(), heating_occupied=2.0, cooling_occupied=-4.0, heating_empty=-20.0)
    assert setpoints(rules, 9, people=1.0) == (17.0, 26.0)  # their bounds keep them apart
    overlap = SetpointOffsets(office(highest=25.0), heating_occupied=2.0, cooling_occupied=-4.0)
    assert setpoints(overlap, 9, people=1.0) == (14.0, 29.0)  # both by the mean, -1 K
    assert setpoints(rules, 23, people=0.0) == (7.0, None)  # an action's bound: -8 K
    wide = SetpointOffsets(office(bound=20.0), heating_empty=-20.0)
    assert setpoints(wide, 23, people=0.0) == (5.0, None)  # the actuator's


def test_setpoint_offsets__needs_relative_actions() -> None:
    with pytest.raises(
        InvalidConfig, match=r"no action of node 'office' is an offset .*: set relative: 3 in the scenario"
    ):
        SetpointOffsets(node(actuator("heating_setpoint", 15.0, 22.5)))
    with pytest.raises(InvalidConfig, match="shed_cooling = -1"):
        SetpointOffsets(office(), shed_cooling=-1.0)


def hall_and_office(bound: float = 20.0) -> Manifest:
    """One offset for the heating setpoints of a hall and an office."""
    names = ("hall", "office")
    actuators = tuple(actuator(name, 7.2, 22.5).model_copy(update={"baseline_sensor": f"{name}_own"}) for name in names)
    own = tuple(sensor(f"{name}_own", "Schedule Value", name) for name in names)
    of = manifest(sensors=(ROOM, *own), actuators=actuators)
    action = Action(name="heating", unit="K", low=-bound, high=bound, actuators=names, relative=True)
    return of.model_copy(update={"task": of.task.model_copy(update={"actions": (action,)})})


@given(st.floats(-20.0, 20.0, width=32), st.floats(7.2, 22.5), st.floats(7.2, 22.5))
def test_action_of__is_the_offset_of_the_values_unless_all_are_clipped(
    offset: float, hall: float, office: float
) -> None:
    of = hall_and_office()
    sample = view(of, hall_own=hall, office_own=office)

    def effective(action: float) -> list[float]:
        values = values_of(of, [action], sample)  # None: the building's own value
        return [own if (value := values[name]) is None else value for name, own in (("hall", hall), ("office", office))]

    (again,) = action_of(of, values_of(of, [offset], sample), sample)
    if any(7.2 < own + offset < 22.5 for own in (hall, office)):
        assert again == pytest.approx(offset, abs=1e-5)
    assert effective(again) == pytest.approx(effective(offset), abs=1e-5)


def test_action_of__cold_hall_does_not_halve_the_setback_of_its_office() -> None:
    of = hall_and_office()
    sample = view(of, hall_own=7.2, office_own=21.0)
    assert action_of(of, {"hall": 7.2, "office": 16.0}, sample).tolist() == [-5.0]
    assert action_of(of, {"hall": None, "office": 16.0}, sample).tolist() == [-2.5]  # the hall is left as it is


@pytest.mark.slow
@pytest.mark.process
def test_setpoint_offsets__zeros_have_the_rewards_of_the_baseline_to_the_bit() -> None:
    env = BuildingEnv(scenario="ref-small-office-USA_CO_Denver-continuous-v1", begin="07-10", end="07-11", relative=4.0)
    try:
        results = []
        for controller in (SetpointOffsets(env.manifest), BaselineController(env.manifest)):
            agent = Agent(controller, env)
            results.append(run_episode(env, lambda _, agent=agent: agent.action(env.sample), seed=0)[0])
        assert results[0] == results[1]
    finally:
        env.close()
