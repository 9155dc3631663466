"""Actions that change a value rather than set it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, Values
from agent_sdk.wrappers.incremental import IncrementalLogic, refused, rounded
from agent_sdk.wrappers.names import places
from topics.errors import InvalidConfig


class _Logic(IncrementalLogic):
    def __init__(
        self, view: EnvView, increments: Mapping[str, float | Sequence[float]], initial: Mapping[str, float]
    ) -> None:
        if set(increments) != set(initial):
            raise InvalidConfig(f"{view.who}: increments and initial should name the same actions")
        places(increments, view.action_names, view.who, "action")
        super().__init__(view, {name: initial[name] for name in increments})
        pairs = np.array([_pair(given, f"{view.who}: {name}") for name, given in increments.items()])
        most, self._steps = self._most, _ = pairs.reshape(-1, 2).T
        low, high = self.inner.low.astype(np.float32), self.inner.high.astype(np.float32)
        low[self.at], high[self.at] = -most, most
        self._space = self.action_space = Box(low, high, dtype=np.float32)
        self.action_names = self.names

    def act(self, slots: list[int], actions: Values) -> Values:
        """See `WrapperLogic`."""
        told = actions.astype(np.float32)
        low, high = self._space.low, self._space.high
        if told.shape[1:] != low.shape or not ((told >= low) & (told <= high) & np.isfinite(told)).all():
            raise refused(self.view.who, actions if self.view.vector else actions[0], self._space)
        told[:, self.at] = self.move(slots, rounded(told[:, self.at].astype(np.float64), self._steps, self._most))
        return told


def _pair(given: Any, who: str) -> tuple[float, float]:
    try:
        most, step = given if isinstance(given, Sequence) else (given, 0.0)
        fine = 0 < most < np.inf and 0 <= step <= most
    except (TypeError, ValueError):
        fine = False
    if not fine:
        raise InvalidConfig(f"{who}: {given!r}; the largest increment is above 0, and its step is not above that")
    return float(most), float(step)


class IncrementalAction(BuildingWrapper):
    """Named actions are increments on the value before, in the action's unit; the others stay as they are.

    The value starts from `initial` in each episode and stays within the action's bounds.

    Args:
        increments: action to the largest increment, or to (largest increment, step): increments are rounded to the
            nearest multiple of the step, half to even.
        initial: the value of each of these actions at an episode's begin.

    Raises:
        InvalidConfig: no such action, no initial value or one out of bounds, or a wrapper within that takes actions
            out of their units. `InvalidAction` at a step: an action out of the space, nothing was simulated.
    """

    logic = _Logic
