"""Statistics of durations in a ring buffer."""

from __future__ import annotations

from array import array

import numpy as np

from zenostat.topics.messages import LatencySummary

_WINDOW = 4096


class LatencyWindow:
    """Durations in seconds: their count, their maximum and the latest 4,096.

    The ring buffer grows as it fills, so that a controller that sent little leaves no hole of 32 kB in the heap.
    """

    __slots__ = ("_count", "_max_s", "_ring")

    def __init__(self) -> None:
        self._ring = array("d")
        self._count = 0
        self._max_s = 0.0

    def add(self, duration_s: float) -> None:
        """Add a duration."""
        if self._count < _WINDOW:
            self._ring.append(duration_s)
        else:
            self._ring[self._count % _WINDOW] = duration_s
        self._count += 1
        if duration_s > self._max_s:
            self._max_s = duration_s

    def summary(self) -> LatencySummary:
        """Return the count, the maximum, and the median and 99th percentile (nearest rank); from any thread."""
        count = self._count
        if not count:
            return LatencySummary()
        latest = np.array(self._ring[: min(count, _WINDOW)])
        median, p99 = np.percentile(latest, (50, 99), method="closest_observation")
        return LatencySummary(count=count, median_ms=1e3 * median, p99_ms=1e3 * p99, max_ms=1e3 * self._max_s)
