"""Apply a trained model during an episode, and compare the spaces of its training with those of a node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np


class Model(Protocol):
    """A trained model with the interface of stable-baselines3."""

    observation_space: Any
    action_space: Any

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, *, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return an action and the next state of a recurrent model."""


class Predictor:
    """A model's actions during an episode; it keeps the state of a recurrent model."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._state: Any = None
        self._first = np.array([True])

    def action(self, observation: Any) -> Any:
        """Return the model's action without exploration."""
        action, self._state = self._model.predict(
            observation, state=self._state, episode_start=self._first, deterministic=True
        )
        self._first = np.array([False])
        return action


def describe_difference(trained: gym.Space[Any], current: gym.Space[Any], names: Sequence[str] = ()) -> str:
    """Describe how two spaces differ; with the same number of dimensions, by the names whose bounds differ."""
    if not (isinstance(trained, gym.spaces.Box) and isinstance(current, gym.spaces.Box)):
        return f"{trained}, now {current}"
    if trained.shape != current.shape:
        listed = f": {', '.join(names)}" if names else ""
        return f"{trained.low.size} of them, now {current.low.size}{listed}"
    if len(names) != current.low.size:
        names = [f"number {index}" for index in range(current.low.size)]
    before, now = (np.stack([box.low.ravel(), box.high.ravel()], 1) for box in (trained, current))
    rows = zip(names, before.tolist(), now.tolist(), strict=True)
    return "; ".join(f"{name} was {a[0]:g} to {a[1]:g}, now {b[0]:g} to {b[1]:g}" for name, a, b in rows if a != b)
