"""A model that was trained behind wrappers acts within them again if they are saved beside it."""

from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from zenostat.agent_sdk.controllers import Agent, ScheduledSetback
from zenostat.agent_sdk.controllers.policy_loader import load_policy
from zenostat.agent_sdk.controllers.training_folder import normalization_path
from zenostat.agent_sdk.controllers.wrapped_policy import WrappedPolicy
from zenostat.agent_sdk.envs.sb3_vec_env import as_sb3
from zenostat.agent_sdk.testing import FakeBuilding, FakeEnv, FakeLink
from zenostat.agent_sdk.wrappers import apply_wrappers, restore_wrappers, save_wrappers
from zenostat.lab.evaluate import evaluate
from zenostat.lab.training import evaluate_model
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig

ONE = (np.float32(-1), np.float32(1))
DAY: dict[str, Any] = {"steps_per_hour": 1, "control": "building"}


def test_policy__model_behind_rescaled_actions_is_evaluated_afterwards(tmp_path: Path) -> None:
    """The recipe of docs/vector.md; the commands equal those of the model in the wrapped environment."""
    envs = gym.make_vec("zenostat/Fake-v1", num_envs=2, autoreset_mode="SameStep", **DAY)
    scaled = gym.wrappers.vector.RescaleAction(envs, *ONE)
    model = PPO("MlpPolicy", VecNormalize(VecMonitor(as_sb3(scaled))), n_steps=8, batch_size=8, device="cpu", seed=0)
    model.learn(16)
    normalization = model.get_vec_normalize_env()
    assert normalization is not None
    file = tmp_path / "model.zip"
    model.save(file)
    normalization.save(str(normalization_path(file)))
    with closing(FakeEnv(**DAY)) as env, pytest.raises(InvalidConfig, match="save_wrappers"):
        load_policy(file, "ppo")(env.manifest)
    save_wrappers(scaled, tmp_path / "model.wrappers.yaml")
    envs.close()
    with closing(FakeEnv(**DAY)) as env, closing(gym.wrappers.RescaleAction(FakeEnv(**DAY), *ONE)) as wrapped:
        agent = Agent(load_policy(file, "ppo")(env.manifest))
        observation, _ = env.reset(seed=5)
        wrapped.reset(seed=5)
        for _ in range(12):
            action = model.predict(normalization.normalize_obs(observation), deterministic=True)[0]
            observation, reward, *_ = env.step(agent.action(env.sample))
            expected, expected_reward, *_ = wrapped.step(action)
            assert np.array_equal(observation, expected)
            assert reward == expected_reward


def test_policy__forecast_errors_are_those_of_the_seed_of_the_episode(tmp_path: Path) -> None:
    """An evaluation afterwards gives what one during the training gives, also with a reward that is code."""
    errors = {"dry_bulb_temperature": {"sigma": 2.0, "tau_h": 6.0}}
    chain = [{"wrapper": "WeatherForecast", "columns": ["dry_bulb_temperature"], "n": 2, "errors": errors}]

    def bill(values: Any, begin: Any) -> float:
        return -float(values["hvac_electricity"])

    with closing(apply_wrappers(FakeEnv(reward=bill, **DAY), chain)) as env:
        model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu", seed=0)
        with torch.no_grad():  # a policy that reacts to the forecasts
            model.policy.action_net.weight.normal_(0.0, 5.0)
        model.save(tmp_path / "model.zip")
        save_wrappers(env, tmp_path / "model.wrappers.yaml")
        expected = [result.reward for result in evaluate_model(model, env, episodes=2, seed=7)]
        policy = load_policy(tmp_path / "model.zip", "ppo")
        rows = evaluate(
            {"link": FakeLink(FakeBuilding(**DAY)), "reward": bill}, {"policy": policy}, episodes=2, seed=7
        ).rows
    assert [row.result.reward for row in rows] == expected


class Forecaster:
    """A model whose cooling setpoint follows the first value of the forecast."""

    def __init__(self, env: Any) -> None:
        self.observation_space, self.action_space = env.observation_space, env.action_space

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        return np.array([15.0, np.clip(26.0 + 0.1 * observation[-2], 22.5, 30.0)], np.float32), None


@pytest.mark.parametrize("slots", [0, 2])
def test_policy__forecast_errors_differ_between_episodes_without_seeds(tmp_path: Path, slots: int) -> None:
    """In the same weather; a new controller repeats them."""
    errors = {"dry_bulb_temperature": {"sigma": 2.0, "tau_h": 6.0}}
    chain = [{"wrapper": "WeatherForecast", "columns": ["dry_bulb_temperature"], "n": 2, "errors": errors}]
    with closing(apply_wrappers(FakeEnv(**DAY), chain)) as env:
        model, file = Forecaster(env), tmp_path / "wrappers.yaml"
        save_wrappers(env, file)
    states = yaml12.read_mapping(file)["wrappers"]
    if slots:  # the state of running episodes of another number of slots is not restored
        states = [{**state, "slots": state["slots"] * slots} for state in states]

    def two_episodes() -> list[list[Any]]:
        with closing(FakeEnv(**DAY)) as env:
            agent, episodes = Agent(WrappedPolicy(env.manifest, model, None, chain, states)), []
            for _ in range(2):
                env.reset(seed=5)
                actions = []
                for _ in range(12):
                    actions.append(agent.action(env.sample).tolist())
                    env.step(actions[-1])
                episodes.append(actions)
        return episodes

    first, second = two_episodes()
    assert first != second
    assert two_episodes() == [first, second]


class ZeroModel(Forecaster):
    """A model without offsets."""

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        return np.zeros(self.action_space.shape, np.float32), None


def test_policy__rule_continues_beyond_the_time_limit_of_the_training() -> None:
    chain: list[dict[str, Any]] = [
        {"wrapper": "TimeLimit", "max_episode_steps": 3},
        {"wrapper": "ResidualAction", "controller": "setback"},
    ]
    with closing(FakeEnv(**DAY)) as env:
        model = ZeroModel(apply_wrappers(env, chain))
        policy, rule = (
            Agent(controller)
            for controller in (WrappedPolicy(env.manifest, model, None, chain, []), ScheduledSetback(env.manifest))
        )
        env.reset(seed=0)
        expected = set()
        for _ in range(24):
            action = policy.action(env.sample)
            np.testing.assert_array_equal(action, rule.action(env.sample))
            expected.add(tuple(action.tolist()))
            env.step(action)
    assert len(expected) == 2, "of day and night"


def test_policy__state_of_wrappers_is_restored_with_and_without_the_chain(tmp_path: Path) -> None:
    class Mine(gym.Wrapper[Any, Any, Any, Any]):
        """A wrapper of the user's, which cannot be written as data."""

    def chain(*, with_own: bool) -> Any:
        inner = gym.wrappers.NormalizeObservation(FakeEnv(**DAY))
        return Mine(inner) if with_own else inner

    for with_own in (False, True):
        file = tmp_path / f"{with_own}.wrappers.yaml"
        with closing(chain(with_own=with_own)) as env:
            env.reset(seed=0)
            save_wrappers(env, file)
        content = yaml12.parse(file.read_text(), str(file))
        assert content.get("chain") == (None if with_own else [{"wrapper": "NormalizeObservation"}])
        assert content.get("chain_error", "").startswith("Mine cannot be written" if with_own else "")
        with closing(chain(with_own=with_own)) as env:
            restore_wrappers(env, file)


def test_policy__model_within_wrappers_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "model.wrappers.yaml"
    with closing(gym.wrappers.TransformAction(FakeEnv(**DAY), lambda action: action + 1.0, None)) as env:
        PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu").save(tmp_path / "model.zip")
        save_wrappers(env, file)
    with pytest.raises(InvalidConfig, match=r"TransformAction cannot be written as data.*evaluate_model\(model, env\)"):
        load_policy(tmp_path / "model.zip", "ppo")
    file.write_text("wrappers:\n- wrapper: CyclicTime\n  slots: [{}]\n")
    with pytest.raises(InvalidConfig, match="it has no chain"):
        load_policy(tmp_path / "model.zip", "ppo")


def test_policy__wrappers_of_slots_are_those_of_a_controller(tmp_path: Path) -> None:
    """Those around and within the environments of one process; those in other processes cannot be read."""

    def make_env() -> Any:
        return gym.wrappers.RepeatAction(FakeEnv(**DAY), 2)

    envs = gym.vector.SyncVectorEnv([make_env, make_env])
    file = tmp_path / "model.wrappers.yaml"
    with closing(gym.wrappers.vector.RescaleAction(envs, *ONE)) as env:
        save_wrappers(env, file)
    names = [entry["wrapper"] for entry in yaml12.read_mapping(file)["chain"]]
    assert names == ["RepeatAction", "RescaleAction"]
