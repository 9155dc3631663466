"""Search distributions over action sequences, for sampling-based model predictive control.

A sequence has an action for each timestep of the horizon, and changes from its center in blocks of several timesteps.
Both distributions are updated by weights of their samples: exponential in the return for model predictive path
integral control (MPPI), equal for the best samples and zero for all others for the cross-entropy method (CEM).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.topics.arrays import Floats

Actions = NDArray[Any]
"""Action sequences: shape (sequences, timesteps, *action shape)."""


class SequenceSearch(Protocol):
    """A distribution over action sequences of one planning step."""

    def sample(self, count: int) -> Actions:
        """Draw sequences."""

    def center(self) -> Actions:
        """Return the most likely sequence, shape (1, timesteps, *action shape)."""

    def update(self, actions: Actions, weights: Floats) -> None:
        """Move the distribution to weighted sequences; the weights add up to 1."""


def path_integral_weights(returns: Floats, temperature: float) -> Floats:
    """Return the weights of MPPI: exp((R - max R) / (temperature * std R)), which add up to 1.

    Source: Williams, Aldrich, Theodorou, "Model Predictive Path Integral Control", J. Guidance 40 (2017). The returns
    are scaled by their standard deviation, so that the temperature does not depend on the reward's unit.
    """
    spread = float(returns.std())
    weights = np.exp((returns - returns.max()) / (temperature * spread)) if spread > 0.0 else np.ones(len(returns))
    normalized: Floats = weights / weights.sum()
    return normalized


def elite_weights(returns: Floats, fraction: float) -> Floats:
    """Return the weights of CEM: equal for the best `fraction` of the samples, at least two of them, 0 for the rest.

    Source: Rubinstein, Kroese, "The Cross-Entropy Method", Springer 2004.
    """
    count = min(len(returns), max(2, round(fraction * len(returns))))
    weights = np.zeros(len(returns))
    weights[np.argsort(-returns, kind="stable")[:count]] = 1.0 / count
    return weights


class GaussianSearch:
    """Normal distribution of offsets from a center, independent for each block and action, clipped to the bounds.

    Args:
        space: bounds of the actions.
        center: shape (timesteps, actions).
        block: timesteps with a common offset.
        sigma: initial standard deviation, as a share of each action's range.
        adapt: whether updates change the standard deviation too, as in CEM.
        repair: changes actions that are not allowed, in place; shape (..., actions).
        random: generator of the samples.
    """

    def __init__(
        self,
        space: gym.spaces.Box,
        center: Actions,
        *,
        block: int,
        sigma: float,
        adapt: bool,
        repair: Callable[[Actions], None],
        random: np.random.Generator,
    ) -> None:
        self._low, self._high = space.low.astype(np.float64), space.high.astype(np.float64)
        if not (np.isfinite(self._low).all() and np.isfinite(self._high).all()):
            raise ControllerMismatch("the oracle draws actions between their bounds: add bounds in the scenario")
        self._center = center.astype(np.float64)
        self._repeats = _block_lengths(len(center), block)
        self._range = self._high - self._low
        self._sigma = np.full((len(self._repeats), len(self._low)), sigma) * self._range
        self._floor, self._adapt, self._repair, self._random = 0.01 * self._range, adapt, repair, random

    def sample(self, count: int) -> Actions:
        """Draw sequences; float32, shape (count, timesteps, actions)."""
        offsets = self._random.normal(size=(count, *self._sigma.shape)) * self._sigma
        return self._actions(self._center + np.repeat(offsets, self._repeats, axis=1))

    def center(self) -> Actions:
        """Return the center; float32, shape (1, timesteps, actions)."""
        return self._actions(self._center[None].copy())

    def _actions(self, values: Floats) -> Actions:
        np.clip(values, self._low, self._high, out=values)
        self._repair(values)
        return values.astype(np.float32)

    def update(self, actions: Actions, weights: Floats) -> None:
        """Move the center to the weighted mean; with `adapt`, the deviation to that of the samples in each block."""
        mean = np.tensordot(weights, actions.astype(np.float64), axes=1)
        if self._adapt:
            variance = np.tensordot(weights, (actions - mean) ** 2, axes=1)
            starts = np.concatenate([[0], np.cumsum(self._repeats)[:-1]])
            by_block = np.add.reduceat(variance, starts, axis=0) / self._repeats[:, None]
            self._sigma = np.maximum(np.sqrt(by_block), self._floor)
        self._center = mean


class CategoricalSearch:
    """Distribution of discrete choices, independent for each block and discrete action.

    Args:
        choices: number of choices of each discrete action.
        center: shape (timesteps, discrete actions).
        block: timesteps with a common choice.
        spread: initial probability of a choice other than the center's.
        random: generator of the samples.
    """

    def __init__(
        self, choices: Sequence[int], center: Actions, *, block: int, spread: float, random: np.random.Generator
    ) -> None:
        self._repeats, self._random = _block_lengths(len(center), block), random
        starts = np.concatenate([[0], np.cumsum(self._repeats)[:-1]])
        self._rows: list[Floats] = []
        for action, count in enumerate(choices):
            rows = np.full((len(self._repeats), count), spread / max(count, 1))
            rows[np.arange(len(rows)), center[starts, action]] += 1.0 - spread
            self._rows.append(rows / rows.sum(axis=1, keepdims=True))
        self._starts = starts

    def sample(self, count: int) -> Actions:
        """Draw sequences; int64, shape (count, timesteps, discrete actions)."""
        drawn = []
        for rows in self._rows:
            uniform = self._random.random((count, len(rows), 1))
            drawn.append((uniform > np.cumsum(rows, axis=1)[:, :-1]).sum(axis=-1))
        return np.repeat(np.stack(drawn, axis=-1), self._repeats, axis=1)

    def center(self) -> Actions:
        """Return the most likely choices; int64, shape (1, timesteps, discrete actions)."""
        return np.repeat(np.stack([rows.argmax(axis=1) for rows in self._rows], axis=-1)[None], self._repeats, axis=1)

    def update(self, actions: Actions, weights: Floats) -> None:
        """Move the probabilities halfway to the weighted shares of the choices."""
        for action, rows in enumerate(self._rows):
            chosen = actions[:, self._starts, action]
            shares = np.stack([weights @ (chosen == choice) for choice in range(rows.shape[1])], axis=1)
            self._rows[action] = rows + 0.5 * (shares - rows)


def _block_lengths(timesteps: int, block: int) -> NDArray[np.intp]:
    """Return the number of timesteps of each block; the last one may be shorter."""
    starts = np.arange(0, timesteps, block)
    return np.diff(np.append(starts, timesteps))
