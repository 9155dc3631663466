"""Read dates, day types and times of EnergyPlus's schedules and special days as EnergyPlus reads them.

The rules are those of EnergyPlus 25.2's `ScheduleManager` and of its Input Output Reference, "Group Schedules"; each
was tried with EnergyPlus itself (`tests/models/test_schedule_rules.py`).
"""

from __future__ import annotations

import re
from calendar import monthrange
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import date, timedelta
from math import isfinite
from typing import Any

from zenostat.models.input_format.idf_reader import NUMBER
from zenostat.topics.calendar import LEAP_YEAR, is_month_day
from zenostat.topics.errors import did_you_mean

DAY_TYPES = (
    *("Sunday", "Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday"),
    *("Holiday", "SummerDesignDay", "WinterDesignDay", "CustomDay1", "CustomDay2"),
)
"""The day types for which each day of a schedule needs values."""

DATED = ("RunPeriodControl:SpecialDays", "RunPeriodControl:DaylightSavingTime")
"""Objects with dates that can be weekdays of a month."""

LAST_DAY = 366
"""31 December, counted in a leap year."""

DAY_MIN = 1440

_WEEKDAYS = DAY_TYPES[1:6]
_GROUPS: dict[str, tuple[str, ...]] = {
    "WEEKDAY": _WEEKDAYS,
    **{name.upper(): (name,) for name in _WEEKDAYS},
    "WEEKEND": ("Sunday", "Saturday"),
    **{name.upper(): (name,) for name in ("Saturday", "Sunday", "CustomDay1", "CustomDay2")},
    "ALLDAY": DAY_TYPES,
    "HOLIDAY": ("Holiday",),
    "SUMMER": ("SummerDesignDay",),
    "WINTER": ("WinterDesignDay",),
}
"""Words that EnergyPlus looks for anywhere in a list of day types, in its order, and the day types that each means."""

_REST = "ALLOTHERDAY"
_DESIGN_DAYS = ("summerdesignday", "winterdesignday", "customday")
_DAY_WORDS = ("AllDays", "AllOtherDays", "Weekdays", "Weekends", "Holidays", *DAY_TYPES)
_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
_WEEK = tuple(name[:3].upper() for name in DAY_TYPES[:7])
_BEFORE = date(LEAP_YEAR, 1, 1) - timedelta(days=1)


class FieldError(Exception):
    """A field that EnergyPlus does not accept; the text follows the field's name and value."""


def has_other_days(days: str) -> bool:
    """Return whether a list of day types, such as `For: Weekdays SummerDesignDay`, has others than design days."""
    words = re.findall(r"\w+", days.strip().casefold().removeprefix("for"))
    return any(not word.startswith(_DESIGN_DAYS) for word in words)


def number(value: Any) -> float | None:
    """Return the number that EnergyPlus reads in a field; None if it is no number. A blank one is 0."""
    if isinstance(value, (int, float)):
        return float(value)
    text = str(value or "").strip()
    if not text:
        return 0.0
    if text.startswith("+") or not NUMBER.fullmatch(text):  # a plus sign is only read in an IDF, as that of a number
        return None
    result = float(re.sub("[dD]", "e", text))
    return result if isfinite(result) else None


def day_of_year(text: str) -> int:
    """Return the day, from 1 to 366, of a date such as `12/31` or `31 Dec`; 0 of a blank one.

    Raises:
        FieldError: it is no day of the year.
    """
    parts = _date_words(text)
    numbers = [number(part) for part in parts]
    if not parts or (len(parts) == 1 and numbers[0] == 0):
        return 0
    if len(parts) == 3 and all(each is not None for each in numbers):
        first, second, third = (int(each or 0) for each in numbers)
        month, day = (second, third) if first > 100 else (first, second)
    elif len(parts) == 2 and numbers[1] is not None:
        month = int(numbers[0]) if numbers[0] is not None else _month(parts[0])
        day = int(numbers[1])
    elif len(parts) == 2 and numbers[0] is not None:
        month, day = _month(parts[1]), int(numbers[0])
    else:
        raise FieldError("which is no date; expected month/day, such as '12/31'")
    if not is_month_day(month, day):
        swapped = "; the month is first" if month > 12 >= day else ""
        raise FieldError(f"which is no day of the year; expected month/day, such as '12/31'{swapped}")
    return (date(LEAP_YEAR, month, day) - _BEFORE).days


def _date_words(text: str) -> list[str]:
    words = re.sub("[/:-]", " ", text.upper())
    return re.sub("(ST|ND|RD|TH|OF|IN) ", "   ", words).split()


def check_date(text: str) -> None:
    """Check a date that can also be a weekday of a month, such as `1st Sunday in May` or `Last Sunday in May`.

    Raises:
        FieldError: EnergyPlus does not accept it.
    """
    try:
        day_of_year(text)
    except FieldError:
        if _weekday_of_month(text) is not None:
            return
        if all(number(part) is not None for part in _date_words(text)):
            raise
        expected = "expected one such as '31 Dec', '1st Sunday in May' or 'Last Sunday in May'"
        raise FieldError(f"which is no date; {expected}") from None


def is_in_year(text: str, year: int) -> bool:
    """Return whether a year has a date that is a weekday of a month: not all have a `5th Sunday in March`."""
    weekday = _weekday_of_month(text)
    if weekday is None:
        return True
    ordinal, day, month = weekday
    first, length = monthrange(year, month)  # the weekday of the first day, from Monday
    return ordinal < 5 or 1 + (day - 1 - first) % 7 + 28 <= length


def missing_date(fields: Mapping[str, Any], year: int) -> str:
    """Return the field of special days, or of daylight saving time, whose date a year does not have; empty if none."""
    ends = ("start_date", "end_date")
    return next((end for end in ends if not is_in_year(str(fields.get(end, "")), year)), "")


def _weekday_of_month(text: str) -> tuple[int, int, int] | None:
    """Return ordinal (0: the last), day of the week (0: Sunday) and month of such a date; None of another text."""
    parts = _date_words(text)
    if len(parts) == 3 and _is_ordinal(parts[0]):
        names = parts[1][:3], parts[2][:3]
        for day, month in (names, names[::-1]):
            if day in _WEEK and month in _MONTHS:
                return int(number(parts[0]) or 0), _WEEK.index(day), _MONTHS.index(month) + 1
    return None


def _is_ordinal(word: str) -> bool:
    value = number(word)
    return word == "LA" or (value is not None and 0 <= value <= 5)  # LA is what _date_words leaves of LAST


def _month(word: str) -> int:
    return _MONTHS.index(word[:3]) + 1 if word[:3] in _MONTHS else 0


def date_of(day: int) -> str:
    """Return the date of a day, from 1 to 366: `12/31`."""
    moment = _BEFORE + timedelta(days=day)
    return f"{moment.month}/{moment.day}"


@dataclass
class DayTypes:
    """The day types of a week that have values so far."""

    known: set[str] = field(default_factory=set)

    def add(self, text: str) -> None:
        """Add those of a list such as `For: Weekdays SummerDesignDay`.

        Raises:
            FieldError: it names no day type, or one that has values already.
        """
        words, named, twice = text.upper(), False, list[str]()
        for word, members in _GROUPS.items():
            if word in words:
                named = True
                twice += [member for member in members if member in self.known]
                self.known.update(members)
        if _REST in words:
            named = True
            self.known.update(DAY_TYPES)
        if not named:
            raise FieldError(f"which names no day type; expected one or more of {', '.join(_DAY_WORDS)}")
        if twice:
            raise FieldError(f"but {', '.join(dict.fromkeys(twice))} has values already")

    @property
    def missing(self) -> tuple[str, ...]:
        """The day types without values."""
        return tuple(name for name in DAY_TYPES if name not in self.known)


def unknown_day_words(text: str) -> Iterator[str]:
    """Yield a note on each word of a list of day types that EnergyPlus ignores."""
    for word in re.split(r"[\s,]+", re.sub(r"^\s*for\s*:?", "", text, flags=re.IGNORECASE)):
        if word and _REST not in word.upper() and not any(group in word.upper() for group in _GROUPS):
            yield f"EnergyPlus ignores {word!r}, which is no day type; {did_you_mean(word, _DAY_WORDS)}"


@dataclass
class DayTimes:
    """The ends of a day's intervals, each of which has one value, in minutes.

    Attributes:
        last: the last time.
        latest: the latest time.
    """

    last: int = 0
    latest: int = 0

    def add(self, text: str) -> str:
        """Add a time such as `Until: 24:00`; return a note on it, empty without one.

        Raises:
            FieldError: it is no time, or is before the last one.
        """
        hour, minute = _hour_and_minute(re.sub(r"^until:?", "", text.strip(), flags=re.IGNORECASE))
        note = ""
        if hour == 24 and minute:
            note, minute = "EnergyPlus ends the day at 24:00", 0
        time, before = 60 * hour + minute, self.last
        # EnergyPlus finds a time that is out of order only if it is in an earlier hour.
        if time < before and (time - 1) // 60 < before // 60:
            raise FieldError(f"which is before {_clock(before)}, the time before it; times must increase")
        if time <= before:
            note = f"EnergyPlus does not use the value, since the time is not after {_clock(before)}"
        self.last, self.latest = time, max(time, self.latest)
        return note

    def check_end(self) -> None:
        """Check that the whole day has values.

        Raises:
            FieldError: the last time is not 24:00.
        """
        if self.latest < DAY_MIN:
            raise FieldError(f"but the day ends at 24:00; the values after {_clock(self.latest)} are missing")


def _hour_and_minute(text: str) -> tuple[int, int]:
    before, colon, after = text.partition(":")
    hour, minute = number(before), number(after)
    if not colon or hour is None or minute is None or hour != int(hour) or minute != int(minute):
        raise FieldError("which is no time; expected hours:minutes, such as '18:00'")
    if not 0 <= hour <= 24 or not 0 <= minute < 60:
        raise FieldError("which is no time of a day; expected 0:00 to 24:00")
    return int(hour), int(minute)


def _clock(minutes: int) -> str:
    return f"{minutes // 60}:{minutes % 60:02}"
