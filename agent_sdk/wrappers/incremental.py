"""What both incremental wrappers have: values of named actions that steps move within bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from agent_sdk.wrappers.base import EnvView, ResetBatch, Values, WrapperLogic
from agent_sdk.wrappers.names import places, refuse_inside
from topics.errors import InvalidAction, InvalidConfig

Floats = NDArray[np.float64]
_NOT_IN_UNITS = (
    "RescaleAction",
    "DiscretizeAction",
    "TransformAction",
    "IncrementalAction",
    "DiscreteIncrementalAction",
)


def incremented(values: Floats, increments: Floats, low: Floats, high: Floats) -> Floats:
    """Values after increments, within bounds, shapes (…, n)."""
    return np.clip(values + increments, low, high)


def rounded(increments: Floats, steps: Floats, most: Floats) -> Floats:
    """Increments to the nearest multiple of their step within `most`, half to even; as they are where it is 0."""
    whole = np.where(steps > 0, steps, 1.0)
    largest = np.floor(most / whole + 1e-9)
    return np.where(steps > 0, np.clip(np.round(increments / whole), -largest, largest) * whole, increments)


class IncrementalLogic(WrapperLogic):
    """Base: named actions have values that begin at `initial` in each episode."""

    def __init__(self, view: EnvView, initial: Mapping[str, float]) -> None:
        super().__init__(view)
        refuse_inside(view.env, _NOT_IN_UNITS, view.who + " moves values in their units; put it before {}")
        names = view.action_names
        if not isinstance(view.action_space, Box) or view.action_space.shape != (len(names),):
            raise InvalidConfig(f"{view.who} needs a value for each of {', '.join(names)}, not {view.action_space}")
        self.inner: Box[Any] = view.action_space
        self.names = names
        self.at = places(initial, names, view.who, "action")
        self.low, self.high = (bound[self.at].astype(np.float64) for bound in (self.inner.low, self.inner.high))
        self._initial = np.array(list(initial.values()), np.float64)
        self._check(initial)
        self._values = np.tile(self._initial, (view.slots, 1))

    def _check(self, initial: Mapping[str, float]) -> None:
        inside = (self._initial >= self.low) & (self._initial <= self.high)
        faults = [
            f"{self.view.who}: {name} begins at {value:g}; its bounds are {low:g} to {high:g}"
            for (name, value), low, high, fine in zip(initial.items(), self.low, self.high, inside, strict=True)
            if not fine
        ]
        if faults:
            raise InvalidConfig("\n".join(faults))

    def start(self, start: ResetBatch) -> Values:
        """The values begin anew."""
        self._values[start.slots] = self._initial
        return start.observations

    def move(self, slots: list[int], increments: Floats) -> NDArray[np.float32]:
        """The values after the increments, shape (rows, named actions)."""
        self._values[slots] = incremented(self._values[slots], increments, self.low, self.high)
        # float32 last: rounding may step over a bound that has no float32 of its own.
        told = self._values[slots].astype(np.float32)
        return np.clip(told, self.inner.low[self.at], self.inner.high[self.at])

    def get_state(self) -> list[dict[str, Any]]:
        """See `WrapperLogic`."""
        return [{"values": row} for row in self._values.tolist()]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """See `WrapperLogic`."""
        rows = np.array([state["values"] for state in slots], np.float64)
        self._values[:] = rows.reshape(self._values.shape)


def refused(who: str, action: Any, expected: Any) -> InvalidAction:
    """An action that the wrapper's space does not have."""
    return InvalidAction(f"{who}: action {np.asarray(action).tolist()}; {expected} expected")
