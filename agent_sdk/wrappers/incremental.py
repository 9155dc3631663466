"""Common logic of the incremental wrappers: values of named actions that increments change within bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from agent_sdk.wrappers.base import EnvView, ResetBatch, Values, WrapperLogic
from agent_sdk.wrappers.names import indices_of, reject_wrappers
from topics.errors import InvalidAction, InvalidConfig
from topics.typing_compat import override

Floats = NDArray[np.float64]
_NOT_IN_UNITS = (
    "RescaleAction",
    "DiscretizeAction",
    "TransformAction",
    "IncrementalAction",
    "DiscreteIncrementalAction",
)


def incremented(values: Floats, increments: Floats, low: Floats, high: Floats) -> Floats:
    """Return the values after increments, clipped to their bounds, shapes (…, n)."""
    return np.clip(values + increments, low, high)


def rounded(increments: Floats, steps: Floats, max_increments: Floats) -> Floats:
    """Round increments to the nearest multiple of their step, half to even; a step of 0 leaves them unchanged."""
    divisors = np.where(steps > 0, steps, 1.0)
    largest = np.floor(max_increments / divisors + 1e-9)
    return np.where(steps > 0, np.clip(np.round(increments / divisors), -largest, largest) * divisors, increments)


class IncrementalLogic(WrapperLogic):
    """Base of the incremental wrappers: named actions have values, which are `initial` at each episode's start."""

    def __init__(self, view: EnvView, initial: Mapping[str, float]) -> None:
        super().__init__(view)
        reject_wrappers(
            view.env, _NOT_IN_UNITS, view.wrapper_name + " changes values in their units; apply it before {}"
        )
        names = view.action_names
        if not isinstance(view.action_space, Box) or view.action_space.shape != (len(names),):
            raise InvalidConfig(
                f"{view.wrapper_name} needs a value for each of {', '.join(names)}, not {view.action_space}"
            )
        self.inner: Box[Any] = view.action_space
        self.names = names
        self.indices = indices_of(initial, names, view.wrapper_name, "action")
        self.low, self.high = (bound[self.indices].astype(np.float64) for bound in (self.inner.low, self.inner.high))
        self._initial = np.array(list(initial.values()), np.float64)
        self._check(initial)
        self._values = np.tile(self._initial, (view.slots, 1))

    def _check(self, initial: Mapping[str, float]) -> None:
        inside = (self._initial >= self.low) & (self._initial <= self.high)
        errors = [
            f"{self.view.wrapper_name}: {name} starts at {value:g}, outside its bounds {low:g} to {high:g}"
            for (name, value), low, high, is_inside in zip(initial.items(), self.low, self.high, inside, strict=True)
            if not is_inside
        ]
        if errors:
            raise InvalidConfig("\n".join(errors))

    @override
    def start(self, start: ResetBatch) -> Values:
        self._values[start.slots] = self._initial
        return start.observations

    def move(self, slots: list[int], increments: Floats) -> NDArray[np.float32]:
        """Add the increments and return the values, shape (rows, named actions)."""
        self._values[slots] = incremented(self._values[slots], increments, self.low, self.high)
        # Clip after the conversion to float32: rounding may exceed a bound that is not a float32.
        values = self._values[slots].astype(np.float32)
        return np.clip(values, self.inner.low[self.indices], self.inner.high[self.indices])

    @override
    def get_state(self) -> list[dict[str, Any]]:
        return [{"values": row} for row in self._values.tolist()]

    @override
    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        rows = np.array([state["values"] for state in slots], np.float64)
        self._values[:] = rows.reshape(self._values.shape)


def invalid_action(wrapper_name: str, action: Any, expected: Any) -> InvalidAction:
    """Return the error for an action outside the wrapper's space."""
    return InvalidAction(f"{wrapper_name}: action {np.asarray(action).tolist()} is not in {expected}")
