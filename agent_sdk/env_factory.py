"""An environment as one file: scenario, reward and wrappers."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import gymnasium as gym

from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.envs.arguments import check_arguments
from agent_sdk.envs.building_env import BuildingEnv
from agent_sdk.rewards import Reward
from agent_sdk.rewards.config import RewardConfig
from agent_sdk.wrappers import apply_wrappers, wrappers_of
from topics import yaml12
from topics.errors import InvalidConfig


def make(**given: Any) -> gym.Env[Any, Any]:
    """The environment of a scenario, within the wrappers that it names; what `gym.make` calls.

    Raises:
        UsageError, BusError, SimulatorError: see `BuildingEnv`; nothing is left behind.
    """
    check_arguments(given, list(inspect.signature(BuildingEnv).parameters))
    env = BuildingEnv(**given)
    try:
        wrapped: gym.Env[Any, Any] = apply_wrappers(env, env.manifest.task.wrappers)
    except BaseException:
        env.close()
        raise
    return wrapped


def save_env(env: gym.Env[Any, Any], path: str | Path) -> None:
    """Writes an environment, its reward and its wrappers as a scenario file; `load_env` makes an equal one.

    Args:
        env: with any wrappers of `agent_sdk.wrappers` and those of Gymnasium's that can be written as data.
        path: of the file (YAML).

    Raises:
        InvalidConfig: an environment without a node, a reward that is a function or a class of the user's, or a
            wrapper that cannot be written as data.
    """
    building = env.unwrapped
    if not isinstance(building, BuildingEnv) or not isinstance(building.link, ControllerLink):
        raise InvalidConfig(f"{type(building).__name__} has no scenario to be written; save a zenostat/ environment")
    fields = yaml12.parse(building.link.scenario(), "the node's scenario")
    fields["reward"] = _written(building.reward)
    fields["wrappers"] = wrappers_of(env)
    Path(path).write_text(yaml12.dump(fields), encoding="utf-8")


def _written(reward: Reward | None) -> dict[str, Any] | None:
    if reward is None:
        return None
    if not isinstance(reward, RewardConfig):
        raise InvalidConfig(
            f"the reward {reward!r} is code of your own and cannot stand in a file; pass it again by "
            "load_env(path, reward=...) after saving the environment with reward=None"
        )
    return reward.model_dump(mode="json", exclude_defaults=True)


def load_env(path: str | Path, **given: Any) -> gym.Env[Any, Any]:
    """The environment of a file; arguments go before what it says.

    Raises:
        UsageError, BusError, SimulatorError: see `BuildingEnv`.
    """
    return gym.make("zenostat/Scenario-v1", file=path, **given)
