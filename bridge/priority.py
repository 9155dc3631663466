"""Who rules an actuator: 16 levels each, as in BACnet (ASHRAE 135, clause 19.2).

The lowest occupied level rules, releasing it falls to the next, and an empty array gives the building's own
control back.

Rules without I/O. Values stay in the bytes that they came in as long as one level rules alone: the usual
case then costs neither an array nor a copy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEVELS = 16
THE_BUILDING = ""
"""Name of the building's own control among the rulers."""

MOST_SOURCES = 255


@dataclass(slots=True)
class _Row:
    """One occupied level: float64 values, NaN where it is free, and who set each, as raw bytes."""

    values: bytes
    sources: bytes
    full: bool


class PriorityArray:
    """Values and sources of all actuators of all slots, shaped `shape`: (slots, actuators)."""

    def __init__(self, slots: int, actuators: int) -> None:
        self.shape = (slots, actuators)
        self._size = slots * actuators
        self.clear()

    def clear(self) -> None:
        """Releases everything and forgets the sources, for a new episode."""
        self._rows: dict[int, _Row] = {}
        self._released = (np.full(self._size, np.nan).tobytes(), bytes(self._size))
        self.names: list[str] = [THE_BUILDING]

    def source(self, name: str) -> int:
        """The index of a source's name; new names are added, those beyond the 254th share the last index."""
        if name not in self.names:
            if len(self.names) == MOST_SOURCES:
                return MOST_SOURCES - 1
            self.names.append(name)
        return self.names.index(name)

    def put_all(self, level: int, source: int, values: bytes) -> None:
        """Sets all actuators of a level to finite values."""
        row = self._rows.get(level)
        if row is not None and row.full and row.sources[:1] == bytes((source,)):
            row.values = values
        else:
            self._rows[level] = _Row(values, bytes((source,)) * self._size, full=True)

    def put(self, level: int, source: int, values: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
        """Sets those of a level that `where` says; NaN releases."""
        row = self._rows.get(level)
        old, sources = (row.values, row.sources) if row else self._released
        new_values = np.frombuffer(old).reshape(self.shape).copy()
        new_sources = np.frombuffer(sources, np.uint8).reshape(self.shape).copy()
        new_values[where] = values[where]
        new_sources[where] = source
        self._rows[level] = _Row(new_values.tobytes(), new_sources.tobytes(), full=False)
        if np.isnan(new_values).all():
            del self._rows[level]

    def put_one(self, level: int, source: int, actuator: int, value: float) -> None:
        """Sets one actuator of all slots at a level; NaN releases."""
        where = np.zeros(self.shape, np.bool_)
        where[:, actuator] = True
        self.put(level, source, np.full(self.shape, value), where)

    def resolve(self) -> tuple[bytes, bytes]:
        """The ruling values (float64, NaN where nobody rules) and the index of who rules (uint8)."""
        rows = self._rows
        if len(rows) == 1:
            (row,) = rows.values()
            if row.full:
                return row.values, row.sources
        if not rows:
            return self._released
        values = np.full(self._size, np.nan)
        sources = np.zeros(self._size, np.uint8)
        for level in sorted(rows):
            free = np.isnan(values)
            values[free] = np.frombuffer(rows[level].values)[free]
            sources[free] = np.frombuffer(rows[level].sources, np.uint8)[free]
        sources[np.isnan(values)] = 0
        return values.tobytes(), sources.tobytes()
