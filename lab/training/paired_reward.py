"""Rewards as differences to those of the same episodes with zero actions: common random numbers.

Weather, noise and schedules cause most of the variance of a building's rewards, and no action changes them. A reference
with the same seed, whose offsets are zero, has the same ones. What remains in the difference of both rewards is what
the actions change. The best policy is the same, since no action affects the reference.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from zenostat.agent_sdk.wrappers.checkpoint import LOGS
from zenostat.agent_sdk.wrappers.names import layers
from zenostat.lab.training.zero_actions import zero_actions
from zenostat.topics.errors import InvalidConfig

SCALED = frozenset({"NormalizeReward", "ClipReward"})
"""Gymnasium's wrappers that change a reward by what it has been, or not in proportion."""


def paired(env: Any, reference: Any) -> Any:
    """Return a single or vector environment whose rewards are less by those of a reference.

    The reference is reset and stepped with it. Its actions are zero, so it follows the building's own control
    (`relative`) or the rule (`ResidualAction`).

    Args:
        env: environment whose actions are offsets.
        reference: another one, made with the same arguments and wrappers; the caller closes both.

    Raises:
        InvalidConfig: the actions are no offsets, zero is not one of them, a wrapper logs episodes, which would
            write those of the reference as well, or scales rewards. At a step: the episodes of both do not end
            together.
    """
    zeros = zero_actions(env, "paired_reward")
    for layer in layers(env):
        if type(layer).__name__ in LOGS:
            raise InvalidConfig(f"paired_reward: {type(layer).__name__} would log the reference as well; remove it")
        if type(layer).__name__ in SCALED:
            raise InvalidConfig(
                f"paired_reward: {type(layer).__name__} would scale the rewards of environment and reference "
                "differently; remove it, and use normalization.rewards"
            )
    if isinstance(env, VectorEnv):
        return _PairedVectorEnv(env, reference, np.tile(zeros, (env.num_envs, 1)))
    return _PairedEnv(env, reference, zeros)


def _check_ends(ends: Any, reference_ends: Any) -> None:
    if np.any(np.asarray(ends) != np.asarray(reference_ends)):
        raise InvalidConfig(
            "paired_reward: an episode did not end together with that of its reference; remove the scenario's "
            "termination"
        )


class _PairedEnv(gym.Wrapper[Any, Any, Any, Any]):
    def __init__(self, env: Any, reference: Any, zeros: NDArray[np.float32]) -> None:
        super().__init__(env)
        self._reference, self._zeros = reference, zeros

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._reference.reset(seed=seed, options=options)
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        _, subtracted, *reference_ends, _ = self._reference.step(self._zeros)
        _check_ends([terminated, truncated], reference_ends)
        return observation, float(reward) - float(subtracted), terminated, truncated, info


class _PairedVectorEnv(VectorWrapper):
    def __init__(self, env: Any, reference: Any, zeros: NDArray[np.float32]) -> None:
        super().__init__(env)
        self._reference, self._zeros = reference, zeros

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._reference.reset(seed=seed, options=options)
        return self.env.reset(seed=seed, options=options)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        _, subtracted, *reference_ends, _ = self._reference.step(self._zeros)
        _check_ends([terminated, truncated], reference_ends)
        return observations, rewards - subtracted, terminated, truncated, infos
