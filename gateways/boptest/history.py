"""Samples of a test, at equal intervals, in arrays that grow."""

from __future__ import annotations

from math import ceil, floor, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_ROWS = 256


class History:
    """Rows of a test's samples: values of points, effective values of actuators, and which of them were activated.

    Args:
        begin_s: time of the first row.
        step_s: time between two rows.
        points, actuators: numbers of columns.
    """

    def __init__(self, begin_s: int, step_s: int, points: int, actuators: int) -> None:
        self.begin_s, self.step_s = begin_s, step_s
        self._values = np.empty((_ROWS, points))
        self._inputs = np.empty((_ROWS, actuators))
        self._activated = np.empty((_ROWS, actuators), np.bool_)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def values(self) -> Floats:
        """Values of points, shape (rows, points)."""
        return self._values[: self._count]

    @property
    def inputs(self) -> Floats:
        """Effective values of actuators, shape (rows, actuators)."""
        return self._inputs[: self._count]

    @property
    def activated(self) -> NDArray[np.bool_]:
        """Which inputs were activated, shape (rows, actuators)."""
        return self._activated[: self._count]

    def append(self, values: Floats, inputs: Floats, activated: NDArray[np.bool_] | bool) -> None:  # noqa: FBT001
        """Append a row."""
        row = self._count
        if row == len(self._values):
            self._values, self._inputs = _doubled(self._values), _doubled(self._inputs)
            self._activated = _doubled(self._activated)
        self._values[row], self._inputs[row], self._activated[row] = values, inputs, activated
        self._count += 1

    def copy(self, rows: int | None = None) -> History:
        """Return a copy of the first rows; all by default."""
        count = self._count if rows is None else rows
        other = History(self.begin_s, self.step_s, self._values.shape[1], self._inputs.shape[1])
        other._values, other._inputs = self._values[:count].copy(), self._inputs[:count].copy()
        other._activated = self._activated[:count].copy()
        other._count = count
        return other

    def row(self, time_s: float) -> int:
        """Return the row of the last sample at or before a time."""
        return floor((time_s - self.begin_s) / self.step_s)

    def span(self, start_s: float, final_s: float) -> tuple[int, int]:
        """Return the first row and the row after the last one of the samples from a start to an end, inclusive."""
        first = 0 if not isfinite(start_s) else ceil((start_s - self.begin_s) / self.step_s)
        last = self._count - 1 if not isfinite(final_s) else self.row(final_s)
        if start_s == float("inf") or final_s == -float("inf"):
            return 0, 0
        first, after = max(first, 0), min(last + 1, self._count)
        return (first, after) if first < after else (0, 0)


def _doubled(array: Any) -> Any:
    return np.concatenate([array, np.empty_like(array, shape=(max(len(array), _ROWS), array.shape[1]))])
