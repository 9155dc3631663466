"""Profiles in CSV files: values that are means over intervals, and their means over other intervals."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from math import floor, inf, isfinite
from pathlib import Path

import numpy as np

from zenostat.plants.grid.schema import Profile
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.user_file import user_file


class Table:
    """A CSV file with a header."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with user_file(path, expected="a CSV file"), path.open(newline="", encoding="utf-8-sig") as file:
            self._rows = list(csv.reader(file))
        if not any(self._rows[1:]):
            raise InvalidConfig(f"{path}: a header and at least one row expected")
        self.header = [name.strip() for name in self._rows[0]]

    def lines(self) -> list[int]:
        """Return the line of each row that is not blank."""
        return [number for number, _ in self._numbered()]

    def texts(self, column: str) -> list[str]:
        """Return the texts of a column.

        Raises:
            InvalidConfig: there is no such column, or more than one, or a row has no value.
        """
        if column not in self.header:
            raise InvalidConfig(f"{self.path}: no column {column!r}; {did_you_mean(column, self.header)}")
        if self.header.count(column) > 1:
            raise InvalidConfig(f"{self.path}: {self.header.count(column)} columns {column!r}; one expected")
        place = self.header.index(column)
        for number, row in self._numbered():
            if len(row) <= place:
                raise InvalidConfig(f"{self.path}:{number}: no value of {column!r}")
        return [row[place].strip() for _, row in self._numbered()]

    def numbers(self, column: str, factor: float = 1.0, low: float = -inf) -> Floats:
        """Return the numbers of a column, times a factor.

        Raises:
            InvalidConfig: as of `texts`; or a value is not a finite number, or with the factor less than `low`.
        """
        values = []
        for (number, _), text in zip(self._numbered(), self.texts(column), strict=True):
            try:
                value = float(text) * factor
            except ValueError:
                value = np.nan
            if not isfinite(value) or value < low:
                expected = "a finite number" if low == -inf else f"a number of at least {low:g}"
                times = "" if factor == 1.0 else f" with the factor {factor:g}"
                raise InvalidConfig(f"{self.path}:{number}: {column} = {text!r}{times}; {expected} expected")
            values.append(value)
        return np.array(values)

    def _numbered(self) -> Iterator[tuple[int, list[str]]]:
        return ((number, row) for number, row in enumerate(self._rows[1:], start=2) if row)


class Means:
    """A periodic function of time that is constant within intervals, and its exact means.

    Args:
        values: of the intervals.
        step_s: length of an interval, s.
    """

    def __init__(self, values: Floats, step_s: float) -> None:
        self._values, self._step_s = values, step_s
        self._sums = np.concatenate(([0.0], np.cumsum(values)))

    @classmethod
    def read(cls, source: float | Profile, folder: Path, low: float = -inf) -> Means:
        """Return a constant, or the profile in a file relative to `folder`, whose values are at least `low`."""
        if not isinstance(source, Profile):
            return cls(np.array([source]), 1.0)
        return cls(Table(folder / source.file).numbers(source.column, source.factor, low), source.step_s)

    def mean(self, begin_s: float, end_s: float) -> float:
        """Return the mean from one time to a later one."""
        first, last = begin_s / self._step_s, end_s / self._step_s
        number = floor(first)
        if last <= number + 1:  # within one interval: its value, to the bit
            return float(self._values[number % len(self._values)])
        return (self._integral(last) - self._integral(first)) / (last - first)

    def _integral(self, position: float) -> float:
        """Return the integral from 0 to a position, in intervals."""
        whole, number = divmod(floor(position), len(self._values))
        rest = (position - floor(position)) * self._values[number]
        return float(whole * self._sums[-1] + self._sums[number] + rest)
