"""Write a recording as a table: one row per sample and slot."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.recording.data import Recording
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.extras import import_extra

_ROWS = 4096


def write_parquet(recording: Recording, path: str | Path) -> None:
    """Write all samples to a Parquet file; the unit of each column, and the scenario, are in its metadata.

    Raises:
        InvalidConfig: pyarrow is not installed.
        InvalidRecording: the recording has no samples.
    """
    arrow, parquet = import_extra("pyarrow", "parquet", "a Parquet file"), _parquet()
    table = _table(recording)
    units = _units(recording)
    fields, columns = [], []
    for name, values in table.items():
        column = arrow.array(values.tolist()) if values.dtype.kind == "U" else arrow.array(values)
        if values.dtype.kind == "U":
            column = column.dictionary_encode()
        columns.append(column)
        fields.append(arrow.field(name, column.type, metadata={"unit": units[name]} if name in units else None))
    metadata = {"scenario": recording.scenario, "node": recording.manifest.node}
    schema = arrow.schema(fields, metadata=metadata)
    floats = [name for name, values in table.items() if values.dtype.kind == "f"]
    others = [name for name in table if name not in floats]
    with atomic_file(Path(path)) as temporary:
        parquet.write_table(
            arrow.Table.from_arrays(columns, schema=schema),
            str(temporary),
            compression="zstd",
            use_dictionary=others,
            use_byte_stream_split=floats,
        )


def write_csv(recording: Recording, path: str | Path) -> None:
    """Write all samples to a CSV file; a value that is unknown is an empty cell. Numbers are exact.

    Raises:
        InvalidRecording: the recording has no samples.
    """
    table = _table(recording)
    with atomic_file(Path(path)) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        for rows in _blocks([*table.values()]):
            writer.writerows(rows)


def _blocks(columns: Sequence[NDArray[Any]]) -> Iterator[Iterator[tuple[Any, ...]]]:
    for start in range(0, len(columns[0]), _ROWS):
        yield zip(*(_cells(column[start : start + _ROWS]) for column in columns), strict=True)


def _cells(column: NDArray[Any]) -> list[Any]:
    cells: list[Any] = (np.datetime_as_string(column) if column.dtype.kind == "M" else column).tolist()
    if column.dtype.kind == "f" and np.isnan(column).any():
        return ["" if isnan(value) else value for value in cells]
    return cells


def _table(recording: Recording) -> dict[str, NDArray[Any]]:
    """Return the columns of all episodes, one after another; all episodes of a recording have the same columns."""
    if not recording.episodes:
        raise InvalidRecording(f"{recording.path} has no samples")
    tables = [episode.columns() for episode in recording.episodes]
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _units(recording: Recording) -> dict[str, str]:
    manifest = recording.manifest
    return {point.name: point.unit for point in (*manifest.points, *manifest.actuators)}


def _parquet() -> Any:
    return import_extra("pyarrow.parquet", "parquet", "a Parquet file")
