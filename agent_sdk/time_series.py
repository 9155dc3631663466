"""Prices, carbon intensities and other signals that go by the clock: from a file, a list, a table, or constant.

A year of hours holds for any simulated year. Its first row is 1 January, 0:00 to 1:00 local standard time, as simulated
time is: it has no summer time, and row k is simply hour k of the year. It is looked up by month, day and hour. A
series of 8760 hours has no 29 February; where the simulated year has one, it is that of the 28th. One of 8784 hours
has one; where the simulated year has none, its rows are passed over. Weekdays are therefore those of the simulated
year in an `TimeOfUse`, and those of the series' own year in the others.
"""

from __future__ import annotations

import csv
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from topics.errors import InvalidConfig, did_you_mean

HOURS, LEAP_HOURS = 8760, 8784
_FEBRUARY_28, _FEBRUARY_29 = 24 * (31 + 27), 24 * (31 + 28)
_DAYS_BEFORE = (0, 31, 60, 91, 121, 152, 182, 213, 244, 274, 305, 335)
_SHOWN = 5

Number = Annotated[float, Field(strict=True)]
Unit = Annotated[str, Field(min_length=1)]
Weekday = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
_WEEKDAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


def _is_a_span(hours: tuple[int, int]) -> tuple[int, int]:
    first, end = hours
    if not (0 <= first <= 23 and 0 <= end <= 24 and first != end):
        raise ValueError("a first hour from 0 to 23 and an end from 0 to 24 expected, as [9, 20] or [22, 6]")
    return hours


Hours = Annotated[tuple[int, int], AfterValidator(_is_a_span)]
"""The first hour of the day, and the one that is not in it any more; (22, 6) spans midnight."""


def within(hours: tuple[int, int], hour: int) -> bool:
    """Whether an hour of the day (0 to 23) is in a span of hours."""
    first, end = hours
    return first <= hour < end if first < end else hour >= first or hour < end


def hour_of_leap_year(moment: datetime) -> int:
    """0 to 8783; 1 March at 0:00 is the same hour in each year."""
    return (_DAYS_BEFORE[moment.month - 1] + moment.day - 1) * 24 + moment.hour


class TimeSeries(BaseModel, ABC):
    """A number for each hour.

    Attributes:
        unit: of the number, as `EUR/MWh`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    unit: Unit

    def at(self, begin: datetime | Sequence[datetime]) -> Any:
        """The number of the hour in which a moment lies, or an array of those of several moments."""
        if isinstance(begin, datetime):
            return self._at(begin)
        return np.array([self._at(moment) for moment in begin], np.float64)

    def load(self) -> None:  # most have nothing to read
        """Reads what there is to read, so that its mistakes are known before anything starts.

        Raises:
            InvalidConfig: there is no such file or column, or it is no year of numbers.
        """

    @abstractmethod
    def _at(self, moment: datetime) -> float:
        """The number of the hour in which a moment lies."""


class Constant(TimeSeries):
    """The same number at all times: `{value: 0.25, unit: EUR/kWh}`."""

    value: Number

    def _at(self, moment: datetime) -> float:  # noqa: ARG002
        return self.value


class Period(BaseModel):
    """A number for some hours of some days; what is left out is all of them.

    Attributes:
        hours: the first one, and the one that is not in it any more; [22, 6] spans midnight.
        weekdays: of the day on which the hour lies: `[mon, tue, wed, thu, fri]`.
        months: 1 to 12.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    value: Number
    hours: Hours | None = None
    weekdays: Annotated[tuple[Weekday, ...], Field(min_length=1)] | None = None
    months: Annotated[tuple[Annotated[int, Field(ge=1, le=12)], ...], Field(min_length=1)] | None = None

    def holds(self, month: int, weekday: int, hour: int) -> bool:
        """Whether it is for that hour (0 to 23) of that day (0 is Monday) of that month (1 to 12)."""
        return (
            (self.hours is None or within(self.hours, hour))
            and (self.weekdays is None or _WEEKDAYS[weekday] in self.weekdays)
            and (self.months is None or month in self.months)
        )


class TimeOfUse(TimeSeries):
    """A time of use: the first period that holds, else `otherwise`.

    `{table: [{value: 0.30, hours: [8, 20], weekdays: [mon, tue, wed, thu, fri]}], otherwise: 0.12, unit: EUR/kWh}`
    """

    table: Annotated[tuple[Period, ...], Field(min_length=1)]
    otherwise: Number

    def _at(self, moment: datetime) -> float:
        return self._numbers[moment.month - 1][moment.weekday()][moment.hour]

    @cached_property
    def _numbers(self) -> list[list[list[float]]]:
        """By month, weekday and hour."""
        return [[[self._first(month, day, hour) for hour in range(24)] for day in range(7)] for month in range(1, 13)]

    def _first(self, month: int, weekday: int, hour: int) -> float:
        return next((p.value for p in self.table if p.holds(month, weekday, hour)), self.otherwise)


class HourlySeries(TimeSeries):
    """A year of hours: `{hourly: [..8760 or 8784 numbers..], unit: g/kWh}`."""

    hourly: tuple[Number, ...]

    @field_validator("hourly")
    @classmethod
    def _is_a_year(cls, hourly: tuple[float, ...]) -> tuple[float, ...]:
        if len(hourly) not in (HOURS, LEAP_HOURS):
            raise ValueError(f"a year of {HOURS} or {LEAP_HOURS} hours expected, got {len(hourly)}")
        return hourly

    def _at(self, moment: datetime) -> float:
        return self._numbers[hour_of_leap_year(moment)]

    @cached_property
    def _numbers(self) -> list[float]:
        return _leap_year(list(self.hourly))


class HourlyFile(TimeSeries):
    """A column of a CSV file with a row for each hour of a year.

    `{csv: prices.csv, column: value, unit: EUR/MWh, delimiter: ;}`

    Attributes:
        csv: the file, UTF-8; a relative path is beside the program that uses it.
        column: its name in the header, or its number, from 1.
        delimiter: between columns.
        decimal: `.` or `,`.
        header_row: the line with the columns' names, from 1; the numbers begin below it. 0 is none.
    """

    csv: Path
    column: Annotated[int, Field(ge=1, strict=True)] | Annotated[str, Field(min_length=1)]
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    decimal: Literal[".", ","] = "."
    header_row: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="after")
    def _can_be_read(self) -> HourlyFile:
        if self.decimal == self.delimiter:
            raise ValueError(f"{self.decimal!r} cannot stand between columns and within numbers")
        if self.header_row == 0 and isinstance(self.column, str):
            raise ValueError("without a header_row the column is a number, from 1")
        return self

    def load(self) -> None:
        """See `TimeSeries`."""
        assert self._numbers

    def _at(self, moment: datetime) -> float:
        return self._numbers[hour_of_leap_year(moment)]

    @cached_property
    def _numbers(self) -> list[float]:
        rows = self._rows()
        place = self._place(dict(rows).get(self.header_row, []))
        below = [(line, row) for line, row in rows if line > self.header_row and row]
        numbers = [_number(row[place] if place < len(row) else "", self.decimal) for _, row in below]
        wrong = [line for (line, _), number in zip(below, numbers, strict=True) if number is None]
        if wrong:
            shown = ", ".join(map(str, wrong[:_SHOWN])) + (f" and {len(wrong) - _SHOWN} more" if wrong[_SHOWN:] else "")
            raise InvalidConfig(f"{self.csv}: column {self.column!r} has no number in line {shown}")
        if len(numbers) not in (HOURS, LEAP_HOURS):
            raise InvalidConfig(
                f"{self.csv}: a year has {HOURS} hours, or {LEAP_HOURS} with 29 February; the file has {len(numbers)}"
            )
        return _leap_year([number for number in numbers if number is not None])

    def _rows(self) -> list[tuple[int, list[str]]]:
        """Lines by their numbers, as an editor counts them."""
        try:
            with self.csv.expanduser().open(encoding="utf-8-sig", newline="") as file:
                reader = csv.reader(file, delimiter=self.delimiter)
                return [(reader.line_num, row) for row in reader]
        except (OSError, RuntimeError, UnicodeDecodeError, csv.Error) as error:
            raise InvalidConfig(f"cannot read the signal {self.csv}: {error}") from None

    def _place(self, header: list[str]) -> int:
        """The column's place in a row."""
        if isinstance(self.column, int):
            return self.column - 1
        names = [name.strip() for name in header]
        if names.count(self.column) != 1:
            fault = "stands twice" if self.column in names else "is not there"
            raise InvalidConfig(
                f"{self.csv}: column {self.column!r} {fault} in line {self.header_row}, with {self.delimiter!r} "
                f"between columns; {did_you_mean(self.column, names)}"
            )
        return names.index(self.column)


def _number(text: str, decimal: str) -> float | None:
    try:
        number = float(text.replace(decimal, "."))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _leap_year(numbers: list[float]) -> list[float]:
    """8784 hours; a year that has no 29 February gets the 28th's."""
    if len(numbers) == LEAP_HOURS:
        return numbers
    return [*numbers[:_FEBRUARY_29], *numbers[_FEBRUARY_28:_FEBRUARY_29], *numbers[_FEBRUARY_29:]]


_FORMS: dict[str, type[TimeSeries]] = {
    "value": Constant, "table": TimeOfUse, "hourly": HourlySeries, "csv": HourlyFile,
}  # fmt: skip
_EXPECTED = (
    "a signal expected: {value: 0.25, unit: EUR/kWh}, or one with `csv` and `column`, `hourly`, or `table` and "
    "`otherwise` in place of `value`"
)


def _form(given: Any) -> str | None:
    """Which form of signal is meant; by the field that only that one has."""
    for name, form in _FORMS.items():
        if isinstance(given, form) or (isinstance(given, Mapping) and name in given):
            return f"@{name}"
    return None


Signal = Annotated[
    Annotated[Constant, Tag("@value")]
    | Annotated[TimeOfUse, Tag("@table")]
    | Annotated[HourlySeries, Tag("@hourly")]
    | Annotated[HourlyFile, Tag("@csv")],
    Discriminator(_form, custom_error_type="signal", custom_error_message=_EXPECTED),
]
"""Any form of signal, told apart by its fields."""


# Units

KWH = {"Wh": 1e-3, "kWh": 1.0, "MWh": 1e3, "GWh": 1e6, "MJ": 1 / 3.6, "GJ": 1e3 / 3.6}
GRAMS = {"g": 1.0, "kg": 1e3, "t": 1e6}


def _parts(unit: str) -> tuple[str, float]:
    """What stands above the line of a unit, and the kWh below it."""
    above, _, below = unit.partition("/")
    if not above.strip() or below.strip() not in KWH:
        raise ValueError(
            f"a unit of something by energy expected, as EUR/kWh or g/kWh, got {unit!r}; energies are {', '.join(KWH)}"
        )
    return above.strip(), KWH[below.strip()]


def per_kwh(unit: str) -> float:
    """What one of a price's unit is in a kWh: 0.001 for EUR/MWh; `ValueError` for what is no price."""
    return 1.0 / _parts(unit)[1]


def grams_per_kwh(unit: str) -> float:
    """What one of an intensity's unit is in g/kWh: 1 for kg/MWh; `ValueError` for what is no intensity."""
    above, kwh = _parts(unit)
    for end in ("CO2eq", "CO2e", "CO2"):
        above = above.removesuffix(end).strip()
    if above not in GRAMS:
        raise ValueError(f"a mass by energy expected, as g/kWh or kg/MWh, got {unit!r}")
    return GRAMS[above] / kwh


def _is_a_price(signal: TimeSeries) -> TimeSeries:
    per_kwh(signal.unit)
    return signal


def _is_an_intensity(signal: TimeSeries) -> TimeSeries:
    grams_per_kwh(signal.unit)
    return signal


Price = Annotated[Signal, AfterValidator(_is_a_price)]
"""A signal in money by energy."""

Intensity = Annotated[Signal, AfterValidator(_is_an_intensity)]
"""A signal in mass of CO2 by energy."""
