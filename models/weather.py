"""What an EPW file says of itself in its header (EnergyPlus Auxiliary Programs, EPW data dictionary)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from models.period import Period
from topics.errors import InvalidConfig


@dataclass(frozen=True, slots=True)
class Header:
    """Place and covered days of a weather file; the days have no year in a typical-year file."""

    place: str
    latitude_deg: float
    longitude_deg: float
    time_zone_h: float
    elevation_m: float
    first: tuple[int, int]
    last: tuple[int, int]


def read_header(path: Path) -> Header:
    """The header of `path`.

    Raises:
        InvalidConfig: the file does not begin as an EPW does, or has no DATA PERIODS line.
    """
    with path.open(encoding="latin-1") as file:
        lines = [file.readline().rstrip("\r\n").split(",") for _ in range(8)]
    location, periods = lines[0], lines[7]
    if location[0].strip().upper() != "LOCATION" or periods[0].strip().upper() != "DATA PERIODS":
        raise InvalidConfig(f"{path} is no EPW file: it should begin with LOCATION and have DATA PERIODS in line 8")
    try:
        return Header(
            place=", ".join(part.strip() for part in location[1:4] if part.strip(" -")),
            latitude_deg=float(location[6]),
            longitude_deg=float(location[7]),
            time_zone_h=float(location[8]),
            elevation_m=float(location[9]),
            first=_month_day(periods[5]),
            last=_month_day(periods[6]),
        )
    except (IndexError, ValueError) as error:
        raise InvalidConfig(f"{path}: the header cannot be read: {error}") from None


def _month_day(text: str) -> tuple[int, int]:
    parts = text.strip().split("/")
    return int(parts[0]), int(parts[1])


def check_covers(header: Header, period: Period, name: str) -> None:
    """Refuses a run period of which the weather file has no data."""
    first, last = header.first, header.last
    for day, what in ((period.begin, "begins"), (period.end, "ends")):
        if not first <= (day.month, day.day) <= last:
            raise InvalidConfig(
                f"the run period {what} on {day:%m-%d}, outside the weather file {name}, "
                f"which has {first[0]:02}-{first[1]:02} to {last[0]:02}-{last[1]:02}"
            )
    if period.begin.year != period.end.year:
        raise InvalidConfig(f"the run period crosses a year ({period.begin} to {period.end}); the weather file has one")
