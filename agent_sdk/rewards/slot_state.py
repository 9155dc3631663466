"""What a reward remembers of each slot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topics.errors import InvalidConfig

Numbers = dict[str, NDArray[np.float64]]


class SlotState:
    """Numbers by name, one of each for each slot.

    Args:
        kind: the reward's, for errors.
        blank: the numbers before anything was seen.
    """

    def __init__(self, kind: str, **blank: float) -> None:
        self._kind, self._blank = kind, blank
        self._numbers: Numbers = {}

    def of(self, shape: tuple[int, ...]) -> Numbers:
        """The numbers, as arrays of the leading shape of the values; blank at first.

        Raises:
            InvalidConfig: they were of another shape before.
        """
        if not self._numbers:
            self._numbers = {name: np.full(shape, value) for name, value in self._blank.items()}
        was = next(iter(self._numbers.values())).shape
        if was != shape:
            raise InvalidConfig(
                f"the {self._kind} reward remembers something of each slot: values of the leading shape {was} "
                f"expected, as before, got {shape}; bind it once for each use"
            )
        return self._numbers

    def keep(self, **numbers: NDArray[np.float64]) -> None:
        """Puts others in their place."""
        self._numbers = {name: np.asarray(array, np.float64) for name, array in numbers.items()}

    def forget(self, slots: Sequence[int] | None) -> None:
        """Makes them blank, in these slots or in all."""
        if slots is None or any(array.ndim == 0 for array in self._numbers.values()):
            self._numbers = {}
            return
        for name, array in self._numbers.items():
            changed = array.copy()
            changed[list(slots)] = self._blank[name]
            self._numbers[name] = changed

    def state(self) -> dict[str, Any]:
        """As plain numbers and lists; empty before anything was seen."""
        return {name: array.tolist() for name, array in self._numbers.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Goes on from a `state`.

        Raises:
            InvalidConfig: it is of something else.
        """
        if state and set(state) != set(self._blank):
            raise InvalidConfig(
                f"the {self._kind} reward remembers {', '.join(self._blank)}; the state has {', '.join(state)}"
            )
        self._numbers = {name: np.array(state[name], np.float64) for name in state}
