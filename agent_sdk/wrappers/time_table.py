"""Tables of values by time of day or of year."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Mapping
from datetime import datetime
from typing import Generic, TypeVar

from topics.errors import InvalidConfig

T = TypeVar("T")
_TIME = re.compile(r"(?:(\d\d)-(\d\d) )?(\d\d):(\d\d)")


class Table(Generic[T]):
    """Values at times of the day (`07:30`) or of the year (`07-01 07:30`), each valid until the next.

    Before the first time of a day or year, the last value is valid.

    Args:
        entries: values by time.
        label: names the table in errors.

    Raises:
        InvalidConfig: there are no entries, a time is invalid, or the times are of both forms.
    """

    def __init__(self, entries: Mapping[str, T], label: str) -> None:
        read = sorted(((_key(text, label), value) for text, value in entries.items()), key=lambda entry: entry[0])
        self._keys, self._values = [key for key, _ in read], [value for _, value in read]
        if len({len(key) for key in self._keys}) != 1:
            raise InvalidConfig(f"{label}: the times of a table should all be like '07:30', or all like '07-01 07:30'")
        self._daily = len(self._keys[0]) == 2

    def at(self, time: datetime) -> T:
        """Return the value that is valid at that time."""
        key = (time.hour, time.minute) if self._daily else (time.month, time.day, time.hour, time.minute)
        return self._values[bisect_right(self._keys, key) - 1]


def _key(text: str, label: str) -> tuple[int, ...]:
    match = _TIME.fullmatch(text) if isinstance(text, str) else None
    if match:
        key = tuple(int(part) for part in match.groups() if part is not None)
        try:
            month, day, hour, minute = key if len(key) == 4 else (1, 1, *key)
            datetime(2000, month, day, hour, minute)  # a leap year, so that 29 February is valid
        except ValueError:
            pass
        else:
            return key
    raise InvalidConfig(f"{label}: {text!r} is not a time; write '07:30' or '07-01 07:30'")
