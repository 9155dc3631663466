"""Prices, carbon intensities and other hourly time series: from a file, a list, a table, or constant.

A year of hours is valid for any simulated year. Its first row is 1 January, 0:00 to 1:00 local standard time; like
simulated time it has no daylight saving time, and row k is hour k of the year. Values are looked up by month, day and
hour. A series of 8760 hours has no 29 February; if the simulated year has one, the values of the 28th are used. One of
8784 hours has a 29 February; if the simulated year has none, its rows are skipped. Weekdays are therefore those of the
simulated year in a `TimeOfUse`, and those of the series' own year in the other forms.
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
    field_serializer,
    field_validator,
    model_validator,
)

from zenostat.topics.calendar import WEEKDAYS, Weekday, check_hours, hour_of_leap_year, in_hours
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.user_file import user_file

__all__ = [
    "Constant",
    "HourlyFile",
    "HourlySeries",
    "Intensity",
    "Period",
    "Price",
    "Signal",
    "TimeOfUse",
    "TimeSeries",
]

HOURS, LEAP_HOURS = 8760, 8784
_FEBRUARY_28, _FEBRUARY_29 = 24 * (31 + 27), 24 * (31 + 28)
_MAX_LISTED = 5

Number = Annotated[float, Field(strict=True)]
Unit = Annotated[str, Field(min_length=1)]
Hours = Annotated[tuple[int, int], AfterValidator(check_hours)]
"""The first hour of a span within the day, and the hour after its last one; (22, 6) spans midnight."""


class TimeSeries(BaseModel, ABC):
    """A time series with a number for each hour.

    Attributes:
        unit: Unit of the numbers, as `EUR/MWh`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    unit: Unit

    def at(self, begin: datetime | Sequence[datetime]) -> Any:
        """Return the number of the hour that contains a moment, or an array of those of several moments."""
        if isinstance(begin, datetime):
            return self._at(begin)
        return np.array([self._at(moment) for moment in begin], np.float64)

    def load(self) -> None:  # most forms have nothing to read
        """Read the file, if there is one, so that its errors are reported before anything starts.

        Raises:
            InvalidConfig: No such file or column, or not a year of numbers.
        """

    @abstractmethod
    def _at(self, moment: datetime) -> float:
        """Return the number of the hour that contains a moment."""


class Constant(TimeSeries):
    """A constant number: `{value: 0.25, unit: EUR/kWh}`."""

    value: Number

    def _at(self, moment: datetime) -> float:  # noqa: ARG002
        return self.value


class Period(BaseModel):
    """A number for some hours of some days; a field that is left out selects all.

    Attributes:
        value: The number.
        hours: The first hour, and the hour after the last one; [22, 6] spans midnight.
        weekdays: Weekdays of the day that contains the hour: `[mon, tue, wed, thu, fri]`.
        months: 1 to 12.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    value: Number
    hours: Hours | None = None
    weekdays: Annotated[tuple[Weekday, ...], Field(min_length=1)] | None = None
    months: Annotated[tuple[Annotated[int, Field(ge=1, le=12)], ...], Field(min_length=1)] | None = None

    def holds(self, month: int, weekday: int, hour: int) -> bool:
        """Return whether the period contains this month (1 to 12), weekday (0 is Monday) and hour (0 to 23)."""
        return (
            (self.hours is None or in_hours(self.hours, hour))
            and (self.weekdays is None or WEEKDAYS[weekday] in self.weekdays)
            and (self.months is None or month in self.months)
        )


class TimeOfUse(TimeSeries):
    """A time-of-use table: the value of the first period that contains the hour, else `otherwise`.

    `{table: [{value: 0.30, hours: [8, 20], weekdays: [mon, tue, wed, thu, fri]}], otherwise: 0.12, unit: EUR/kWh}`
    """

    table: Annotated[tuple[Period, ...], Field(min_length=1)]
    otherwise: Number

    def _at(self, moment: datetime) -> float:
        return self._numbers[moment.month - 1][moment.weekday()][moment.hour]

    @cached_property
    def _numbers(self) -> list[list[list[float]]]:
        """Numbers by month, weekday and hour."""
        return [[[self._first(month, day, hour) for hour in range(24)] for day in range(7)] for month in range(1, 13)]

    def _first(self, month: int, weekday: int, hour: int) -> float:
        return next((p.value for p in self.table if p.holds(month, weekday, hour)), self.otherwise)


class HourlySeries(TimeSeries):
    """A list with a number for each hour of a year: `{hourly: [..8760 or 8784 numbers..], unit: g/kWh}`."""

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
        csv: The file, UTF-8; a relative path refers to the working directory of the program that reads it.
        column: Name of the column in the header, or its number, from 1.
        delimiter: Character between columns.
        decimal: Decimal separator, `.` or `,`.
        header_row: Line with the columns' names, from 1; the numbers begin below it. 0: no header.
    """

    csv: Path
    column: Annotated[int, Field(ge=1, strict=True)] | Annotated[str, Field(min_length=1)]
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    decimal: Literal[".", ","] = "."
    header_row: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="after")
    def _check_format(self) -> HourlyFile:
        if self.decimal == self.delimiter:
            raise ValueError(f"{self.decimal!r} cannot be both the delimiter and the decimal separator")
        if self.header_row == 0 and isinstance(self.column, str):
            raise ValueError("without a header_row the column is a number, from 1")
        return self

    @field_serializer("csv", when_used="json")
    def _serialize_absolute(self, file: Path) -> str:
        """Return a path that refers to the same file for a reader in another folder."""
        return str(file.expanduser().absolute())

    def load(self) -> None:
        """Read the file; see `TimeSeries.load`."""
        assert self._numbers

    def _at(self, moment: datetime) -> float:
        return self._numbers[hour_of_leap_year(moment)]

    @cached_property
    def _numbers(self) -> list[float]:
        rows = self._rows()
        header = dict(rows).get(self.header_row, [])
        index = self._column_index(header)
        below = [(line, row) for line, row in rows if line > self.header_row and row]
        numbers = [_number(row[index] if index < len(row) else "", self.decimal) for _, row in below]
        invalid = [line for (line, _), number in zip(below, numbers, strict=True) if number is None]
        wider = next((line for line, row in below if self.header_row and any(row[len(header) :])), None)
        if wider is not None and self.delimiter == ",":
            raise InvalidConfig(
                f"{self.csv}: line {wider} has more cells than the header, line {self.header_row}; if the comma is the "
                "decimal separator, set delimiter and decimal, as {csv: prices.csv, delimiter: ;, decimal: ','}"
            )
        if invalid:
            more = f" and {len(invalid) - _MAX_LISTED} more" if invalid[_MAX_LISTED:] else ""
            lines = ", ".join(map(str, invalid[:_MAX_LISTED])) + more
            raise InvalidConfig(f"{self.csv}: column {self.column!r} has no number in line {lines}")
        if len(numbers) not in (HOURS, LEAP_HOURS):
            raise InvalidConfig(
                f"{self.csv}: a year has {HOURS} hours, or {LEAP_HOURS} with 29 February; the file has {len(numbers)}"
            )
        return _leap_year([number for number in numbers if number is not None])

    def _rows(self) -> list[tuple[int, list[str]]]:
        """Return rows with their line numbers, from 1."""
        with user_file(self.csv), self.csv.expanduser().open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, delimiter=self.delimiter)
            return [(reader.line_num, row) for row in reader]

    def _column_index(self, header: list[str]) -> int:
        """Return the column's position in a row."""
        if isinstance(self.column, int):
            return self.column - 1
        names = [name.strip() for name in header]
        if names.count(self.column) != 1:
            problem = "is not unique" if self.column in names else "is missing"
            raise InvalidConfig(
                f"{self.csv}: column {self.column!r} {problem} in line {self.header_row}, with {self.delimiter!r} "
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
    """Return 8784 hours; a year without 29 February gets the values of the 28th."""
    if len(numbers) == LEAP_HOURS:
        return numbers
    return [*numbers[:_FEBRUARY_29], *numbers[_FEBRUARY_28:_FEBRUARY_29], *numbers[_FEBRUARY_29:]]


_FORMS: dict[str, type[TimeSeries]] = {
    "value": Constant, "table": TimeOfUse, "hourly": HourlySeries, "csv": HourlyFile,
}  # fmt: skip
_EXPECTED = (
    "a time series expected: {value: 0.25, unit: EUR/kWh}, or one with `csv` and `column`, `hourly`, or `table` and "
    "`otherwise` instead of `value`"
)


def _form(spec: Any) -> str | None:
    """Return the tag of the form that a specification has, by the field that only this form has."""
    for name, form in _FORMS.items():
        if isinstance(spec, form) or (isinstance(spec, Mapping) and name in spec):
            return f"@{name}"
    return None


Signal = Annotated[
    Annotated[Constant, Tag("@value")]
    | Annotated[TimeOfUse, Tag("@table")]
    | Annotated[HourlySeries, Tag("@hourly")]
    | Annotated[HourlyFile, Tag("@csv")],
    Discriminator(_form, custom_error_type="signal", custom_error_message=_EXPECTED),
]
"""Any form of time series, distinguished by its fields."""


# Units

KWH = {"Wh": 1e-3, "kWh": 1.0, "MWh": 1e3, "GWh": 1e6, "MJ": 1 / 3.6, "GJ": 1e3 / 3.6}
GRAMS = {"g": 1.0, "kg": 1e3, "t": 1e6}


def _split_unit(unit: str) -> tuple[str, float]:
    """Return the numerator of a unit, and its denominator in kWh."""
    numerator, _, denominator = unit.partition("/")
    if not numerator.strip() or denominator.strip() not in KWH:
        raise ValueError(
            f"a unit per energy expected, as EUR/kWh or g/kWh, got {unit!r}; units of energy are {', '.join(KWH)}"
        )
    return numerator.strip(), KWH[denominator.strip()]


def per_kwh(unit: str) -> float:
    """Return the factor from a price's unit to money per kWh: 0.001 for EUR/MWh.

    Raises:
        ValueError: The unit is not a price per energy.
    """
    return 1.0 / _split_unit(unit)[1]


def price_per_kwh(what: str, unit: str) -> float:
    """Return `per_kwh` of a point's unit; `what` names the point in the error.

    Raises:
        InvalidConfig: The unit is not a price per energy.
    """
    try:
        return per_kwh(unit)
    except ValueError as error:
        raise InvalidConfig(f"{what}: {error}") from None


def currency(unit: str) -> str:
    """Return the currency of a price's unit: EUR of EUR/MWh; "" for one without, such as 1/kWh.

    Raises:
        ValueError: The unit is not a price per energy.
    """
    numerator = _split_unit(unit)[0]
    return "" if numerator == "1" else numerator


def grams_per_kwh(unit: str) -> float:
    """Return the factor from an intensity's unit to g/kWh: 1 for kg/MWh.

    Raises:
        ValueError: The unit is not a mass per energy.
    """
    numerator, kwh = _split_unit(unit)
    for suffix in ("CO2eq", "CO2e", "CO2"):
        numerator = numerator.removesuffix(suffix).strip()
    if numerator not in GRAMS:
        raise ValueError(f"a mass per energy expected, as g/kWh or kg/MWh, got {unit!r}")
    return GRAMS[numerator] / kwh


def _check_price(series: TimeSeries) -> TimeSeries:
    per_kwh(series.unit)
    return series


def _check_intensity(series: TimeSeries) -> TimeSeries:
    grams_per_kwh(series.unit)
    return series


Price = Annotated[Signal, AfterValidator(_check_price)]
"""A time series of money per energy."""

Intensity = Annotated[Signal, AfterValidator(_check_intensity)]
"""A time series of mass of CO2 per energy."""
