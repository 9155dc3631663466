"""Make environments from scenarios, and save them as scenario files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv

from zenostat.agent_sdk.envs.arguments import check_arguments
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.district_env import DistrictEnv
from zenostat.agent_sdk.envs.fleet_env import FleetVectorEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.rewards import Reward
from zenostat.agent_sdk.rewards.manifest_data import is_data, reward_data
from zenostat.agent_sdk.wrappers import apply_wrappers, wrappers_of
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig


def make(**arguments: Any) -> gym.Env[Any, Any]:
    """Make the environment of a scenario within its wrappers, as `gym.make` does.

    Args:
        arguments: As for `BuildingEnv`: `make(scenario="5zone-hot-continuous-v1", end="01-07")`.

    Raises:
        UsageError, BusError, SimulatorError: See `BuildingEnv`; everything that was started is closed again.
    """
    env = BuildingEnv(**arguments)
    try:
        wrapped: gym.Env[Any, Any] = apply_wrappers(env, env.manifest.task.wrappers)
    except BaseException:
        env.close()
        raise
    return wrapped


def make_district(**arguments: Any) -> DistrictEnv:
    """Make the environment of a district, as `gym.make("zenostat/District-v1", file=...)` does.

    Args:
        arguments: As for `DistrictEnv`.

    Raises:
        UsageError, BusError, SimulatorError: See `DistrictEnv`; everything that was started is closed again.
    """
    check_arguments(arguments, DistrictEnv)
    return DistrictEnv(**arguments)


def make_vec(num_envs: int = 1, **arguments: Any) -> VectorEnv[Any, Any, Any]:
    """Make the vector environment of a scenario within its wrappers, as `gym.make_vec` does.

    Args:
        num_envs: Number of slots, 1 to 256; with a list of endpoints or nodes, their number.
        arguments: As for `BuildingVectorEnv`; with a list in `connect` or `node`, as for `FleetVectorEnv`.

    Raises:
        UsageError, BusError, SimulatorError: See `BuildingVectorEnv`; everything that was started is closed again.
    """
    env: BuildingVectorEnv | FleetVectorEnv
    if any(isinstance(arguments.get(name), list | tuple) for name in ("connect", "node")):
        env = FleetVectorEnv(num_envs=num_envs, **{"connect": None, **arguments})
    else:
        env = BuildingVectorEnv(num_envs, **arguments)
    try:
        wrapped: VectorEnv[Any, Any, Any] = apply_wrappers(env, env.manifest.task.wrappers)
    except BaseException:
        env.close()
        raise
    return wrapped


def save_env(env: gym.Env[Any, Any], path: str | Path) -> None:
    """Write an environment with its reward and wrappers to a scenario file; `load_env` makes an equal one from it.

    Args:
        env: An environment within any wrappers of `zenostat.wrappers`, and those of Gymnasium that can be serialized.
        path: The file (YAML).

    Raises:
        InvalidConfig: An environment without a node, of a district or of a plant other than EnergyPlus, a reward that
            is a function or class of the user's, or a wrapper that cannot be serialized.
    """
    building = env.unwrapped
    if not isinstance(building, BuildingEnv) or not isinstance(building.link, ControllerLink):
        raise InvalidConfig(
            f"{type(building).__name__} has no scenario that can be saved; save an environment of a building"
        )
    text = building.link.scenario()
    fields = yaml12.parse(text, "the node's scenario") if text else {}
    if "building" not in fields:
        raise InvalidConfig(
            f"{building.manifest.building!r} is a district or a plant without a scenario and cannot be saved; create "
            "it again with the same arguments of gym.make, and its wrappers with apply_wrappers(env, wrappers_of(env))"
        )
    fields["reward"] = _serialize(building.reward)
    fields["wrappers"] = wrappers_of(env)
    Path(path).write_text(yaml12.dump(fields), encoding="utf-8")


def _serialize(reward: Reward | None) -> dict[str, Any] | None:
    if reward is None:
        return None
    if not is_data(reward):
        raise InvalidConfig(
            f"the reward {reward!r} is code of your own and cannot be saved in a file; save the environment with "
            "reward=None, and pass the reward to load_env(path, reward=...)"
        )
    return reward_data(reward)


def load_env(path: str | Path, **arguments: Any) -> gym.Env[Any, Any]:
    """Make the environment of a scenario file; arguments override its settings.

    Raises:
        UsageError, BusError, SimulatorError: See `BuildingEnv`.
    """
    return gym.make("zenostat/Scenario-v1", file=path, **arguments)
