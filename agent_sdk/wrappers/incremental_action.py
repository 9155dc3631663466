"""A wrapper whose actions change values instead of setting them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, Values
from agent_sdk.wrappers.incremental import IncrementalLogic, invalid_action, rounded
from agent_sdk.wrappers.names import indices_of
from topics.errors import InvalidConfig


class _Logic(IncrementalLogic):
    def __init__(
        self, view: EnvView, increments: Mapping[str, float | Sequence[float]], initial: Mapping[str, float]
    ) -> None:
        if set(increments) != set(initial):
            raise InvalidConfig(f"{view.wrapper_name}: increments and initial have to name the same actions")
        indices_of(increments, view.action_names, view.wrapper_name, "action")
        super().__init__(view, {name: initial[name] for name in increments})
        pairs = [_increment_and_step(value, f"{view.wrapper_name}: {name}") for name, value in increments.items()]
        self._max, self._steps = np.array(pairs).reshape(-1, 2).T
        low, high = self.inner.low.astype(np.float32), self.inner.high.astype(np.float32)
        low[self.indices], high[self.indices] = -self._max, self._max
        self._space = self.action_space = Box(low, high, dtype=np.float32)
        self.action_names = self.names

    def act(self, slots: list[int], actions: Values) -> Values:
        inner = actions.astype(np.float32)
        low, high = self._space.low, self._space.high
        if inner.shape[1:] != low.shape or not ((inner >= low) & (inner <= high) & np.isfinite(inner)).all():
            raise invalid_action(self.view.wrapper_name, actions if self.view.vector else actions[0], self._space)
        inner[:, self.indices] = self.move(
            slots, rounded(inner[:, self.indices].astype(np.float64), self._steps, self._max)
        )
        return inner


def _increment_and_step(value: Any, label: str) -> tuple[float, float]:
    try:
        increment, step = value if isinstance(value, Sequence) else (value, 0.0)
        is_valid = 0 < increment < np.inf and 0 <= step <= increment
    except (TypeError, ValueError):
        is_valid = False
    if not is_valid:
        raise InvalidConfig(
            f"{label}: got {value!r}; the largest increment has to be above 0 and its step not above the increment"
        )
    return float(increment), float(step)


class IncrementalAction(BuildingWrapper):
    """Take named actions as increments of their previous values, in the action's unit; other actions are unchanged.

    The values start at `initial` in each episode and stay within the actions' bounds.

    Args:
        increments: the largest increment by action, or (largest increment, step), in which case increments are rounded
            to the nearest multiple of the step, half to even.
        initial: the value of each of these actions at an episode's start.

    Raises:
        InvalidConfig: there is no such action, an initial value is missing or out of bounds, or an inner wrapper
            changes the units of actions. `InvalidAction` at a step: the action is not in the space; nothing was
            simulated.
    """

    logic = _Logic
