"""Actions relative to the building's own control: zero is the baseline, to the bit; offsets add to its schedules."""

import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import zenostat
from zenostat.agent_sdk.controllers.agent import Agent
from zenostat.agent_sdk.controllers.random_control import RandomController
from zenostat.envs import BuildingEnv, BuildingVectorEnv
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics.errors import InvalidConfig, ZenostatError
from zenostat.topics.scenario_ids import BUILDINGS

SCENARIO = "ref-small-office-USA_AZ_Phoenix-continuous-v1"
DAYS = {"begin": "07-05", "end": "07-06"}
"""Two weekdays, on which the model's schedules set 21 and 24 degC from 05:00 to 21:00 standard time (06:00 to 22:00
daylight saving time), else 15.6 and 26.7 degC."""

BY_HEART = {"htgsetp_sch_next": (15.6, 21.0), "clgsetp_sch_next": (26.7, 24.0)}


def settings(**more: Any) -> dict[str, Any]:
    return {"scenario": SCENARIO, **DAYS, "relative": 3.0, **more}


def observed(env: BuildingEnv, actions: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], list[float], list[Any]]:
    """Return the values of all samples but those of schedules, the rewards, and the effective values."""
    env.reset(seed=0)
    kept = [i for i, sensor in enumerate(env.manifest.sensors) if not sensor.lead_s]
    kept += range(len(env.manifest.sensors), len(env.sample.values))
    values, rewards, effective = [env.sample.values[kept]], [], []
    for action in actions:
        _, reward, _, _, info = env.step(action)
        values.append(env.sample.values[kept])
        rewards.append(reward)
        effective.append(info["effective"])
    return np.array(values), rewards, effective


@pytest.mark.slow
def test_relative__zero_is_the_baseline_to_the_bit() -> None:
    with_zeros = BuildingEnv(**settings())
    assert with_zeros.action_space == gym.spaces.Box(-3.0, 3.0, (2,), np.float32)
    baseline = BuildingEnv(scenario=SCENARIO, **DAYS, actuators={}, discrete=None)
    try:
        steps = with_zeros.manifest.steps
        values, rewards, _ = observed(with_zeros, np.zeros((steps, 2), np.float32))
        own_values, own_rewards, _ = observed(baseline, np.zeros((steps, 0), np.float32))
    finally:
        with_zeros.close()
        baseline.close()
    assert values.tobytes() == own_values.tobytes()
    assert rewards == own_rewards


@pytest.mark.slow
def test_relative__zero_of_a_scaled_action_is_the_baseline_to_the_bit() -> None:
    """Behind RescaleAction with bounds that float32 does not divide, zero comes back as 1e-8 to 1e-7 K."""
    plain, trajectories, low, high = BuildingEnv(**settings(relative=(-2.0, 3.4))), [], -2.0, 3.4
    scaled = gym.wrappers.RescaleAction(plain, np.float32(-1), np.float32(1))
    zero = np.full(plain.action_space.shape, -1.0 + 2.0 * -low / (high - low), np.float32)
    assert scaled.action(zero).any()
    for env, action in ((plain, np.zeros_like(zero)), (scaled, zero)):
        env.reset(seed=1)
        trajectories.append([env.step(action)[0].tobytes() for _ in range(40)])
    plain.close()
    assert trajectories[0] == trajectories[1]


@pytest.mark.slow
def test_relative__offsets_add_to_the_schedule_of_the_same_timestep() -> None:
    env = BuildingEnv(**settings())
    try:
        manifest, steps = env.manifest, env.manifest.steps
        assert [(action.unit, action.relative) for action in manifest.task.actions] == [("K", True)] * 2
        rng = np.random.default_rng(1)
        actions = rng.uniform(-3.0, 3.0, (steps, 2)).astype(np.float32)
        _, _, effective = observed(env, actions)
        hour = np.arange(steps) // (steps // 48) % 24
        at_work = ((hour >= 5) & (hour < 21)).astype(int)
        for column, actuator in enumerate(manifest.actuators):
            schedule = np.array(BY_HEART[str(actuator.baseline_sensor)])[at_work]
            offset = actions[:, int(actuator.control_type == "Cooling Setpoint")].astype(float)
            expected = np.clip(schedule + offset, actuator.low, actuator.high)
            assert np.array(effective)[:, column].tolist() == expected.tolist(), actuator.name
    finally:
        env.close()


@pytest.mark.slow
def test_relative__observes_the_schedule_one_timestep_ahead_at_the_end_as_well() -> None:
    env = BuildingEnv(
        **settings(sensors={"power": ("Facility Total HVAC Electricity Demand Rate", "Whole Building")}, reward=None)
    )
    try:
        observation, _ = env.reset(seed=0)
        assert env.manifest.observed_names[:3] == ("power", "htgsetp_sch_next", "clgsetp_sch_next")
        rows = [observation]
        while not env.sample.truncated:
            rows.append(env.step(np.zeros(2, np.float32))[0])
    finally:
        env.close()
    per_hour = (len(rows) - 1) // 48
    heating = np.array(rows)[:, 1]
    assert heating[: 5 * per_hour].tolist() == [np.float32(15.6)] * (5 * per_hour)
    assert heating[5 * per_hour : 21 * per_hour].tolist() == [21.0] * (16 * per_hour)  # the sample at 05:00 has it
    assert heating[-1] == np.float32(15.6)  # the last timestep's value stays


@pytest.mark.slow
def test_relative__slots_have_the_trajectories_of_single_environments() -> None:
    rng = np.random.default_rng(2)
    actions = rng.uniform(-3.0, 3.0, (40, 2, 2)).astype(np.float32)
    actions[::3, 0] = 0.0
    vector = BuildingVectorEnv(2, **settings())
    single = BuildingEnv(**settings())
    try:
        vector.reset(seed=[0, 0])
        rows = [vector.step(step) for step in actions]
        for slot in range(2):
            single.reset(seed=0)
            for step, (observations, rewards, _, _, infos) in zip(actions, rows, strict=True):
                observation, reward, _, _, info = single.step(step[slot])
                assert observation.tobytes() == observations[slot].tobytes()
                assert reward == rewards[slot]
                assert info["action"].tobytes() == infos["action"][slot].tobytes()
                relinquished = step[slot] == 0.0
                assert np.isnan(info["action"]).all() == relinquished.all()
    finally:
        vector.close()
        single.close()


@pytest.mark.slow
def test_relative__plans_give_the_rewards_of_their_steps() -> None:
    env = BuildingEnv(**settings())
    try:
        env.reset(seed=0)
        steps = env.manifest.steps // 48 * 5 - 5
        for _ in range(steps):  # the schedule changes within the plans
            env.step(np.zeros(2, np.float32))
        plans = np.random.default_rng(3).uniform(-3.0, 3.0, (2, 10, 2)).astype(np.float32)
        rewards = env.plan(plans)
        again = env.plan(plans)  # in one request: the first one has met the schedules
        expected = [env.step(action)[1] for action in plans[1]]
        later = env.plan(plans[:, :4])  # beyond what is known, timestep by timestep
        afterwards = [env.step(action)[1] for action in plans[1, :4]]
    finally:
        env.close()
    assert rewards[1].tolist() == again[1].tolist() == expected
    assert later[1].tolist() == afterwards


@pytest.mark.slow
def test_relative__controllers_of_absolute_values_act_through_offsets() -> None:
    env = BuildingEnv(**settings(relative={"cooling_setpoint": (-2.0, 4.0)}))
    try:
        manifest = env.manifest
        assert [action.relative for action in manifest.task.actions] == [False, True]
        env.reset(seed=0)
        agent = Agent(zenostat.controllers.RuleBasedController(manifest))
        action = agent.action(env.sample)
        wanted = agent.values(env.sample)["core_zn_cooling_setpoint"]
        assert wanted is not None
        assert action[1] == np.float32(np.clip(wanted - 26.7, -2.0, 4.0))
        values = RandomController(manifest, seed=1).act(env.sample)
        cooling = [values[name] for name in manifest.task.actions[1].actuators]
        assert all(value is not None and 24.7 <= value <= 30.7 for value in cooling)
    finally:
        env.close()


@pytest.mark.slow
def test_relative__recording_verifies(scratch: Path) -> None:
    path = scratch / "relative.mcap"
    env = BuildingEnv(**settings(record=str(path)))
    try:
        env.reset(seed=4)
        for action in np.random.default_rng(4).uniform(-3.0, 3.0, (60, 2)).astype(np.float32):
            env.step(action)
    finally:
        env.close()
    assert verify(path).passed


@pytest.mark.variants
@pytest.mark.parametrize(
    ("relative", "parts"),
    [
        ([1.0, 3.0], ["include 0", "1 to 3"]),
        (-1.0, ["relative", "greater than 0"]),
        ({"heating": 2.0}, ["no action 'heating'", "heating_setpoint"]),
    ],
)
def test_relative__refuses_offsets_that_are_none(relative: Any, parts: list[str]) -> None:
    with pytest.raises(ZenostatError) as error:
        BuildingEnv(**settings(relative=relative))
    assert all(part in str(error.value) for part in parts), error.value


def test_relative__refuses_actuators_that_depend_on_more_than_time() -> None:
    cutout = {
        "ZoneControl:Thermostat": {"Core_ZN Thermostat": {"temperature_difference_between_cutout_and_setpoint": 1.0}}
    }
    with pytest.raises(ZenostatError, match="difference between cutout and setpoint of ZoneControl") as error:
        BuildingEnv(**settings(edits=cutout))
    assert "'core_zn_heating_setpoint' cannot be set relative" in str(error.value)


def test_relative__refuses_bounds_of_its_own_actions() -> None:
    actions = {"heat": {"actuators": ["core_zn_heating_setpoint"], "low": 15.0}}
    with pytest.raises(ZenostatError, match="'heat' is relative: its bounds are those of `relative`"):
        BuildingEnv(**settings(actions=actions))


@pytest.mark.slow
def test_lead__reports_a_schedule_hours_ahead() -> None:
    sensors = {
        "occupancy": ("Schedule Value", "BLDG_OCC_SCH"),
        "occupancy_in_2h": ("Schedule Value", "BLDG_OCC_SCH", None, 2.0),
    }
    env = BuildingEnv(scenario=SCENARIO, **DAYS, sensors=sensors, reward=None)
    try:
        rows = [env.reset(seed=0)[0]]
        while not env.sample.truncated:
            rows.append(env.step(env.action_space.sample())[0])
    finally:
        env.close()
    now, later = np.array(rows)[:, :2].T
    count = (len(rows) - 1) // 24  # two hours
    assert later[1:-count].tolist() == now[1 + count :].tolist()
    assert len(set(now)) > 2


@pytest.mark.variants
@pytest.mark.parametrize(
    ("sensor", "text"),
    [
        (("Zone Air Temperature", "Core_ZN", None, 1.0), "lead_h is for 'Schedule Value'"),
        (("Schedule Value", "BLDG_OCC_SCH", None, 0.01), "no multiple of the timestep"),
        (("Schedule Value", "BLDG_OCC_SCH", None, -1.0), "greater than 0"),
    ],
)
def test_lead__refuses_what_is_not_known_beforehand(sensor: tuple[Any, ...], text: str) -> None:
    with pytest.raises(ZenostatError, match=text):
        BuildingEnv(scenario=SCENARIO, **DAYS, sensors={"ahead": sensor}, reward=None)


@pytest.mark.slow
@pytest.mark.parametrize("building", BUILDINGS)
def test_relative__known_value_is_what_energyplus_uses(building: str) -> None:
    scenario = f"{building}-USA_CO_Denver-continuous-v1"
    try:
        env = BuildingEnv(scenario=scenario, begin="01-13", end="01-17", relative=2.0)
    except InvalidConfig as error:
        known = r"EMS programs? |moves the setpoint|switches the setpoint off|2 schedules"
        if building.startswith("ref-") or not re.search(known, str(error)):
            raise
        return
    try:
        env.reset(seed=0)
        zero, done, compared = np.zeros(env.action_space.shape or (), np.float32), False, 0
        while not done:
            known = {a.name: env.sample[str(a.baseline_sensor)] for a in env.manifest.actuators if a.baseline_sensor}
            _, _, _, done, info = env.step(zero)
            for actuator, used in zip(env.manifest.actuators, info["effective"].tolist(), strict=True):
                if actuator.name in known and used == used:
                    assert used == known[actuator.name], actuator.name
                    compared += 1
        assert compared
    finally:
        env.close()
