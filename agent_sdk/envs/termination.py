"""Limits that end an episode before its time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from topics.messages import Manifest

Floats = NDArray[np.float64]


class TerminationLimits:
    """Watches an episode's samples, or those of several slots.

    Args:
        manifest: with the task's limits, of points that it has.
        slots: how many there are; None is one building, whose values are no rows.
    """

    def __init__(self, manifest: Manifest, slots: int | None = None) -> None:
        self._limits = manifest.task.terminate
        self._step_s = 3600.0 / manifest.steps_per_hour
        self._points = [np.array([manifest.names.index(name) for name in limit.points]) for limit in self._limits]
        self._low = [-np.inf if limit.low is None else limit.low for limit in self._limits]
        self._high = [np.inf if limit.high is None else limit.high for limit in self._limits]
        self._lead = () if slots is None else (slots,)
        self.reset()

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """An episode begins (in these slots; None: in all)."""
        if slots is None:
            self._outside_s = [np.zeros((*self._lead, len(points))) for points in self._points]
            return
        for outside_s in self._outside_s:
            outside_s[list(slots)] = 0.0

    def violated(self, values: Floats) -> str:
        """Which limit ends the episode with this sample's values, shape (points,); empty if none does.

        A point counts the timesteps that it has ended outside the range, until it is back.
        """
        for number in range(len(self._limits)):
            found = self._count(number, values)
            if found.over.any():
                return self._words(number, *found)
        return ""

    def violated_slots(self, values: Floats) -> dict[int, str]:
        """The same of several slots, values of shape (slots, points): those that end, and by which limit."""
        ended: dict[int, str] = {}
        for number in range(len(self._limits)):
            found = self._count(number, values)
            if found.over.any():
                for slot in np.flatnonzero(found.over.any(axis=-1)).tolist():
                    ended.setdefault(slot, self._words(number, *(part[slot] for part in found)))
        return ended

    def _count(self, number: int, values: Floats) -> _Found:
        own = values.take(self._points[number], axis=-1)
        outside = (own < self._low[number]) | (own > self._high[number])
        since = self._outside_s[number] = np.where(outside, self._outside_s[number] + self._step_s, 0.0)
        return _Found(own, since, outside & (since >= self._limits[number].duration_s))

    def _words(self, number: int, own: Floats, since: Floats, over: NDArray[np.bool_]) -> str:
        worst = int(np.argmax(np.where(over, since, -1.0)))
        low, high = self._low[number], self._high[number]
        name, hours = self._limits[number].points[worst], since[worst] / 3600.0
        return f"{name} = {own[worst]:g} has been outside {low:g} to {high:g} for {hours:g} h"


class _Found(NamedTuple):
    """Of one limit's points: values, seconds outside so far, and whether that is enough."""

    own: Floats
    since: Floats
    over: NDArray[np.bool_]
