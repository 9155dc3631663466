"""Unobserved points: observations, default rewards and controllers are as if the points did not exist."""

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.builders import view

from zenostat.agent_sdk.controllers import CONTROLLERS, Agent, make_controller
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.envs.zone_agents import ZonesEnv
from zenostat.agent_sdk.rewards import REWARDS, LinearReward, from_function, read_reward
from zenostat.agent_sdk.testing import FakeBuilding, FakeLink, check_environment
from zenostat.metrics.episode_metrics import MetricsAccumulator
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

HIDDEN = ("zone_2_air_temperature", "zone_1_occupants", "electricity_facility")
TIME = ("hour",)


def building(**options: Any) -> FakeBuilding:
    return FakeBuilding(3, **{"unobserved": HIDDEN, "time": TIME, **options})


def removed(manifest: Manifest) -> Manifest:
    """The manifest of a node that lacks the unobserved points."""
    return manifest.model_copy(
        update={
            "sensors": tuple(s for s in manifest.sensors if s.observed),
            "meters": tuple(m for m in manifest.meters if m.observed),
        }
    )


def rollout(env: BuildingEnv, steps: int = 30) -> list[Any]:
    env.action_space.seed(1)
    first = env.reset(seed=1)[0]
    return [first, *(env.step(env.action_space.sample())[0] for _ in range(steps))]


def test_unobserved_points__observation_is_that_of_all_points_without_the_unobserved_ones() -> None:
    everything, some = (BuildingEnv(link=FakeLink(building(unobserved=names)), reward=None) for names in ((), HIDDEN))
    kept = [i for i, name in enumerate(everything.observation_names) if name not in HIDDEN]
    assert some.observation_names == tuple(everything.observation_names[i] for i in kept)
    assert len(kept) == len(everything.observation_names) - len(HIDDEN)
    space, full = some.observation_space, everything.observation_space
    assert isinstance(space, gym.spaces.Box)
    assert isinstance(full, gym.spaces.Box)
    assert space == gym.spaces.Box(full.low[kept], full.high[kept], dtype=np.float32)
    expected, observed = rollout(everything), rollout(some)
    np.testing.assert_array_equal(np.array(observed), np.array(expected)[:, kept])
    assert len(some.sample.values) == len(some.manifest.points)  # the bus has all of them
    assert some.observation_dict(observed[-1])["zone_3_air_temperature"] == observed[-1][kept.index(7)]


def test_unobserved_points__slots_observe_the_same_as_single_environments() -> None:
    single = BuildingEnv(link=FakeLink(building()))
    vector = BuildingVectorEnv(2, link=FakeLink([building(), building()]))
    assert vector.single_observation_space == single.observation_space
    first = vector.reset(seed=[1, 2])[0]
    single.action_space.seed(1)
    actions = [single.action_space.sample() for _ in range(5)]
    observed = [first, *(vector.step(np.stack([action] * 2))[0] for action in actions)]
    np.testing.assert_array_equal(np.array(observed)[:, 0], np.array(rollout(single, 5)))


def test_unobserved_points__agents_of_zones_observe_no_unobserved_point() -> None:
    env = ZonesEnv(link=FakeLink(building()))
    assert env.observation_names("zone_2") == ("hour", "outdoor_temperature", "zone_2_occupants")
    assert env.observation_names("zone_1") == ("hour", "outdoor_temperature", "zone_1_air_temperature")
    observations, _ = env.reset(seed=1)
    sample = env.env.sample
    assert observations["zone_1"][2] == np.float32(sample["zone_1_air_temperature"])
    assert observations["zone_2"][2] == np.float32(sample["zone_2_occupants"])
    with pytest.raises(InvalidConfig, match="no observation is named 'zone_1_occupants'"):
        ZonesEnv(link=FakeLink(building()), shared=["zone_1_occupants"])


@pytest.mark.parametrize("kind", sorted(REWARDS))
def test_unobserved_points__reward_without_names_reads_observed_points_only(kind: str) -> None:
    whole = building().manifest
    reduced = removed(whole)
    try:
        expected = read_reward(kind).bind(reduced)
    except InvalidConfig as error:  # it needs points or parameters that the building lacks, hidden or not
        with pytest.raises(InvalidConfig, match=re.escape(str(error))):
            read_reward(kind).bind(whole)
        return
    bound = read_reward(kind).bind(whole)
    values = {name: 10.0 + 3.0 * i for i, name in enumerate(whole.names)}
    sample = view(whole, **values)
    outcome = bound(sample.values, sample.time)
    assert outcome == expected(view(reduced, **{name: values[name] for name in reduced.names}).values, sample.time)
    changed = view(whole, **values | dict.fromkeys(HIDDEN, 99.0))
    assert read_reward(kind).bind(whole)(changed.values, sample.time) == outcome


def test_unobserved_points__reward_reads_an_unobserved_point_that_it_names() -> None:
    whole = building().manifest
    bound = LinearReward(temperatures=["zone_2_air_temperature"], weight=0.0).bind(whole)
    sample = view(whole, zone_2_air_temperature=30.0, zone_1_air_temperature=99.0)
    assert bound(sample.values, sample.time).metrics["degrees_outside"] == pytest.approx(6.5)  # January: 20 to 23.5


def test_unobserved_points__function_gets_the_observed_values_and_the_others_by_name() -> None:
    whole = building().manifest
    listed: list[str] = []

    def function(values: Any, _: Any) -> float:
        listed.extend(values)
        return float(values["zone_2_air_temperature"])

    sample = view(whole, zone_2_air_temperature=30.0)
    assert from_function(function).bind(whole)(sample.values, sample.time).reward == 30.0
    assert tuple(listed) == whole.observed_names


@pytest.mark.parametrize(
    "name", sorted(set(CONTROLLERS) - {"coordinator", "offsets", "oracle", "portable-limit", "portable-setback"})
)  # which need a district, relative actions, a real building or a semantic model
def test_unobserved_points__controller_reads_observed_points_only(name: str) -> None:
    whole = building(control="building").manifest
    reduced = removed(whole)
    parameters = {"sensor": "zone_1_air_temperature", "actuator": "heating_setpoint", "setpoint": 21.0}
    own_parameters: dict[str, Any] = {"pid": parameters, "random": {"seed": 1}}.get(name, {})
    with_hidden, without = (Agent(make_controller(CONTROLLERS[name], one, own_parameters)) for one in (whole, reduced))
    for hour in range(0, 24, 3):
        values = {n: 17.0 + i + 0.3 * hour for i, n in enumerate(reduced.names)}
        at = view(whole).time.replace(hour=hour)
        hidden = dict.fromkeys(HIDDEN, 40.0)
        assert with_hidden.values(view(whole, at, step=hour, **values, **hidden)) == without.values(
            view(reduced, at, step=hour, **values)
        )


def test_unobserved_points__metrics_use_unobserved_points_and_tell_so() -> None:
    whole = building().manifest
    metrics = MetricsAccumulator(whole)
    assert metrics.sources["electricity_kwh"] == "meter Electricity:Facility"
    metrics.add(view(whole))
    metrics.add(view(whole, step=1, electricity_facility=7.2e6))
    assert metrics.result().energy_kwh["electricity"] == pytest.approx(2.0)


def test_unobserved_points__environment_with_unobserved_points_passes_all_checks() -> None:
    report = check_environment(BuildingEnv(link=FakeLink(building())))
    assert not report.failed, str(report)
