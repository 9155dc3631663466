"""Numbers that depend on the season."""

from __future__ import annotations

from datetime import datetime
from typing import Generic, TypeVar

import numpy as np

from zenostat.agent_sdk.rewards.base import Begin
from zenostat.topics.arrays import Floats

Pair = TypeVar("Pair", bound=tuple[float, ...])


class Seasons(Generic[Pair]):
    """Numbers that differ between summer and winter.

    Args:
        winter: numbers on all other days.
        summer: numbers on days of summer.
        begin: first day of summer (month, day).
        end: last day of summer (month, day), inclusive; summer may span the turn of the year.
    """

    __slots__ = ("begin", "end", "summer", "winter")

    def __init__(self, winter: Pair, summer: Pair, begin: tuple[int, int], end: tuple[int, int]) -> None:
        self.winter, self.summer, self.begin, self.end = winter, summer, begin, end

    def band(self, day: datetime) -> Pair:
        """Return the numbers of a day."""
        month_day = (day.month, day.day)
        if self.begin <= self.end:
            return self.summer if self.begin <= month_day <= self.end else self.winter
        return self.winter if self.end < month_day < self.begin else self.summer

    def columns(self, begin: Begin) -> tuple[float, ...] | tuple[Floats, ...]:
        """Return the numbers of a timestep: floats if all slots have the same, else columns with a row per slot."""
        if isinstance(begin, datetime):
            return self.band(begin)
        if begin.count(begin[0]) == len(begin):
            return self.band(begin[0])
        rows = np.array([self.band(day) for day in begin], np.float64)
        return tuple(rows[:, i : i + 1] for i in range(len(self.winter)))
