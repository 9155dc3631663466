"""What a weather file is, for listing: from its header and three columns."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.weather.epw import Floats, read_header
from topics.errors import InvalidConfig

_YEAR_DAYS = 365
_TEMPERATURE_MISSING, _HUMIDITY_MISSING = 99.9, 999.0
_STAT_ZONE = re.compile(r'Climate (?:type|zone) "(\d[ABC]?)" \(ASHRAE', re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class WeatherSummary:
    """A weather file in numbers and words.

    `climate_zone`: of ASHRAE Standard 169, empty where the file has less than a year. `years`: those that
    the file's data are of, or "typical year" where its months are of different ones. Days are (month, day).
    """

    place: str
    latitude_deg: float
    longitude_deg: float
    elevation_m: float
    climate_zone: str
    mean_temperature_degC: float  # noqa: N815 (the unit's name)
    mean_humidity_pct: float
    years: str
    first: tuple[int, int]
    last: tuple[int, int]


def weather_summary(path: Path) -> WeatherSummary:
    """The facts of an EPW file: its header and the columns of dry bulb and relative humidity; 15 ms.

    The climate zone is that of a `.stat` file beside the EPW, with its moisture letter, if there is one.

    Raises:
        InvalidConfig: no EPW file, or its rows are no whole days of numbers.
    """
    header = read_header(path)
    year, temperature, humidity = _columns(path, 24 * header.records_per_hour)
    return WeatherSummary(
        place=header.place,
        latitude_deg=header.latitude_deg,
        longitude_deg=header.longitude_deg,
        elevation_m=header.elevation_m,
        climate_zone=_stat_zone(path) or climate_zone(temperature),
        mean_temperature_degC=float(np.nanmean(temperature)),
        mean_humidity_pct=float(np.nanmean(humidity)),
        years=_years(year[:, 0]),
        first=header.first,
        last=header.last,
    )


def _columns(path: Path, rows_a_day: int) -> tuple[Floats, Floats, Floats]:
    """Year, dry bulb (degC) and relative humidity (%), a row a day; NaN where a value is missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is told below
            table = np.loadtxt(
                path, delimiter=",", skiprows=8, usecols=(0, 6, 8), comments=None, encoding="latin-1", ndmin=2
            )
    except ValueError as error:
        raise InvalidConfig(f"{path}: its rows cannot be read: {error}") from None
    if not len(table) or len(table) % rows_a_day:
        raise InvalidConfig(f"{path} has {len(table)} rows, which are no whole days of {rows_a_day} rows")
    table[table[:, 1] >= _TEMPERATURE_MISSING, 1] = np.nan
    table[table[:, 2] >= _HUMIDITY_MISSING, 2] = np.nan
    year, temperature, humidity = table.T.reshape(3, -1, rows_a_day)
    if np.isnan(temperature).all() or np.isnan(humidity).all():
        raise InvalidConfig(f"{path} has no dry-bulb temperature or no relative humidity: all values are missing")
    return year, temperature, humidity


def climate_zone(temperature: Floats) -> str:
    """Thermal zone, `0` to `8`, of dry-bulb temperatures (degC), a row a day; empty for less than a year.

    Limits on a year's cooling degree days to 10 degC and heating degree days to 18.3 degC, of daily means:
    ANSI/ASHRAE Standard 169-2013, Climatic Data for Building Design Standards, Normative Appendix A,
    definitions of the thermal climate zones. The Standard assigns US counties by long-term data; the degree
    days of a single file near a limit can give the next zone.
    """
    if len(temperature) < _YEAR_DAYS:
        return ""
    mean = temperature.mean(axis=1)  # a day with a missing value is left out
    cooling = float(np.nanmean(np.maximum(mean - 10.0, 0.0))) * _YEAR_DAYS
    heating = float(np.nanmean(np.maximum(18.3 - mean, 0.0))) * _YEAR_DAYS
    for zone, least in (("0", 6000.0), ("1", 5000.0), ("2", 3500.0)):
        if cooling > least:
            return zone
    return str(3 + sum(heating > limit for limit in (2000.0, 3000.0, 4000.0, 5000.0, 7000.0)))


def _stat_zone(path: Path) -> str:
    """The zone that a `.stat` file beside the EPW names, as `5B`; empty if there is none."""
    beside = path.with_suffix(".stat")
    found = _STAT_ZONE.search(beside.read_text(encoding="latin-1")) if beside.is_file() else None
    return found[1].upper() if found else ""


def _years(years: Floats) -> str:
    """`2019`, `2018-2020`, or `typical year` where the days' years do not follow each other."""
    first, last = int(years[0]), int(years[-1])
    if np.any(np.diff(years) < 0) or np.any(np.diff(years) > 1):
        return "typical year"
    return str(first) if first == last else f"{first}-{last}"
