"""Priority arrays: 16 priorities for each actuator, as in BACnet (ASHRAE 135, clause 19.2).

The value at the highest occupied priority (the lowest number) takes effect. Once it is relinquished, the next one
does; an empty array leaves the actuator to baseline control.

No I/O. Values stay in the bytes in which they arrived as long as only one priority is occupied: the usual case then
needs neither an array nor a copy.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.codec import INDEX

PRIORITIES = 16
BASELINE_SOURCE = ""
"""Name of baseline control among the sources."""

MAX_SOURCES = 4096
"""Largest number of sources with a value or a claim; each sample contains their names."""

FEW_SOURCES = 256
"""Number of names up to which unused ones are kept; beyond, new names replace unused ones."""


@dataclass(slots=True)
class _Row:
    """One occupied priority: values (float64, NaN where relinquished) and sources (uint16) as raw bytes.

    `only_source`: index of the source that has set all values; None if several have, or not all are set.
    """

    values: bytes
    sources: bytes
    only_source: int | None


class PriorityArray:
    """The priority arrays of all actuators in all slots; `shape` is (slots, actuators)."""

    def __init__(self, slots: int, actuators: int) -> None:
        self.shape = (slots, actuators)
        self._size = slots * actuators
        self.clear()

    def clear(self) -> None:
        """Relinquish everything and drop the sources, for a new episode."""
        self._rows: dict[int, _Row] = {}
        self._relinquished = (np.full(self._size, np.nan).tobytes(), bytes(INDEX.itemsize * self._size))
        self.names: list[str] = [BASELINE_SOURCE]

    def relinquish_slots(self, slots: Sequence[int]) -> None:
        """Relinquish everything in some slots, for new episodes there."""
        where = np.zeros(self.shape, np.bool_)
        where[list(slots)] = True
        for priority in [*self._rows]:
            self.put(priority, 0, np.full(self.shape, np.nan), where)

    def relinquish_sources(self, names: Collection[str]) -> NDArray[np.bool_]:
        """Relinquish all values of some sources; return whether each actuator had one, shape (actuators,)."""
        indices = [index for index, name in enumerate(self.names) if index and name in names]
        changed = np.zeros(self.shape, np.bool_)
        for priority in [*self._rows]:
            changed |= self.relinquish(priority, indices, np.ones(self.shape, np.bool_))
        return np.asarray(changed.any(axis=0))

    def relinquish(self, priority: int, sources: Collection[int], where: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Relinquish those of the selected values at a priority that are of some sources; return which, same shape.

        Args:
            priority: of the values.
            sources: indices of the sources.
            where: of each value, whether it is selected, broadcast to shape (slots, actuators).
        """
        chosen = where & self._values_of(priority, sources)
        if chosen.any():
            self.put(priority, 0, np.full(self.shape, np.nan), chosen)
        return chosen

    def has(self, priority: int, source: int, actuator: int) -> bool:
        """Return whether an actuator has a value of a source at a priority in any slot."""
        return bool(self._values_of(priority, [source])[:, actuator].any())

    def _values_of(self, priority: int, sources: Collection[int]) -> NDArray[np.bool_]:
        """Return of each value at a priority whether it is set and of one of some sources."""
        row = self._rows.get(priority)
        if row is None:
            return np.zeros(self.shape, np.bool_)
        is_theirs = np.isin(np.frombuffer(row.sources, INDEX).reshape(self.shape), [*sources])
        return np.asarray(is_theirs & ~np.isnan(np.frombuffer(row.values).reshape(self.shape)))

    def copy(self) -> PriorityArray:
        """Return a deep copy."""
        duplicate = PriorityArray(*self.shape)
        duplicate.restore(self)
        return duplicate

    def restore(self, saved: PriorityArray) -> None:
        """Copy the values and sources of another array of the same shape."""
        self._rows = {priority: replace(row) for priority, row in saved._rows.items()}
        self.names = [*saved.names]

    def of_slot(self, slot: int, slots: int) -> PriorityArray:
        """Return an array for `slots` new slots, all with the values of one slot."""
        result = PriorityArray(slots, self.shape[1])
        result.names = [*self.names]
        width = self.shape[1]
        for priority, row in self._rows.items():
            values = row.values[8 * width * slot : 8 * width * (slot + 1)] * slots
            sources = row.sources[2 * width * slot : 2 * width * (slot + 1)] * slots
            if not np.isnan(np.frombuffer(values)).all():
                result._rows[priority] = _Row(values, sources, row.only_source)
        return result

    def source(self, name: str, keeping: Collection[int] = ()) -> int:
        """Return the index of a source's name; a new name is added.

        Once there are 256 names, a new one replaces one that is used at no priority and is not in `keeping`.
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
        """Return whether a source can set values: its name is known, or there is room for another one."""
        return len(self.names) < MAX_SOURCES or name in self.names or self._free(keeping) < MAX_SOURCES

    def _free(self, keeping: Collection[int]) -> int:
        used = np.zeros(len(self.names) + 1, np.bool_)
        used[[0, *keeping]] = True
        for row in self._rows.values():
            used[np.frombuffer(row.sources, INDEX)] = True
        return int(used.argmin())

    def put_all(self, priority: int, source: int, values: bytes) -> None:
        """Set all actuators at a priority to finite values."""
        row = self._rows.get(priority)
        if row is not None and row.only_source == source:
            row.values = values
        else:
            self._rows[priority] = _Row(values, source.to_bytes(2, "little") * self._size, source)

    def put(self, priority: int, source: int, values: Floats, where: NDArray[np.bool_]) -> None:
        """Set the actuators selected by `where` at a priority; NaN relinquishes."""
        row = self._rows.get(priority)
        old, sources = (row.values, row.sources) if row else self._relinquished
        new_values = np.frombuffer(old).reshape(self.shape).copy()
        new_sources = np.frombuffer(sources, INDEX).reshape(self.shape).copy()
        new_values[where] = values[where]
        new_sources[where] = source
        self._rows[priority] = _Row(new_values.tobytes(), new_sources.tobytes(), None)
        if np.isnan(new_values).all():
            del self._rows[priority]

    def occupied(self, priority: int, actuator: int) -> bool:
        """Return whether an actuator has a value at a priority in any slot."""
        row = self._rows.get(priority)
        return row is not None and not np.isnan(np.frombuffer(row.values).reshape(self.shape)[:, actuator]).all()

    def put_one(self, priority: int, source: int, actuator: int, value: float) -> None:
        """Set one actuator in all slots at a priority; NaN relinquishes."""
        where = np.zeros(self.shape, np.bool_)
        where[:, actuator] = True
        self.put(priority, source, np.full(self.shape, value), where)

    def table(self) -> tuple[Floats, NDArray[np.uint16]]:
        """Return all values, NaN where relinquished, and their sources, each of shape (slots, actuators, 16)."""
        values, sources = np.full((*self.shape, PRIORITIES), np.nan), np.zeros((*self.shape, PRIORITIES), np.uint16)
        for priority, row in self._rows.items():
            values[..., priority - 1] = np.frombuffer(row.values).reshape(self.shape)
            sources[..., priority - 1] = np.frombuffer(row.sources, INDEX).reshape(self.shape)
        sources[np.isnan(values)] = 0
        return values, sources

    def resolve(self) -> tuple[bytes, bytes]:
        """Return the values in effect (float64, NaN under baseline control) and their sources' indices (uint16)."""
        rows = self._rows
        if len(rows) == 1:
            (row,) = rows.values()
            if row.only_source is not None:
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
