"""`zenostat log`: who requested what of a recorded node, when, and with which result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.console import warnings_printed
from zenostat.cli.tables import show, show_json
from zenostat.cli.verify import File
from zenostat.topics.errors import UnknownName, did_you_mean


def log(
    file: File,
    source: Annotated[
        str | None,
        typer.Option(help="Only what this controller, device or person sent; `*` stands for any characters."),
    ] = None,
    rejected: Annotated[bool, typer.Option("--rejected", help="Only what the node did not accept.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the log as JSON.")] = False,
) -> None:
    """List the writes, commands, requests and alarms of a recording, with senders, times and results.

    `proven` is the name of the certificate that proves the sender's, `via` the way in. Consecutive accepted commands of
    a controller are one row.

    Example: `zenostat log run.mcap --source plc7`
    """
    from fnmatch import fnmatchcase

    from zenostat import recording

    with warnings_printed():
        entries = recording.load_log(file)
        _check_chain(file)
    if source is not None:
        known = dict.fromkeys(entry.source for entry in entries if entry.source)
        entries = tuple(entry for entry in entries if fnmatchcase(entry.source, source))
        if not entries:
            raise UnknownName(f"no messages of {source!r} in {file}; {did_you_mean(source, known)}")
    if rejected:
        entries = tuple(entry for entry in entries if not entry.is_accepted)
    if as_json:
        names = ("simulated", "source", "proven", "via", "kind", "subject", "result", "count")
        rows = [{name: getattr(entry, name) for name in names} for entry in entries]
        show_json([{"time": e.time.isoformat(timespec="milliseconds")} | r for e, r in zip(entries, rows, strict=True)])
        return
    show(
        str(file),
        ("UTC", "simulated", "source", "proven", "via", "kind", "subject", "result"),
        [
            (
                f"{entry.time:%Y-%m-%d %H:%M:%S.%f}"[:-3],
                entry.simulated,
                entry.source,
                entry.proven or ("" if entry.kind == "alarm" else "no"),
                entry.via,
                entry.kind,
                entry.subject + (f" and {entry.count - 1:,} more" if entry.count > 1 else ""),
                entry.result,
            )
            for entry in entries
        ],
        wrap=("subject", "result"),
    )


def _check_chain(file: Path) -> None:
    """Warn if entries of the log have been removed, changed or moved."""
    import warnings

    from zenostat.bridge.recording.audit_chain import check_audit
    from zenostat.bridge.recording.reader import RecordingReader

    with RecordingReader(file) as reader:
        result = check_audit(reader)
    if result.problems:
        warnings.warn(f"{file}: {result}", stacklevel=2)
