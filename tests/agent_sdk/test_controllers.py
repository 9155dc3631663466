"""The controllers' rules, on manifests and samples made by hand."""

import math
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import actuator, manifest, sensor, view
from support.controller_nodes import COOL, HEAT, PEOPLE, ROOM, discrete, node, single

from zenostat.agent_sdk.controllers import (
    CONTROLLERS,
    Agent,
    FixedSetpoints,
    IncrementalRules,
    RandomController,
    RuleBasedController,
    ScheduledSetback,
    action_of,
    make_controller,
)
from zenostat.agent_sdk.controllers.action_roles import Role, bind_actions
from zenostat.agent_sdk.envs.spaces import action_space
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Action, Actuator, DiscreteAction, Task

WINTER = datetime(2017, 1, 16, 12)  # a Monday
SUMMER = datetime(2017, 7, 17, 12)
QUARTER = timedelta(minutes=15)


def thermostat(name: str, zone: str, what: str, low: float, high: float) -> Actuator:
    return Actuator(
        name=name, component_type="Zone Temperature Control", control_type=what, key=zone, unit="degC",
        low=low, high=high,
    )  # fmt: skip


# What an action is


@pytest.mark.parametrize(
    ("name", "low", "high", "role"),
    [
        ("Heating_Setpoint_RL", 15.0, 22.5, Role.HEATING),
        ("htgsetp", None, None, Role.HEATING),
        ("office_cooling_setpoint", 22.5, 35.0, Role.COOLING),
        ("chws_supply_temperature", 5.0, 10.0, Role.COLD_WATER),
        ("water_temperature", 25.0, 45.0, Role.HOT_WATER),
        ("radiant_bed1_availability", 0.0, 1.0, Role.AVAILABILITY),
        ("battery_discharge_rate", 0.0, 1.0, Role.STORAGE),
        ("cooling_coil_fraction", 0.0, 1.0, Role.OTHER),
        ("cooling_flow", 0.0, 5.0, Role.OTHER),
        ("fan", 0.0, 1.0, Role.OTHER),
    ],
)
def test_controllers__what_an_action_is(name: str, low: float | None, high: float | None, role: Role) -> None:
    assert bind_actions(single(name, low, high))[0].role is role


def test_controllers__power_of_a_heater_is_no_setpoint() -> None:
    heater = actuator("heater", 0.0, 3000.0).model_copy(update={"unit": "W"})
    assert bind_actions(manifest(actuators=[heater]))[0].role is Role.OTHER


def test_controllers__thermostats_have_their_own_zone_and_switches_the_room_of_their_name() -> None:
    sensors = (
        sensor("bedroom01_air", key="BED1"),
        sensor("bedroom02_air", key="BED2"),
        sensor("livingroom_air", key="LIVING"),
        sensor("people_b2", "Zone People Occupant Count", "BED2", "1"),
    )
    of = node(
        thermostat("b2_heating", "Bed2", "Heating Setpoint", 15.0, 22.5),
        actuator("radiant_bed1_availability", 0.0, 1.0),
        actuator("radiant_living_availability", 0.0, 1.0),
        actuator("radiant_water", 25.0, 45.0),
        sensors=sensors,
    )
    rooms = [part.temperatures for part in bind_actions(of)]
    assert rooms == [(1,), (0,), (2,), (0, 1, 2)]
    assert [part.people for part in bind_actions(of)] == [(3,)] * 4  # what is not measured follows what is


# Rules on comfort bands


def test_controllers__rules_keep_the_seasons_band_while_people_are_in_and_set_back_else() -> None:
    of = node(sensors=(ROOM, PEOPLE))
    rules = RuleBasedController(of)
    assert rules.act(view(of, WINTER, people=2.0)) == pytest.approx({HEAT.name: 21.0, COOL.name: 22.5})
    assert rules.act(view(of, WINTER, people=0.0)) == pytest.approx({HEAT.name: 19.0, COOL.name: 24.5})
    assert rules.act(view(of, SUMMER, people=2.0)) == pytest.approx({HEAT.name: 22.5, COOL.name: 25.0})


def test_controllers__rules_set_back_far_where_the_reward_counts_occupied_hours_only() -> None:
    of = node(HEAT, COOL, sensors=(ROOM, PEOPLE))
    of = of.model_copy(update={"task": of.task.model_copy(update={"reward": {"kind": "occupied"}})})
    night = WINTER.replace(hour=3)
    assert RuleBasedController(of).act(view(of, night, people=0.0)) == pytest.approx({HEAT.name: 15.0, COOL.name: 29.5})
    closed = ScheduledSetback(of).act(view(of, night))
    assert closed == pytest.approx({HEAT.name: 15.0, COOL.name: 29.5})


def test_controllers__rules_bring_a_zone_back_an_hour_before_people_came_the_day_before() -> None:
    of = node(sensors=(ROOM, PEOPLE))
    rules = RuleBasedController(of)
    arrival = datetime(2017, 1, 16, 8)  # the first sample that counts them closes the quarter that began at 7:45
    rules.act(view(of, arrival, people=1.0))
    back = {}
    for minutes in range(0, 24 * 60, 15):
        at = datetime(2017, 1, 17) + timedelta(minutes=minutes)
        back[at.time().isoformat("minutes")] = rules.act(view(of, at, people=0.0))[HEAT.name] == pytest.approx(21.0)
    assert [at for at, comfortable in back.items() if comfortable] == ["06:45", "07:00", "07:15", "07:30", "07:45"]


def test_controllers__rules_forget_at_an_episodes_begin() -> None:
    of = node(sensors=(ROOM, PEOPLE))
    rules = RuleBasedController(of)
    rules.act(view(of, datetime(2017, 1, 16, 8), people=1.0))
    noon = view(of, datetime(2017, 1, 17, 12), people=0.0)
    assert rules.act(noon)[HEAT.name] == 19.0
    rules.begin(noon)
    assert rules.act(noon)[HEAT.name] == pytest.approx(21.0)  # nobody has been seen yet


def test_controllers__where_nobody_is_counted_zones_are_in_use_at_night_too() -> None:
    of = node()
    assert RuleBasedController(of).act(view(of, datetime(2017, 1, 16, 3)))[HEAT.name] == pytest.approx(21.0)


def test_controllers__band_is_the_rewards_or_the_users() -> None:
    reward = {"kind": "linear", "winter": (18.0, 27.0), "summer": (18.0, 27.0)}
    cooling = actuator("cooling_setpoint", 20.0, 30.0)
    action = Action(name="cooling_setpoint", unit="degC", low=20.0, high=30.0, actuators=("cooling_setpoint",))
    of = node(cooling, task=Task(actions=(action,), reward=reward))
    assert RuleBasedController(of).act(view(of)) == pytest.approx({"cooling_setpoint": 26.0})
    assert RuleBasedController(of, high=25.0, margin=0.0).act(view(of)) == {"cooling_setpoint": 25.0}
    strange = node(cooling, task=Task(actions=(action,), reward={"kind": "somebody's"}))
    assert RuleBasedController(strange).act(view(strange, SUMMER)) == pytest.approx({"cooling_setpoint": 25.0})


def test_controllers__july_is_winter_in_the_south() -> None:
    of = node().model_copy(update={"latitude_deg": -33.9})
    assert RuleBasedController(of).act(view(of, SUMMER)) == pytest.approx({HEAT.name: 21.0, COOL.name: 22.5})


def test_controllers__margin_wider_than_the_band_meets_in_its_middle() -> None:
    of = node(actuator("heating_setpoint", 10.0, 30.0), actuator("cooling_setpoint", 10.0, 30.0))
    assert set(RuleBasedController(of, low=20.0, high=21.0, margin=5.0).act(view(of)).values()) == {20.5}


def test_rbc__an_action_on_several_thermostats_follows_any_occupied_zone() -> None:
    sensors = [sensor(f"air_{z}", key=z) for z in "AB"]
    sensors += [sensor(f"people_{z}", "Zone People Occupant Count", z, "1") for z in "AB"]
    pair = tuple(thermostat(f"heat_{z}", z, "Heating Setpoint", 15.0, 22.5) for z in "AB")
    together = Action(name="heating", unit="degC", low=15.0, high=22.5, actuators=("heat_A", "heat_B"))
    of = node(*pair, sensors=tuple(sensors), task=Task(actions=(together,)))
    setpoints = RuleBasedController(of).act(view(of, people_A=0.0, people_B=1.0))
    assert setpoints == pytest.approx({"heat_A": 21.0, "heat_B": 21.0})
    assert action_of(of, setpoints).tolist() == pytest.approx([21.0], rel=1e-6)
    each = node(*pair, sensors=tuple(sensors))
    apart = RuleBasedController(each).act(view(each, WINTER.replace(hour=3), people_A=0.0, people_B=1.0))
    assert apart == pytest.approx({"heat_A": 19.0, "heat_B": 21.0})


@pytest.mark.parametrize(("air", "hot"), [(18.0, 45.0), (20.0, 45.0), (20.5, 35.0), (21.0, 25.0), (30.0, 25.0)])
def test_controllers__heating_water_is_hottest_at_the_bands_lower_end(air: float, hot: float) -> None:
    of = single("water_temperature", 25.0, 45.0)
    assert RuleBasedController(of).act(view(of, air=air)) == {"water_temperature": hot}


@pytest.mark.parametrize(("air", "cold"), [(22.5, 10.0), (23.0, 7.5), (23.5, 5.0), (30.0, 5.0)])
def test_controllers__chilled_water_is_coldest_at_the_bands_upper_end(air: float, cold: float) -> None:
    of = single("chw_temperature", 5.0, 10.0)
    assert RuleBasedController(of).act(view(of, air=air)) == {"chw_temperature": cold}


def test_controllers__switch_goes_on_below_the_band_and_off_above_its_middle() -> None:
    of = single("radiant_availability", 0.0, 1.0)
    rules = RuleBasedController(of, margin=0.3)
    airs = [21.8, 21.0, 20.4, 20.2, 21.0, 21.7, 21.8, 21.0]
    assert [rules.act(view(of, air=air))["radiant_availability"] for air in airs] == [0, 0, 0, 1, 1, 1, 0, 0]
    rules.begin(view(of))
    assert rules.act(view(of, air=21.0)) == {"radiant_availability": 1.0}  # below the middle, nothing is known


def test_controllers__storage_is_idle() -> None:
    of = node(HEAT, actuator("battery_charge_rate", 0.0, 1.0))
    assert RuleBasedController(of).act(view(of))["battery_charge_rate"] == 0.0


SITE = node(
    HEAT,
    COOL,
    actuator("chw_temperature", 5.0, 10.0),
    actuator("hot_water", 25.0, 45.0),
    actuator("availability", 0.0, 1.0),
    actuator("battery_charge", 0.0, 1.0),
    sensors=(ROOM, PEOPLE),
)


PORTABLE = ("portable-limit", "portable-setback")
"""Controllers that need a semantic model."""


@pytest.mark.variants
@pytest.mark.parametrize(
    "name", sorted(set(CONTROLLERS) - {"baseline", "coordinator", "offsets", "oracle", "pid", *PORTABLE})
)
@given(
    samples=st.lists(
        st.tuples(
            st.floats(-60.0, 60.0), st.floats(0.0, 50.0), st.datetimes(datetime(2016, 1, 1), datetime(2020, 12, 31))
        ),
        min_size=1,
        max_size=8,
    )
)
def test_controllers__what_is_set_lies_within_the_bounds(
    name: str, samples: list[tuple[float, float, datetime]]
) -> None:
    controller, space = CONTROLLERS[name](SITE), action_space(SITE)
    for air, people, at in samples:
        values = controller.act(view(SITE, at, air=air, people=people))
        assert set(values) == {a.name for a in SITE.actuators}
        assert values[HEAT.name] <= values[COOL.name]
        assert space.contains(action_of(SITE, values))


@pytest.mark.parametrize(
    ("controller", "arguments", "message"),
    [
        (RuleBasedController, {"margin": -1}, "margin = -1; expected a number of at least 0"),
        (RuleBasedController, {"preconditioning": 24}, "preconditioning = 24; expected a number from 0 to 23"),
        (RuleBasedController, {"setback": "much"}, "setback = 'much'; expected a number of at least 0"),
        (RuleBasedController, {"low": 24.0}, r"the comfort band 24 to 23.5 degC is reversed"),
        (RuleBasedController, {"marign": 1}, "RuleBasedController has no parameter 'marign'; did you mean 'margin'"),
        (FixedSetpoints, {"heating_setpoint": 25}, "heating_setpoint = 25; its bounds are 15 to 22.5 degC"),
        (FixedSetpoints, {"heatng_setpoint": 20},
            "node 'office' has no action or actuator 'heatng_setpoint'; did you mean 'heating"),
        (FixedSetpoints, {"heating_setpoint": "warm"}, "heating_setpoint = 'warm'; expected a number"),
        (ScheduledSetback, {"days": "monday"}, "days = 'monday'; expected weekdays, such as 'mon-fri'"),
        (ScheduledSetback, {"opens": 7, "closes": 7}, "opens = closes = 7"),
        (ScheduledSetback, {"closes": 25}, "closes = 25; expected a number from 0 to 24"),
        (ScheduledSetback, {"heating": 40}, "heating = 40; its bounds are 15 to 22.5"),
        (ScheduledSetback, {"cooling_setback": 20}, "cooling_setback = 20; its bounds are 22.5 to 30"),
    ],
)  # fmt: skip
def test_controllers__parameters_that_cannot_be(controller: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        make_controller(controller, node(), arguments)


@pytest.mark.parametrize(
    ("controller", "others", "message"),
    [
        (RuleBasedController, manifest(), "the rule-based controller needs an action that sets a heating"),
        (IncrementalRules, node(sensors=()), "needs an action that sets a heating or cooling setpoint, and a sensor"),
    ],
)
def test_controllers__rules_need_something_to_rule(controller: Any, others: Any, message: str) -> None:
    for of in (single("fan", 0.0, 1.0), others):
        with pytest.raises(InvalidConfig, match=message):
            controller(of)


# Random


def test_controllers__random_is_uniform_repeats_by_its_seed_and_goes_on_after_a_begin() -> None:
    of = node()
    first, second = RandomController(of, seed=1), RandomController(of, seed=1)
    drawn = [first.act(view(of)) for _ in range(2000)]
    assert [second.act(view(of)) for _ in range(2000)] == drawn
    assert RandomController(of, seed=2).act(view(of)) != drawn[0]
    heat = np.array([values[HEAT.name] for values in drawn])
    # Uniform on 15 to 22.5: mean 18.75, standard deviation 7.5 / sqrt(12); of the mean of 2000, a 45th of that.
    assert abs(heat.mean() - 18.75) < 5 * 7.5 / math.sqrt(12 * 2000)
    assert heat.min() < 15.1
    assert heat.max() > 22.4
    first.begin(view(of))
    assert first.act(view(of)) not in drawn


def test_controllers__random_draws_rows_of_choices() -> None:
    rows = ((15.0, 30.0), (20.0, 25.0), (22.0, 23.0))
    of = node(task=discrete(DiscreteAction(actions=(HEAT.name, COOL.name), values=rows)))
    control = RandomController(of, seed=0)
    drawn = {(values[HEAT.name], values[COOL.name]) for values in (control.act(view(of)) for _ in range(100))}
    assert drawn == set(rows)


def test_controllers__random_needs_bounds_and_a_seed_that_is_one() -> None:
    with pytest.raises(InvalidConfig, match="'heating_setpoint' has no bounds to draw from: add bounds"):
        RandomController(single("heating_setpoint", None, 22.5))
    with pytest.raises(InvalidConfig, match="seed = -1"):
        RandomController(node(), seed=-1)


# Fixed


def test_controllers__fixed_values_by_name_and_the_bands_ends_for_the_rest() -> None:
    of = node()
    assert FixedSetpoints(of, heating_setpoint=21.5).act(view(of)) == {HEAT.name: 21.5, COOL.name: 22.5}
    assert FixedSetpoints(of).act(view(of, SUMMER)) == {HEAT.name: 22.5, COOL.name: 25.0}  # 24 is out of bounds


@pytest.mark.parametrize(
    ("of", "arguments"),
    [
        (FixedSetpoints, {"heating_setpoint": 27}),
        (FixedSetpoints, {"cooling_setpoint": 19}),
        (ScheduledSetback, {"heating": 27}),
        (ScheduledSetback, {"cooling": 19}),
        (ScheduledSetback, {"heating_setback": 34}),
    ],
)
def test_controllers__setpoint_that_crosses_the_bands_end_is_refused(of: Any, arguments: dict[str, float]) -> None:
    """The other setpoint of a pair is the comfort band's: 20 to 23.5 degC in winter, 23 to 26 in summer."""
    office = node(actuator("heating_setpoint", 10.0, 35.0), actuator("cooling_setpoint", 10.0, 35.0))
    with pytest.raises(InvalidConfig, match="is above cooling_setpoint"):
        of(office, **arguments)


def test_controllers__fixed_heating_above_cooling_is_refused() -> None:
    of = node(actuator("heating_setpoint", 15.0, 25.0), actuator("cooling_setpoint", 20.0, 30.0))
    with pytest.raises(InvalidConfig, match=r"heating_setpoint = 24 is above cooling_setpoint = 22; EnergyPlus stops"):
        FixedSetpoints(of, heating_setpoint=24.0, cooling_setpoint=22.0)


# Setback


@pytest.mark.parametrize(
    ("at", "is_open"),
    [
        (datetime(2017, 1, 16, 6, 45), False),  # Monday
        (datetime(2017, 1, 16, 7), True),
        (datetime(2017, 1, 16, 18, 45), True),
        (datetime(2017, 1, 16, 19), False),
        (datetime(2017, 1, 20, 12), True),  # Friday
        (datetime(2017, 1, 21, 12), False),  # Saturday
    ],
)
def test_controllers__setback_at_the_boundaries_of_hours_and_days(at: datetime, is_open: bool) -> None:
    of = node()
    control = ScheduledSetback(
        of, opens=7, closes=19, days="mon-fri", heating=21, cooling=24, heating_setback=16, cooling_setback=29
    )
    expected = {HEAT.name: 21.0, COOL.name: 24.0} if is_open else {HEAT.name: 16.0, COOL.name: 29.0}
    assert control.act(view(of, at)) == expected


@pytest.mark.parametrize(
    ("at", "is_open"),
    [
        (datetime(2017, 1, 20, 21, 45), False),
        (datetime(2017, 1, 20, 22), True),  # Friday night, which ends on Saturday
        (datetime(2017, 1, 21, 5, 45), True),
        (datetime(2017, 1, 21, 6), False),
        (datetime(2017, 1, 21, 23), False),
    ],
)
def test_controllers__setback_over_midnight_belongs_to_the_day_on_which_it_opened(at: datetime, is_open: bool) -> None:
    of = node()
    control = ScheduledSetback(of, opens=22, closes=6, days="fri", heating=21, heating_setback=15)
    assert control.act(view(of, at))[HEAT.name] == (21.0 if is_open else 15.0)


def test_controllers__setback_by_default_is_inside_the_band_and_at_night_outside_where_people_are_counted() -> None:
    of, night = node(sensors=(ROOM, PEOPLE)), WINTER.replace(hour=3)
    assert ScheduledSetback(of).act(view(of)) == {HEAT.name: 21.0, COOL.name: 22.5}
    assert ScheduledSetback(of).act(view(of, night)) == {HEAT.name: 19.0, COOL.name: 24.5}
    assert ScheduledSetback(of, heating=22).act(view(of, night)) == {HEAT.name: 21.0, COOL.name: 24.5}
    uncounted = node()
    assert ScheduledSetback(uncounted).act(view(uncounted, night)) == {HEAT.name: 21.0, COOL.name: 22.5}


def test_controllers__setback_needs_setpoints_and_heating_below_cooling() -> None:
    with pytest.raises(InvalidConfig, match="setback needs an action that sets a heating or cooling setpoint"):
        ScheduledSetback(single("fan", 0.0, 1.0))
    wide = node(actuator("heating_setpoint", 10.0, 30.0), actuator("cooling_setpoint", 10.0, 30.0))
    with pytest.raises(InvalidConfig, match="heating, cooling = 25, 22; the first has to be below the second"):
        ScheduledSetback(wide, heating=25, cooling=22)


# Incremental


def test_controllers__incremental_moves_by_its_step_to_the_middle_and_back_to_the_end() -> None:
    of = node(actuator("heating_setpoint", 10.0, 30.0), actuator("cooling_setpoint", 10.0, 30.0))
    control = IncrementalRules(of, step=0.5, margin=0.2)  # winter: 20 to 23.5, middle 21.75
    hot = [control.act(view(of, air=25.0))["cooling_setpoint"] for _ in range(5)]
    assert hot == [23.0, 22.5, 22.0, 21.75, 21.75]
    fine = [control.act(view(of, air=22.0))["cooling_setpoint"] for _ in range(5)]
    assert fine == [22.25, 22.75, 23.25, 23.5, 23.5]
    cold = [control.act(view(of, air=20.1))["heating_setpoint"] for _ in range(5)]
    assert cold == [20.5, 21.0, 21.5, 21.75, 21.75]
    assert control.act(view(of, air=20.2))["heating_setpoint"] == 21.25  # the margin is reached


def test_controllers__incremental_forgets_at_an_episodes_begin() -> None:
    of = node()
    agent = Agent(IncrementalRules(of, step=0.25))
    moved = [agent.values(view(of, air=30.0, step=k))[COOL.name] for k in range(3)]
    assert moved == [23.25, 23.0, 22.75]
    assert agent.values(view(of, air=30.0, episode=1))[COOL.name] == 23.25
    assert agent.values(view(of, air=30.0, episode=1, step=1))[COOL.name] == 23.0


def test_controllers__incremental_reads_the_mean_of_its_zones() -> None:
    of = node(COOL, sensors=(sensor("a"), sensor("b")))
    control = IncrementalRules(of, margin=0.0)
    assert control.act(view(of, a=25.0, b=22.0))[COOL.name] == 23.5  # a mean of 23.5 is comfortable
    assert control.act(view(of, a=25.1, b=22.0))[COOL.name] == 23.0
