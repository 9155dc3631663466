"""The header of an EPW weather file: place, covered days and design conditions."""

from __future__ import annotations

import calendar
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

from zenostat.models.scenario.run_period import Period
from zenostat.topics.calendar import format_month_day
from zenostat.topics.errors import InvalidConfig

HEADER_LINES = 8


@dataclass(frozen=True, slots=True)
class DesignConditions:
    """The annual design conditions of the header: heating 99.6 %, cooling 0.4 % (ASHRAE, since 2009).

    Attributes:
        heating_month, cooling_month: the coldest and the hottest month, 1 to 12.
        heating_dry_bulb_c: the dry bulb that 99.6 % of the hours of a year exceed.
        cooling_dry_bulb_c, cooling_wet_bulb_c: the dry bulb that 0.4 % exceed, the mean wet bulb at it.
        cooling_range_k: daily range of the dry bulb in the hottest month.
        heating_wind_m_s, heating_wind_deg, cooling_wind_m_s, cooling_wind_deg: the wind at those dry bulbs.
    """

    heating_month: int
    heating_dry_bulb_c: float
    heating_wind_m_s: float
    heating_wind_deg: float
    cooling_month: int
    cooling_range_k: float
    cooling_dry_bulb_c: float
    cooling_wet_bulb_c: float
    cooling_wind_m_s: float
    cooling_wind_deg: float

    @property
    def plausible(self) -> bool:
        """Whether all values are in plausible ranges; they are not if a header has another format."""
        return (
            {self.heating_month, self.cooling_month} <= set(range(1, 13))
            and -70 < self.heating_dry_bulb_c <= self.cooling_dry_bulb_c < 70
            and -70 < self.cooling_wet_bulb_c <= self.cooling_dry_bulb_c
            and 0 <= self.cooling_range_k < 50
            and all(0 <= speed <= 40 for speed in (self.heating_wind_m_s, self.cooling_wind_m_s))
            and all(0 <= angle <= 360 for angle in (self.heating_wind_deg, self.cooling_wind_deg))
        )


@dataclass(frozen=True, slots=True)
class Header:
    """Place and covered days of a weather file; the days have no year in a typical-year file.

    Attributes:
        first, last: first and last day as (month, day).
        leap: whether the file has 29 February ("leap year observed").
        start_weekday: the weekday of `first`, in English.
        wmo: the station's WMO number.
        design: None if there are no design conditions or they cannot be read.
    """

    place: str
    latitude_deg: float
    longitude_deg: float
    time_zone_h: float
    elevation_m: float
    first: tuple[int, int]
    last: tuple[int, int]
    leap: bool = False
    records_per_hour: int = 1
    start_weekday: str = ""
    wmo: str = ""
    design: DesignConditions | None = None

    @property
    def whole_year(self) -> bool:
        """Whether the file covers 1 January to 31 December."""
        return (self.first, self.last) == ((1, 1), (12, 31))


def read_header(path: Path) -> Header:
    """Read the header of `path`.

    Raises:
        InvalidConfig: the file does not begin like an EPW file, or has no DATA PERIODS line.
    """
    with path.open(encoding="latin-1") as file:
        return parse_header(path, [file.readline() for _ in range(HEADER_LINES)])


def parse_header(path: Path, lines: Sequence[str]) -> Header:
    """Parse the first lines of `path`; raises as `read_header` does."""
    cells = [[cell.strip() for cell in line.split(",")] for line in lines]
    if len(cells) < HEADER_LINES or cells[0][0].upper() != "LOCATION" or cells[7][0].upper() != "DATA PERIODS":
        raise InvalidConfig(f"{path} is not an EPW file: it should begin with LOCATION and have DATA PERIODS in line 8")
    location, periods = cells[0], cells[7]
    try:
        return Header(
            place=", ".join(part for part in location[1:4] if part.strip("-")),
            latitude_deg=float(location[6]),
            longitude_deg=float(location[7]),
            time_zone_h=float(location[8]),
            elevation_m=float(location[9]),
            first=_month_day(periods[5]),
            last=_month_day(periods[6]),
            leap=cells[4][1].casefold() == "yes",
            records_per_hour=int(periods[2]),
            start_weekday=periods[4],
            wmo=location[5],
            design=_design(cells[1]),
        )
    except (IndexError, ValueError) as error:
        raise InvalidConfig(f"{path}: the header cannot be read: {error}") from None


def _month_day(text: str) -> tuple[int, int]:
    parts = text.split("/")
    return int(parts[0]), int(parts[1])


def _design(cells: list[str]) -> DesignConditions | None:
    titles = [cell.casefold() for cell in cells]
    try:
        heating = cells[titles.index("heating") + 1 :]
        cooling = cells[titles.index("cooling") + 1 :]
        conditions = DesignConditions(
            heating_month=int(heating[0]),
            heating_dry_bulb_c=float(heating[1]),
            heating_wind_m_s=float(heating[13]),
            heating_wind_deg=float(heating[14]),
            cooling_month=int(cooling[0]),
            cooling_range_k=float(cooling[1]),
            cooling_dry_bulb_c=float(cooling[2]),
            cooling_wet_bulb_c=float(cooling[3]),
            cooling_wind_m_s=float(cooling[14]),
            cooling_wind_deg=float(cooling[15]),
        )
    except (IndexError, ValueError):
        return None
    return conditions if conditions.plausible else None


def check_complete(header: Header, path: Path) -> None:
    """Check that a weather file has a complete line for each interval that its header announces.

    Raises:
        InvalidConfig: lines are missing, or the last one is cut off; EnergyPlus would end in the middle of an episode.
    """
    lines = [line for line in path.read_bytes().splitlines()[HEADER_LINES:] if line.strip()]
    days = (date(2001 + 3 * header.leap, *header.last) - date(2001 + 3 * header.leap, *header.first)).days
    expected = (days % (365 + header.leap) + 1) * 24 * header.records_per_hour
    if len(lines) < expected:
        raise InvalidConfig(
            f"{path} is incomplete: it has {len(lines):,} records, but {_span(header)} has {expected:,}; get the whole "
            "file again"
        )
    if lines[expected - 1].count(b",") < lines[0].count(b","):
        raise InvalidConfig(f"{path} is incomplete: its last record is cut off; get the whole file again")


def check_covers(header: Header, period: Period, name: str) -> None:
    """Check that the weather file has data for every day of a run period.

    When a run period continues past 31 December, EnergyPlus reads the file again from its beginning, and the number of
    timesteps is correct. If a run period contains a 29 February that the file lacks, EnergyPlus 25.2 skips that day
    silently: the episode is a day too short or, if it should end on that day, ends on 1 March, and the weekdays after
    it are off by one. A run period that begins on that day is a fatal error. All of these are rejected here. (A 29
    February that is in the file but not in the run period is skipped, as it should be.)

    Raises:
        InvalidConfig: the file has no data for some days.
    """
    if period.begin.year != period.end.year and not header.whole_year:
        raise InvalidConfig(
            f"the run period crosses a year boundary ({period.begin} to {period.end}), which requires a weather file "
            f"of a whole year; {name} covers {_span(header)}"
        )
    for day, verb in ((period.begin, "begins"), (period.end, "ends")):
        if not header.first <= (day.month, day.day) <= header.last:
            raise InvalidConfig(
                f"the run period {verb} on {day:%m-%d}, outside the weather file {name}, which covers {_span(header)}"
            )
    for leap_day in _leap_days(period):
        if not header.leap:
            raise InvalidConfig(
                f"the run period {period.begin} to {period.end} contains {leap_day}, but the weather file {name} has "
                f"no 29 February: use another year ({leap_day.year + 1} has no 29 February either), "
                f"end by {leap_day - timedelta(days=1)}, or begin on {leap_day + timedelta(days=1)} or later"
            )


def _span(header: Header) -> str:
    return f"{format_month_day(*header.first)} to {format_month_day(*header.last)}"


def _leap_days(period: Period) -> Iterator[date]:
    for year in range(period.begin.year, period.end.year + 1):
        if calendar.isleap(year) and period.begin <= (day := date(year, 2, 29)) <= period.end:
            yield day
