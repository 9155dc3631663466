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

from zenostat.agent_sdk.wrappers import EpisodeLog, ResidualAction, TensorBoardLog, WeightsAndBiasesLog
from zenostat.agent_sdk.wrappers.names import attribute, layers
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

_LOGS = (EpisodeLog, TensorBoardLog, WeightsAndBiasesLog)
_RESCALED = (gym.wrappers.RescaleAction, gym.wrappers.vector.RescaleAction)


def paired(env: Any, reference: Any) -> Any:
    """Return a single or vector environment whose rewards are less by those of a reference.

    The reference is reset and stepped with it. Its actions are zero, so it follows the building's own control
    (`relative`) or the rule (`ResidualAction`).

    Args:
        env: environment whose actions are offsets.
        reference: another one, made with the same arguments and wrappers; the caller closes both.

    Raises:
        InvalidConfig: the actions are no offsets, zero is not one of them, or a wrapper logs episodes, which would
            write those of the reference as well. At a step: the episodes of both do not end together.
    """
    manifest: Manifest = attribute(env, "manifest")
    chain = [*layers(env)]
    is_residual = any(isinstance(layer, ResidualAction) for layer in chain)
    absolute = [action.name for action in manifest.task.actions if not action.relative]
    if absolute and not is_residual:
        raise InvalidConfig(
            f"paired_reward: the action {absolute[0]!r} is no offset, so zero is not the building's own control; use "
            "relative actions or ResidualAction"
        )
    for layer in chain:
        if isinstance(layer, _LOGS):
            raise InvalidConfig(f"paired_reward: {type(layer).__name__} would log the reference as well; remove it")
    zeros = _zeros(env)
    if isinstance(env, VectorEnv):
        return _PairedVectorEnv(env, reference, np.tile(zeros, (env.num_envs, 1)))
    return _PairedEnv(env, reference, zeros)


def _zeros(env: Any) -> NDArray[np.float32]:
    """Return the action that is an offset of zero, shape (actions,)."""
    space = getattr(env, "single_action_space", env.action_space)
    if not isinstance(space, gym.spaces.Box):
        raise InvalidConfig(f"paired_reward needs continuous actions, not {space}")
    zeros = np.zeros(space.shape, np.float32)
    if isinstance(env, _RESCALED):
        inner: Any = getattr(env.env, "single_action_space", env.env.action_space)
        zeros = space.low + (space.high - space.low) * ((zeros - inner.low) / (inner.high - inner.low))
    if zeros not in space:
        raise InvalidConfig(f"paired_reward: an offset of zero is not in {space}")
    return zeros


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
