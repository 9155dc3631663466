"""Writers of tables that get their final name only when they are complete."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from typing_extensions import override

from zenostat.topics.extras import import_extra

Cell = str | int | float | None


class Writer(Protocol):
    """A table file that is written row by row."""

    def row(self, cells: Sequence[Cell]) -> None:
        """Append a row."""

    def extend(self, columns: Sequence[str]) -> None:
        """Append columns, which are empty in the rows before."""

    def finish(self, path: Path) -> None:
        """Close the file and rename it to `path`."""


class CsvWriter(Writer):
    """CSV writer. Numbers are written with full precision; None is an empty cell."""

    def __init__(self, columns: Sequence[str], hidden: Path) -> None:
        self._hidden = hidden
        self._file = hidden.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(columns)

    @override
    def row(self, cells: Sequence[Cell]) -> None:
        self._writer.writerow(cells)

    @override
    def extend(self, columns: Sequence[str]) -> None:
        self._file.close()
        with self._hidden.open(newline="", encoding="utf-8") as file:
            header, *rows = csv.reader(file)
        self._file = self._hidden.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow([*header, *columns])
        self._writer.writerows([*row, *[""] * len(columns)] for row in rows)

    @override
    def finish(self, path: Path) -> None:
        self._file.close()
        self._hidden.replace(path)


class ParquetWriter(Writer):
    """Parquet writer. Columns are float64, except the `texts`."""

    _ROWS = 8192

    def __init__(self, columns: Sequence[str], hidden: Path, texts: Sequence[str], feature: str) -> None:
        self._arrow = import_extra("pyarrow", "parquet", feature)
        self._parquet = import_extra("pyarrow.parquet", "parquet", feature)
        kinds = [self._arrow.string() if name in texts else self._arrow.float64() for name in columns]
        self._schema = self._arrow.schema(list(zip(columns, kinds, strict=True)))
        self._hidden, self._rows = hidden, list[Sequence[Any]]()
        self._writer = self._parquet.ParquetWriter(str(hidden), self._schema)

    @override
    def row(self, cells: Sequence[Cell]) -> None:
        self._rows.append(cells)
        if len(self._rows) >= self._ROWS:
            self._flush()

    @override
    def extend(self, columns: Sequence[str]) -> None:
        if self._rows:
            self._flush()
        self._writer.close()
        table = self._parquet.read_table(str(self._hidden))
        for name in columns:
            table = table.append_column(name, self._arrow.nulls(len(table), self._arrow.float64()))
        self._schema = table.schema
        self._writer = self._parquet.ParquetWriter(str(self._hidden), self._schema)
        self._writer.write_table(table)

    def _flush(self) -> None:
        columns = [
            self._arrow.array(column, kind.type)
            for column, kind in zip(zip(*self._rows, strict=True), self._schema, strict=True)
        ]
        self._writer.write_table(self._arrow.Table.from_arrays(columns, schema=self._schema))
        self._rows = []

    @override
    def finish(self, path: Path) -> None:
        if self._rows:
            self._flush()
        self._writer.close()
        self._hidden.replace(path)
