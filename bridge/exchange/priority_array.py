"""Who rules an actuator: 16 levels each, as in BACnet (ASHRAE 135, clause 19.2).

The lowest occupied level rules, releasing it falls to the next, and an empty array gives the building's own
control back.

Rules without I/O. Values stay in the bytes that they came in as long as one level rules alone: the usual
case then costs neither an array nor a copy.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from topics.codec import INDEX

PRIORITIES = 16
BASELINE_SOURCE = ""
"""Name of the building's own control among the rulers."""

MAX_SOURCES = 4096
"""Sources that may hold something at a time, claims included; each sample carries their names."""

FEW_SOURCES = 256
"""Names that are kept although nothing of theirs holds; beyond, they make place for others."""


@dataclass(slots=True)
class _Row:
    """One occupied level: float64 values, NaN where it is free, and who set each (uint16), as raw bytes."""

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
        self._relinquished = (np.full(self._size, np.nan).tobytes(), bytes(INDEX.itemsize * self._size))
        self.names: list[str] = [BASELINE_SOURCE]

    def relinquish_slots(self, slots: Sequence[int]) -> None:
        """Releases everything in some slots, for a new episode there."""
        where = np.zeros(self.shape, np.bool_)
        where[list(slots)] = True
        for priority in [*self._rows]:
            self.put(priority, 0, np.full(self.shape, np.nan), where)

    def copy(self) -> PriorityArray:
        """The same again, on its own."""
        other = PriorityArray(*self.shape)
        other.restore(self)
        return other

    def restore(self, other: PriorityArray) -> None:
        """Becomes as another one of the same shape is; what changes in one later does not change the other."""
        self._rows = {priority: replace(row) for priority, row in other._rows.items()}
        self.names = [*other.names]

    def of_slot(self, slot: int, slots: int) -> PriorityArray:
        """What one slot has, in each of `slots` new ones."""
        other = PriorityArray(slots, self.shape[1])
        other.names = [*self.names]
        width = self.shape[1]
        for priority, row in self._rows.items():
            values = row.values[8 * width * slot : 8 * width * (slot + 1)] * slots
            sources = row.sources[2 * width * slot : 2 * width * (slot + 1)] * slots
            if not np.isnan(np.frombuffer(values)).all():
                other._rows[priority] = _Row(values, sources, row.full)
        return other

    def source(self, name: str, keeping: Collection[int] = ()) -> int:
        """The index of a source's name.

        Once there are 256 names, a new one takes the place of one that stands in no row and is not in `keeping`.
        """
        if name in self.names:
            return self.names.index(name)
        free = len(self.names) if len(self.names) < FEW_SOURCES else self._free(keeping)
        if free == len(self.names):
            self.names.append(name)
        else:
            self.names = [*self.names[:free], name, *self.names[free + 1 :]]
        return free

    def has_room(self, name: str, keeping: Collection[int] = ()) -> bool:
        """Whether one more source may hold something."""
        return len(self.names) < MAX_SOURCES or name in self.names or self._free(keeping) < MAX_SOURCES

    def _free(self, keeping: Collection[int]) -> int:
        used = np.zeros(len(self.names) + 1, np.bool_)
        used[[0, *keeping]] = True
        for row in self._rows.values():
            used[np.frombuffer(row.sources, INDEX)] = True
        return int(used.argmin())

    def put_all(self, priority: int, source: int, values: bytes) -> None:
        """Sets all actuators of a level to finite values."""
        row = self._rows.get(priority)
        index = source.to_bytes(2, "little")
        if row is not None and row.full and row.sources[:2] == index:
            row.values = values
        else:
            self._rows[priority] = _Row(values, index * self._size, full=True)

    def put(self, priority: int, source: int, values: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
        """Sets those of a level that `where` says; NaN releases."""
        row = self._rows.get(priority)
        old, sources = (row.values, row.sources) if row else self._relinquished
        new_values = np.frombuffer(old).reshape(self.shape).copy()
        new_sources = np.frombuffer(sources, INDEX).reshape(self.shape).copy()
        new_values[where] = values[where]
        new_sources[where] = source
        self._rows[priority] = _Row(new_values.tobytes(), new_sources.tobytes(), full=False)
        if np.isnan(new_values).all():
            del self._rows[priority]

    def occupied(self, priority: int, actuator: int) -> bool:
        """Return whether an actuator has a value at a level, in any slot."""
        row = self._rows.get(priority)
        return row is not None and not np.isnan(np.frombuffer(row.values).reshape(self.shape)[:, actuator]).all()

    def put_one(self, priority: int, source: int, actuator: int, value: float) -> None:
        """Sets one actuator of all slots at a level; NaN releases."""
        where = np.zeros(self.shape, np.bool_)
        where[:, actuator] = True
        self.put(priority, source, np.full(self.shape, value), where)

    def resolve(self) -> tuple[bytes, bytes]:
        """The ruling values (float64, NaN where nobody rules) and the index of who rules (uint16)."""
        rows = self._rows
        if len(rows) == 1:
            (row,) = rows.values()
            if row.full:
                return row.values, row.sources
        if not rows:
            return self._relinquished
        values = np.full(self._size, np.nan)
        sources = np.zeros(self._size, INDEX)
        for priority in sorted(rows):
            free = np.isnan(values)
            values[free] = np.frombuffer(rows[priority].values)[free]
            sources[free] = np.frombuffer(rows[priority].sources, INDEX)[free]
        sources[np.isnan(values)] = 0
        return values.tobytes(), sources.tobytes()
