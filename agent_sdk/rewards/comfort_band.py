"""The seasons, and what differs between them."""

from __future__ import annotations

from datetime import date, datetime
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, model_validator

from agent_sdk.rewards.base import Begin, BoundReward
from agent_sdk.rewards.config import Names, RewardConfig
from agent_sdk.rewards.selectors import temperatures
from topics.messages import Manifest

Band = tuple[float, float]
"""Lowest and highest air temperature of comfort, degC; both belong to it."""

Pair = TypeVar("Pair", bound=tuple[float, ...])

NORTH = ((6, 1), (9, 30))
SOUTH = ((12, 1), (3, 31))
"""First and last day of summer where nobody says otherwise."""


def _is_a_day(value: tuple[int, int]) -> tuple[int, int]:
    try:
        date(2000, *value)
    except ValueError:
        raise ValueError("a month and a day expected, as [6, 1]") from None
    return value


MonthDay = Annotated[tuple[int, int], AfterValidator(_is_a_day)]


_IN_ORDER = 7
"""So many numbers NumPy adds one after the other: a plain loop gives the same sum, to the bit, and sooner."""


class Seasons(Generic[Pair]):
    """What holds on a day of summer, and what on all others.

    Args:
        winter, summer: numbers.
        begin, end: first and last day of summer, both included; it may span the turn of the year.
    """

    __slots__ = ("begin", "end", "summer", "winter")

    def __init__(self, winter: Pair, summer: Pair, begin: tuple[int, int], end: tuple[int, int]) -> None:
        self.winter, self.summer, self.begin, self.end = winter, summer, begin, end

    def band(self, day: datetime) -> Pair:
        """The numbers of a day."""
        here = (day.month, day.day)
        if self.begin <= self.end:
            return self.summer if self.begin <= here <= self.end else self.winter
        return self.winter if self.end < here < self.begin else self.summer

    def columns(self, begin: Begin) -> tuple[float, ...] | tuple[NDArray[np.float64], ...]:
        """The numbers of a timestep: floats where they hold for all, or columns with a row for each slot."""
        if isinstance(begin, datetime):
            return self.band(begin)
        if begin.count(begin[0]) == len(begin):
            return self.band(begin[0])
        rows = np.array([self.band(day) for day in begin], np.float64)
        return tuple(rows[:, i : i + 1] for i in range(len(self.winter)))


class Seasonal(RewardConfig):
    """Knows summer from winter.

    Attributes:
        summer_begin, summer_end: first and last day of summer (month, day), both included; left out, 1 June to
            30 September, or 1 December to 31 March where the building lies south of the equator.
    """

    summer_begin: MonthDay | None = None
    summer_end: MonthDay | None = None

    def _seasons(self, winter: Pair, summer: Pair, manifest: Manifest | None) -> Seasons[Pair]:
        latitude_deg = manifest.latitude_deg if manifest is not None else None
        begin, end = SOUTH if latitude_deg is not None and latitude_deg < 0 else NORTH
        return Seasons(winter, summer, self.summer_begin or begin, self.summer_end or end)


class ComfortBand(Seasonal):
    """Has a comfort band for winter and one for summer.

    Attributes:
        winter, summer: the bands, degC.
        temperatures: names of the sensors of zones' air temperatures; None is all.
    """

    winter: Band = (20.0, 23.5)
    summer: Band = (23.0, 26.0)
    temperatures: Names | None = None

    @model_validator(mode="after")
    def _bands_are_upright(self) -> ComfortBand:
        for name, (low, high) in (("winter", self.winter), ("summer", self.summer)):
            if not low < high:
                raise ValueError(f"the {name} band's lower end {low} is not below its upper end {high}")
        return self

    def season(self, manifest: Manifest | None = None) -> Seasons[Band]:
        """The bands by day, with the summer of the building's hemisphere; of the northern one without a manifest."""
        return self._seasons(self.winter, self.summer, manifest)

    def band(self, day: datetime) -> Band:
        """The comfort band in degC of a day, in the northern hemisphere where `summer_begin` does not say."""
        return self.season().band(day)


class BandedBound(BoundReward):
    """Measures how far zones are outside the band.

    Args:
        of: the reward.
        manifest: of the node.

    Raises:
        InvalidConfig: there are no such temperatures.
    """

    def __init__(self, of: ComfortBand, manifest: Manifest) -> None:
        self._season = of.season(manifest)
        self._zones = temperatures(of.kind, of.temperatures, manifest)

    def band(self, day: datetime) -> Band:
        """The comfort band in degC of a day."""
        return self._season.band(day)

    def _outside(self, values: NDArray[np.float64], begin: Begin) -> NDArray[np.float64]:
        """Degrees outside the band, by zone."""
        low, high = self._season.columns(begin)
        air = values.take(self._zones, axis=-1)
        return np.maximum(np.maximum(low - air, air - high), 0.0)

    def _degrees(self, values: NDArray[np.float64], begin: Begin) -> Any:
        """Their sum over the zones."""
        if values.ndim == 1 and len(self._zones) <= _IN_ORDER and isinstance(begin, datetime):
            low, high = self._season.band(begin)
            outside = 0.0
            for air in values.take(self._zones).tolist():
                outside += max(low - air, air - high, 0.0)
            return outside
        degrees: NDArray[np.float64] = np.add.reduce(self._outside(values, begin), axis=-1)
        return degrees
