"""The header of an EPW weather file: place, covered days and design conditions."""

from __future__ import annotations

import calendar
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

from zenostat.models.run_period import Period
from zenostat.topics.calendar import format_month_day, is_month_day
from zenostat.topics.errors import InvalidConfig

HEADER_LINES = 8

MonthDay = tuple[int, int]

_PLACE_LIMITS = (
    ("latitude", -90.0, 90.0),
    ("longitude", -180.0, 180.0),
    ("time zone", -12.0, 14.0),
    ("elevation", -1000.0, 9999.9),
)
"""Limits of the EPW data dictionary, and EnergyPlus's for time zones."""


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
        first, last: first and last day of the data period, of the first of several, as (month, day).
        more: first and last days of the other data periods.
        leap: whether the file has 29 February ("leap year observed").
        design: None if there are no design conditions or they cannot be read.
    """

    place: str
    latitude_deg: float
    longitude_deg: float
    time_zone_h: float
    elevation_m: float
    first: MonthDay
    last: MonthDay
    more: tuple[tuple[MonthDay, MonthDay], ...] = ()
    leap: bool = False
    records_per_hour: int = 1
    design: DesignConditions | None = None

    @property
    def periods(self) -> tuple[tuple[MonthDay, MonthDay], ...]:
        """First and last day of each data period."""
        return ((self.first, self.last), *self.more)


def read_header(path: Path) -> Header:
    """Read the header of `path`.

    Raises:
        InvalidConfig: the file does not begin like an EPW file, has no DATA PERIODS line, or a number that cannot be.
    """
    with path.open("rb") as file:
        return parse_header(path, [file.readline() for _ in range(HEADER_LINES)])


def parse_header(path: Path, lines: Sequence[bytes]) -> Header:
    """Parse the first lines of `path`; raises as `read_header` does."""
    cells = [[cell.strip() for cell in _decode(line).split(",")] for line in lines]
    if len(cells) < HEADER_LINES or cells[0][0].upper() != "LOCATION" or cells[7][0].upper() != "DATA PERIODS":
        raise InvalidConfig(f"{path} is not an EPW file: it should begin with LOCATION and have DATA PERIODS in line 8")
    location, data = cells[0], cells[7]
    try:
        latitude, longitude, time_zone, elevation = map(float, location[6:10])
        periods = [(_month_day(data[5 + 4 * k]), _month_day(data[6 + 4 * k])) for k in range(int(data[1]))]
        header = Header(
            place=", ".join(part for part in location[1:4] if part.strip("-")),
            latitude_deg=latitude,
            longitude_deg=longitude,
            time_zone_h=time_zone,
            elevation_m=elevation,
            first=periods[0][0],
            last=periods[0][1],
            more=tuple(periods[1:]),
            leap=cells[4][1].casefold() == "yes",
            records_per_hour=int(data[2]),
            design=_design(cells[1]),
        )
    except (IndexError, ValueError) as error:
        raise InvalidConfig(f"{path}: the header cannot be read: {error}") from None
    if reason := next(_header_errors(header), ""):
        raise InvalidConfig(f"{path}, {reason}")
    return header


def _decode(line: bytes) -> str:
    """Return the text of a line in UTF-8, or else in Latin-1."""
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def _header_errors(header: Header) -> Iterator[str]:
    """Yield an error, with its line, for each number of the header that cannot be."""
    place = (header.latitude_deg, header.longitude_deg, header.time_zone_h, header.elevation_m)
    for (name, low, high), value in zip(_PLACE_LIMITS, place, strict=True):
        if not low <= value <= high:
            yield f"line 1: LOCATION has {name} {value:g}, expected {low:g} to {high:g}"
    if not 1 <= header.records_per_hour <= 60 or 60 % header.records_per_hour:
        yield f"line 8: DATA PERIODS has {header.records_per_hour} records per hour, which does not divide the hour"
    for day in (day for period in header.periods for day in period):
        if not is_month_day(*day):
            yield f"line 8: DATA PERIODS has {day[0]}/{day[1]}, which is no day"


def _month_day(text: str) -> MonthDay:
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


def has_record(line: bytes) -> bool:
    """Return whether a line has more than blanks and Ctrl-Z, at which DOS ends a file and which EnergyPlus skips."""
    return bool(line.replace(b"\x1a", b"").strip())


def check_complete(header: Header, path: Path) -> None:
    """Check that a weather file has a complete line for each interval that its header announces.

    Raises:
        InvalidConfig: lines are missing, or the last one is cut off; EnergyPlus would end in the middle of an episode.
    """
    lines = [line for line in path.read_bytes().splitlines()[HEADER_LINES:] if has_record(line)]
    year, length = 2001 + 3 * header.leap, 365 + header.leap
    days = sum((_day(year, last) - _day(year, first)).days % length + 1 for first, last in header.periods)
    expected = days * 24 * header.records_per_hour
    if len(lines) < expected:
        raise InvalidConfig(
            f"{path} is incomplete: it has {len(lines):,} records, but {_span(header)} has {expected:,}; get the whole "
            "file again"
        )
    if lines[expected - 1].count(b",") < lines[0].count(b","):
        raise InvalidConfig(f"{path} is incomplete: its last record is cut off; get the whole file again")


def check_covers(header: Header, period: Period, name: str) -> None:
    """Check that the weather file has data for every day of a run period.

    EnergyPlus takes no account of the years: it begins with the first record of that month and day, and goes on from
    there. The run period must be within one of the file's data periods. When it continues past the end of a file of
    whole years, EnergyPlus reads the file again from its beginning, and the number of timesteps is correct. If a run
    period contains a 29 February that the file lacks, EnergyPlus 25.2 skips that day silently: the episode is a day too
    short or, if it should end on that day, ends on 1 March, and the weekdays after it are off by one. A run period that
    begins on that day is a fatal error. All of these are rejected here. (A 29 February that is in the file but not in
    the run period is skipped, as it should be.) A run period that begins in a leap year from 28 February on and goes
    over New Year has a day less as well, unless its years count.

    Raises:
        InvalidConfig: the file has no data for some days, or its records are not those of the timesteps.
    """
    if header.records_per_hour not in (1, period.steps_per_hour):
        raise InvalidConfig(
            f"the weather file {name} has {header.records_per_hour} records per hour, which EnergyPlus reads only with "
            f"as many timesteps: set steps_per_hour to {header.records_per_hour}, not {period.steps_per_hour}"
        )
    if not any(_covers(data, period.begin, period.end) for data in header.periods):
        if period.begin.year != period.end.year:
            raise InvalidConfig(
                f"the run period crosses a year boundary ({period.begin} to {period.end}), which requires a weather "
                f"file of a whole year; {name} covers {_span(header)}"
            )
        for day, verb in ((period.begin, "begins"), (period.end, "ends")):
            if not any(_covers(data, day, day) for data in header.periods):
                covered = f"outside the weather file {name}, which covers {_span(header)}"
                raise InvalidConfig(f"the run period {verb} on {day:%m-%d}, {covered}")
        raise InvalidConfig(
            f"the run period {period.begin} to {period.end} is not within one of the data periods of the weather file "
            f"{name}: {_span(header)}"
        )
    for leap_day in _leap_days(period.begin, period.end):
        if not header.leap:
            raise InvalidConfig(
                f"the run period {period.begin} to {period.end} contains {leap_day}, but the weather file {name} has "
                f"no 29 February: use another year ({leap_day.year + 1} has no 29 February either), "
                f"end by {leap_day - timedelta(days=1)}, or begin on {leap_day + timedelta(days=1)} or later"
            )
    year = period.begin.year
    if year < period.end.year and not period.by_year and calendar.isleap(year) and period.begin >= date(year, 2, 28):
        raise InvalidConfig(
            f"the run period {period.begin} to {period.end} goes over New Year from a leap year in which it begins "
            f"after 27 February; EnergyPlus leaves out its last day: begin in a common year such as {year + 1} or "
            f"{year + 2}, or end by {year}-12-31"
        )


def _covers(data: tuple[MonthDay, MonthDay], begin: date, end: date) -> bool:
    """Return whether all days but 29 February are in a data period, which may go over New Year."""
    first, last = (_ordinal(*day) for day in data)
    days = (last - first) % 365 + 1
    offset = (_ordinal(begin.month, begin.day) - first) % 365
    length = (end - begin).days + 1 - sum(1 for _ in _leap_days(begin, end))
    return days == 365 or offset + length <= days


def _ordinal(month: int, day: int) -> int:
    """Return the number of a day in a common year; 29 February has that of the day before."""
    return date(2000, month, day).timetuple().tm_yday - ((month, day) > (2, 28))


def _day(year: int, day: MonthDay) -> date:
    """Return a day of a year; 28 February for a 29 February that the year lacks."""
    return date(year, *day) if day != (2, 29) or calendar.isleap(year) else date(year, 2, 28)


def _span(header: Header) -> str:
    return ", ".join(f"{format_month_day(*first)} to {format_month_day(*last)}" for first, last in header.periods)


def _leap_days(begin: date, end: date) -> Iterator[date]:
    for year in range(begin.year, end.year + 1):
        if calendar.isleap(year) and begin <= (day := date(year, 2, 29)) <= end:
            yield day
