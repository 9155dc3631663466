"""Seasons, and comfort bands that depend on them."""

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
"""Lowest and highest comfortable air temperature, degC, both inclusive."""

Pair = TypeVar("Pair", bound=tuple[float, ...])

NORTH = ((6, 1), (9, 30))
SOUTH = ((12, 1), (3, 31))
"""Default first and last day of summer."""


def _check_day(value: tuple[int, int]) -> tuple[int, int]:
    try:
        date(2000, *value)
    except ValueError:
        raise ValueError("a month and a day expected, as [6, 1]") from None
    return value


MonthDay = Annotated[tuple[int, int], AfterValidator(_check_day)]


_MAX_SEQUENTIAL_SUM = 7
"""NumPy adds up to this many numbers sequentially: a plain loop gives the same bits, faster."""


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

    def columns(self, begin: Begin) -> tuple[float, ...] | tuple[NDArray[np.float64], ...]:
        """Return the numbers of a timestep: floats if all slots have the same, else columns with a row per slot."""
        if isinstance(begin, datetime):
            return self.band(begin)
        if begin.count(begin[0]) == len(begin):
            return self.band(begin[0])
        rows = np.array([self.band(day) for day in begin], np.float64)
        return tuple(rows[:, i : i + 1] for i in range(len(self.winter)))


class Seasonal(RewardConfig):
    """Base of rewards that distinguish summer from winter.

    Attributes:
        summer_begin, summer_end: first and last day of summer (month, day), both inclusive; by default 1 June to
            30 September, or 1 December to 31 March if the building is south of the equator.
    """

    summer_begin: MonthDay | None = None
    summer_end: MonthDay | None = None

    def _seasons(self, winter: Pair, summer: Pair, manifest: Manifest | None) -> Seasons[Pair]:
        latitude_deg = manifest.latitude_deg if manifest is not None else None
        begin, end = SOUTH if latitude_deg is not None and latitude_deg < 0 else NORTH
        return Seasons(winter, summer, self.summer_begin or begin, self.summer_end or end)


class ComfortBand(Seasonal):
    """Base of rewards with a comfort band for winter and one for summer.

    Attributes:
        winter, summer: the bands, degC.
        temperatures: names of the sensors of zone air temperatures; None is all.
    """

    winter: Band = (20.0, 23.5)
    summer: Band = (23.0, 26.0)
    temperatures: Names | None = None

    @model_validator(mode="after")
    def _check_bands(self) -> ComfortBand:
        for name, (low, high) in (("winter", self.winter), ("summer", self.summer)):
            if not low < high:
                raise ValueError(f"the {name} band's lower bound {low} is not below its upper bound {high}")
        return self

    def season(self, manifest: Manifest | None = None) -> Seasons[Band]:
        """Return the bands by day, with the summer of the building's hemisphere (without a manifest: northern)."""
        return self._seasons(self.winter, self.summer, manifest)

    def band(self, day: datetime) -> Band:
        """Return the comfort band of a day in degC; by default with summer in the northern hemisphere."""
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
        if values.ndim == 1 and len(self._zones) <= _MAX_SEQUENTIAL_SUM and isinstance(begin, datetime):
            low, high = self._season.band(begin)
            outside = 0.0
            for air in values.take(self._zones).tolist():
                outside += max(low - air, air - high, 0.0)
            return outside
        degrees: NDArray[np.float64] = np.add.reduce(self._outside(values, begin), axis=-1)
        return degrees
