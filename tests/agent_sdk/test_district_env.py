"""Districts as environments: Gymnasium's and PettingZoo's own checks, seeds, and errors before anything starts."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from support.district_files import DISTRICT, STEPS, write_district

from zenostat import save_env  # the package registers the environments
from zenostat.envs import DistrictAgentsEnv
from zenostat.topics.errors import InvalidConfig, UnknownArgument


@pytest.fixture(scope="module")
def agents(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DistrictAgentsEnv]:
    """A district with an agent for each plant; its `env` is the district with a single one."""
    rewards = {
        "east": lambda values, begin: -abs(values["east.temperature"] - 20.0),
        "west": {"kind": "district", "consumption": "west.draw", "peak": 2.0, "ramping": 0.0},
        "feeder": {"kind": "district", "consumption": "feeder.import", "cost": 0.0},
    }
    file = write_district(tmp_path_factory.mktemp("district"))
    env = DistrictAgentsEnv(file, shared=["feeder.loading"], reward=rewards)
    yield env
    env.close()


def episode(env: Any, seed: int) -> list[bytes]:
    """The observations and rewards of an episode with random actions."""
    observation, _ = env.reset(seed=seed)
    env.action_space.seed(seed)
    bits = [observation.tobytes()]
    for _ in range(STEPS):
        observation, reward, _, truncated, _ = env.step(env.action_space.sample())
        bits += [observation.tobytes(), np.float64(reward).tobytes()]
    assert truncated
    return bits


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*(symmetric and normalized|is probably too|infinity)")
def test_district_env__passes_the_check_of_gymnasium(agents: DistrictAgentsEnv) -> None:
    check_env(agents.env, skip_render_check=True, skip_close_check=True)


def test_district_env__has_the_points_of_all_plants_that_no_connection_feeds(agents: DistrictAgentsEnv) -> None:
    env = agents.env
    assert env.action_names == ("east.heater", "west.heater", "feeder.battery_setpoint", "feeder.car_limit")
    assert env.observation_names[:3] == ("hour", "east.temperature", "east.draw")
    assert not any(name.startswith(("exchange.", "plant.")) for name in env.observation_names)


def test_district_env__seed_gives_one_trajectory_to_the_bit(agents: DistrictAgentsEnv) -> None:
    first = episode(agents.env, 5)
    assert episode(agents.env, 6) != first
    assert episode(agents.env, 5) == first


def test_district_env__pays_the_reward_of_its_file(agents: DistrictAgentsEnv) -> None:
    env = agents.env
    env.reset(seed=0)
    *_, info = env.step(np.float32([0.0, 0.0, 0.0, 0.0]))
    net_kw = (500.0 * 2 + 900.0 * 2) / 1e3
    assert info["reward_metrics"]["net_kw"] == pytest.approx(net_kw)
    assert info["reward_terms"]["peak"] == pytest.approx(-0.5 * net_kw)


def test_district_agents__pass_the_test_of_pettingzoo(agents: DistrictAgentsEnv) -> None:
    parallel_api_test(agents, num_cycles=2 * STEPS)


def test_district_agents__are_plants_that_see_themselves_and_what_is_shared(agents: DistrictAgentsEnv) -> None:
    assert agents.possible_agents == ["east", "west", "feeder"]
    assert agents.observation_names("east") == (
        "hour", "east.temperature", "east.draw", "feeder.loading", "east.electricity"
    )  # fmt: skip
    assert agents.action_names("feeder") == ("feeder.battery_setpoint", "feeder.car_limit")


def test_district_agents__each_is_paid_its_own_reward(agents: DistrictAgentsEnv) -> None:
    _, begin = agents.reset(seed=0)
    actions = {"east": [0.0], "west": [1000.0], "feeder": [0.0, 0.0]}
    observations, rewards, *_, infos = agents.step({name: np.float32(a) for name, a in actions.items()})
    temperature = agents.observation_dict("east", observations["east"])["east.temperature"]
    assert rewards["east"] == pytest.approx(-abs(temperature - 20.0), rel=1e-6)
    assert rewards["west"] == pytest.approx(-0.5 * 2.0 * 2.8)
    assert infos["feeder"]["reward_terms"] == pytest.approx({"peak": -0.5 * 3.8, "ramping": 0.0})
    assert {name: set(info["reward_terms"]) for name, info in begin.items()} == {
        name: set(info["reward_terms"]) for name, info in infos.items()
    }
    assert all(np.isnan([*info["reward_terms"].values()]).all() for info in begin.values())


@pytest.mark.variants
@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({}, InvalidConfig, "name the file of a district"),
        ({"fil": "x.yaml"}, UnknownArgument, "did you mean 'file'"),
        ({"file": "x.yaml"}, InvalidConfig, "there is no file .*x.yaml"),
        ({"reward": "distrct"}, InvalidConfig, "did you mean 'district'"),
        ({"render_mode": "rgb_array"}, InvalidConfig, "a district has: rerun"),
    ],
)
def test_district_env__error_is_one_sentence(
    tmp_path: Path, arguments: dict[str, Any], error: type[Exception], text: str
) -> None:
    if "reward" in arguments or "render_mode" in arguments:
        arguments = {"file": write_district(tmp_path), **arguments}
    with pytest.raises(error, match=text):
        gym.make("zenostat/District-v1", **arguments)


def test_save_env__refuses_a_district_and_a_plant_of_ones_own(agents: DistrictAgentsEnv, tmp_path: Path) -> None:
    tank = Path(__file__).parents[2] / "examples" / "own_plant.py"
    with closing(gym.make("zenostat/Plant-v1", plant=f"{tank}:HeatPumpRoom", reward=None)) as plant:
        for env in (agents.env, plant):
            with pytest.raises(InvalidConfig, match=r"create it again with the same arguments of gym.make"):
                save_env(env, tmp_path / "saved.yaml")
    assert not list(tmp_path.iterdir())


def test_district_env__reward_of_the_file_is_checked_first(tmp_path: Path) -> None:
    file = write_district(
        tmp_path, DISTRICT.replace("kind: district", "kind: distrct").replace("east.draw", "no.where")
    )
    with pytest.raises(InvalidConfig) as raised:
        gym.make("zenostat/District-v1", file=file)
    assert "did you mean 'district'" in str(raised.value)


@pytest.mark.parametrize(
    ("reward", "text"),
    [
        ({"est": "linear"}, "no agent 'est'; did you mean .*'east'.*no reward of 'east'"),
        ({"east": "linear", "west": "linear", "feeder": "linear"}, "of 'east': the linear reward needs"),
        ("own", "'shared', a reward for each agent"),
    ],
)
def test_district_agents__rewards_that_do_not_fit_are_named(agents: DistrictAgentsEnv, reward: Any, text: str) -> None:
    endpoint, node = agents.env.local_node.endpoint, agents.env.manifest.node
    with pytest.raises(InvalidConfig, match=text):
        DistrictAgentsEnv(connect=endpoint, node=node, priority=12, reward=reward)
