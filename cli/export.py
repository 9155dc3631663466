"""`zenostat export`: write a recording in the format of another program."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.console import err, out, warnings_printed
from zenostat.cli.verify import File
from zenostat.topics.atomic_file import check_writable
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.plurals import counted


class Format(StrEnum):
    """Format of an export."""

    PARQUET = "parquet"
    CSV = "csv"
    RRD = "rrd"
    MCAP = "mcap"


_SUFFIXES = {Format.MCAP: ".plot.mcap"}  # not that of the recording itself


def export(
    file: File,
    to: Annotated[
        Format,
        typer.Option(
            "--to",
            help="A table (`parquet`, `csv`), what the monitor saves (`rrd`, for `zenostat view`), or protobuf "
            "messages for Foxglove and PlotJuggler (`mcap`).",
        ),
    ] = Format.PARQUET,
    target: Annotated[
        Path | None, typer.Option("--out", help="File to write. Default: that of the recording, with another suffix.")
    ] = None,
) -> None:
    """Write all samples of a recording in the format of another program.

    Example: `zenostat export run.mcap --to csv --out run.csv`

    Example: `zenostat export run.mcap --to rrd`
    """
    path = target or file.with_suffix(_SUFFIXES.get(to, f".{to}"))
    if path.suffix != f".{to}":
        raise InvalidConfig(f"--out {path}: expected a .{to} file")
    if path.resolve() == file.resolve():
        raise InvalidConfig(f"--out {path}: that is the recording itself; choose another name")
    check_writable(path, f"--out {path}")
    if to is Format.RRD:
        text = f"{counted(_write_rrd(file, path), 'sample', ',')}; open it with: zenostat view {path}"
    else:
        text = f"{_write_table(file, to, path):,} {'samples' if to is Format.MCAP else 'rows'}"
    out.print(f"{path}: {text}")


def _write_rrd(file: Path, path: Path) -> int:
    from zenostat.topics.extras import requires_extra

    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.reader import RecordingReader
    from zenostat.cli.monitor_stream import reward_terms
    from zenostat.metrics.reward_comfort import display_comfort
    from zenostat.views.live.from_recording import write_rrd

    with RecordingReader(file) as reader:
        count = write_rrd(reader, path, comfort=display_comfort, reward=reward_terms)
        if reader.end.text:
            err.print(f"{file}: {reader.end.text}")
        if reader.manifest.slots > 1:
            err.print("slot 0 is shown, as in the monitor")
    return count


def _write_table(file: Path, to: Format, path: Path) -> int:
    from zenostat import recording

    with warnings_printed():
        loaded = recording.load(file)
    writers = {
        Format.PARQUET: recording.write_parquet,
        Format.CSV: recording.write_csv,
        Format.MCAP: recording.write_mcap,
    }
    if to is not Format.MCAP:  # whose metadata has the names
        for name, point in loaded.episodes[0].renamed.items() if loaded.episodes else ():
            err.print(f"{point} is in the column {name}: the name is in use")
    writers[to](loaded, path)
    return sum(len(episode) for episode in loaded.episodes)
