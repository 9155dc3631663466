"""Timestamps of measured rows: local standard time, in order, and the interval that each row stands for."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from zenostat.lab.calibration.config import Calibration
from zenostat.topics.errors import InvalidConfig

HOUR = timedelta(hours=1)
DAY = timedelta(days=1)
BILL = timedelta(days=27)
"""Rows of this length are those of bills, which are compared by the monthly criteria."""
_INTERVALS = {"1h": HOUR, "1d": DAY} | {f"{n}min": timedelta(minutes=n) for n in (5, 10, 15, 20, 30)}
_YEARS = range(1583, 9999)
"""Years of a timestamp: with the calendar of the simulation, and with a day before and after each."""
_MIDNIGHT = re.compile(r"(?<![\d:.+-])24(?=:00(:00)?(?![\d:.]))")
_SAVING = (
    ". If the clock of the data has daylight saving time, set time_zone (as America/Denver), or convert the times to "
    "standard time"
)


def read_timestamps(
    path: Path, config: Calibration, rows: Sequence[tuple[int, list[str]]], place: int, utc_offset_h: float
) -> tuple[list[int], list[datetime]]:
    """Return lines and timestamps in local standard time, in their order."""
    zone = _zone(config.time_zone)
    lines: list[int] = []
    stamps: list[datetime] = []
    for line, row in rows:
        text = row[place].strip() if place < len(row) else ""
        where = f"{path}, line {line}"
        try:
            stamp = _parsed(text, config.time_format)
            if not _YEARS.start <= stamp.year < _YEARS.stop:
                raise ValueError
        except (ValueError, OverflowError):
            wanted = config.time_format or "ISO 8601, as 2017-01-09 13:00, or time_format in the parameters file"
            raise InvalidConfig(f"{where}: {text!r} is no timestamp; expected {wanted}") from None
        standard = _standard(where, stamp, zone, utc_offset_h, stamps[-1] if stamps else None)
        if stamps and standard <= stamps[-1]:
            raise InvalidConfig(f"{where}: {_order_error(text, standard, stamps, lines, config)}")
        lines.append(line)
        stamps.append(standard)
    if len(stamps) < 2:
        raise InvalidConfig(f"{path}: {len(stamps)} rows with data; a calibration needs more")
    return lines, stamps


def _parsed(text: str, time_format: str | None) -> datetime:
    """Return a time; 24:00, as meters and EnergyPlus's own CSV files write midnight, is 0:00 of the next day.

    Raises:
        ValueError, OverflowError: the text is no time of this form.
    """
    midnight = _MIDNIGHT.sub("00", text, count=1)
    stamp = datetime.strptime(midnight, time_format) if time_format else datetime.fromisoformat(midnight)
    return stamp if midnight == text else stamp + DAY


def _zone(name: str | None) -> ZoneInfo | None:
    if name is None:
        return None
    try:
        if name == "localtime":  # that of the machine
            raise ValueError
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):  # a folder of the database is no file
        raise InvalidConfig(f"time_zone: {name!r} is no IANA time zone, such as America/Denver") from None


def _standard(
    where: str, stamp: datetime, zone: ZoneInfo | None, utc_offset_h: float, before: datetime | None
) -> datetime:
    """Return a timestamp in the standard time of the weather file; `before`: that of the row before."""
    if stamp.tzinfo is not None:
        return (stamp.astimezone(UTC) + timedelta(hours=utc_offset_h)).replace(tzinfo=None)
    if zone is None:
        return stamp
    local = stamp.replace(tzinfo=zone)
    back = local.astimezone(UTC).astimezone(zone).replace(tzinfo=None)
    if back != stamp:
        raise InvalidConfig(
            f"{where}: {stamp} does not exist in {zone.key}, whose clock jumps to {back} there; the timestamps are "
            "not local time with daylight saving: remove time_zone if they are standard time"
        )
    standard = _standard_offset_h(zone, stamp.year)
    if standard != utc_offset_h:
        raise InvalidConfig(
            f"time_zone: {zone.key} has the standard time UTC{standard:+g}, the weather file UTC{utc_offset_h:+g}; use "
            "the zone or the weather file of the building"
        )
    first, second = (
        (local.replace(fold=fold).astimezone(UTC) + timedelta(hours=utc_offset_h)).replace(tzinfo=None)
        for fold in (0, 1)
    )
    # Of the hour that a clock shows twice, the second one follows the first one in the file.
    return second if before is not None and first <= before else first


def _standard_offset_h(zone: ZoneInfo, year: int) -> float:
    """Return the hours of a zone's standard time against UTC: its clock in that half of the year in which it is behind.

    `dst()` has none for Europe/Dublin, whose database calls the time of the summer the standard.
    """
    offsets = (datetime(year, month, 1, tzinfo=zone).utcoffset() or timedelta() for month in (1, 7))
    return min(offsets) / HOUR


def _order_error(
    text: str, stamp: datetime, stamps: Sequence[datetime], lines: Sequence[int], config: Calibration
) -> str:
    """Return what is wrong with a timestamp that is not after the one before it."""
    if stamp in stamps:
        error = f"{text} occurs again, after line {lines[stamps.index(stamp)]}; each time may occur once"
    else:
        error = f"{text} is before the time of line {lines[-1]}; sort the rows by time"
    return error + saving_hint(stamp, config)


def saving_hint(stamp: datetime, config: Calibration) -> str:
    """Return a hint at daylight saving time for an error at a time around which clocks change, else an empty text.

    Clocks change early on a Sunday in spring or autumn.
    """
    is_change = stamp.month in (3, 4, 9, 10, 11) and stamp.weekday() == 6 and stamp.hour <= 4
    return _SAVING if is_change and config.time_zone is None else ""


def row_interval(config: Calibration, stamps: Sequence[datetime]) -> timedelta | None:
    """Return the length of rows; None: each lasts to the next stamp, or since the one before."""
    if config.interval is not None:
        return _INTERVALS.get(config.interval)
    common: timedelta = Counter(after - before for before, after in pairwise(stamps)).most_common(1)[0][0]
    return None if common >= BILL else common


def row_intervals(
    path: Path, config: Calibration, lines: Sequence[int], stamps: Sequence[datetime], interval: timedelta | None
) -> tuple[list[datetime], list[datetime]]:
    """Return begins and ends of the rows, which are whole hours, or whole parts of an hour."""
    apart = min(after - before for before, after in pairwise(stamps))
    if config.interval is not None and interval is not None and apart > interval:
        raise InvalidConfig(
            f"{path}: interval is {config.interval}, but the timestamps are {apart} apart or more; leave it out, or "
            "set it to that"
        )
    grid = min(interval or HOUR, DAY)
    if HOUR % grid and grid % HOUR:
        minutes = grid / timedelta(minutes=1)
        raise InvalidConfig(
            f"{path}, lines {lines[0]} and {lines[1]}: the timestamps are {minutes:g} min apart; expected a part of an "
            "hour, as 15 min, or whole hours"
        )
    for line, stamp in zip(lines, stamps, strict=True):
        since = stamp - datetime(stamp.year, stamp.month, stamp.day)
        if since % grid:
            raise InvalidConfig(
                f"{path}, line {line}: {stamp} is no multiple of {grid / timedelta(minutes=1):g} min after midnight; "
                "resample the data to whole intervals"
            )
    if interval is None:
        return list(stamps[:-1]), list(stamps[1:])
    if config.timestamps == "end":
        return [stamp - interval for stamp in stamps], list(stamps)
    return list(stamps), [stamp + interval for stamp in stamps]
