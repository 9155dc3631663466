"""State of a reward, kept for each slot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig

Numbers = dict[str, Floats]


class SlotState:
    """Numbers by name, each with one value per slot.

    Args:
        kind: the reward's kind, for errors.
        initial: the numbers' initial values.
    """

    def __init__(self, kind: str, **initial: float) -> None:
        self._kind, self._initial = kind, initial
        self._numbers: Numbers = {}

    def of(self, shape: tuple[int, ...]) -> Numbers:
        """Return the numbers as arrays of the leading shape of the values, with their initial values at first.

        Raises:
            InvalidConfig: the shape was another one before.
        """
        if not self._numbers:
            self._numbers = {name: np.full(shape, value) for name, value in self._initial.items()}
        former = next(iter(self._numbers.values())).shape
        if former != shape:
            raise InvalidConfig(
                f"the {self._kind} reward keeps state for each slot: values of the leading shape {former} "
                f"expected, as before, got {shape}; bind it once for each use"
            )
        return self._numbers

    def store(self, **numbers: Floats) -> None:
        """Replace some of the numbers."""
        self._numbers |= {name: np.asarray(array, np.float64) for name, array in numbers.items()}

    def reset(self, slots: Sequence[int] | None) -> None:
        """Restore the initial values, in these slots or (None) in all."""
        if slots is None or any(array.ndim == 0 for array in self._numbers.values()):
            self._numbers = {}
            return
        for name, array in self._numbers.items():
            changed = array.copy()
            changed[list(slots)] = self._initial[name]
            self._numbers[name] = changed

    def state(self) -> dict[str, Any]:
        """Return the numbers as plain values; empty before the first use."""
        return {name: array.tolist() for name, array in self._numbers.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a state that `state` returned.

        Raises:
            InvalidConfig: it is the state of another reward.
        """
        if state and set(state) != set(self._initial):
            raise InvalidConfig(
                f"the {self._kind} reward has the state {', '.join(self._initial)}, not {', '.join(state)}"
            )
        self._numbers = {name: np.array(state[name], np.float64) for name in state}
