"""Simulated time in words: days, times of day, days of the week and moments, parsed and checked in one place.

Simulated time is local standard time without a zone or daylight saving time. A day without a year is one of the year
that is simulated; where that year is not known yet, it is checked against a leap year, which has every day.
"""

from __future__ import annotations

import re
from datetime import date, datetime, timedelta
from typing import Any, Literal, TypeVar, get_args

from zenostat.topics.errors import InvalidConfig

Weekday = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
WEEKDAYS: tuple[Weekday, ...] = get_args(Weekday)
"""Days of the week; the position is that of `datetime.weekday`."""

WEEKDAY_NAMES = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
"""The names that EnergyPlus uses, in the same order."""

LEAP_YEAR = 2016

_DAY = re.compile(r"(?:(\d{4})-)?(\d{1,2})-(\d{1,2})")
_MOMENT = re.compile(r"(?:(\d{4})-)?(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d))?)?")
_CLOCK_TIME = re.compile(r"(?:(\d\d)-(\d\d) )?(\d\d):(\d\d)")
_UNIT_S = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_DURATION = re.compile(rf"(\d+(?:\.\d+)?) ?({'|'.join(_UNIT_S)})")
_DAYS_BEFORE = (0, 31, 60, 91, 121, 152, 182, 213, 244, 274, 305, 335)
_Hour = TypeVar("_Hour", int, float)


def parse_day(text: str, what: str, year: int = LEAP_YEAR) -> date:
    """Parse `07-01` in a year, or `2018-07-01`; `what` names the setting in errors.

    Raises:
        InvalidConfig: the text has another format, or there is no such day.
    """
    hint = "write it as MM-DD or YYYY-MM-DD, for example 07-01"
    match = _DAY.fullmatch(text.strip())
    if not match:
        raise InvalidConfig(f"{what} {text!r} is not a date; {hint}")
    month, day = int(match[2]), int(match[3])
    if not is_month_day(month, day):
        raise InvalidConfig(f"{what} {text!r} is not a calendar date; {hint}")
    try:
        return date(int(match[1] or year), month, day)
    except ValueError:
        raise InvalidConfig(
            f"{what} {text!r} does not exist in {match[1] or year}"
            + ("" if match[1] else ", the model's year; give another year as YYYY-MM-DD")
        ) from None


def parse_moment(text: str, year: int = LEAP_YEAR) -> datetime:
    """Parse `2017-07-03T08:00`, or `07-03T08:00` in a year; without a time of day, the time is 0:00.

    Raises:
        ValueError: the text has another form, or there is no such date or time.
    """
    match = _MOMENT.fullmatch(text.strip())
    if not match:
        raise ValueError("expected a date and time such as 2017-07-03T08:00, or 07-03T08:00 in the simulated year")
    own_year, month, day, hour, minute, second = (int(part or 0) for part in match.groups())
    try:
        return datetime(own_year or year, month, day, hour, minute, second)
    except ValueError as error:
        raise ValueError(f"{text!r} is not a valid date and time: {error}") from None


def parse_moment_within(text: str, first: datetime, last: datetime) -> datetime:
    """Parse a moment as `parse_moment` does, without a year in the year in which it is, or is nearest, to a period.

    Args:
        text: the moment.
        first: begin of the period.
        last: its end, inclusive.

    Raises:
        ValueError: the text has another form, or none of these years has such a date or time.
    """
    moments, errors = [], []
    for year in range(first.year, last.year + 1):
        try:
            moments.append(parse_moment(text, year))
        except ValueError as error:  # 29 February in another year
            errors.append(error)
    if not moments:
        raise errors[0]
    return min(moments, key=lambda moment: max(first - moment, moment - last, timedelta(0)))


def parse_clock_time(text: str, what: str) -> tuple[int, ...]:
    """Parse a time of each day, `07:30`, or of each year, `07-01 07:30`, to (month, day,) hour and minute.

    Raises:
        InvalidConfig: the text has another form, or there is no such time; `what` names the setting.
    """
    match = _CLOCK_TIME.fullmatch(text) if isinstance(text, str) else None
    if match:
        *month_day, hour, minute = (int(part) for part in match.groups() if part is not None)
        if hour < 24 and minute < 60 and (not month_day or is_month_day(*month_day)):
            return (*month_day, hour, minute)
    raise InvalidConfig(f"{what}: {text!r} is not a time; write '07:30' or '07-01 07:30'")


def parse_weekdays(text: str, what: str) -> frozenset[int]:
    """Parse `mon-fri` or `mon,wed,sat-sun` to weekdays from 0 (Monday); `what` names the setting in errors.

    Raises:
        InvalidConfig: the text has another form.
    """
    names: tuple[str, ...] = WEEKDAYS
    selected: set[int] = set()
    for part in str(text).casefold().replace(" ", "").split(","):
        first, dash, last = part.partition("-")
        if first not in names or (dash and last not in names):
            raise InvalidConfig(f"{what} = {text!r}; expected weekdays, such as 'mon-fri' or 'mon,wed,sat-sun'")
        begin, end = names.index(first), names.index(last or first)
        selected |= {day % 7 for day in range(begin, end + 1 if end >= begin else end + 8)}
    return frozenset(selected)


def is_month_day(month: int, day: int) -> bool:
    """Return whether a month has this day, in a leap year."""
    try:
        date(LEAP_YEAR, month, day)
    except (ValueError, OverflowError):
        return False
    return True


def format_month_day(month: int, day: int) -> str:
    """Return `07-01`, which `parse_day` reads."""
    return f"{month:02}-{day:02}"


def check_hours(hours: tuple[_Hour, _Hour]) -> tuple[_Hour, _Hour]:
    """Check a span of hours of the day: its start (inclusive) and its end (exclusive); (22, 6) spans midnight.

    Raises:
        ValueError: an hour is not of the day, or the span is empty.
    """
    start, end = hours
    if not (0 <= start < 24 and 0 <= end <= 24 and start != end):
        raise ValueError("expected a start from 0 to below 24 h and a different end, such as [9, 20] or [22, 6]")
    return hours


def in_hours(hours: tuple[float, float], hour: Any) -> Any:
    """Return whether an hour of the day, or each of an array of them, is in a span of hours."""
    start, end = hours
    return (start <= hour) & (hour < end) if start < end else (hour >= start) | (hour < end)


def hour_of_leap_year(moment: datetime) -> int:
    """Return the hour of a leap year, 0 to 8783; 1 March at 0:00 is the same hour in each year."""
    return (_DAYS_BEFORE[moment.month - 1] + moment.day - 1) * 24 + moment.hour


def parse_duration(text: str, what: str) -> float:
    """Convert a duration such as `90s`, `15min`, `2h` or `1d` to seconds.

    Args:
        text: the duration.
        what: name of the setting, for the error.

    Raises:
        InvalidConfig: another form, or 0.
    """
    match = _DURATION.fullmatch(text.strip())
    if not match or float(match[1]) == 0:
        raise InvalidConfig(
            f"{what} {text}: expected a number above 0 and s, min, h or d, for example 90s, 15min, 2h, 1d"
        )
    return float(match[1]) * _UNIT_S[match[2]]


def format_duration(seconds: float) -> str:
    """Return a duration with the unit that suits it: `15 min`, `1 h`, `30 s`."""
    if seconds < 60.0 or seconds % 60.0:
        return f"{seconds:g} s"
    return f"{seconds / 60.0:g} min" if seconds < 3600.0 or seconds % 3600.0 else f"{seconds / 3600.0:g} h"
