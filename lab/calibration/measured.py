"""Measured data of a calibration: a CSV file with timestamps, checked line by line before anything starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np

from zenostat.lab.calibration.config import Calibration, Column
from zenostat.lab.calibration.headings import Heading, read_rows
from zenostat.lab.calibration.timestamps import (
    BILL,
    DAY,
    HOUR,
    read_timestamps,
    row_interval,
    row_intervals,
    saving_hint,
)
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.units import conversion, quantity, units_of

_GAP = 1.6
"""A row that is longer by this factor than most, without `interval: between`, is taken for one that lacks another."""
_MAX_TEMPERATURE_C, _MIN_TEMPERATURE_C = 60.0, -60.0
"""Plausible temperatures of a building and its surroundings; what is outside has another unit."""


class SimulatedSeries(Protocol):
    """Simulated series that a column is compared with."""

    @property
    def name(self) -> str:
        """Name of the point."""

    @property
    def unit(self) -> str:
        """Unit of its values."""

    @property
    def summed(self) -> bool:
        """Whether a value is the sum over an hour rather than the mean."""


@dataclass(frozen=True)
class MeasuredColumn:
    """A measured column and how simulated hours become its values.

    Attributes:
        values: measured values in the column's own unit, shape (rows,); NaN where missing.
        factor, offset: from the point's unit to the column's: factor * value + offset.
        per_hour: whether the column is a power and the point an energy (-1), the reverse (1), or neither (0).
        is_absolute: whether its errors are rated in K rather than in percent of the mean.
    """

    header: str
    unit: str
    point: str
    settings: Column
    values: Floats
    factor: float
    offset: float
    per_hour: int
    summed: bool
    is_absolute: bool

    @property
    def is_total(self) -> bool:
        """Whether a value is a total of its interval, as an energy, rather than a mean."""
        return self.per_hour == 1 or (self.summed and self.per_hour == 0)

    @property
    def tolerance(self) -> float:
        """Tolerance of a temperature in the column's unit."""
        return self.settings.tolerance * (1.8 if self.unit == "degF" else 1.0)

    def of_hours(self, hours: Floats) -> float:
        """Return the value of the column for an interval with these simulated hours, shape (hours,)."""
        value = float(np.sum(hours)) if self.summed else float(np.mean(hours))
        seconds = 3600.0 * len(hours)
        return (value * seconds**self.per_hour) * self.factor + self.offset


@dataclass(frozen=True)
class MeasuredData:
    """Measured data.

    Attributes:
        columns: the columns.
        begins, ends: begin and end of each row's interval in local standard time; whole hours.
        lines: line of each row in the file.
    """

    columns: tuple[MeasuredColumn, ...]
    begins: tuple[datetime, ...]
    ends: tuple[datetime, ...]
    lines: tuple[int, ...]

    @property
    def is_monthly(self) -> bool:
        """Whether the rows are those of bills, which have the monthly limits."""
        return (
            float(np.median([(end - begin) / BILL for begin, end in zip(self.begins, self.ends, strict=True)])) >= 1.0
        )

    @property
    def is_hourly(self) -> bool:
        """Whether each row is an hour, which has the hourly limits."""
        return all(end - begin == HOUR for begin, end in zip(self.begins, self.ends, strict=True))

    def rows_of(self, days: tuple[date, date]) -> list[int]:
        """Return the rows whose intervals are within a period."""
        begin, end = bounds(days)
        return [
            row for row, (first, last) in enumerate(zip(self.begins, self.ends, strict=True))
            if begin <= first and last <= end
        ]  # fmt: skip


def bounds(days: tuple[date, date]) -> tuple[datetime, datetime]:
    """Return begin and end of a period of whole days."""
    first, last = (datetime(day.year, day.month, day.day) for day in days)
    return first, last + timedelta(days=1)


def read_measured(
    path: Path,
    config: Calibration,
    headings: Sequence[Heading],
    targets: Sequence[SimulatedSeries],
    utc_offset_h: float,
) -> MeasuredData:
    """Read the measured data of a calibration.

    Args:
        path: the CSV file.
        config: the calibration.
        headings: its columns to compare.
        targets: what each of them is compared with.
        utc_offset_h: standard time of the weather file, h east of Greenwich.

    Raises:
        InvalidConfig: an error of the file, with its line and what would be right.
    """
    rows = read_rows(path, config.delimiter)
    header = [cell.strip() for cell in rows[0][1]]
    lines, stamps = read_timestamps(path, config, rows[1:], header.index(config.time_column or header[0]), utc_offset_h)
    interval = row_interval(config, stamps)
    begins, ends = row_intervals(path, config, lines, stamps, interval)
    columns = []
    for heading, target in zip(headings, targets, strict=True):
        values = _values(path, rows[1:], header.index(heading.header), heading)
        columns.append(_column(path, heading, target, values, lines))
    if interval is None:
        lines, columns = _between(path, config, lines, stamps, columns)
    data = MeasuredData(tuple(columns), tuple(begins), tuple(ends), tuple(lines))
    _check_periods(path, data, config, is_hourly=interval is not None)
    if interval is not None and interval < HOUR:
        data = _to_hours(path, data, interval)
        _check_periods(path, data, config, is_hourly=True)
    return data


def _values(path: Path, rows: Sequence[tuple[int, list[str]]], place: int, heading: Heading) -> Floats:
    values = np.full(len(rows), np.nan)
    for number, (line, row) in enumerate(rows):
        text = row[place].strip() if place < len(row) else ""
        if text.casefold() in ("", "nan", "na", "null"):
            continue
        try:
            values[number] = float(text.replace("_", "?"))  # Python's own mark within numbers
        except ValueError:
            raise InvalidConfig(
                f"{path}, line {line}, column {heading.header!r}: {text!r} is no number; expected one as 12.5, or an "
                "empty cell where nothing was measured"
            ) from None
        if math.isinf(values[number]):
            raise InvalidConfig(f"{path}, line {line}, column {heading.header!r}: {text!r} is not finite")
    return values


def _column(
    path: Path, heading: Heading, target: SimulatedSeries, values: Floats, lines: Sequence[int]
) -> MeasuredColumn:
    unit = heading.unit
    kind = quantity(target.unit)
    per_hour, allowed = 0, list(units_of(kind)) or [target.unit]
    if unit is None:
        raise InvalidConfig(
            f"{path}, line 1: column {heading.header!r} has no unit; write it in brackets, as "
            f"{heading.name} [{allowed[0]}], or set columns.{heading.header}.unit"
        )
    way = conversion(target.unit, unit)
    other = {"energy": ("power", "W", -1), "power": ("energy", "J", 1)}.get(kind)
    if way is None and other is not None and quantity(unit) == other[0]:
        way, per_hour = conversion(other[1], unit), other[2]
        to_base = conversion(target.unit, "J" if kind == "energy" else "W")
        assert way is not None
        assert to_base is not None
        way = (way[0] * to_base[0], way[1])
    if way is None:
        allowed += list(units_of(other[0])) if other else []
        raise InvalidConfig(
            f"{path}, line 1: column {heading.header!r} has the unit {unit!r}, but {target.name} is in {target.unit}; "
            f"expected one of {', '.join(allowed)}"
        )
    is_absolute = kind == "temperature"
    if is_absolute:
        _check_temperatures(path, heading, unit, values, lines)
    return MeasuredColumn(
        heading.header,
        unit,
        target.name,
        heading.settings,
        values,
        way[0],
        way[1],
        per_hour,
        target.summed,
        is_absolute,
    )


def _check_temperatures(path: Path, heading: Heading, unit: str, values: Floats, lines: Sequence[int]) -> None:
    way = conversion(unit, "degC")
    assert way is not None
    celsius = values * way[0] + way[1]
    wrong = np.flatnonzero((celsius > _MAX_TEMPERATURE_C) | (celsius < _MIN_TEMPERATURE_C))
    if wrong.size:
        hint = " (degF?)" if unit == "degC" else " (degC?)" if unit in ("K", "degF") else ""
        raise InvalidConfig(
            f"{path}, line {lines[wrong[0]]}, column {heading.header!r}: {values[wrong[0]]:g} {unit} is no "
            f"temperature of a building; expected {_MIN_TEMPERATURE_C:g} to {_MAX_TEMPERATURE_C:g} degC: is the unit "
            f"wrong{hint}?"
        )


def _to_hours(path: Path, data: MeasuredData, interval: timedelta) -> MeasuredData:
    """Return rows of whole hours: sums of energies, means of all else; an hour that lacks a row is left out.

    Raises:
        InvalidConfig: every hour lacks a row.
    """
    parts = round(HOUR / interval)
    hours: dict[datetime, list[int]] = {}
    for row, begin in enumerate(data.begins):
        hours.setdefault(begin.replace(minute=0), []).append(row)
    whole = {begin: rows for begin, rows in hours.items() if len(rows) == parts}
    if not whole:
        raise InvalidConfig(f"{path}: no hour has all of its {parts} rows")
    joined = []
    for column in data.columns:
        table = column.values[np.array(list(whole.values()), dtype=int).reshape(-1, parts)]
        joined.append(replace(column, values=table.sum(axis=1) if column.is_total else table.mean(axis=1)))
    lines = tuple(data.lines[rows[0]] for rows in whole.values())
    return MeasuredData(tuple(joined), tuple(whole), tuple(begin + HOUR for begin in whole), lines)


def _between(
    path: Path, config: Calibration, lines: Sequence[int], stamps: Sequence[datetime], columns: Sequence[MeasuredColumn]
) -> tuple[list[int], list[MeasuredColumn]]:
    """Return rows that last to the next stamp, or since the one before: the last or first stamp is none of its own.

    Unless they are to be left out: a value without an interval is an error if it concerns a period, and so is a row
    that is much longer than most, since another one seems to be missing within it.
    """
    is_end = config.timestamps == "end"
    alone, kept = (0, slice(1, None)) if is_end else (len(stamps) - 1, slice(None, -1))
    rows = list(lines[kept])
    if config.missing != "leave_out":
        periods = [bounds(days) for days in (*config.periods, *config.held_out)]
        stamp = stamps[alone]
        is_inside = any(begin < stamp <= end if is_end else begin <= stamp < end for begin, end in periods)
        with_value = next((each for each in columns if not math.isnan(each.values[alone])), None)
        if is_inside and with_value is not None:
            lacks, where, last = ("beginning", "before", "after") if is_end else ("end", "after", "before")
            raise InvalidConfig(
                f"{path}, line {lines[alone]}, column {with_value.header!r}: the value of {stamp} has no {lacks}, "
                f"since no stamp is {where} it; add a row with that time and empty cells, choose periods that lie "
                f"{last} {stamp:%Y-%m-%d}, or set missing: leave_out"
            )
    values = [column.values[kept].copy() for column in columns]
    lengths = np.array([(after - before) / DAY for before, after in pairwise(stamps)])
    usual = float(np.median(lengths))
    are_bills = usual * DAY >= BILL
    for row in np.flatnonzero(lengths > _GAP * usual).tolist() if config.interval is None or not are_bills else ():
        if config.missing != "leave_out":
            raise InvalidConfig(
                f"{path}, line {rows[row]}: its row lasts from {stamps[row]} to {stamps[row + 1]}, {lengths[row]:g} "
                f"days, and most rows {usual:g} days: another seems to be missing; add it, with empty cells if it is "
                f"unknown{', set interval: between if the row does last that long' if are_bills else ''}, or set "
                "missing: leave_out"
            )
        for column in values:
            column[row] = np.nan
    return rows, [replace(column, values=each) for column, each in zip(columns, values, strict=True)]


def _check_periods(path: Path, data: MeasuredData, config: Calibration, *, is_hourly: bool) -> None:
    for name, periods in (("periods", config.periods), ("held_out", config.held_out)):
        for number, days in enumerate(periods):
            _check_period(path, data, config, days, f"{name}[{number}]", is_hourly=is_hourly)


def _check_period(
    path: Path, data: MeasuredData, config: Calibration, days: tuple[date, date], name: str, *, is_hourly: bool
) -> None:
    """Check that a period has measured data, without gaps unless these are to be left out."""
    begin, end = bounds(days)
    rows = data.rows_of(days)
    if not rows:
        raise InvalidConfig(
            f"{name}: {days[0]} to {days[1]} has no measured data; {path.name} covers {data.begins[0]} to "
            f"{data.ends[-1]} (lines {data.lines[0]} to {data.lines[-1]}){_cut_off(data, begin, end)}"
        )
    if config.missing == "leave_out":
        return
    times = [begin, *(data.ends[row] for row in rows)]
    starts = [*(data.begins[row] for row in rows), end]
    for number, (last, first) in enumerate(zip(times, starts, strict=True)):
        if first > last and (is_hourly or first - last >= DAY):  # bills are read at some hour of a day
            line = data.lines[rows[number]] if number < len(rows) else data.lines[rows[-1]] + 1
            saving = saving_hint(last, config) if first - last == HOUR else ""
            raise InvalidConfig(
                f"{path}, before line {line}: no data for {last} to {first}, within {name}; add the rows, choose other "
                f"days{'' if is_hourly else ' (rows that reach beyond them do not count)'}, or set missing: "
                f"leave_out{saving or _cut_off(data, begin, end)}"
            )
    for column in data.columns:
        empty = [row for row in rows if math.isnan(column.values[row])]
        if empty:
            raise InvalidConfig(
                f"{path}, line {data.lines[empty[0]]}, column {column.header!r}: no value, within {name}"
                f"{f' (and {len(empty) - 1} more)' if empty[1:] else ''}; fill it in, choose other days, or set "
                "missing: leave_out"
            )


def _cut_off(data: MeasuredData, begin: datetime, end: datetime) -> str:
    """Return a hint at the first row that lies mostly, but not wholly, within a period; else an empty text.

    Days and bills of a clock with daylight saving time begin an hour before those of standard time.
    """
    for line, first, last in zip(data.lines, data.begins, data.ends, strict=True):
        inside = min(last, end) - max(first, begin)
        if last - first > inside > (last - first) / 2:
            remedy = f"begin on {first:%Y-%m-%d}" if first < begin else f"end on {last - HOUR:%Y-%m-%d}"
            return f". The row of line {line} lasts from {first} to {last} in standard time: {remedy} to include it"
    return ""
