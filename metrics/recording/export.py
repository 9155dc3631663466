"""Write a recording as a table: one row per sample and slot."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.parquet import write_table
from zenostat.metrics.recording.data import Recording
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidRecording

_ROWS = 4096


def write_parquet(recording: Recording, path: str | Path) -> None:
    """Write all samples to a Parquet file; the unit of each column, and the scenario, are in its metadata.

    Raises:
        InvalidConfig: pyarrow is not installed.
        InvalidRecording: the recording has no samples.
    """
    metadata = {"scenario": recording.scenario, "node": recording.manifest.node}
    write_table(_table(recording), recording.episodes[0].column_units, metadata, Path(path))


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
