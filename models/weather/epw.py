"""Weather files: header, rows and columns of an EPW, and the same file with some columns replaced.

The form is the EPW data dictionary of EnergyPlus's Auxiliary Programs: 8 header lines, then 35 cells a line.
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

from models.weather.header import HEADER_LINES, Header, parse_header
from topics.errors import InvalidConfig, UnknownName, did_you_mean

Floats = NDArray[np.float64]

WIDTH = 35
_TEXT = (5, 27)  # the source flags, and the weather codes: nine digits side by side that are no number
_NUMBERS = [index for index in range(WIDTH) if index not in _TEXT]
_TIMES = ("year", "month", "day", "hour", "minute")
_MOST = 5


@dataclass(frozen=True, slots=True)
class Column:
    """A column of numbers of an EPW.

    Attributes:
        index: its place in a line, from 0.
        low, high: the dictionary's limits, both allowed; a limit that is excluded there is moved in by 0.1.
        missing: values from here on stand for none.
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
"""The data columns by name; the flags and the weather codes are text and not among them."""

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
    """The column that `text` names: `Dry Bulb Temperature`, `dry_bulb_temperature` and `dry-bulb` are one.

    Raises:
        UnknownName: no such column; the text lists near names.
    """
    folded = re.sub(r"[^0-9a-z]+", "_", text.casefold()).strip("_")
    found = COLUMNS.get(_ALIASES.get(folded, folded))
    if found is None:
        raise UnknownName(f"no weather column {text!r}; {did_you_mean(folded, COLUMNS)}")
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Weather:
    """A weather file that was read and checked.

    Attributes:
        head: the header lines verbatim, without line ends.
        rows: the data lines verbatim, without line ends.
        end: the line end, and `tail` what follows the last row's cells.
        table: numbers of all columns but the text ones, float64 (33, rows), read-only.
    """

    path: Path
    header: Header
    head: tuple[str, ...]
    rows: list[str]
    end: str
    tail: str
    table: Floats

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> Floats:
        """The values of a column as the file has them, float64 (rows,), read-only; `UnknownName` if there is none."""
        return self.numbers(find_column(name).index)

    @property
    def times(self) -> NDArray[np.int64]:
        """Year, month, day, hour (1 to 24), minute of each row as the file says, int64 (rows, 5)."""
        return np.asarray(self.table[: len(_TIMES)].T, dtype=np.int64)

    @property
    def record_h(self) -> float:
        """Hours from a row to the next."""
        return 1.0 / self.header.records_per_hour

    def numbers(self, index: int) -> Floats:
        """The values of the column in that place of a line."""
        values: Floats = self.table[_NUMBERS.index(index)]
        return values


def read(path: Path) -> Weather:
    """The weather file `path`, checked from end to end.

    Raises:
        InvalidConfig: no EPW; or rows that are too few or too many for DATA PERIODS, out of order, or have cells
            that are missing or no numbers. The text names the lines, what is there and what is expected.
    """
    text = path.read_bytes().decode("latin-1")
    end = "\r\n" if "\r\n" in text else "\n"
    lines = text.split(end)
    header = parse_header(path, lines[:HEADER_LINES])
    last = len(lines)
    while last > HEADER_LINES and not lines[last - 1].strip():
        last -= 1
    rows = lines[HEADER_LINES:last]
    table = _parsed(rows)
    faults = [] if table is not None else _faults_of_cells(rows)
    faults = _faults_of_days(_seen(rows, table), header, _spans(path, lines[7])) + faults
    if faults or table is None:
        raise InvalidConfig(_report(path, faults))
    table.setflags(write=False)
    return Weather(path, header, tuple(lines[:HEADER_LINES]), rows, end, "".join(end + t for t in lines[last:]), table)


def _parsed(rows: list[str]) -> Floats | None:
    """All numbers, (33, rows); None if a row has another number of cells or a cell is no finite number."""
    if not rows or any(row.count(",") != WIDTH - 1 for row in rows):
        return None
    try:
        table = np.loadtxt(rows, delimiter=",", comments=None, usecols=_NUMBERS, ndmin=2)
    except ValueError:
        return None
    if table.shape[0] != len(rows) or not np.isfinite(table).all():
        return None
    return np.ascontiguousarray(table.T)


def _faults_of_cells(rows: list[str]) -> list[str]:
    names = dict(enumerate(_TIMES)) | {column.index: name for name, column in COLUMNS.items()}
    faults = []
    for number, row in enumerate(rows, HEADER_LINES + 1):
        cells = row.split(",")
        if len(cells) != WIDTH:
            faults.append(f"line {number} has {len(cells)} cells, {WIDTH} are expected")
            continue
        faults += [
            f"line {number}: {names[index]} is {cells[index].strip()!r}, a number is expected"
            for index in _NUMBERS
            if not _is_number(cells[index])
        ]
    return faults


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def _spans(path: Path, line: str) -> list[tuple[str, str]]:
    """First and last day of each data period as text."""
    cells = [cell.strip() for cell in line.split(",")]
    try:
        return [(cells[5 + 4 * k], cells[6 + 4 * k]) for k in range(int(cells[1]))]
    except (IndexError, ValueError):
        raise InvalidConfig(f"{path}: DATA PERIODS should have a name, weekday, first and last day each") from None


def _days(spans: list[tuple[str, str]], *, leap: bool) -> list[tuple[int, int]]:
    """Month and day of each day of the data periods; without years they are those of any year."""
    days = []
    for begin, end in spans:
        first, last = (_date(text, leap=leap) for text in (begin, end))
        if last < first:  # from autumn to spring
            last = date(last.year + 1, last.month, last.day)
        span = (first + timedelta(days=k) for k in range((last - first).days + 1))
        days += [(day.month, day.day) for day in span if leap or (day.month, day.day) != (2, 29)]
    return days


def _date(text: str, *, leap: bool) -> date:
    parts = [int(part) for part in text.split("/")]
    return date(parts[2] if len(parts) > 2 else 2016 if leap else 2017, parts[0], parts[1])


def _seen(rows: list[str], table: Floats | None) -> NDArray[np.int64] | None:
    """Month and day of each row, (rows, 2); None where a row does not say them."""
    if table is not None:
        return np.asarray(table[1:3].T, dtype=np.int64)
    try:
        return np.array([[int(cell) for cell in row.split(",", 3)[1:3]] for row in rows], dtype=np.int64).reshape(-1, 2)
    except ValueError:
        return None


def _faults_of_days(seen: NDArray[np.int64] | None, header: Header, spans: list[tuple[str, str]]) -> list[str]:
    """Whether the rows are those of the days that DATA PERIODS names."""
    if seen is None:
        return []
    a_day = 24 * header.records_per_hour
    due = np.repeat(np.array(_days(spans, leap=header.leap)).reshape(-1, 2), a_day, axis=0)
    lines = np.arange(len(seen)) + HEADER_LINES + 1
    if not header.leap and len(seen) > len(due):  # EnergyPlus skips a 29 February that the header denies
        other = (seen != (2, 29)).any(axis=1)
        seen, lines = seen[other], lines[other]
    if len(seen) != len(due):
        leap = ", with 29 February" if header.leap else ""
        at = f"; the last, line {lines[-1]}, is of {seen[-1][0]}/{seen[-1][1]}" if len(seen) else ""
        return [
            f"there are {len(seen)} rows, DATA PERIODS claims {len(due)} ({spans[0][0]} to {spans[-1][1]}, "
            f"{header.records_per_hour} an hour{leap}){at}"
        ]
    wrong = np.flatnonzero((seen != due).any(axis=1))
    return [
        f"line {lines[k]} is of {seen[k][0]}/{seen[k][1]}, {due[k][0]}/{due[k][1]} is expected"
        for k in wrong[:1].tolist()
    ]


def _report(path: Path, faults: list[str]) -> str:
    more = [f"and {len(faults) - _MOST} more"] if len(faults) > _MOST else []
    return "\n  ".join([f"{path} is no sound weather file:", *faults[:_MOST], *more])


def write(weather: Weather, path: Path, changed: Mapping[str, Floats]) -> None:
    """Writes `weather` to `path` with the columns of `changed` replaced, each of shape (rows,).

    New values get four decimals. A cell whose value is as before, and all else, stays byte for byte.

    Raises:
        UnknownName: no such column.
        InvalidConfig: an array of another shape, or with NaN or infinities.
    """
    columns = {find_column(name).index: _checked(name, values, len(weather)) for name, values in changed.items()}
    rows = _replaced(weather, columns) if columns else weather.rows
    text = weather.end.join([*weather.head, *rows]) + weather.tail
    path.write_bytes(text.encode("latin-1"))


def _replaced(weather: Weather, columns: dict[int, Floats]) -> list[str]:
    """The rows with other cells. One flat list of cells: a list for each row costs three times as much."""
    splits = min(max(columns) + 1, WIDTH - 1)
    width = splits + 1
    cells = list(chain.from_iterable(row.split(",", splits) for row in weather.rows))
    for index, values in columns.items():
        texts = [f"{value:.4f}" for value in values.tolist()]
        for k in np.flatnonzero(values == weather.numbers(index)).tolist():
            texts[k] = cells[k * width + index]
        cells[index::width] = texts
    return [",".join(cells[k : k + width]) for k in range(0, len(cells), width)]


def _checked(name: str, values: Floats, rows: int) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (rows,):
        raise InvalidConfig(f"weather column {name}: an array of shape ({rows},) is expected, got {array.shape}")
    if not np.isfinite(array).all():
        raise InvalidConfig(f"weather column {name}: row {int(np.argmin(np.isfinite(array)))} is not finite")
    return array
