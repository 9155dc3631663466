"""`zenostat record`: start or end the recording of a running node."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zenostat.bridge.runtime.affinity import host
from zenostat.cli.console import out
from zenostat.cli.node_options import RecordOnFull
from zenostat.cli.options import DEFAULTS, BusOptions, Node, on_bus
from zenostat.cli.write import person
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role
from zenostat.topics.messages import OnFull, RecordingState, RecordingStatus
from zenostat.topics.plurals import counted


@on_bus
def record(
    node: Node,
    file: Annotated[
        Path | None, typer.Option("--out", help="File (`.mcap`) or folder on the node's machine, which writes it.")
    ] = None,
    now: Annotated[
        bool, typer.Option("--now", help="Begin at once; what is before the next reset cannot be verified.")
    ] = False,
    stop: Annotated[bool, typer.Option("--stop", help="End the recording, and complete its file.")] = False,
    on_full: RecordOnFull = OnFull.WAIT,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file if it is a recording.")] = False,
    options: BusOptions = DEFAULTS,
) -> None:
    """Record a running node, from its next reset until the node ends or `--stop`; the node writes the file.

    Example: `zenostat record office --out run.mcap`
    """
    if (file is not None) is stop:
        raise InvalidConfig("expected either --out FILE.mcap, or --stop")
    with options.open_bus(Role.OPERATOR) as bus:
        if file is None:
            status = bus.stop_recording(node, source=person())
        else:
            if not file.is_absolute() and bus.manifest(node).host != host():
                raise InvalidConfig(f"--out {file}: the node runs on another machine; name an absolute path there")
            status = bus.record(node, file.absolute(), now=now, overwrite=overwrite, on_full=on_full, source=person())
    out.print(f"{node}: {describe_recording(status)}")


def describe_recording(status: RecordingStatus) -> str:
    """Describe the state of a recording in a line."""
    if status.state is RecordingState.ARMED:
        return f"the next reset of all slots begins the recording to {status.path}; --now begins at once"
    if status.state is RecordingState.RECORDING:
        return f"recording to {status.path}"
    if status.state is RecordingState.ENDED and not status.bytes:
        return f"nothing was recorded to {status.path}, because no reset of all slots came"
    if status.reason and not status.bytes:
        return f"there is no recording at {status.path}: {status.reason}"
    text = f"recorded {counted(status.messages, 'message', ',')}, {status.bytes / 1e6:.1f} MB, to {status.path}"
    if status.waits:
        text += f"; waited for the disk {counted(status.waits, 'time')}, {status.waited_s:.1f} s in total"
    return text + (f"; stopped early: {status.reason}" if status.reason else "")
