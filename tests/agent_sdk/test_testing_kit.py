"""The fake building against theory and hand calculation; the conformance kit passes what is good."""

import copy
import gc
import math
import pickle
import re
from collections.abc import Callable
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.agent_sdk.controllers import (
    BaselineController,
    FixedSetpoints,
    RandomController,
    RuleBasedController,
    ScheduledSetback,
)
from zenostat.agent_sdk.rewards import LinearReward
from zenostat.agent_sdk.testing import (
    Climate,
    ConformanceError,
    FakeBuilding,
    FakeEnv,
    FakeLink,
    RCZones,
    Zone,
    check_controller,
    check_environment,
    check_reward,
)
from zenostat.agent_sdk.testing.check_controller import CONTROLLER_CHECKS
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.agent_sdk.wrappers import PreviousObservation, RewardVector, apply_wrappers, names_of
from zenostat.topics.errors import (
    EpisodeChanged,
    InvalidAction,
    InvalidConfig,
    ModelError,
    PeerError,
    RequestRejected,
    UnknownName,
    UsageError,
)

CALM = Climate(noise_k=0.0)
OFF = (np.array([-1e9]), np.array([1e9]))
"""Setpoints that no room reaches."""

ROOM = Zone("room", capacity_j_per_k=3.6e6, resistance_k_per_w=0.01, heating_w=5000.0, cooling_w=5000.0)
"""Its time constant is 36,000 s: ten hours."""

temps = st.floats(-30, 50)
watts = st.floats(0, 5000)


def column(*values: float) -> Any:
    return np.array(values, float)


# The room against the closed form


def test_testing_kit__hour_of_a_free_room_by_hand() -> None:
    """From 20 degC towards 0 + 0.01 * 1000 = 10 degC: 10 + 10 e^-0.1, and its mean 10 + 10 * 10 (1 - e^-0.1)."""
    flow = RCZones([ROOM]).step(column(20), 0.0, column(1000), *OFF, 3600.0)
    assert flow.end_degc[0] == pytest.approx(19.0483742, abs=1e-7)
    assert flow.mean_degc[0] == pytest.approx(19.5162582, abs=1e-7)
    assert flow.heat_w[0] == 0.0


def test_testing_kit__what_holds_a_room_is_what_it_loses() -> None:
    """At 20 degC it loses 20 / 0.01 = 2000 W outdoors at 0 degC: 1000 W of gains leave 1000 W to the heating."""
    flow = RCZones([ROOM]).step(column(20), 0.0, column(1000), column(20), column(25), 3600.0)
    assert flow.heat_w[0] == pytest.approx(1000.0)
    assert flow.end_degc[0] == pytest.approx(20.0)
    warm = RCZones([ROOM]).step(column(25), 35.0, column(500), column(20), column(25), 3600.0)
    assert warm.heat_w[0] == pytest.approx(-(10.0 / 0.01 + 500.0))


def test_testing_kit__thermostat_gives_no_more_than_it_can() -> None:
    """5000 W for ever would end at -10 + 0.01 * 5000 = 40 degC; an hour brings 10 degC to 40 - 30 e^-0.1."""
    flow = RCZones([ROOM]).step(column(10), -10.0, column(0), column(22), column(25), 3600.0)
    assert flow.heat_w[0] == 5000.0
    assert flow.end_degc[0] == pytest.approx(40.0 - 30.0 * math.exp(-0.1))
    hot = RCZones([ROOM]).step(column(40), 40.0, column(0), column(20), column(24), 3600.0)
    assert hot.heat_w[0] == -5000.0


@given(start=temps, outdoor=temps, gains=watts, parts=st.integers(2, 60))
def test_testing_kit__many_short_timesteps_are_one_long_one(
    start: float, outdoor: float, gains: float, parts: int
) -> None:
    rooms, now = RCZones([ROOM]), column(start)
    for _ in range(parts):
        now = rooms.step(now, outdoor, column(gains), *OFF, 7200.0 / parts).end_degc
    calm = outdoor + 0.01 * gains
    assert now[0] == pytest.approx(calm + (start - calm) * math.exp(-0.2), abs=1e-9)


@given(start=temps, outdoor=temps, gains=watts, heating=st.floats(15, 22.5), cooling=st.floats(22.5, 30))
def test_testing_kit__heat_that_comes_is_stored_or_goes(
    start: float, outdoor: float, gains: float, heating: float, cooling: float
) -> None:
    flow = RCZones([ROOM]).step(column(start), outdoor, column(gains), column(heating), column(cooling), 900.0)
    stored_w = 3.6e6 * (flow.end_degc[0] - start) / 900.0
    through_wall_w = (outdoor - flow.mean_degc[0]) / 0.01
    assert stored_w == pytest.approx(through_wall_w + gains + flow.heat_w[0], rel=1e-9, abs=1e-5)
    if abs(flow.heat_w[0]) < 5000.0:
        assert heating - 1e-9 <= flow.end_degc[0] <= cooling + 1e-9


# The building


def run(building: FakeBuilding, seed: int = 0) -> list[dict[str, float]]:
    """An episode under the building's own control."""
    names = building.manifest.names
    rows = [building.reset(seed)]
    nobody = np.full(len(building.manifest.actuators), np.nan)
    rows += [building.advance(nobody)[0] for _ in range(building.manifest.steps)]
    return [dict(zip(names, row.tolist(), strict=True)) for row in rows]


def test_testing_kit__each_timestep_of_a_building_keeps_its_energy() -> None:
    building = FakeBuilding(2, cop=2.5)
    nobody = np.full(4, np.nan)
    building.reset(seed=3)
    before, heats = building.zone_step.end_degc, []
    sun = np.frombuffer(building.weather(["global_horizontal_radiation"]).values)
    for step in range(96):
        row, _ = building.advance(nobody)
        values = dict(zip(building.manifest.names, row.tolist(), strict=True))
        flow = building.zone_step
        inside_w = 4 * 100.0 + 600.0 if 32 <= step < 72 else 60.0
        assert building.gains_w.tolist() == pytest.approx([inside_w + 0.5 * sun[step], inside_w + 1.0 * sun[step]])
        gained = 900.0 * ((values["outdoor_temperature"] - flow.mean_degc) / 0.01 + building.gains_w + flow.heat_w)
        assert gained == pytest.approx(5e6 * (flow.end_degc - before), abs=1e-3)
        assert [values["zone_1_air_temperature"], values["zone_2_air_temperature"]] == flow.end_degc.tolist()
        power_w = np.abs(flow.heat_w).sum() / 2.5
        assert values["hvac_and_plant_power"] == pytest.approx(power_w)
        assert values["hvac_electricity"] == pytest.approx(900.0 * power_w)
        before = flow.end_degc
        heats.append(flow.heat_w.sum())
    assert min(heats) < 0.0, "a July day wants cooling"


def test_testing_kit__electricity_of_the_equipment_and_people_by_the_clock() -> None:
    """Two zones of 600 W and 4 people: open on Monday 8 to 18 o'clock, at a tenth and empty else."""
    rows = run(FakeBuilding(2))
    begins = [datetime(2017, 7, 3) + timedelta(minutes=15 * k) for k in range(96)]
    for begin, row in zip(begins, rows[1:], strict=True):
        opened = 8 <= begin.hour < 18
        equipment_j = row["electricity_facility"] - row["hvac_electricity"]
        assert equipment_j == pytest.approx(1200.0 * 900.0 * (1.0 if opened else 0.1))
        assert row["zone_1_occupants"] == (4.0 if opened else 0.0)
    assert rows[0]["electricity_facility"] == 0.0
    sunday = run(FakeBuilding(2, begin="07-02"))
    assert {row["zone_2_occupants"] for row in sunday} == {0.0}


def test_testing_kit__weather_is_the_sines_that_it_states() -> None:
    """16 July is 182 days after 15 January: half a year but half a day; 15 o'clock is the day's warmest hour."""
    day = [row["outdoor_temperature"] for row in run(FakeBuilding(1, climate=CALM, begin="07-16"))]
    assert max(day) == day[60]
    assert day[60] == pytest.approx(11.0 + 12.0 + 5.0, abs=0.01)
    assert day[12] == pytest.approx(11.0 + 12.0 - 5.0, abs=0.01)
    winter = [row["outdoor_temperature"] for row in run(FakeBuilding(1, climate=CALM, begin="01-16"))]
    assert winter[36] == pytest.approx(11.0 - 12.0, abs=0.01)


def test_testing_kit__forecast_is_the_upcoming_weather() -> None:
    building = FakeBuilding(1)
    outdoor = [row["outdoor_temperature"] for row in run(building, seed=5)]
    series = building.weather(["dry_bulb_temperature", "global_horizontal_radiation"])
    table = np.frombuffer(series.values).reshape(-1, 2)
    assert (series.step_s, series.units, series.episode) == (900.0, ["C", "Wh/m2"], 0)
    assert table[:96, 0].tolist() == outdoor[1:]
    assert len(table) == 96 + 7 * 96
    assert table[47, 1] == pytest.approx(600.0)  # noon
    assert table[95, 1] == 0.0
    with pytest.raises(UnknownName, match="no column 'dry_bulb'; did you mean 'dry_bulb_temperature'"):
        building.weather(["dry_bulb"])


def test_testing_kit__noise_has_the_deviation_and_the_memory_that_it_states() -> None:
    climate = Climate(season_k=0.0, day_k=0.0, noise_k=2.0, noise_tau_h=1.0)
    series, _ = climate.series(datetime(2017, 1, 1), 200_000, 900.0, np.random.default_rng(1))
    noise = series - climate.mean_degc
    assert noise.std() == pytest.approx(2.0, rel=0.03)
    assert noise.mean() == pytest.approx(0.0, abs=0.05)
    assert np.corrcoef(noise[:-1], noise[1:])[0, 1] == pytest.approx(math.exp(-0.25), abs=0.01)


def test_testing_kit__seed_rules_the_weather_and_without_one_it_goes_on() -> None:
    building, other = FakeBuilding(2), FakeBuilding(2)

    def first(of: FakeBuilding, seed: int | None) -> float:
        return float(of.reset(seed)[0])

    sequence = [first(building, 7), first(building, None), first(building, None)]
    assert len(set(sequence)) == 3
    assert [first(other, 7), first(other, None), first(other, None)] == sequence
    assert first(building, 7) == sequence[0]
    assert first(building, 8) != sequence[0]
    assert run(building, 3) == run(other, 3)


def test_testing_kit__heating_setpoint_above_the_cooling_setpoint_is_refused() -> None:
    building = FakeBuilding(1)
    building.reset(0)
    with pytest.raises(ModelError, match=r"zone 'zone_1': heating setpoint 24 is above cooling setpoint 23"):
        building.advance(column(24, 23))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"zones": 0}, "zones: expected at least one"),
        ({"zones": "a"}, "zones = 'a'; a number of zones, or a list of them, expected"),
        ({"zones": 2.5}, "zones = 2.5; a number of zones, or a list of them, expected"),
        ({"zones": [Zone("a"), Zone("A")]}, "names that differ"),
        ({"begin": "13-01"}, "begin '13-01' is not a calendar date; write it as MM-DD or YYYY-MM-DD"),
        ({"begin": "07-02", "end": "07-01"}, "is before begin"),
        ({"steps_per_hour": 7}, "steps_per_hour = 7; expected a divisor of 60"),
        ({"control": "room"}, "control = 'room'; expected 'point', 'zone' or 'building'"),
        ({"discrete": 1}, "discrete = 1; expected 2 to 1000 steps"),
        ({"discrete": 1001}, "discrete = 1001; expected 2 to 1000 steps"),
        ({"actions": {"a": ["zone_9_heating_setpoint"]}}, "no actuator 'zone_9_heating_setpoint'; did you mean"),
        (
            {"actions": {"a": ["zone_1_heating_setpoint"], "b": ["zone_1_heating_setpoint"]}},
            "action 'b': the actuator 'zone_1_heating_setpoint' belongs to action 'a'",
        ),
        ({"actions": {"a": []}}, "action 'a' has no actuators; name at least one"),
        (
            {"actions": {"a": ["zone_1_heating_setpoint", "zone_1_cooling_setpoint"]}},
            "action 'a': its lower bound 22.5 is not below its upper bound 22.5",
        ),
        ({"terminate": [{"points": ["zone_9"], "high": 30.0}]}, "no sensor or meter 'zone_9'"),
        ({"time": ["century"]}, "time.0"),
        ({"cop": 0.0}, "cop = 0.0; more than 0 expected"),
    ],
)
def test_testing_kit__building_that_cannot_be(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        FakeBuilding(**arguments)


def test_testing_kit__zone_that_cannot_be() -> None:
    with pytest.raises(InvalidConfig, match=r"zone 'x': capacity_j_per_k = 0.0; more than 0 expected"):
        Zone("x", capacity_j_per_k=0.0)
    with pytest.raises(InvalidConfig, match=r"zone 'x': people = -1.0; at least 0 expected"):
        Zone("x", people=-1.0)


# The link


def test_testing_kit__commands_set_keep_and_release() -> None:
    link = FakeLink(FakeBuilding(1), name="me")
    first = link.reset(seed=0)
    assert first.effective.tolist() == [16.0, 28.0], "Monday at midnight: the building's own setback"
    link.send({"zone_1_heating_setpoint": 21.0})
    sample = link.receive()
    assert sample.effective.tolist() == [21.0, 28.0]
    assert sample.value_source == {"zone_1_heating_setpoint": "me", "zone_1_cooling_setpoint": ""}
    link.send()
    assert link.receive().effective.tolist() == [21.0, 28.0], "what is not named is kept"
    link.send({"zone_1_heating_setpoint": None})
    relinquished = link.receive()
    assert relinquished.effective.tolist() == [16.0, 28.0]
    assert set(relinquished.value_source.values()) == {""}
    link.send(column(20, 24))
    assert link.receive().effective.tolist() == [20.0, 24.0]
    anew = link.reset()
    assert set(anew.value_source.values()) == {""}, "a new episode begins with the building's own control"
    link.send()
    assert link.receive().effective.tolist() == [16.0, 28.0]


def test_testing_kit__what_a_node_refuses_a_fake_refuses() -> None:
    link = FakeLink(FakeBuilding(1))
    with pytest.raises(UsageError, match=r"call reset\(\) first"):
        link.send({})
    sample = link.reset(seed=0)
    with pytest.raises(PeerError, match=r"call send\(\) before receive\(\)"):
        link.receive()
    with pytest.raises(InvalidAction, match="no actuator 'heating'; did you mean 'zone_1_heating_setpoint'"):
        sample.send({"heating": 20.0})
    for value in (float("nan"), "20", True, np.True_, [20.0, 21.0], 10**400):
        with pytest.raises(InvalidAction, match=r"zone_1_heating_setpoint = .*; a finite number or None"):
            sample.send({"zone_1_heating_setpoint": value})  # type: ignore[dict-item]
    with pytest.raises(InvalidAction, match=r"shape \(1,\); \(2,\) expected"):
        link.send(column(20))
    link.send({"zone_1_heating_setpoint": 23.0})
    with pytest.raises(RequestRejected, match=r"zone_1_heating_setpoint = 23; its bounds are 15 to 22.5 degC"):
        link.receive()
    link.send({"zone_1_heating_setpoint": 22.5})
    assert link.receive().step == 1


def test_fake_link__several_buildings_are_the_slots_of_one_node() -> None:
    buildings = [FakeBuilding(1), FakeBuilding(1)]
    link = FakeLink(buildings)
    with pytest.raises(PeerError, match="reset all slots first"):
        link.reset(slots=[1])
    link.reset(seed=0)
    link.send(np.array([[20.0, 24.0], [20.0, 31.0]]))
    with pytest.raises(RequestRejected, match="zone_1_cooling_setpoint = 31"):
        link.receive()
    assert [building.step for building in buildings] == [0, 0], "no slot has advanced"
    link.send({"zone_1_heating_setpoint": 21.0}, still=[0])
    sample = link.receive()
    assert sample.message.step == [0, 1]
    assert [sample.of_slot(slot).effective.tolist() for slot in (0, 1)] == [[16.0, 28.0], [21.0, 28.0]]
    assert [list(sample.of_slot(slot).value_source.values()) for slot in (0, 1)] == [["", ""], ["env", ""]]
    assert link.reset(seed=[7], slots=[1]).message.episode == [0, 1]
    assert link.accepted.episode == [0, 1]


def test_testing_kit__controllers_loop_runs_on_it() -> None:
    link = FakeLink(FakeBuilding(2))
    rules = RuleBasedController(link.manifest)
    steps = []
    for sample in link:
        steps.append(sample.step)
        if not sample.truncated:
            sample.send(rules.act(sample))
    assert steps == list(range(97))
    with pytest.raises(EpisodeChanged, match=r"the episode is over; call reset\(\)"):
        link.receive()


# The environment


def test_testing_kit__it_has_the_spaces_of_its_manifest() -> None:
    env = FakeEnv(2, time=["month", "hour"])
    assert env.observation_names == (
        "month", "hour", "outdoor_temperature", "hvac_and_plant_power", "zone_1_air_temperature", "zone_1_occupants",
        "zone_2_air_temperature", "zone_2_occupants", "electricity_facility", "hvac_electricity",
    )  # fmt: skip
    assert env.action_space == gym.spaces.Box(np.float32([15, 22.5] * 2), np.float32([22.5, 30] * 2))
    both = FakeEnv(2, control="building")
    assert both.action_names == ("heating_setpoint", "cooling_setpoint")
    both.reset(seed=0)
    *_, info = both.step(np.float32([20, 24]))
    assert info["effective"].tolist() == [20.0, 24.0, 20.0, 24.0]


@pytest.mark.parametrize(
    ("control", "space"),
    [
        ("building", gym.spaces.Discrete(3)),
        ("zone", gym.spaces.MultiDiscrete([3, 3])),
        ("point", gym.spaces.MultiDiscrete([3] * 4)),
    ],
)
def test_testing_kit__discrete_steps_go_from_the_widest_to_the_tightest(control: str, space: Any) -> None:
    env = FakeEnv(2, control=control, discrete=3)
    assert env.action_space == space
    env.reset(seed=0)
    middle = 1 if isinstance(space, gym.spaces.Discrete) else np.ones(space.shape, int)
    assert env.step(middle)[-1]["effective"].tolist() == [18.75, 26.25] * 2


def test_testing_kit__context_weather_reward_and_limits_are_those_of_a_real_environment() -> None:
    env = FakeEnv(
        1,
        equipment_control=True,
        climate=CALM,
        actions={"cooling": ["zone_1_cooling_setpoint"]},
        terminate=[{"points": ["outdoor_temperature"], "high": 20.0}],
        reward=LinearReward(weight=1.0, lambda_energy=1.0),
    )
    _, info = env.reset(seed=0)
    assert (info["weather"], info["weather_noise"]) == ("fake", {})
    env.set_context({"equipment": 0.0})
    observation, reward, *_, info = env.step(np.float32([24]))
    assert info["value_source"] == ("", "agent", "agent")
    values = env.observation_dict(observation)
    assert values["electricity_facility"] == values["hvac_electricity"], "the equipment is off"
    assert reward == pytest.approx(-values["hvac_and_plant_power"])
    assert env.weather(["dry_bulb_temperature"]).columns == ["dry_bulb_temperature"]
    steps = 1
    terminated = False
    while not terminated:
        observation, _, terminated, truncated, info = env.step(np.float32([24]))
        assert not truncated
        steps += 1
    outdoor = [row["outdoor_temperature"] for row in run(FakeBuilding(1, climate=CALM))]
    assert steps == next(k for k, degc in enumerate(outdoor) if degc > 20.0)
    assert "outdoor_temperature" in info["terminated_by"]


def test_testing_kit__fake_building_is_on_no_bus() -> None:
    for mode in ("rerun", "ansi"):
        for make in (FakeEnv, FakeVectorEnv):
            with pytest.raises(InvalidConfig, match=f"render_mode '{mode}'; 'rgb_array' expected: without a node"):
                make(1, render_mode=mode)
    with FakeEnv(1) as env, closing(FakeVectorEnv(1)) as envs:
        assert env.metadata["render_modes"] == envs.metadata["render_modes"] == ["rgb_array"]


def test_noise__is_reported_and_drawn_by_seed() -> None:
    env = FakeEnv(1)
    observation, info = env.reset(seed=4)
    assert info["weather_noise"] == {
        "dry_bulb_temperature.sigma": 1.0, "dry_bulb_temperature.mu": 0.0, "dry_bulb_temperature.tau_h": 24.0
    }  # fmt: skip
    assert env.reset(seed=5)[0].tobytes() != observation.tobytes()
    assert env.reset(seed=4)[0].tobytes() == observation.tobytes()


# The kit: what is good passes


@pytest.mark.parametrize(
    "make",
    [
        BaselineController,
        RuleBasedController,
        ScheduledSetback,
        lambda manifest: FixedSetpoints(manifest, zone_1_heating_setpoint=20.5),
    ],
)
def test_testing_kit__controllers_of_the_house_conform(make: Callable[..., Any]) -> None:
    report = check_controller(make)
    assert report.passed == tuple(CONTROLLER_CHECKS)


def test_testing_kit__one_that_draws_conforms_but_for_what_it_states_of_itself() -> None:
    with pytest.raises(ConformanceError) as unseeded:
        check_controller(RandomController)
    assert "the same samples get the same answers" in unseeded.value.report.failed
    report = check_controller(lambda m: RandomController(m, seed=1), skip=["resets at the start of an episode"])
    assert report.skipped == ("resets at the start of an episode",)
    assert len(report.passed) == len(CONTROLLER_CHECKS) - 1
    assert "skipped  resets at the start of an episode\n         on request" in str(report)


@pytest.mark.parametrize(
    "reward", [LinearReward(), "exponential", "hourly", {"kind": "occupied", "by": "people"}, "peak"]
)
def test_testing_kit__rewards_of_the_house_conform(reward: Any) -> None:
    assert not check_reward(reward).failed


def documented(name: str) -> Any:
    """A reward of the page on rewards."""
    page = (Path(__file__).parents[2] / "docs" / "rewards.md").read_text(encoding="utf-8")
    code = next(block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if f" {name}" in block)
    defined: dict[str, Any] = {}
    exec(code.partition("\nenv = ")[0], defined)
    return defined[name]


def test_testing_kit__reward_class_of_the_page_conforms() -> None:
    assert not check_reward(documented("Steady")).failed


def test_testing_kit__reward_function_for_single_environments_fails_the_checks_of_vectors_alone() -> None:
    function = documented("cool_and_cheap")
    several = ["several buildings at once get the same rewards as alone", "resets single buildings"]
    with pytest.raises(ConformanceError, match="vector environments call it with an array for each point") as error:
        check_reward(function)
    assert list(error.value.report.failed) == several
    assert not check_reward(function, skip=several).failed


@pytest.mark.parametrize("arguments", [{}, {"control": "building", "discrete": 4}, {"time": ["hour"], "reward": None}])
def test_testing_kit__environments_of_the_house_conform(arguments: dict[str, Any]) -> None:
    env = FakeEnv(2, **arguments)
    assert len(check_environment(env).passed) == 11


NAMES, TERMS = "observations have names", "rewards are finite and equal the sum of their terms"
STEPS, INFO = "an episode has its N timesteps", "info has its keys and counts steps"


@pytest.mark.parametrize(
    ("wrapper", "skipped"),
    [
        ({"wrapper": "NormalizeObservation"}, ()),
        ({"wrapper": "NormalizeReward"}, (TERMS,)),
        ({"wrapper": "RewardVector", "terms": ["energy", "comfort"]}, ()),
        ({"wrapper": "FrameStackObservation", "stack_size": 2}, (NAMES,)),
        ({"wrapper": "NumericInfos"}, (INFO,)),
        ({"wrapper": "RepeatAction", "num_repeats": 2}, (STEPS, TERMS, INFO, "an action of NaN is rejected")),
        ({"wrapper": "TimeLimit", "max_episode_steps": 9}, (STEPS, "a step after the end is rejected")),
    ],
    ids=lambda part: part["wrapper"] if isinstance(part, dict) else "",
)
def test_check_environment__skips_only_what_cannot_hold_within_a_wrapper(
    wrapper: dict[str, Any], skipped: tuple[str, ...]
) -> None:
    report = check_environment(apply_wrappers(FakeEnv(1), [wrapper]))
    assert report.skipped == skipped
    assert all(wrapper["wrapper"] in result.skipped for result in report.results if result.skipped)
    assert len(report.passed) == 11 - len(skipped)


def test_check_environment__leaves_running_statistics_as_they_are() -> None:
    env = gym.wrappers.NormalizeObservation(FakeEnv(1))
    env.reset(seed=0)
    mean = env.obs_rms.mean.copy()
    check_environment(env)
    np.testing.assert_array_equal(env.obs_rms.mean, mean)
    assert env.update_running_mean


def test_check_environment__observation_wrapper_of_ones_own_needs_names_alone() -> None:
    class Doubled(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
        """Appends twice the first value."""

        def __init__(self, env: gym.Env[Any, Any]) -> None:
            gym.utils.RecordConstructorArgs.__init__(self)
            super().__init__(env)
            space: Any = env.observation_space
            low, high = (np.append(bound, np.float32(2.0) * bound[0]) for bound in (space.low, space.high))
            self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)
            self.observation_names = (*names_of(env), "doubled")

        def observation(self, observation: Any) -> Any:
            return np.append(observation, np.float32(2.0) * observation[0])

    assert len(check_environment(Doubled(FakeEnv(1))).passed) == 11
    assert len(check_environment(gym.wrappers.NormalizeObservation(Doubled(FakeEnv(1)))).passed) == 11


def test_check_environment__vector_of_terms_lies_in_its_space() -> None:
    class First(gym.Wrapper[Any, Any, Any, Any]):
        def step(self, action: Any) -> Any:
            observation, rewards, *rest = self.env.step(action)
            return (observation, rewards[:1], *rest)

    with pytest.raises(ConformanceError, match=r"the reward of step 1 is array\(.*expected a finite float"):
        check_environment(First(RewardVector(FakeEnv(1), ["energy", "comfort"])))


def test_check_environment__refuses_a_vector() -> None:
    with pytest.raises(InvalidConfig, match=r"checks a single environment, a gymnasium\.Env, not FakeVectorEnv"):
        check_environment(FakeVectorEnv(2))  # type: ignore[arg-type]


def test_testing_kit__manifest_of_ones_own() -> None:
    manifest = FakeBuilding([Zone("hall"), Zone("attic")], equipment_control=True).manifest
    report = check_controller(lambda m: FixedSetpoints(m, equipment=0.5), manifest)
    assert report.passed == tuple(CONTROLLER_CHECKS)[:-1], "nothing of the kind can be simulated"
    assert not check_reward("linear", manifest).failed
    with pytest.raises(ConformanceError, match="equipment"):
        check_controller(lambda m: FixedSetpoints(m, equipment=0.5))


def test_check_controller__points_of_another_node_need_its_manifest() -> None:
    class Attic:
        def __init__(self, manifest: Any) -> None: ...

        def act(self, sample: Any) -> Any:
            return {"attic_heating_setpoint": 20.0 if sample["attic_air_temperature"] < 21.0 else 19.0}

    manifest = FakeBuilding([Zone("hall"), Zone("attic")]).manifest
    assert not check_controller(Attic, manifest).failed
    text = "no sensor or meter 'attic_air_temperature'.*; for another node than the fake building, pass its manifest"
    with pytest.raises(ConformanceError, match=text):
        check_controller(Attic)


def test_fake_env__is_copied_but_not_pickled() -> None:
    env = FakeEnv(1)
    env.reset(seed=0)
    action = env.action_space.sample()
    env.step(action)
    copied = copy.deepcopy(env)
    for _ in range(2):
        observation, reward, *_ = copied.step(action)
    env.step(action)
    expected, expected_reward, *_ = env.step(action)
    assert (observation.tolist(), reward) == (expected.tolist(), expected_reward)
    with pytest.raises(UsageError, match="nor one of a fake building pickled"):
        pickle.dumps(env)


def test_fake_env__copy_has_wrappers_of_its_own() -> None:
    env = PreviousObservation(FakeEnv(1), ["zone_1_air_temperature"])
    env.reset(seed=0)
    copied = copy.deepcopy(env)
    observation, *_ = copied.step(copied.action_space.sample())
    alone = copy.deepcopy(copied.unwrapped)
    for own, wrapper in ((env, env), (copied, copied)):
        assert isinstance(own.unwrapped, FakeEnv)
        assert [*own.unwrapped.wrappers] == [wrapper]
    del env, wrapper, own
    gc.collect()
    assert isinstance(copied.unwrapped, FakeEnv)
    assert isinstance(alone, FakeEnv)
    assert list(copied.unwrapped.observation_dict(observation)) == list(copied.observation_names)
    assert not len(alone.wrappers), "a copy without the wrapper"
