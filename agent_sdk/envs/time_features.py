"""Time features of an observation, as EnergyPlus's data exchange API defines them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import MAXYEAR, MINYEAR, datetime

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import TimeField

_BEGIN: dict[TimeField, Callable[[datetime], float]] = {
    TimeField.YEAR: lambda t: t.year,
    TimeField.MONTH: lambda t: t.month,
    TimeField.DAY_OF_MONTH: lambda t: t.day,
    TimeField.DAY_OF_WEEK: lambda t: t.isoweekday() % 7 + 1,
    TimeField.DAY_OF_YEAR: lambda t: t.timetuple().tm_yday,
    TimeField.HOUR: lambda t: t.hour,
}
_HOURS = 24.0

BOUNDS: dict[TimeField, tuple[float, float]] = {
    TimeField.YEAR: (MINYEAR, MAXYEAR),
    TimeField.MONTH: (1, 12),
    TimeField.DAY_OF_MONTH: (1, 31),
    TimeField.DAY_OF_WEEK: (1, 7),
    TimeField.DAY_OF_YEAR: (1, 366),
    TimeField.HOUR: (0, 23),
    TimeField.MINUTES: (0, 60),
    TimeField.CURRENT_TIME: (0, _HOURS),
}
"""Minimum and maximum of each field."""


def time_features(fields: Sequence[TimeField], begin: datetime, end: datetime) -> Floats:
    """Return the fields of the timestep from `begin` to `end` (equal for sample 0), shape (fields,).

    `hour` and the date are those of its beginning, `minutes` and `current_time` (h) those of its end.
    """
    return np.array([_field(field, begin, end) for field in fields], np.float64)


def _field(field: TimeField, begin: datetime, end: datetime) -> float:
    if field is TimeField.MINUTES:
        return 60.0 if end > begin and end.minute == 0 else end.minute
    if field is TimeField.CURRENT_TIME:
        midnight = begin.replace(hour=0, minute=0, second=0, microsecond=0)
        return (end - midnight).total_seconds() / 3600.0
    return _BEGIN[field](begin)
