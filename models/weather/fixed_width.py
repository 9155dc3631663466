"""EPW files whose numbers have fields of fixed width, so that other values do not change the layout of the file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zenostat.models.weather.epw import NUMBER_COLUMNS, Weather, find_column
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig

_FIRST_COLUMN = 6
"""The columns before it are the date and the source flags, which stay as they are."""
_TEXT_COLUMN = 27
"""The weather codes, which are text."""
_DECIMALS = 4
_MIN_WIDTH = 12


class FixedWidthWeather:
    """A weather file with padded fields.

    Each number after the source flags is padded with spaces on the left to the same width, at least 12 characters.
    EnergyPlus reads the same values from it. All files that `write` writes have the same layout, byte for byte: a row
    begins at the same offset in each.

    Args:
        weather: the weather file.

    Attributes:
        data: the content of the padded file.
        row_offsets: offset of each row in bytes, and of what follows the rows; shape (rows + 1,).
    """

    def __init__(self, weather: Weather) -> None:
        self.weather = weather
        fields = [[field.strip() for field in row.split(",")] for row in weather.rows]
        padded = [index for index in NUMBER_COLUMNS if _FIRST_COLUMN <= index < weather.width]
        self._width = max(_MIN_WIDTH, max((len(row[index]) for row in fields for index in padded), default=0))
        for row in fields:
            for index in padded:
                row[index] = row[index].rjust(self._width)
        rows = [",".join(row) for row in fields]
        head = "".join(line + weather.end for line in weather.head)
        self.data = (head + weather.end.join(rows) + weather.tail).encode("latin-1")
        sizes = [len(row) + len(weather.end) for row in rows]
        self.row_offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64) + len(head)
        self._first_offsets = self.row_offsets[:-1] + np.array(
            [sum(map(len, row[:_FIRST_COLUMN])) + _FIRST_COLUMN for row in fields], np.int64
        )
        self._text_sizes = np.array([len(row[_TEXT_COLUMN]) for row in fields], np.int64)

    def write(self, path: Path, changed: Mapping[str, Floats], first: int = 0) -> None:
        """Write the file with other values, with four decimals, in some rows.

        Args:
            path: where to.
            changed: columns, each of shape (changed rows,); values that do not differ keep their text.
            first: the first of the changed rows; after the last row of the file comes its first one.

        Raises:
            UnknownName: there is no such column.
            InvalidConfig: a value does not fit into the width of its field, or the file's lines lack its column.
        """
        buffer = bytearray(self.data)
        characters = np.frombuffer(buffer, np.uint8)
        for name, values in changed.items():
            index = find_column(name).index
            if not self.weather.has(index, values):
                continue
            changed_rows = np.arange(first, first + len(values)) % len(self.weather)
            differs = np.flatnonzero(values != self.weather.numbers(index)[changed_rows])
            offsets = self._offsets(index)[changed_rows[differs]]
            characters[offsets[:, np.newaxis] + np.arange(self._width)] = self._digits(values[differs], name)
        path.write_bytes(buffer)

    def _offsets(self, index: int) -> NDArray[np.int64]:
        """Return the offset of a column's field in each row."""
        offsets = self._first_offsets + (index - _FIRST_COLUMN) * (self._width + 1)
        return offsets + self._text_sizes - self._width if index > _TEXT_COLUMN else offsets

    def _digits(self, values: Floats, name: str) -> NDArray[np.uint8]:
        """Return numbers as text of the fields' width with four decimals, padded on the left, (values, width)."""
        scaled = np.rint(values * 10.0**_DECIMALS).astype(np.int64)
        rest, point = np.abs(scaled), self._width - _DECIMALS - 1
        whole_digits = 1 + sum((rest >= 10 ** (_DECIMALS + place)).astype(np.int64) for place in range(1, point + 1))
        if (whole_digits + (scaled < 0) > point).any():
            raise InvalidConfig(f"weather column {name}: {values[np.abs(values).argmax()]:g} has too many digits")
        text = np.full((len(values), self._width), ord(" "), np.uint8)
        for position in [*range(self._width - 1, point, -1), *range(point - 1, -1, -1)]:
            is_shown = position >= point - whole_digits
            text[:, position] = np.where(is_shown, ord("0") + rest % 10, ord(" "))
            rest //= 10
        negative = np.flatnonzero(scaled < 0)
        text[negative, point - 1 - whole_digits[negative]] = ord("-")
        text[:, point] = ord(".")
        return text
