"""Columns of a CSV file of numbers that grows while it is read."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from math import isfinite
from pathlib import Path

MAX_BYTES = 64 << 20
"""Largest size of a file; what is beyond it is not read."""


class CsvTable:
    """Numbers of a CSV file by column; each `update` reads what was added since the previous one.

    Args:
        path: the file, which need not exist yet.

    Attributes:
        columns: numbers by column name, all of one length; None where a row has no finite number.
    """

    def __init__(self, path: Path) -> None:
        self.columns: dict[str, list[float | None]] = {}
        self._path = path
        self._names: list[str] = []
        self._read_bytes, self._file_id, self._rest = 0, 0, b""

    def update(self) -> bool:
        """Read what is new, and return whether there is anything; a file that was replaced is read again."""
        try:
            with self._path.open("rb") as file:
                identity, size = (status := self._path.stat()).st_ino, status.st_size
                is_same = identity == self._file_id and size >= self._read_bytes
                if is_same and size == self._read_bytes:
                    return False
                if not is_same:
                    self.columns, self._names, self._read_bytes, self._rest = {}, [], 0, b""
                self._file_id = identity
                file.seek(self._read_bytes)
                data = file.read(max(0, MAX_BYTES - self._read_bytes))
        except OSError:
            return False
        self._read_bytes += len(data)
        complete, newline, rest = (self._rest + data).rpartition(b"\n")
        self._rest = rest
        rows = list(csv.reader(complete.decode("utf-8", "replace").splitlines())) if newline else []
        if rows and not self._names:
            self._names, rows = rows[0], rows[1:]
            self.columns = {name: [] for name in self._names}
        for row in rows:
            self._add(row)
        return bool(data)

    def _add(self, row: Sequence[str]) -> None:
        if len(row) == len(self._names):
            for name, text in zip(self._names, row, strict=True):
                self.columns[name].append(_number(text))


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if isfinite(value) else None
