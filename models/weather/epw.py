"""Read and write EPW weather files; columns can be replaced, and everything else stays byte for byte.

The format is the EPW data dictionary of EnergyPlus's Auxiliary Programs: 8 header lines, then 35 cells per line.
Like EnergyPlus, it also reads lines without the last one to three of them, as older files have them.
This module does not use an EPW library: readers such as pvlib's cannot write the rest of a file back unchanged, and do
not check its rows against its header.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, timedelta
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zenostat.models.weather.header import HEADER_LINES, Header, has_record, parse_header
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean, list_errors

WIDTH = 35
MIN_WIDTH = 32
"""Smallest number of cells of a line: files of the format's first years end with the days since the last snowfall."""
_TEXT = (5, 27)  # the source flags and the weather codes, which are nine separate digits rather than a number
NUMBER_COLUMNS = [index for index in range(WIDTH) if index not in _TEXT]
"""Positions of the columns that are numbers."""
_TIMES = ("year", "month", "day", "hour", "minute")
_MAX_ERRORS = 5


@dataclass(frozen=True, slots=True)
class Column:
    """A numeric column of an EPW.

    Attributes:
        index: position in a line, from 0.
        low, high: the dictionary's limits, both inclusive; a limit that is exclusive there is moved inwards by 0.1.
        missing: values of this or more mean a missing value.
    """

    name: str
    index: int
    unit: str
    low: float
    high: float
    missing: float


_INF = float("inf")
COLUMNS: dict[str, Column] = {
    name: Column(name, index, unit, low, high, missing)
    for index, name, unit, low, high, missing in (
        (6, "dry_bulb_temperature", "C", -69.9, 69.9, 99.9),
        (7, "dew_point_temperature", "C", -69.9, 69.9, 99.9),
        (8, "relative_humidity", "%", 0.0, 110.0, 999.0),
        (9, "atmospheric_station_pressure", "Pa", 31_000.1, 119_999.9, 999_999.0),
        (10, "extraterrestrial_horizontal_radiation", "Wh/m2", 0.0, _INF, 9999.0),
        (11, "extraterrestrial_direct_normal_radiation", "Wh/m2", 0.0, _INF, 9999.0),
        (12, "horizontal_infrared_radiation_intensity", "Wh/m2", 0.0, _INF, 9999.0),
        (13, "global_horizontal_radiation", "Wh/m2", 0.0, _INF, 9999.0),
        (14, "direct_normal_radiation", "Wh/m2", 0.0, _INF, 9999.0),
        (15, "diffuse_horizontal_radiation", "Wh/m2", 0.0, _INF, 9999.0),
        (16, "global_horizontal_illuminance", "lux", 0.0, _INF, 999_900.0),
        (17, "direct_normal_illuminance", "lux", 0.0, _INF, 999_900.0),
        (18, "diffuse_horizontal_illuminance", "lux", 0.0, _INF, 999_900.0),
        (19, "zenith_luminance", "Cd/m2", 0.0, _INF, 9999.0),
        (20, "wind_direction", "deg", 0.0, 360.0, 999.0),
        (21, "wind_speed", "m/s", 0.0, 40.0, 999.0),
        (22, "total_sky_cover", "tenths", 0.0, 10.0, 99.0),
        (23, "opaque_sky_cover", "tenths", 0.0, 10.0, 99.0),
        (24, "visibility", "km", 0.0, _INF, 9999.0),
        (25, "ceiling_height", "m", 0.0, _INF, 99_999.0),
        (26, "present_weather_observation", "", 0.0, 9.0, 9.0),
        (28, "precipitable_water", "mm", 0.0, _INF, 999.0),
        (29, "aerosol_optical_depth", "thousandths", 0.0, _INF, 0.999),
        (30, "snow_depth", "cm", 0.0, _INF, 999.0),
        (31, "days_since_last_snowfall", "d", 0.0, _INF, 99.0),
        (32, "albedo", "", 0.0, _INF, 999.0),
        (33, "liquid_precipitation_depth", "mm", 0.0, _INF, 999.0),
        (34, "liquid_precipitation_quantity", "h", 0.0, _INF, 99.0),
    )
}
"""The numeric columns by name; the flags and the weather codes are text and not included."""

_ALIASES = {
    "dry_bulb": "dry_bulb_temperature",
    "drybulb": "dry_bulb_temperature",
    "temperature": "dry_bulb_temperature",
    "dew_point": "dew_point_temperature",
    "dewpoint": "dew_point_temperature",
    "dewpoint_temperature": "dew_point_temperature",
    "humidity": "relative_humidity",
    "rh": "relative_humidity",
    "pressure": "atmospheric_station_pressure",
    "atmospheric_pressure": "atmospheric_station_pressure",
    "horizontal_infrared_radiation": "horizontal_infrared_radiation_intensity",
    "horizontal_infrared_radiation_intensity_from_sky": "horizontal_infrared_radiation_intensity",
    "global_radiation": "global_horizontal_radiation",
    "direct_radiation": "direct_normal_radiation",
    "diffuse_radiation": "diffuse_horizontal_radiation",
    "days_since_last_snow": "days_since_last_snowfall",
}


def find_column(text: str) -> Column:
    """Find a column by name: `Dry Bulb Temperature`, `dry_bulb_temperature` and `dry-bulb` are the same.

    Raises:
        UnknownName: there is no such column; the text lists similar names.
    """
    folded = re.sub(r"[^0-9a-z]+", "_", text.casefold()).strip("_")
    column = COLUMNS.get(_ALIASES.get(folded, folded))
    if column is None:
        raise UnknownName(f"no weather column {text!r}; {did_you_mean(folded, COLUMNS)}")
    return column


@dataclass(frozen=True, slots=True, eq=False)
class Weather:
    """A validated weather file.

    Attributes:
        head: the header lines verbatim, without line endings.
        rows: the data lines verbatim, without line endings.
        end: the line ending.
        tail: the text after the last row's cells.
        table: numbers of all columns except the text columns, float64 (33, rows), read-only; the last columns, which
            the lines may lack, have their missing values.
        width: number of cells of each line, 32 to 35.
    """

    path: Path
    header: Header
    head: tuple[str, ...]
    rows: list[str]
    end: str
    tail: str
    table: Floats
    width: int = WIDTH

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> Floats:
        """Return a column's values, float64 (rows,), read-only; `UnknownName` if there is no such column."""
        return self.numbers(find_column(name).index)

    @property
    def times(self) -> NDArray[np.int64]:
        """Year, month, day, hour (1 to 24) and minute of each row, int64 (rows, 5)."""
        return np.asarray(self.table[: len(_TIMES)].T, dtype=np.int64)

    @property
    def record_h(self) -> float:
        """Hours between two rows."""
        return 1.0 / self.header.records_per_hour

    def numbers(self, index: int) -> Floats:
        """Return the values of the column at a position in the line, float64 (rows,)."""
        values: Floats = self.table[NUMBER_COLUMNS.index(index)]
        return values

    def has(self, index: int, values: Floats) -> bool:
        """Return whether the file's lines have the column at a position.

        Raises:
            InvalidConfig: they lack it, and these values for it are not all missing.
        """
        if index < self.width:
            return True
        if (values != self.numbers(index)[: len(values)]).any():
            name = next(name for name, column in COLUMNS.items() if column.index == index)
            raise InvalidConfig(f"{self.path} has no column {name}: its lines have {self.width} of {WIDTH} cells")
        return False


def read(path: Path) -> Weather:
    """Read and validate the weather file `path`.

    Raises:
        InvalidConfig: the file is not an EPW file, has too few or too many rows for DATA PERIODS, rows out of order,
            or cells that are missing (except the last one to three of all lines) or not numbers. The text has the
            lines, their content and what was expected.
    """
    text = path.read_bytes().decode("latin-1")
    # With line ends of both kinds, a CR belongs to the last cell, where numbers may have blanks.
    end = "\r\n" if 0 < text.count("\r\n") == text.count("\n") else "\n"
    lines = text.split(end)
    header = parse_header(path, [line.encode("latin-1") for line in lines[:HEADER_LINES]])
    last = len(lines)
    while last > HEADER_LINES and not has_record(lines[last - 1].encode("latin-1")):
        last -= 1
    rows = lines[HEADER_LINES:last]
    table = _parse_rows(rows)
    errors = [] if table is not None else _cell_errors(rows)
    try:
        errors = _day_errors(_row_days(rows, table), header, _data_periods(path, lines[7])) + errors
    except ValueError as error:
        raise InvalidConfig(f"{path}, line 8: DATA PERIODS has a day that its year lacks: {error}") from None
    if errors or table is None:
        raise InvalidConfig(_report(path, errors))
    table.setflags(write=False)
    return Weather(
        path,
        header,
        tuple(lines[:HEADER_LINES]),
        rows,
        end,
        "".join(end + t for t in lines[last:]),
        table,
        _width(rows[0]),
    )


def _parse_rows(rows: list[str]) -> Floats | None:
    """Parse all numbers, (33, rows); None if a row has the wrong number of cells or a cell is not a finite number."""
    width = _expected_width(rows)
    if not rows or any(_width(row) != width for row in rows):
        return None
    present = [index for index in NUMBER_COLUMNS if index < width]
    try:
        table = np.loadtxt(rows, delimiter=",", comments=None, usecols=present, ndmin=2)
    except ValueError:
        return None
    if table.shape[0] != len(rows) or not np.isfinite(table).all():
        return None
    absent = [column.missing for column in COLUMNS.values() if column.index >= width]
    return np.vstack([table.T, *(np.full((1, len(rows)), missing) for missing in absent)])


def _width(row: str) -> int:
    return row.count(",") + 1


def _expected_width(rows: list[str]) -> int:
    """Return the number of cells of the first row if rows may have it, otherwise that of the format."""
    width = _width(rows[0]) if rows else WIDTH
    return width if MIN_WIDTH <= width <= WIDTH else WIDTH


def _cell_errors(rows: list[str]) -> list[str]:
    names = dict(enumerate(_TIMES)) | {column.index: name for name, column in COLUMNS.items()}
    errors, width = [], _expected_width(rows)
    for number, row in enumerate(rows, HEADER_LINES + 1):
        cells = row.split(",")
        if len(cells) != width:
            errors.append(f"line {number} has {len(cells)} cells, expected {width}")
            continue
        errors += [
            f"line {number}: {names[index]} is {cells[index].strip()!r}, expected a number"
            for index in NUMBER_COLUMNS
            if index < width and not _is_number(cells[index])
        ]
    return errors


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def _data_periods(path: Path, line: str) -> list[tuple[str, str]]:
    """Return the first and last day of each data period as text."""
    cells = [cell.strip() for cell in line.split(",")]
    try:
        return [(cells[5 + 4 * k], cells[6 + 4 * k]) for k in range(int(cells[1]))]
    except (IndexError, ValueError):
        raise InvalidConfig(f"{path}: each of the DATA PERIODS needs a name, weekday, first and last day") from None


def _days(periods: list[tuple[str, str]], *, leap: bool) -> list[tuple[int, int]]:
    """Return month and day of each day of the data periods, which may have no year."""
    days = []
    for begin, end in periods:
        first, last = (_date(text, leap=leap) for text in (begin, end))
        if last < first:  # from autumn to spring
            last = date(last.year + 1, last.month, last.day)
        span = (first + timedelta(days=k) for k in range((last - first).days + 1))
        days += [(day.month, day.day) for day in span if leap or (day.month, day.day) != (2, 29)]
    return days


def _date(text: str, *, leap: bool) -> date:
    parts = [int(part) for part in text.split("/")]
    return date(parts[2] if len(parts) > 2 else 2016 if leap else 2017, parts[0], parts[1])


def _row_days(rows: list[str], table: Floats | None) -> NDArray[np.int64] | None:
    """Return month and day of each row, (rows, 2); None if a row does not have them."""
    if table is not None:
        return np.asarray(table[1:3].T, dtype=np.int64)
    try:
        return np.array([[int(cell) for cell in row.split(",", 3)[1:3]] for row in rows], dtype=np.int64).reshape(-1, 2)
    except ValueError:
        return None


def _day_errors(row_days: NDArray[np.int64] | None, header: Header, periods: list[tuple[str, str]]) -> list[str]:
    """Compare the rows' days with those in DATA PERIODS."""
    if row_days is None:
        return []
    rows_per_day = 24 * header.records_per_hour
    expected = np.repeat(np.array(_days(periods, leap=header.leap)).reshape(-1, 2), rows_per_day, axis=0)
    lines = np.arange(len(row_days)) + HEADER_LINES + 1
    if not header.leap and len(row_days) > len(expected):  # EnergyPlus skips a 29 February that the header excludes
        kept = (row_days != (2, 29)).any(axis=1)
        row_days, lines = row_days[kept], lines[kept]
    if len(row_days) != len(expected):
        leap = ", with 29 February" if header.leap else ""
        last = f"; the last, line {lines[-1]}, is for {row_days[-1][0]}/{row_days[-1][1]}" if len(row_days) else ""
        span = f"{periods[0][0]} to {periods[-1][1]}, {header.records_per_hour} per hour{leap}"
        return [f"there are {len(row_days)} rows, DATA PERIODS requires {len(expected)} ({span}){last}"]
    mismatches = np.flatnonzero((row_days != expected).any(axis=1))
    return [
        f"line {lines[k]} is for {row_days[k][0]}/{row_days[k][1]}, expected {expected[k][0]}/{expected[k][1]}"
        for k in mismatches[:1].tolist()
    ]


def _report(path: Path, errors: list[str]) -> str:
    return list_errors(f"{path} is not a valid weather file:", errors, limit=_MAX_ERRORS)


def write(weather: Weather, path: Path, changed: Mapping[str, Floats]) -> None:
    """Write `weather` to `path` with the columns of `changed` replaced, each of shape (rows,).

    New values get four decimals. Cells whose values did not change, and everything else, stay byte for byte.

    Raises:
        UnknownName: there is no such column.
        InvalidConfig: an array has another shape, or contains NaN or infinities; the file's lines lack a column that
            is not all missing.
    """
    columns = {find_column(name).index: _validated(name, values, len(weather)) for name, values in changed.items()}
    columns = {index: values for index, values in columns.items() if weather.has(index, values)}
    rows = _replace_columns(weather, columns) if columns else weather.rows
    text = weather.end.join([*weather.head, *rows]) + weather.tail
    path.write_bytes(text.encode("latin-1"))


def _replace_columns(weather: Weather, columns: dict[int, Floats]) -> list[str]:
    """Return the rows with columns replaced. One flat list of cells: a list for each row takes three times as long."""
    splits = min(max(columns) + 1, weather.width - 1)
    width = splits + 1
    cells = list(chain.from_iterable(row.split(",", splits) for row in weather.rows))
    for index, values in columns.items():
        texts = [f"{value:.4f}" for value in values.tolist()]
        for k in np.flatnonzero(values == weather.numbers(index)).tolist():
            texts[k] = cells[k * width + index]
        cells[index::width] = texts
    return [",".join(cells[k : k + width]) for k in range(0, len(cells), width)]


def _validated(name: str, values: Floats, rows: int) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (rows,):
        raise InvalidConfig(f"weather column {name}: expected an array of shape ({rows},), got {array.shape}")
    if not np.isfinite(array).all():
        raise InvalidConfig(f"weather column {name}: row {int(np.argmin(np.isfinite(array)))} is not finite")
    return array
