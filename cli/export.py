"""`zenostat export`: write a recording as a table."""

from __future__ import annotations

import warnings
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli.console import err, out
from cli.verify import File
from topics.errors import InvalidConfig


class Format(StrEnum):
    """Format of a table."""

    PARQUET = "parquet"
    CSV = "csv"


def export(
    file: File,
    to: Annotated[Format, typer.Option("--to", help="Format of the table.")] = Format.PARQUET,
    target: Annotated[
        Path | None, typer.Option("--out", help="File to write. Default: that of the recording, with another suffix.")
    ] = None,
) -> None:
    """Write all samples of a recording to a table: a row for each sample and slot.

    Example: `zenostat export run.mcap --to csv --out run.csv`
    """
    from agent_sdk import recording

    path = target or file.with_suffix(f".{to}")
    if not path.absolute().parent.is_dir():
        raise InvalidConfig(f"--out {path}: there is no folder {path.absolute().parent}")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        loaded = recording.load(file)
    for warning in caught:
        err.print(str(warning.message), markup=False, soft_wrap=True)
    (recording.write_parquet if to is Format.PARQUET else recording.write_csv)(loaded, path)
    rows = sum(len(episode) for episode in loaded.episodes)
    out.print(f"{path}: {rows:,} rows", markup=False, soft_wrap=True)
