"""Check the records of a weather file before EnergyPlus reads them: hours and values that are missing, texts."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.models.weather.design_days import standard_pressure
from zenostat.models.weather.epw import COLUMNS, Weather
from zenostat.models.weather.header import HEADER_LINES, Header, has_record, read_header
from zenostat.models.weather.psychrometrics import sky_infrared
from zenostat.topics.arrays import Floats
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.errors import InvalidConfig

_FORMAT = "5"
_MAY_BE_BLANK = COLUMNS["precipitable_water"].index
"""Index of the first cell that EnergyPlus takes for a missing value if it is blank."""
_NOT_READ = COLUMNS["liquid_precipitation_quantity"].index
_INITIAL = {
    "dry_bulb_temperature": 6.0,
    "dew_point_temperature": 3.0,
    "relative_humidity": 50.0,
    "wind_direction": 180.0,
    "wind_speed": 2.5,
    "total_sky_cover": 5.0,
    "opaque_sky_cover": 5.0,
}
_KEPT = (*_INITIAL, "atmospheric_station_pressure")
"""Columns in which EnergyPlus replaces a missing value by the last one before it in the run."""
_SUN = ("direct_normal_radiation", "diffuse_horizontal_radiation")
"""Columns in which EnergyPlus replaces a missing value by 0."""
_INFRARED = "horizontal_infrared_radiation_intensity"
"""Column in which EnergyPlus replaces a missing value, or 0, by the radiation of the sky that it computes."""
_COUNTED = tuple(name for name in COLUMNS if name in {*_KEPT, *_SUN, _INFRARED} and not name.endswith("sky_cover"))
"""Columns whose missing values a warning counts; sky cover has no effect where there is infrared radiation."""


def simulated_values(weather: Weather, name: str, rows: Sequence[int]) -> Floats:
    """Return a column's values in some rows, in the order in which they are simulated, as EnergyPlus takes them.

    What EnergyPlus 25.2 takes for a missing value was determined by experiment. Infrared radiation is that of its
    default model of the sky.

    Returns:
        values, shape (rows,); a missing one is NaN in a column that EnergyPlus does not use. Global radiation is 0
        where direct and diffuse radiation are missing as well.
    """
    values = weather.column(name)[rows]
    is_missing = values >= COLUMNS[name].missing
    if name == _INFRARED:
        inputs = ("dry_bulb_temperature", "dew_point_temperature", "opaque_sky_cover")
        computed = sky_infrared(*(simulated_values(weather, each, rows) for each in inputs))
        return np.where(is_missing | (values <= 0.0), computed, values)
    if name in _KEPT:
        initial = _initial_value(name, weather.header)
        kept = np.floor(values + 0.5) if name == "relative_humidity" else values  # a whole number of percent
        last = np.maximum.accumulate(np.where(is_missing, 0, np.arange(1, len(values) + 1)))
        return np.where(is_missing, np.r_[initial, kept][last], values)
    is_dark = np.full(len(values), name in _SUN)
    if name == "global_horizontal_radiation":
        is_dark = np.logical_and.reduce([weather.column(each)[rows] >= COLUMNS[each].missing for each in _SUN])
    return np.where(is_missing, np.where(is_dark, 0.0, np.nan), values)


def _initial_value(column: str, header: Header) -> float:
    """Return what EnergyPlus takes in one of the columns `_KEPT` until a run comes to a value."""
    return _INITIAL[column] if column in _INITIAL else standard_pressure(header.elevation_m)


def check_records(header: Header, path: Path) -> None:
    """Check that the hours of a weather file follow each other, and that all values are numbers.

    EnergyPlus starts with a file in which an hour is missing or a value is a text, and ends when it reads that hour.

    Raises:
        InvalidConfig: an hour is missing, repeated, or out of order, or a value is no number; the text has the line.
    """
    error = _inspect(header, path)["error"]
    if error:
        raise InvalidConfig(f"{path}, {error}")


def missing_values(path: Path, name: str) -> Iterator[str]:
    """Yield a sentence on the values that a weather file lacks; `name`: of the file, as users know it."""
    header = read_header(path)
    missing = _inspect(header, path)["missing"]
    if missing:
        columns = ", ".join(f"{column} ({count:,})" for column, count in missing.items())
        initial = [f"{_initial_value(name, header):g} {COLUMNS[name].unit}" for name in missing if name in _KEPT]
        uses = []
        if initial:
            uses.append(f"the last one before each, and at the beginning of a run {', '.join(initial)}")
        if not missing.keys().isdisjoint(_SUN):
            uses.append("no sun (0 W/m2) where direct or diffuse radiation is missing")
        if _INFRARED in missing:
            uses.append("infrared radiation that it computes from temperature, dew point and opaque sky cover")
        yield f"{name} has missing values: {columns}; EnergyPlus uses {'; '.join(uses)}"


def _inspect(header: Header, path: Path) -> dict[str, Any]:
    raw = path.read_bytes()

    def make(target: Path) -> None:
        lines = [line for line in raw.splitlines()[HEADER_LINES:] if has_record(line)]
        rows = [line.decode("latin-1").split(",") for line in lines]
        missing = Counter[str]()
        for name in _COUNTED:
            column = COLUMNS[name]
            numbers = [_number(row, column.index) for row in rows]
            missing[name] = sum(x >= column.missing or (name == _INFRARED and x <= 0.0) for x in numbers)
        order = (f"{error}; get the whole file again" for error in _order_errors(rows, 24 * header.records_per_hour))
        error = next(chain(order, _cell_errors(rows)), "")
        target.write_text(json.dumps({"error": error, "missing": {n: c for n, c in missing.items() if c}}))

    return dict(json.loads(cached_bytes(f"weather-records/{digest(raw, _FORMAT)}.json", make)))


def _number(row: Sequence[str], index: int) -> float:
    try:
        return float(row[index])
    except (IndexError, ValueError):
        return 0.0  # `_cell_errors` reports it


def _cell_errors(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield an error for each cell that EnergyPlus does not read as a number."""
    for number, row in enumerate(rows, HEADER_LINES + 1):
        for index, text in enumerate(row[:_NOT_READ]):
            if index in _NAMES and not (_is_number(text) or (index >= _MAY_BE_BLANK and not text.strip())):
                yield f"line {number}: {_NAMES[index]} is {text.strip()[:40]!r}, expected a number"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


_NAMES = {column.index: name for name, column in COLUMNS.items()}


def _order_errors(rows: Sequence[Sequence[str]], rows_per_day: int) -> Iterator[str]:
    """Yield an error for each record that does not follow the one before."""
    times = []
    for number, row in enumerate(rows, HEADER_LINES + 1):
        try:
            times.append((int(row[1]), int(row[2]), int(row[3])))
        except (IndexError, ValueError):
            yield f"line {number}: expected year, month, day and hour, got {','.join(row[:4])[:40]!r}"
            return
    first = max(times[0][2], 1) if times else 1  # EnergyPlus ends at an hour 0
    for index, (month, day, hour) in enumerate(times):
        expected = first + index % rows_per_day * 24 // rows_per_day
        if hour != expected:
            shown = f"{month:02}-{day:02}, hour {hour}"
            yield f"line {index + HEADER_LINES + 1}: the record is for {shown}, expected hour {expected} of a day"
            return
    for index, (before, after) in enumerate(pairwise(times), HEADER_LINES + 2):
        if before[:2] != after[:2] and (index - HEADER_LINES - 1) % rows_per_day:
            yield f"line {index}: the record is for {after[0]:02}-{after[1]:02}, expected {before[0]:02}-{before[1]:02}"
