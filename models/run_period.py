"""The run period of an episode: its days, its timesteps and the simulated time of each step."""

from __future__ import annotations

import calendar
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from zenostat.topics.calendar import LEAP_YEAR, WEEKDAY_NAMES
from zenostat.topics.errors import InvalidConfig


def year_of(begin_month: int, begin_day: int, weekday: str | None) -> int:
    """Return the latest common year up to 2017 in which that day is that weekday.

    EnergyPlus makes the same choice for a run period with a weekday but no year (Input Output Reference, RunPeriod),
    and 2017 without either. For a run period that begins on 29 February it is the latest leap year.
    """
    leap = (begin_month, begin_day) == (2, 29)
    if weekday not in WEEKDAY_NAMES:
        return LEAP_YEAR if leap else 2017
    for year in range(2017, 1988, -1):
        if calendar.isleap(year) != leap:
            continue
        if date(year, begin_month, begin_day).weekday() == WEEKDAY_NAMES.index(weekday):
            return year
    raise AssertionError("each weekday occurs on that day within 28 years")


def check_steps_per_hour(steps: int) -> None:
    """Check that EnergyPlus supports this number of timesteps per hour; `InvalidConfig` if not."""
    if steps < 1 or steps > 60 or 60 % steps:
        raise InvalidConfig(
            f"steps_per_hour {steps} does not divide the hour; "
            "EnergyPlus supports 1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30 or 60"
        )


_FIRST_YEAR, _LAST_YEAR = 1583, 9998
"""EnergyPlus has no years before 1583; Python's calendar ends with 9999, and forecasts go on after a run period."""


@dataclass(frozen=True, slots=True)
class Period:
    """Whole days from `begin` to `end`, both included, in equal timesteps.

    Attributes:
        by_year: whether EnergyPlus looks for the records of these years in the weather file, as with
            `treat_weather_as_actual`, rather than for those of the days in whatever year.
    """

    begin: date
    end: date
    steps_per_hour: int
    by_year: bool = False

    def __post_init__(self) -> None:
        if self.begin.year < _FIRST_YEAR or self.end.year > _LAST_YEAR:
            raise InvalidConfig(
                f"the run period {self.begin} to {self.end} is outside the years {_FIRST_YEAR} to {_LAST_YEAR}"
            )
        if self.end < self.begin:
            raise InvalidConfig(
                f"the run period ends ({self.end}) before it begins ({self.begin}); to end in a later year, write the "
                "day as YYYY-MM-DD"
            )
        check_steps_per_hour(self.steps_per_hour)

    def record_day(self, year: int, month: int, day: int) -> tuple[int, ...]:
        """Return what tells the records of a day from those of others."""
        return (year, month, day) if self.by_year else (month, day)

    @property
    def step_s(self) -> float:
        """Duration of a timestep in seconds."""
        return 3600.0 / self.steps_per_hour

    @property
    def steps(self) -> int:
        """Number of timesteps of an episode."""
        return ((self.end - self.begin).days + 1) * 24 * self.steps_per_hour

    def time(self, step: int) -> datetime:
        """Return the local standard time at the end of timestep `step`; step 0 is the beginning of the episode."""
        begin = datetime(self.begin.year, self.begin.month, self.begin.day)
        return begin + timedelta(seconds=step * self.step_s)
