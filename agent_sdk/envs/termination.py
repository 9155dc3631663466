"""Limits that terminate an episode before the end of its run period."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest
from zenostat.topics.points import bounds, value_index


class TerminationLimits:
    """Checks the samples of an episode, or of several slots, against the task's limits.

    Args:
        manifest: The node's manifest; it has all points of the limits.
        slots: Number of slots.
    """

    def __init__(self, manifest: Manifest, slots: int = 1) -> None:
        self._limits = manifest.task.terminate
        self._step_s = manifest.step_s
        index = value_index(manifest)
        self._points = [np.array([index[name] for name in limit.points]) for limit in self._limits]
        self._bounds = [bounds(limit) for limit in self._limits]
        self._slots = slots
        self.reset()

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """Reset the counts for a new episode in these slots; None: in all."""
        if slots is None:
            self._outside_s = [np.zeros((self._slots, len(points))) for points in self._points]
            return
        for outside_s in self._outside_s:
            outside_s[list(slots)] = 0.0

    def adopt(self, single: TerminationLimits) -> None:
        """Take over the counts of a single building in all slots."""
        self._outside_s = [np.repeat(counts, self._slots, axis=0) for counts in single.counts]

    @property
    def counts(self) -> list[Floats]:
        """Seconds that each point of each limit has been outside its range, shape (slots, points)."""
        return self._outside_s

    def violated(self, values: Floats) -> str:
        """Describe the limit that the sample of a single building violates, shape (points,); empty if none."""
        return self.violated_slots(values[None]).get(0, "")

    def violated_slots(self, values: Floats) -> dict[int, str]:
        """Describe the first limit that each slot violates, of those that violate one.

        A point accumulates the timesteps that it has ended outside its range until it is back inside.

        Args:
            values: The values of the slots' samples, shape (slots, points).
        """
        violations: dict[int, str] = {}
        for number in range(len(self._limits)):
            check = self._check(number, values)
            if check.violated.any():
                for slot in np.flatnonzero(check.violated.any(axis=-1)).tolist():
                    violations.setdefault(slot, self._describe(number, *(part[slot] for part in check)))
        return violations

    def _check(self, number: int, values: Floats) -> _LimitCheck:
        points = values.take(self._points[number], axis=-1)
        low, high = self._bounds[number]
        outside = (points < low) | (points > high)
        outside_s = self._outside_s[number] = np.where(outside, self._outside_s[number] + self._step_s, 0.0)
        return _LimitCheck(points, outside_s, outside & (outside_s >= self._limits[number].duration_s))

    def _describe(self, number: int, values: Floats, outside_s: Floats, violated: NDArray[np.bool_]) -> str:
        worst = int(np.argmax(np.where(violated, outside_s, -1.0)))
        low, high = self._bounds[number]
        name, hours = self._limits[number].points[worst], outside_s[worst] / 3600.0
        return f"{name} = {values[worst]:g} has been outside {low:g} to {high:g} for {hours:g} h"


class _LimitCheck(NamedTuple):
    """State of one limit's points: values, seconds outside so far, and whether that violates the limit."""

    values: Floats
    outside_s: Floats
    violated: NDArray[np.bool_]
