"""Tables that are written row by row and have their name only when they are whole."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from agent_sdk.wrappers.extras import load

Cell = str | int | float | None


class Writer(Protocol):
    """A file that grows by rows."""

    def row(self, cells: Sequence[Cell]) -> None:
        """Adds a row."""

    def finish(self, path: Path) -> None:
        """Closes the file and gives it its name."""


class CsvWriter:
    """Numbers are written so that they read back equal; None is an empty cell."""

    def __init__(self, columns: Sequence[str], hidden: Path) -> None:
        self._hidden = hidden
        self._file = hidden.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(columns)

    def row(self, cells: Sequence[Cell]) -> None:
        """See `Writer`."""
        self._writer.writerow(cells)

    def finish(self, path: Path) -> None:
        """See `Writer`."""
        self._file.close()
        self._hidden.replace(path)


class ParquetWriter:
    """Columns of float64; those of text are named."""

    _ROWS = 8192

    def __init__(self, columns: Sequence[str], hidden: Path, texts: Sequence[str], who: str) -> None:
        self._arrow = load("pyarrow", "parquet", who)
        parquet = load("pyarrow.parquet", "parquet", who)
        kinds = [self._arrow.string() if name in texts else self._arrow.float64() for name in columns]
        self._schema = self._arrow.schema(list(zip(columns, kinds, strict=True)))
        self._hidden, self._rows = hidden, list[Sequence[Any]]()
        self._writer = parquet.ParquetWriter(str(hidden), self._schema)

    def row(self, cells: Sequence[Cell]) -> None:
        """See `Writer`."""
        self._rows.append(cells)
        if len(self._rows) >= self._ROWS:
            self._flush()

    def _flush(self) -> None:
        columns = [
            self._arrow.array(column, kind.type)
            for column, kind in zip(zip(*self._rows, strict=True), self._schema, strict=True)
        ]
        self._writer.write_table(self._arrow.Table.from_arrays(columns, schema=self._schema))
        self._rows = []

    def finish(self, path: Path) -> None:
        """See `Writer`."""
        if self._rows:
            self._flush()
        self._writer.close()
        self._hidden.replace(path)
