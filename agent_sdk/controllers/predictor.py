"""Apply a trained model during an episode, and compare the spaces of its training with those of a node."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from zenostat.agent_sdk.controllers.parameters import ControllerMismatch

_MASKS = "action_masks"
"""Argument of a model's `predict`, and the environment's method that returns it, by sb3-contrib's convention."""


class Model(Protocol):
    """A trained model with the interface of stable-baselines3."""

    observation_space: Any
    action_space: Any

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, *, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return an action and the next state of a recurrent model."""


class Predictor:
    """A model's actions during an episode; it keeps the state of a recurrent model.

    Args:
        model: The model. One that takes action masks, such as `MaskablePPO`, gets those of the environment.
        env: The environment of the episode, within the wrappers of the training; None if the model acts without one.

    Raises:
        ControllerMismatch: The model takes action masks, and the environment has none.
    """

    def __init__(self, model: Model, env: gym.Env[Any, Any] | None = None) -> None:
        self._model = model
        self._masks = _action_masks(model, env)
        self._state: Any = None
        self._first = np.array([True])

    def action(self, observation: Any) -> Any:
        """Return the model's action without exploration."""
        masks = {} if self._masks is None else {_MASKS: self._masks()}
        action, self._state = self._model.predict(
            observation, state=self._state, episode_start=self._first, deterministic=True, **masks
        )
        self._first = np.array([False])
        return action


def _action_masks(model: Model, env: gym.Env[Any, Any] | None) -> Callable[[], Any] | None:
    """Return the function of the current masks of the actions; None if the model takes none."""
    if _MASKS not in inspect.signature(model.predict).parameters:
        return None
    if env is None or not env.has_wrapper_attr(_MASKS):
        raise ControllerMismatch(
            f"a model of {type(model).__name__} needs the masks of its actions, and this environment has no method "
            f"{_MASKS}(); evaluate it in an environment that has it: evaluate_model(model, env)"
        )
    masks: Callable[[], Any] = env.get_wrapper_attr(_MASKS)
    return masks


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
