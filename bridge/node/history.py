"""The history of the present episode: the latest samples, in memory of a fixed size.

A ring of rows, one for each published sample: the values and the effective values as raw bytes, as they were published,
and the episode and the step of each slot. A timestep costs two copies of bytes, and creates no object per point.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Actuator, HistoryQuery, HistorySeries, Meter, Sensor
from zenostat.topics.points import PointIndex

if TYPE_CHECKING:
    from zenostat.bridge.node.plant import PlantDescription


MAX_REPLY_BYTES = 4 << 20
"""Largest number of bytes of values in a reply."""

_NUMBER = 8
"""Bytes of a value, of the number of an episode, and of a step."""


class History:
    """The latest samples of the present episode of each slot; for the node's thread.

    The first sample is added before the first query.

    Args:
        plant: what is simulated.
        slots: number of slots.
        limit_bytes: memory that it may use.

    Attributes:
        samples: number of samples that it keeps; 0 if not a single one fits, and it is then of no use.
        size_bytes: memory that these take.
    """

    def __init__(self, plant: PlantDescription, slots: int, limit_bytes: int) -> None:
        points: list[Sensor | Meter | Actuator] = [*plant.sensors, *plant.meters, *plant.actuators]
        self._units = [point.unit for point in points]
        self._index = PointIndex((point.name for point in points), "point")
        self._slots, self._actuators = slots, len(plant.actuators)
        self._points = len(points) - self._actuators
        self._value_bytes, self._effective_bytes = (_NUMBER * slots * n for n in (self._points, self._actuators))
        self._mark = struct.Struct(f"={2 * slots}q")
        row_bytes = self._value_bytes + self._effective_bytes + self._mark.size
        rows = limit_bytes // row_bytes
        if slots == 1:  # with several slots, one that is reset alone adds rows to an episode of the others
            rows = min(rows, plant.run_period.steps + 1)
        self.samples, self.size_bytes = rows, rows * row_bytes
        sizes = (self._mark.size, self._value_bytes, self._effective_bytes)
        # Not `bytearray`, which writes to all of its pages.
        self._marks, self._values, self._effective = (np.zeros(rows * size, np.uint8).data for size in sizes)
        self._next = self._count = 0

    def add(self, values: bytes, effective: bytes, episode: Sequence[int], step: Sequence[int]) -> None:
        """Add a sample: raw float64 of its values and effective values, and the episode and step of each slot."""
        row = self._next
        begin = row * self._value_bytes
        self._values[begin : begin + self._value_bytes] = values
        begin = row * self._effective_bytes
        self._effective[begin : begin + self._effective_bytes] = effective
        self._mark.pack_into(self._marks, row * self._mark.size, *episode, *step)
        self._next = row + 1 if row + 1 < self.samples else 0
        if self._count < self.samples:
            self._count += 1

    def answer(self, query: HistoryQuery) -> HistorySeries:
        """Return the values that were requested.

        Raises:
            UnknownName: there is no such point.
            RequestRejected: there is no sample in that range.
        """
        self._index.require(query.points)
        columns = [self._index[name] for name in query.points]
        rows, steps, episode = self._rows(query.slot)
        oldest, latest = int(steps[0]), int(steps[-1])
        first = oldest if query.from_step is None else max(query.from_step, oldest)
        last = latest if query.to_step is None else min(query.to_step, latest)
        if first > last:
            raise RequestRejected(f"no samples in that range; the node keeps steps {oldest} to {latest}")
        rows = rows[first - oldest : last - oldest + 1]
        arrays = 3 if query.extremes else 1
        fitting = max(1, MAX_REPLY_BYTES // (_NUMBER * arrays * len(columns)))
        stride, remaining = 1, 0
        if query.max_samples is not None:
            stride = -(-len(rows) // min(query.max_samples, fitting))
        elif len(rows) > fitting:
            remaining = len(rows) - fitting
            rows = rows[:fitting]
        ends = np.arange((len(rows) - 1) % stride, len(rows), stride)  # the last one is the last sample of the range
        table = self._table(rows if query.extremes else rows[ends], columns, query.slot)
        low, high = _extremes(table, ends) if query.extremes else (None, None)
        return HistorySeries(
            episode=episode,
            points=query.points,
            units=[self._units[column] for column in columns],
            first_step=first + int(ends[0]),
            stride=stride,
            remaining=remaining,
            oldest_step=oldest,
            latest_step=latest,
            values=_raw(table[ends] if query.extremes else table),
            lows=_raw(low),
            highs=_raw(high),
        )

    def _rows(self, slot: int) -> tuple[NDArray[np.intp], NDArray[np.int64], int]:
        """Return the rows of the present episode of a slot in the order of their steps, the steps, and the episode."""
        rows = np.arange(self._next - self._count, self._next) % self.samples
        marks = np.frombuffer(self._marks, np.int64).reshape(self.samples, 2, self._slots)[rows, :, slot]
        episode = int(marks[-1, 0])
        of_episode = marks[:, 0] == episode
        rows, steps = rows[of_episode], marks[of_episode, 1]
        # While other slots step or begin an episode, a slot's sample is published again.
        is_new = np.diff(steps, prepend=steps[0] - 1) != 0
        return rows[is_new], steps[is_new], episode

    def _table(self, rows: NDArray[np.intp], columns: Sequence[int], slot: int) -> Floats:
        """Return the values of some rows, shape (rows, columns)."""
        values = np.frombuffer(self._values, codec.FLOAT).reshape(self.samples, self._slots, self._points)
        effective = np.frombuffer(self._effective, codec.FLOAT).reshape(self.samples, self._slots, self._actuators)
        table = np.empty((len(rows), len(columns)), codec.FLOAT)
        for index, column in enumerate(columns):
            is_value = column < self._points
            array, place = (values, column) if is_value else (effective, column - self._points)
            table[:, index] = array[rows, slot, place]
        return table


def _extremes(table: Floats, ends: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return the smallest and the largest value of each block of rows that ends at one of `ends`; NaN if all are."""
    begins = np.concatenate(([0], ends[:-1] + 1))
    return np.fmin.reduceat(table, begins), np.fmax.reduceat(table, begins)


def _raw(table: Floats | None) -> bytes:
    return b"" if table is None else table.tobytes()
