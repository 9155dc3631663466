"""A table of times."""

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
    """Entries at times of the day (`07:30`) or of the year (`07-01 07:30`); each holds until the next.

    Before the first of a day or year, the last one holds.

    Raises:
        InvalidConfig: no entries, a time that cannot be, or times of both kinds.
    """

    def __init__(self, entries: Mapping[str, T], who: str) -> None:
        read = sorted(((_key(text, who), value) for text, value in entries.items()), key=lambda entry: entry[0])
        self._keys, self._values = [key for key, _ in read], [value for _, value in read]
        if len({len(key) for key in self._keys}) != 1:
            raise InvalidConfig(f"{who}: a table needs times like '07:30' or times like '07-01 07:30', of one kind")
        self._daily = len(self._keys[0]) == 2

    def at(self, time: datetime) -> T:
        """The entry that holds then."""
        key = (time.hour, time.minute) if self._daily else (time.month, time.day, time.hour, time.minute)
        return self._values[bisect_right(self._keys, key) - 1]


def _key(text: str, who: str) -> tuple[int, ...]:
    found = _TIME.fullmatch(text) if isinstance(text, str) else None
    if found:
        key = tuple(int(part) for part in found.groups() if part is not None)
        try:
            month, day, hour, minute = key if len(key) == 4 else (1, 1, *key)
            datetime(2000, month, day, hour, minute)  # a leap year, as 29 February may be meant
        except ValueError:
            pass
        else:
            return key
    raise InvalidConfig(f"{who}: {text!r} is no time; write '07:30' or '07-01 07:30'")
