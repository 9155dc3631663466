"""Limits that end an episode before its time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topics.messages import Manifest


class Limits:
    """Watches an episode's samples.

    Args:
        manifest: with the task's limits, of points that it has.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._limits = manifest.task.terminate
        self._step_s = 3600.0 / manifest.steps_per_hour
        self._points = [[manifest.names.index(name) for name in limit.points] for limit in self._limits]
        self._low = [-np.inf if limit.low is None else limit.low for limit in self._limits]
        self._high = [np.inf if limit.high is None else limit.high for limit in self._limits]
        self.reset()

    def reset(self) -> None:
        """An episode begins."""
        self._outside_s = [np.zeros(len(points)) for points in self._points]

    def broken(self, values: NDArray[np.float64]) -> str:
        """Which limit ends the episode with this sample's values, shape (points,); empty if none does.

        A point counts the timesteps that it has ended outside the range, until it is back.
        """
        for number, limit in enumerate(self._limits):
            own = values[self._points[number]]
            outside = (own < self._low[number]) | (own > self._high[number])
            since = self._outside_s[number] = np.where(outside, self._outside_s[number] + self._step_s, 0.0)
            if (outside & (since >= limit.for_s)).any():
                worst = int(np.argmax(np.where(outside, since, -1.0)))
                low, high = self._low[number], self._high[number]
                name, hours = limit.points[worst], since[worst] / 3600.0
                return f"{name} = {own[worst]:g} has been outside {low:g} to {high:g} for {hours:g} h"
        return ""
