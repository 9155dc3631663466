"""Seasons, and comfort bands that depend on them."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import AfterValidator, model_validator

from zenostat.agent_sdk.rewards.config import Names, RewardConfig
from zenostat.agent_sdk.rewards.seasons import Pair, Seasons
from zenostat.agent_sdk.rewards.selectors import temperatures
from zenostat.agent_sdk.rewards.terms import Band, DegreesOutside
from zenostat.topics.calendar import is_month_day
from zenostat.topics.messages import Manifest

NORTH = ((6, 1), (9, 30))
SOUTH = ((12, 1), (3, 31))
"""Default first and last day of summer."""


def _check_day(value: tuple[int, int]) -> tuple[int, int]:
    if not is_month_day(*value):
        raise ValueError("a month and a day expected, such as [6, 1]")
    return value


MonthDay = Annotated[tuple[int, int], AfterValidator(_check_day)]


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

    def _degrees_outside(self, manifest: Manifest) -> DegreesOutside:
        season = self.season(manifest)
        return DegreesOutside(season, temperatures(self.kind, self.temperatures, manifest))
