"""Environments for Ray: RLlib's new API stack, and Tune.

zenostat.ray.register()
config = PPOConfig().environment("zenostat", env_config={"scenario": "5zone-hot-continuous-v1"})
config = zenostat.ray.set_env_runners(config, runners=4, cores=2)

This module can be imported without Ray; its functions say what to install.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from zenostat.agent_sdk.envs.vector_env import MAX_SLOTS
from zenostat.topics.errors import InvalidConfig, NodeNotFound
from zenostat.topics.extras import import_extra

__all__ = ["ENV", "connect", "create_env", "register", "set_env_runners"]

ENV = "zenostat"
"""Default name of the environments in RLlib's registry."""

_TIMEOUT_S = 5.0


def register(name: str = ENV) -> str:
    """Register the environments in Ray's registry, for `AlgorithmConfig.environment(name, env_config={…})`.

    Args:
        name: The name in the registry.

    Returns:
        The name.

    Raises:
        InvalidConfig: Ray is not installed.
    """
    import_extra("ray.tune.registry", "ray", "zenostat.ray").register_env(name, create_env)
    return name


def create_env(context: Mapping[str, Any]) -> gym.Env[Any, Any] | VectorEnv[Any, Any, Any]:
    """Make the environment of an EnvRunner: a single one, or a vector if RLlib asks for one.

    Args:
        context: `env_config`, an `EnvContext` of RLlib. `id` is an id under `zenostat/` and can be left out if
            `scenario`, `file`, `config`, or `building` and `weather` name the simulation; all others are arguments of
            the environment. RLlib adds `num_envs` where it asks for a vector.

    Raises:
        UsageError, BusError, SimulatorError: See `BuildingEnv`.
    """
    arguments = dict(context)
    count, worker = arguments.pop("num_envs", None), getattr(context, "worker_index", 0)
    env_id = str(arguments.pop("id", "Building-v1"))
    env_id = env_id if env_id.startswith("zenostat/") else f"zenostat/{env_id}"
    if count is None:
        return gym.make(env_id, **arguments)
    return _WorkerSeeds(gym.make_vec(env_id, count, "vector_entry_point", **arguments), worker)


class _WorkerSeeds(VectorWrapper):
    """Gives each slot of all EnvRunners a seed of its own.

    RLlib seeds EnvRunner w with `seed + w`, and a vector slot i with `seed + i`: neighbors would have the same weather.
    Here slot i of EnvRunner w with n slots has `seed + n * w + i`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], worker: int) -> None:
        super().__init__(env)
        self._offset = worker * (env.num_envs - 1)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        seed = seed + self._offset if isinstance(seed, int | np.integer) else seed
        return self.env.reset(seed=seed, options=options)


def set_env_runners(config: Any, *, runners: int, cores: int = 1) -> Any:
    """Set the EnvRunners of an algorithm: each is one node, with as many slots as it has cores.

    An EnvRunner that dies is replaced, with a node of its own.

    Args:
        config: An `AlgorithmConfig` of RLlib; it is changed and returned.
        runners: Number of EnvRunners; 0 samples in the algorithm's own process.
        cores: Cores of each EnvRunner, which are also its slots, 1 to 256.

    Raises:
        InvalidConfig: A number out of range.
    """
    if not isinstance(runners, int) or runners < 0:
        raise InvalidConfig(f"runners = {runners!r}; a number from 0 expected")
    if not isinstance(cores, int) or not 1 <= cores <= MAX_SLOTS:
        raise InvalidConfig(f"cores = {cores!r}; a number from 1 to {MAX_SLOTS} expected")
    return config.env_runners(
        num_env_runners=runners,
        num_cpus_per_env_runner=cores,
        num_envs_per_env_runner=cores,
        gym_env_vectorize_mode="vector_entry_point",
    ).fault_tolerance(restart_failed_env_runners=True)


def connect(address: str, **arguments: Any) -> Any:
    """Connect to a Ray cluster that runs; use the result in a `with` statement.

    Args:
        address: HOST:PORT of the head node, as `ray start --head` prints it.
        arguments: Further arguments of `ray.init`.

    Raises:
        InvalidConfig: Ray is not installed, or the address is malformed.
        NodeNotFound: No Ray cluster answers there.
    """
    ray = import_extra("ray", "ray", "zenostat.ray")
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise InvalidConfig(f"{address!r} is not the address of a Ray cluster; write HOST:PORT, such as 127.0.0.1:6379")
    start = f"start one with: ray start --head --port {port}"
    try:
        socket.create_connection((host, int(port)), _TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise NodeNotFound(f"no Ray cluster answers at {address} ({error}); {start}") from None
    try:
        return ray.init(address=address, **arguments)
    except (ConnectionError, RuntimeError) as error:
        raise NodeNotFound(f"no Ray cluster answers at {address} ({str(error).splitlines()[0]}); {start}") from None
