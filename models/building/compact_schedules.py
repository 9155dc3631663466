"""Check the fields of a `Schedule:Compact`: dates, day types, times and values in EnergyPlus's order."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from zenostat.models.building.findings import FieldFinding
from zenostat.models.building.schedule_fields import (
    LAST_DAY,
    DayTimes,
    DayTypes,
    FieldError,
    date_of,
    day_of_year,
    has_other_days,
    number,
    unknown_day_words,
)

_THROUGH, _FOR, _UNTIL, _INTERPOLATE = "THROUGH", "FOR", "UNTIL", "INTERPOLATE"
_INTERPOLATIONS = ("NO", "AVERAGE", "LINEAR")


def compact_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    """Yield the findings on the fields of a `Schedule:Compact`; reading ends at the first that is fatal."""
    reader = _Reader(fields)
    try:
        yield from reader.read()
    except FieldError as error:
        yield reader.finding(str(error))


def compact_values(fields: Mapping[str, Any], *, design_days: bool = True) -> list[tuple[str, float]]:
    """Return the path and the value of each field with a value that EnergyPlus uses; none if it does not accept one.

    Without `design_days`, values that are those of design days alone are left out.
    """
    reader = _Reader(fields)
    try:
        list(reader.read())
    except FieldError:
        return []
    return [(path, value) for days, path, value in reader.values if design_days or has_other_days(days)]


def _text(value: Any) -> str:
    return str(value).strip()


class _Reader:
    """The fields of one schedule, the position of the one that is read, and the values so far, with days and path."""

    def __init__(self, fields: Mapping[str, Any]) -> None:
        entries = [entry.get("field", "") for entry in fields.get("data", ()) if isinstance(entry, Mapping)]
        while entries and not _text(entries[-1]):
            entries.pop()
        self.values: list[tuple[str, str, float]] = []
        self._entries = entries
        self._at = 0

    def finding(self, text: str, *, is_fatal: bool = True) -> FieldFinding:
        """Return a finding on the field at the position."""
        if not self._entries:
            return FieldFinding("", f": {text}", is_fatal)
        index = min(self._at, len(self._entries) - 1)
        path = f"data[{index}].field"
        return FieldFinding(path, f": {path} is {self._entries[index]!r}, {text}", is_fatal)

    def read(self) -> Iterator[FieldFinding]:
        """Yield the findings that are not fatal.

        Raises:
            FieldError: EnergyPlus does not accept the field at the position.
        """
        day = 0
        if not self._entries:
            raise FieldError("it has no fields; expected 'Through: 12/31', 'For: AllDays', 'Until: 24:00' and a value")
        while self._at < len(self._entries):
            through = self._at
            self._expect(_THROUGH, "Through: 12/31")
            if day == LAST_DAY and self._at == len(self._entries) - 1:
                yield self.finding("which EnergyPlus ignores: the whole year has values already", is_fatal=False)
                return
            end = day_of_year(re.sub(r"^through:?", "", self._field, flags=re.IGNORECASE))
            if day == LAST_DAY:
                raise FieldError("but the whole year has values already")
            if end < day:
                raise FieldError(f"which is before {date_of(day)}, the date before it; dates must increase")
            if end == day:
                yield self.finding("which adds no day to those before it", is_fatal=False)
            day = end
            self._at += 1
            yield from self._week(through)
        if day < LAST_DAY:
            self._at = through
            raise FieldError(f"the last date; the days after {date_of(day) if day else 'it'} have no values; "
                             "the last field with 'Through:' must be 'Through: 12/31'")  # fmt: skip

    @property
    def _field(self) -> str:
        return _text(self._entries[self._at])

    def _begins(self, word: str) -> bool:
        return self._at < len(self._entries) and self._field.upper().startswith(word)

    def _expect(self, word: str, example: str) -> None:
        if not self._begins(word):
            raise FieldError(f"where a field such as '{example}' is expected")

    def _week(self, through: int) -> Iterator[FieldFinding]:
        """Read the day types and values up to the next date."""
        if self._at == len(self._entries):
            raise FieldError("after which the values are missing, such as 'For: AllDays', 'Until: 24:00' and a number")
        days = DayTypes()
        while self._at < len(self._entries) and not self._begins(_THROUGH):
            self._expect(_FOR, "For: AllDays")
            if self._at == len(self._entries) - 1:
                yield self.finding("after which the values are missing; EnergyPlus uses 0", is_fatal=False)
                self._at += 1
                return
            days.add(self._field)
            self._days = self._field
            yield from (self.finding(f"but {note}", is_fatal=False) for note in unknown_day_words(self._field))
            self._at += 1
            if not self._begins(_UNTIL):
                self._check_interpolation()
                self._at += 1
            yield from self._day()
        if days.missing:
            at, self._at = self._at, through
            names = ", ".join(days.missing)
            yield self.finding(f"but there is no value for {names}; EnergyPlus uses 0", is_fatal=False)
            self._at = at

    def _check_interpolation(self) -> None:
        if not any(word in self._field.upper() for word in _INTERPOLATIONS):
            if self._begins(_INTERPOLATE):
                raise FieldError("but an interpolation is one of No, Average, Linear")
            raise FieldError("where a field such as 'Until: 24:00' is expected, or 'Interpolate: Average' before it")

    def _day(self) -> Iterator[FieldFinding]:
        """Read times and values."""
        times, last = DayTimes(), self._at
        while self._at < len(self._entries) and not self._begins(_FOR) and not self._begins(_THROUGH):
            last = self._at
            self._expect(_UNTIL, "Until: 24:00")
            before = times.last
            if note := times.add(self._field):
                yield self.finding(f"but {note}", is_fatal=False)
            self._at += 1
            if self._at == len(self._entries):
                raise FieldError("after which the value is missing")
            value = self._entries[self._at]
            read = number(value)
            if read is None:
                raise FieldError("where the value is expected, which is a number")
            if times.last > before:
                self.values.append((self._days, f"data[{self._at}].field", read))
            if not _text(value):
                yield self.finding("where the value is expected; EnergyPlus uses 0", is_fatal=False)
            self._at += 1
        after, self._at = self._at, last
        times.check_end()
        self._at = after
