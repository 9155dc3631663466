"""Agents for zones: on the fake building by hand and property, on a real one by PettingZoo's own checks."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test
from support.nodes import COOLING, SMALL, ZONES
from support.run_cli import run_python

from zenostat.agent_sdk.envs.zone_agents import ZonesEnv
from zenostat.agent_sdk.rewards import LinearReward
from zenostat.agent_sdk.testing import FakeBuilding, FakeEnv, FakeLink
from zenostat.topics.errors import EpisodeChanged, InvalidAction, InvalidConfig
from zenostat.topics.extras import install_command


def fake(
    zones: Any = 3,
    *,
    reward: Any = "shared",
    shared: Sequence[str] = (),
    building_reward: Any = "linear",
    **building: Any,
) -> ZonesEnv:
    link = FakeLink(FakeBuilding(zones, **building))
    return ZonesEnv(link=link, reward=reward, shared=shared, building_reward=building_reward)


def real(**arguments: Any) -> ZonesEnv:
    return ZonesEnv(**{**SMALL, "affinity": "off", **arguments})


def draw(env: ZonesEnv) -> dict[str, Any]:
    return {agent: env.action_space(agent).sample() for agent in env.agents}


@pytest.fixture(scope="module")
def office() -> Iterator[ZonesEnv]:
    env = real(reward="own")
    yield env
    env.close()


# Agents and spaces


def test_zone_agents__agent_for_each_zone_with_its_own_thermostat_and_sensors() -> None:
    env = fake(2, time=["hour"], shared=["hvac_electricity"])
    assert env.possible_agents == ["zone_1", "zone_2"]
    assert env.action_names("zone_2") == ("zone_2_heating_setpoint", "zone_2_cooling_setpoint")
    assert env.observation_names("zone_2") == (
        "hour", "outdoor_temperature", "zone_2_air_temperature", "zone_2_occupants", "hvac_electricity"
    )  # fmt: skip
    assert env.observation_space("zone_2") == gym.spaces.Box(
        np.float32([0, -100, -100, 0, 0]), np.float32([23, 200, 200, np.inf, np.inf])
    )
    assert env.action_space("zone_2") == gym.spaces.Box(np.float32([15, 22.5]), np.float32([22.5, 30]))
    assert env.state_space == env.env.observation_space


def test_zone_agents__what_is_no_single_zones_is_the_buildings() -> None:
    env = fake(
        2,
        actions={
            "lights": ["equipment"],
            "one": ["zone_1_cooling_setpoint"],
            "heat": ["zone_1_heating_setpoint", "zone_2_heating_setpoint"],
        },
        equipment_control=True,
    )
    assert env.possible_agents == ["zone_1", "building"]
    assert env.action_names("zone_1") == ("one",)
    assert env.action_names("building") == ("lights", "heat")
    assert env.observation_names("building") == env.env.observation_names
    env.reset(seed=0)
    *_, infos = env.step({"building": np.float32([0.5, 19]), "zone_1": np.float32([24])})
    assert env.actuator_names("building") == ("zone_1_heating_setpoint", "zone_2_heating_setpoint", "equipment")
    assert infos["building"]["effective"].tolist() == [19.0, 19.0, 0.5]
    assert infos["zone_1"]["effective"].tolist() == [24.0]
    assert infos["zone_1"]["value_source"] == ("zone_1",)


def test_zone_agents__zone_that_is_called_as_another_agent_gets_a_number() -> None:
    from zenostat.agent_sdk.testing import Zone

    env = fake([Zone("building"), Zone("a-b"), Zone("plain")], equipment_control=True)
    assert env.possible_agents == ["building_2", "a-b", "plain", "building"]


def test_zone_agents__plant_of_ones_own_has_no_zones() -> None:
    with pytest.raises(InvalidConfig, match=r"a plant of your own has no zones"):
        ZonesEnv(plant="tank.py:Tank")


def test_zone_agents__discrete_zones_choose_each_for_itself() -> None:
    env = fake(2, control="zone", discrete=4)
    assert env.action_space("zone_1") == gym.spaces.Discrete(4)
    env.reset(seed=0)
    *_, infos = env.step({"zone_1": 0, "zone_2": np.int64(3)})
    assert infos["zone_1"]["effective"].tolist() == [15.0, 30.0]
    assert infos["zone_2"]["effective"].tolist() == [22.5, 22.5]
    points = fake(2, control="point", discrete=4)
    assert points.action_space("zone_1") == gym.spaces.MultiDiscrete([4, 4])
    points.reset(seed=0)
    *_, infos = points.step({"zone_1": [0, 3], "zone_2": [3, 0]})
    assert [infos[a]["effective"].tolist() for a in points.agents] == [[15.0, 22.5], [22.5, 30.0]]
    with pytest.raises(InvalidAction, match=r"agent 'zone_2': action 0.5; Discrete\(4\) expected: zone_2_heating"):
        env.step({"zone_1": 0, "zone_2": 0.5})
    with pytest.raises(InvalidAction, match="choice 4 of zone_2_heating_setpoint"):
        env.step({"zone_1": 0, "zone_2": 4})


def test_zone_agents__one_zone_alone_is_one_agent() -> None:
    env = fake(1, control="zone", discrete=4)
    env.reset(seed=0)
    assert env.step({"zone_1": 0})[-1]["zone_1"]["effective"].tolist() == [15.0, 30.0]


# Episodes


def test_zone_agents__it_is_the_buildings_environment_cut_in_parts() -> None:
    env, whole = fake(2), FakeEnv(2)
    parts, infos = env.reset(seed=3)
    observation, info = whole.reset(seed=3)
    assert infos["zone_1"]["weather_noise"] == info["weather_noise"]
    rng, ends = np.random.default_rng(1), []
    for step in range(1, 97):
        values = whole.observation_dict(observation)
        for agent in env.possible_agents:
            assert env.observation_space(agent).contains(parts[agent])
            named = env.observation_dict(agent, parts[agent])
            assert named == {name: values[name] for name in env.observation_names(agent)}
        assert env.state().tobytes() == observation.tobytes()
        action = whole.action_space.low + rng.uniform(0, 7.5, 4).astype(np.float32)
        parts, rewards, terminated, truncated, infos = env.step({"zone_2": action[2:], "zone_1": action[:2]})
        observation, reward, _, _, info = whole.step(action)
        assert rewards == {"zone_1": reward, "zone_2": reward}
        assert infos["zone_2"]["effective"].tolist() == info["effective"][2:].tolist()
        assert (infos["zone_1"]["step"], infos["zone_1"]["time"]) == (step, info["time"])
        assert infos["zone_1"]["reward_terms"] == info["reward_terms"]
        ends.append((set(terminated.values()), set(truncated.values()), bool(env.agents)))
    assert ends == [({False}, {False}, True)] * 95 + [({False}, {True}, False)]
    with pytest.raises(EpisodeChanged, match=r"the episode is over or has not started; call reset\(\) first"):
        env.step({})
    env.reset()
    assert env.agents == ["zone_1", "zone_2"]


def test_zone_agents__limit_ends_it_for_all() -> None:
    env = fake(2, terminate=[{"points": ["outdoor_temperature"], "low": 100.0}])
    env.reset(seed=0)
    _, _, terminated, truncated, infos = env.step(draw(env))
    assert (terminated, truncated) == ({"zone_1": True, "zone_2": True}, {"zone_1": False, "zone_2": False})
    assert "outdoor_temperature" in infos["zone_2"]["terminated_by"]
    assert env.agents == []


def test_zone_agents__faulty_actions_simulate_nothing() -> None:
    env = fake(2)
    with pytest.raises(EpisodeChanged):
        env.step({})
    with pytest.raises(EpisodeChanged, match=r"call reset\(\) first"):
        env.state()
    env.reset(seed=0)
    good = draw(env)
    for bad, message in (
        ({"zone_1": good["zone_1"]}, "no action of 'zone_2'"),
        ({**good, "zone_3": good["zone_1"]}, "no agent 'zone_3'; did you mean 'zone_"),
        ({**good, "zone_2": good["zone_2"][:1]}, r"agent 'zone_2': action .*; Box.* expected: zone_2_heating_setpoint"),
        ({**good, "zone_2": "warm"}, "agent 'zone_2': action 'warm' is not an array of numbers"),
        ({**good, "zone_2": [31.0, 25.0]}, "zone_2_heating_setpoint = 31; its bounds are 15 to 22.5"),
        ({**good, "zone_2": [np.nan, 25.0]}, "zone_2_heating_setpoint = nan"),
    ):
        with pytest.raises(InvalidAction, match=message):
            env.step(bad)
    assert env.step(good)[-1]["zone_1"]["step"] == 1


# Rewards


@pytest.mark.parametrize(
    "building_reward",
    [
        LinearReward(weight=0.3),
        {"kind": "exponential"},
        {"kind": "hourly"},
        {"kind": "occupied", "by": "people"},
        {"kind": "linear", "temperatures": ["zone_1_air_temperature"]},
    ],
)
def test_zone_agents__own_rewards_add_up_to_the_shared_one(building_reward: Any) -> None:
    own = fake(3, reward="own", building_reward=building_reward, equipment_control=True)
    shared = fake(3, building_reward=building_reward, equipment_control=True)
    own.reset(seed=1)
    shared.reset(seed=1)
    for agent in own.agents:
        own.action_space(agent).seed(5)
    differ = False
    while own.agents:
        actions = draw(own)
        _, mine, _, _, infos = own.step(actions)
        _, ours, _, _, same = shared.step(actions)
        assert sum(mine.values()) == pytest.approx(ours["zone_1"], rel=1e-12)
        comfort = sum(infos[agent]["reward_terms"]["comfort"] for agent in mine)
        assert comfort == pytest.approx(same["zone_1"]["reward_terms"]["comfort"], abs=1e-12)
        differ |= len(set(mine.values())) > 1
        for agent, reward in mine.items():
            assert reward == sum(infos[agent]["reward_terms"].values())
    assert differ


def test_zone_agents__own_reward_by_hand() -> None:
    """Summer band 23 to 26 degC, w = 0.5: -0.5e-4 P / 3 for each, and -0.5 for each degree outside in its own zone."""
    env = fake(2, reward="own", equipment_control=True)
    env.reset(seed=0)
    observations, rewards, *_ = env.step({"zone_1": [15, 22.5], "zone_2": [22.5, 30], "building": [1]})
    power_w = env.observation_dict("building", observations["building"])["hvac_and_plant_power"]
    for zone in ("zone_1", "zone_2"):
        degc = env.observation_dict(zone, observations[zone])[f"{zone}_air_temperature"]
        assert degc < 23.0
        assert rewards[zone] == pytest.approx(-0.5e-4 * power_w / 3 - 0.5 * (23.0 - degc), rel=1e-5)
    assert rewards["building"] == pytest.approx(-0.5e-4 * power_w / 3, rel=1e-6)
    assert rewards["zone_2"] > rewards["zone_1"], "the warmer zone is nearer to the band"


def test_zone_agents__function_of_ones_own() -> None:
    begins = []

    def reward(values: Any, begin: Any) -> dict[str, float]:
        begins.append(begin)
        return {zone: -abs(values[f"{zone}_air_temperature"] - 22.0) for zone in ("zone_1", "zone_2")}

    env = fake(2, reward=reward)
    env.reset(seed=0)
    for _ in range(3):
        observations, rewards, _, _, infos = env.step(draw(env))
    degc = env.observation_dict("zone_2", observations["zone_2"])["zone_2_air_temperature"]
    assert rewards["zone_2"] == pytest.approx(-abs(degc - 22.0), abs=1e-5)
    assert infos["zone_2"]["reward_terms"] == {"reward": rewards["zone_2"]}
    assert [(b.hour, b.minute) for b in begins] == [(0, 0), (0, 15), (0, 30)]
    forgetful = fake(2, reward=lambda values, begin: {"zone_1": 0.0})
    forgetful.reset(seed=0)
    with pytest.raises(InvalidConfig, match="a reward for each of zone_1, zone_2 expected"):
        forgetful.step(draw(forgetful))
    for wrong in (math.nan, -math.inf, None, np.zeros(2), "much"):
        env = fake(2, reward=lambda values, begin, wrong=wrong: {"zone_1": 0.0, "zone_2": wrong})
        env.reset(seed=0)
        with pytest.raises(InvalidConfig, match="for 'zone_2'; a finite number expected"):
            env.step(draw(env))


@pytest.mark.parametrize(
    ("reward", "building_reward", "terms"),
    [
        ("shared", "linear", {"energy", "comfort"}),
        ("shared", None, None),
        ("own", "linear", {"share", "comfort"}),
        (lambda _values, _begin: {"zone_1": 1.0, "zone_2": 2.0}, "linear", {"reward"}),
    ],
    ids=["shared", "none", "own", "function"],
)
def test_zone_agents__infos_of_reset_and_step_have_the_same_terms(
    reward: Any, building_reward: str | None, terms: set[str] | None
) -> None:
    env = fake(2, reward=reward, building_reward=building_reward)
    for _ in range(2):
        _, begin = env.reset(seed=0)
        *_, end = env.step(draw(env))
        for agent in env.agents:
            assert begin[agent].keys() == end[agent].keys()
            of_begin, of_end = (info[agent].get("reward_terms") for info in (begin, end))
            assert (of_begin and set(of_begin), of_end and set(of_end)) == (terms, terms)
            assert all(math.isnan(term) for term in (of_begin or {}).values())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"control": "building"}, "no action of node 'fake' belongs to a single zone; control='zone'"),
        ({"reward": "mine"}, "reward = 'mine'; 'shared', 'own' or a function"),
        ({"reward": "own", "building_reward": None}, "there is no reward; use building_reward='linear'"),
        ({"reward": "own", "building_reward": "peak"}, "PeakReward is not one; use"),
        ({"shared": ["power"]}, "no observation is named 'power'; did you mean 'hvac_and_plant_power'"),
    ],
)
def test_zone_agents__what_cannot_be(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        fake(2, **arguments)


def test_zone_agents__without_a_reward_all_get_nothing() -> None:
    env = fake(2, building_reward=None)
    env.reset(seed=0)
    assert env.step(draw(env))[1] == {"zone_1": 0.0, "zone_2": 0.0}


def test_zone_agents__strangers_are_named() -> None:
    env = fake(1)
    with pytest.raises(InvalidConfig, match="no agent 'zone_9'; did you mean 'zone_1'"):
        env.action_space("zone_9")


# PettingZoo's own checks, and a real building


@pytest.mark.parametrize("make", [fake, lambda: fake(2, discrete=5, equipment_control=True, reward="own")])
def test_zone_agents__pettingzoos_own_checks_pass(make: Callable[[], ZonesEnv]) -> None:
    parallel_api_test(make(), num_cycles=200)
    parallel_seed_test(make, num_cycles=50)


@pytest.mark.slow
def test_zone_agents__pettingzoos_own_checks_pass_on_a_real_building(office: ZonesEnv) -> None:
    parallel_api_test(office, num_cycles=200)
    parallel_seed_test(real, num_cycles=5)


@pytest.mark.slow
def test_zone_agents__zones_of_a_real_building(office: ZonesEnv) -> None:
    assert office.possible_agents == list(ZONES)
    assert office.env.local_node is not None
    office.reset(seed=2)
    assert office.observation_names("core_zn") == (
        "outdoor_temperature", "outdoor_humidity", "core_zn_air_temperature", "core_zn_relative_humidity",
        "core_zn_occupants",
    )  # fmt: skip
    for agent in office.possible_agents:
        office.action_space(agent).seed(len(agent))
    totals = []
    while office.agents:
        actions = draw(office)
        _, rewards, _, _, infos = office.step(actions)
        for agent, info in infos.items():
            assert info["effective"] == pytest.approx(actions[agent], abs=1e-6)
        values = office.env.observation_dict(office.state())
        outside = [max(23.0 - t, t - 26.0, 0.0) for t in (values[f"{zone}_air_temperature"] for zone in ZONES)]
        by_hand = -0.5e-4 * values["hvac_and_plant_power"] - 0.5 * sum(outside)
        assert sum(rewards.values()) == pytest.approx(by_hand, rel=1e-5, abs=1e-5)
        for (one, first), (other, second) in pairwise(zip(ZONES, outside, strict=True)):
            assert rewards[one] - rewards[other] == pytest.approx(-0.5 * (first - second), abs=1e-5)
        totals.append(sum(rewards.values()))
    assert len(totals) == 96
    assert min(totals) < 0.0


@pytest.mark.slow
def test_zone_agents__only_the_zones_that_are_set_have_agents() -> None:
    cooling = {"cool": COOLING["perimeter_zn_2_cooling_setpoint"]}
    with_one = real(actuators=cooling, discrete=3)
    try:
        assert with_one.possible_agents == ["perimeter_zn_2"]
        assert with_one.action_space("perimeter_zn_2") == gym.spaces.Discrete(3)
    finally:
        with_one.close()
        with_one.close()


def test_zone_agents__without_pettingzoo_one_sentence_states_what_to_do() -> None:
    text = "import sys; sys.modules['pettingzoo'] = None; import zenostat.agent_sdk.envs.zone_agents"
    done = run_python("-P", "-c", text)
    assert done.returncode != 0
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("zenostat.topics.errors.MissingExtra: an environment of several agents needs PettingZoo (")
    assert last.endswith(f": {install_command('multi-agent')}")


def test_zone_agents__reset_passes_a_snapshot_on_and_no_other_option() -> None:
    env = fake()
    env.reset(seed=0, options={"option": 1})
    with pytest.raises(InvalidConfig, match=r"options\['snapshot'\] is 's1'"):
        env.reset(options={"snapshot": "s1", "option": 1})
    with pytest.raises(InvalidAction, match="the action of each agent by its name expected"):
        env.step(None)  # type: ignore[arg-type]
