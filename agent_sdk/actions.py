"""From an agent's action to a value for each actuator, checked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent_sdk import spaces
from topics.errors import InvalidAction
from topics.messages import Action, Choice, Manifest, Mask


class Actions:
    """The actions of a node's task.

    Attributes:
        space: `Box`, float32, shape (actions,), or `Discrete`, or `MultiDiscrete`.
        actuators: names of the actuators that they set; None for all.
        mask: what a command does to each actuator, raw; None if they set all.
    """

    def __init__(self, manifest: Manifest) -> None:
        task = manifest.task
        self.space = spaces.action_space(manifest)
        self._actions = task.actions
        self._choices = [_Table(choice, task.actions) for choice in task.choices]
        self._low = np.array([-np.inf if a.low is None else a.low for a in task.actions])
        self._high = np.array([np.inf if a.high is None else a.high for a in task.actions])
        if isinstance(self.space, spaces.Floats):
            self._space_low, self._space_high = self.space.low, self.space.high
        action_of = {name: i for i, action in enumerate(task.actions) for name in action.actuators}
        self._fan = np.array([action_of.get(a.name, 0) for a in manifest.actuators], np.intp)
        self._one_each = self._fan.tolist() == list(range(len(task.actions)))
        left = [a.name for a in manifest.actuators if a.name not in action_of]
        self.actuators = [a.name for a in manifest.actuators if a.name in action_of] if left else None
        kept = [Mask.KEEP if a.name in left else Mask.SET for a in manifest.actuators]
        self.mask = bytes(kept) if left else None

    @property
    def names(self) -> list[str]:
        """Names of the actions, in order."""
        return [action.name for action in self._actions]

    def values(self, action: ArrayLike) -> NDArray[np.float64]:
        """A value for each actuator, shape (actuators,), in manifest order and units.

        Raises:
            InvalidAction: a wrong shape, out of bounds, not finite, or no such choice.
        """
        chosen = self._chosen(action) if self._choices else self._checked(action)
        if self._one_each:
            return chosen
        return chosen[self._fan] if len(self._actions) else np.zeros(len(self._fan))

    def _checked(self, action: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(action, np.float64)
        if values.shape != self._low.shape:
            named = ", ".join(self.names) or "the building's own control"
            raise InvalidAction(f"action of shape {values.shape}; {self._low.shape} expected: {named}")
        if not self._inside(values).all():
            raise InvalidAction(self._fault(values))
        # The space's float32 bounds may lie a rounding error outside the actuators' own.
        return np.clip(values, self._low, self._high)

    def _inside(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        finite = np.isfinite(values)  # an unbounded action takes any finite value
        return finite & (values >= self._space_low) & (values <= self._space_high)

    def _fault(self, values: NDArray[np.float64]) -> str:
        faults = []
        for index in np.flatnonzero(~self._inside(values)):
            action = self._actions[index]
            bounds = f"{self._low[index]:g} to {self._high[index]:g} {action.unit}"
            faults.append(f"{action.name} = {values[index]:g}; its bounds are {bounds}")
        return "; ".join(faults)

    def _chosen(self, action: ArrayLike) -> NDArray[np.float64]:
        picked: NDArray[Any] = np.atleast_1d(np.asarray(action))
        if picked.shape != (len(self._choices),) or not np.issubdtype(picked.dtype, np.integer):
            raise InvalidAction(f"action {action!r}; {self.space} expected")
        values = np.empty(len(self._actions))
        for table, index in zip(self._choices, picked.tolist(), strict=True):
            if not 0 <= index < len(table.rows):
                raise InvalidAction(f"choice {index} of {', '.join(table.names)}; 0 to {len(table.rows) - 1} expected")
            values[table.columns] = table.rows[index]
        return values


class _Table:
    """One discrete dimension: the positions of its actions, and a row of values for each choice."""

    def __init__(self, choice: Choice, actions: tuple[Action, ...]) -> None:
        places = {action.name: i for i, action in enumerate(actions)}
        self.names = choice.actions
        self.columns = np.array([places[name] for name in choice.actions], np.intp)
        self.rows = np.array(choice.values, np.float64)
