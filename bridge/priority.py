"""Who rules an actuator: 16 levels each, as in BACnet (ASHRAE 135, clause 19.2). The lowest occupied level
rules, releasing it falls to the next, and an empty array gives the building's own control back.

Rules without I/O.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEVELS = 16
THE_BUILDING = ""
"""Name of the building's own control among the rulers."""


class PriorityArray:
    """Values and sources of all actuators of all slots; arrays are shaped (slots, actuators)."""

    def __init__(self, slots: int, actuators: int) -> None:
        self._values = np.full((LEVELS, slots, actuators), np.nan)
        self._sources = np.zeros((LEVELS, slots, actuators), np.uint8)
        self._occupied: list[int] = []
        self.names: list[str] = [THE_BUILDING]

    def clear(self) -> None:
        """Releases everything, for a new episode."""
        self._values.fill(np.nan)
        self._sources.fill(0)
        self._occupied = []
        self.names = [THE_BUILDING]

    def source(self, name: str) -> int:
        """The index of a source's name, new ones added; at most 255 in an episode."""
        if name not in self.names:
            self.names.append(name)
        return self.names.index(name)

    def put(
        self, level: int, source: int, values: NDArray[np.float64], where: NDArray[np.bool_] | None = None
    ) -> None:
        """Sets a level's values, all of them or those `where` says; NaN releases."""
        row = level - 1
        if where is None:
            self._values[row] = values
            self._sources[row] = source
        else:
            self._values[row][where] = values[where]
            self._sources[row][where] = source
        if row not in self._occupied:
            self._occupied = sorted([*self._occupied, row])

    def put_one(self, level: int, source: int, actuator: int, value: float) -> None:
        """Sets one actuator of all slots at a level; NaN releases."""
        where = np.zeros(self._values.shape[1:], np.bool_)
        where[:, actuator] = True
        self.put(level, source, np.full(where.shape, value), where)

    def resolve(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """The ruling values, NaN where nobody rules, and the index of who rules."""
        if not self._occupied:
            return self._values[LEVELS - 1].copy(), self._sources[LEVELS - 1].copy()
        first, *others = self._occupied
        values, sources = self._values[first].copy(), self._sources[first].copy()
        for row in others:
            free = np.isnan(values)
            values[free] = self._values[row][free]
            sources[free] = self._sources[row][free]
        sources[np.isnan(values)] = 0
        return values, sources
