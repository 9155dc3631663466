"""The run period of an episode: its days, its timesteps and the simulated time of each step."""

from __future__ import annotations

import calendar
import re
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from topics.errors import InvalidConfig

_WEEKDAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
_LEAP_YEAR = 2016
_DAY = re.compile(r"(?:(\d{4})-)?(\d{1,2})-(\d{1,2})")


def year_of(begin_month: int, begin_day: int, weekday: str | None) -> int:
    """Return the latest common year up to 2017 in which that day is that weekday.

    EnergyPlus makes the same choice for a run period with a weekday but no year (Input Output Reference, RunPeriod),
    and 2017 without either. For a run period that begins on 29 February it is the latest leap year.
    """
    leap = (begin_month, begin_day) == (2, 29)
    if weekday not in _WEEKDAYS:
        return 2016 if leap else 2017
    for year in range(2017, 1988, -1):
        if calendar.isleap(year) != leap:
            continue
        if date(year, begin_month, begin_day).weekday() == _WEEKDAYS.index(weekday):
            return year
    raise AssertionError("each weekday occurs on that day within 28 years")


def parse_day(text: str, what: str, year: int = _LEAP_YEAR) -> date:
    """Parse `07-01` in the model's year, or `2018-07-01`; the default year is a leap year, which has every day.

    Raises:
        InvalidConfig: the text has another format, or there is no such day.
    """
    hint = "write it as MM-DD or YYYY-MM-DD, for example 07-01"
    match = _DAY.fullmatch(text.strip())
    if not match:
        raise InvalidConfig(f"{what} {text!r} is not a date; {hint}")
    month, day = int(match[2]), int(match[3])
    if not 1 <= month <= 12 or not 1 <= day <= calendar.monthrange(_LEAP_YEAR, month)[1]:
        raise InvalidConfig(f"{what} {text!r} is not a calendar date; {hint}")
    try:
        return date(int(match[1] or year), month, day)
    except ValueError:
        raise InvalidConfig(
            f"{what} {text!r} does not exist in {match[1] or year}"
            + ("" if match[1] else ", the model's year; give another year as YYYY-MM-DD")
        ) from None


def check_steps_per_hour(steps: int) -> None:
    """Check that EnergyPlus supports this number of timesteps per hour; `InvalidConfig` if not."""
    if steps < 1 or steps > 60 or 60 % steps:
        raise InvalidConfig(
            f"steps_per_hour {steps} does not divide the hour; "
            "EnergyPlus supports 1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30 or 60"
        )


@dataclass(frozen=True, slots=True)
class Period:
    """Whole days from `begin` to `end`, both included, in equal timesteps."""

    begin: date
    end: date
    steps_per_hour: int

    def __post_init__(self) -> None:
        if self.end < self.begin:
            raise InvalidConfig(f"the run period ends ({self.end}) before it begins ({self.begin})")
        check_steps_per_hour(self.steps_per_hour)

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
