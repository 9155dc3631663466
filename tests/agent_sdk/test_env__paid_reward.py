"""The manifest of an environment has the reward that it pays, in every kind of environment, on the bus and in files."""

from collections.abc import Callable
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.nodes import SMALL, NodeProgram

from zenostat.agent_sdk.controllers import make_controller
from zenostat.agent_sdk.controllers.comfort_band import comfort_bands, default_setback
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.rewards import REWARDS, LinearReward, OccupiedReward, read_reward
from zenostat.agent_sdk.rewards.manifest_data import reward_data
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.lab.benchmark import SETS
from zenostat.metrics.reward_comfort import comfort
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

BAND = {"winter": (20.0, 24.0), "summer": (22.0, 26.0)}
OCCUPIED: dict[str, Any] = {"kind": "occupied", **BAND}
CUSTOM = {"kind": "custom", "name": "own"}
JULY, JANUARY = datetime(2017, 7, 3), datetime(2017, 1, 3)
OFFICE = "zenostat/ref-small-office-USA_CO_Denver-continuous-v1"


def own(values: Any, begin: Any) -> float:
    return -float(np.max(values["electricity_facility"]))


class MyOccupied(OccupiedReward):
    """A class of the user's: its data would be read as that of the bundled one."""


def band(manifest: Manifest) -> tuple[float, float]:
    return comfort_bands(manifest)(JULY)


@pytest.mark.slow
def test_env__local_node_publishes_the_reward_that_is_paid() -> None:
    with closing(BuildingEnv(**SMALL, affinity="off", reward=OCCUPIED)) as env:
        env.reset(seed=0)
        assert read_reward(env.manifest.task.reward) == env.reward == read_reward(OCCUPIED)
        assert env.manifest.task.scenario_reward == {"kind": "linear"}
        assert env.link.manifest.task == env.manifest.task
        assert read_reward(yaml12.parse(env.link.scenario(), "scenario")["reward"]) == env.reward
        assert (band(env.manifest), default_setback(env.manifest)) == ((22.0, 26.0), 6.0)
        with env.branch(slots=2) as branch:
            assert branch.manifest.task == env.manifest.task


@pytest.mark.parametrize("reward", [own, MyOccupied(), None], ids=["function", "class", "none"])
def test_env__code_of_the_user_is_named_and_comfort_stays_that_of_the_scenario(reward: Any) -> None:
    with closing(FakeEnv(reward=reward)) as env, closing(FakeEnv()) as plain:
        before, task = plain.manifest, env.manifest.task
        assert task.reward == (None if reward is None else {"kind": "custom", "name": task.reward["name"]})
        assert task.scenario_reward == before.task.reward
        assert band(env.manifest) == band(before)
        rated, expected = comfort(env.manifest), comfort(before)
        assert rated is not None
        assert np.array_equal(rated.zones, expected.zones)


def test_env__data_of_code_names_the_code_when_it_is_read() -> None:
    with pytest.raises(InvalidConfig, match="own is code of the program that used it"):
        read_reward(CUSTOM)


def test_env__reward_equal_to_that_of_the_scenario_changes_nothing() -> None:
    with closing(FakeEnv(reward=LinearReward())) as env, closing(FakeEnv()) as plain:
        assert env.manifest.task == plain.manifest.task


ENVIRONMENTS: dict[str, Callable[[Any], Any]] = {
    "single": lambda reward: gym.make(OFFICE, begin="07-03", end="07-03", affinity="off", reward=reward).unwrapped,
    "vector": lambda reward: BuildingVectorEnv(2, **SMALL, affinity="off", reward=reward),
}


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", ENVIRONMENTS)
def test_env__each_environment_has_it_before_and_after_a_reset(kind: str) -> None:
    with closing(ENVIRONMENTS[kind](own)) as env:
        before = env.manifest.task
        assert before.reward == CUSTOM
        assert before.scenario_reward is not None
        env.reset(seed=0)
        assert env.manifest.task == before
        assert env.link.manifest.task == before


@pytest.mark.slow
def test_env__environments_of_a_node_elsewhere_know_what_they_pay(scratch: Path) -> None:
    """The node's own manifest stays as it is: other clients see the scenario that it was started with."""
    with NodeProgram(scratch, **SMALL) as node:
        with closing(BuildingEnv(connect=node.endpoint, node="office", reward=OCCUPIED)) as env:
            env.reset(seed=0)
            assert read_reward(env.manifest.task.reward) == env.reward
            assert env.manifest.task.scenario_reward == env.link.manifest.task.reward == {"kind": "linear"}
        with closing(gym.make_vec("zenostat/Building-v1", connect=[node.endpoint], node="office", reward=own)) as fleet:
            fleet.reset(seed=0)
            assert fleet.unwrapped.manifest.task.reward == CUSTOM
            assert fleet.unwrapped.envs[0].manifest.task.reward == CUSTOM


def test_env__python_plant_publishes_it_too() -> None:
    plant = Path(__file__).parents[2] / "examples" / "own_plant.py"
    with closing(gym.make("zenostat/Plant-v1", plant=f"{plant}:HeatPumpRoom", reward=lambda values, begin: 1.0)) as env:
        env.reset(seed=0)
        assert env.unwrapped.link.manifest.task.reward == {"kind": "custom", "name": "<lambda>"}


@pytest.mark.slow
def test_env__rules_take_band_and_setback_of_the_benchmark() -> None:
    """22 to 26 degC in July with a margin of 1 K; 6 K outside while nobody is there, as comfort counts people only."""
    arguments = SETS["quick"].arguments("ref-small-office", "summer", "USA_IL_Chicago")
    with closing(BuildingEnv(**arguments, affinity="off")) as env:
        manifest = env.manifest
        assert read_reward(manifest.task.reward) == env.reward == read_reward(arguments["reward"])
        assert (band(manifest), comfort_bands(manifest)(JANUARY)) == ((22.0, 26.0), (20.0, 24.0))
        assert default_setback(manifest) == 6.0
        env.reset(seed=20_001)
        from zenostat.agent_sdk.controllers import Agent, load_controller

        for name, expected in (("rbc", (16.0, 30.0)), ("fixed", (22.5, 25.0))):  # heating ends at 22.5
            agent = Agent(make_controller(load_controller(name), manifest, {}), env)
            heating, cooling = agent.action(env.sample).tolist()  # midnight on Monday
            assert (heating, cooling) == expected, name


def test_env__price_file_is_the_same_file_for_a_reader_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "prices.csv").write_text("price\n" + "0.25\n" * 8760)
    monkeypatch.chdir(tmp_path)
    tariff = {"kind": "energy_cost", "price": {"csv": "prices.csv", "column": "price", "unit": "EUR/kWh"}}
    with closing(FakeEnv(reward=tariff)) as env:
        data = env.manifest.task.reward
    assert data["price"]["csv"] == str(tmp_path / "prices.csv")


NEEDED: dict[str, Any] = {
    "carbon": {"intensity": {"value": 300.0, "unit": "gCO2/kWh"}},
    "energy_cost": {"price": {"value": 0.2, "unit": "EUR/kWh"}},
    "occupied_cost": {"price": {"table": [{"value": 0.3, "hours": [12, 20]}], "otherwise": 0.1, "unit": "EUR/kWh"}},
    "tariff": {"periods": [{"value": 0.3, "hours": [12, 20]}], "otherwise": 0.1, "unit": "EUR/kWh"},
    "district": {"consumption": "feeder.import"},
}


@pytest.mark.parametrize("kind", REWARDS)
def test_env__kind_is_read_back_from_its_data(kind: str) -> None:
    reward = read_reward({"kind": kind, **NEEDED.get(kind, {})})
    assert read_reward(reward_data(reward) or {}) == reward
