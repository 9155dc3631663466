"""`zenostat replay`: publish a recording under its node's keys."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import datetime
from typing import Annotated

import typer

from bridge.transport.session import default_endpoint
from cli.console import out, progress, until_signal
from cli.node_options import Connect as Peers
from cli.node_options import Expose, Listen, NoListen
from cli.options import CertificateName, Keys
from cli.verify import File
from topics.errors import AddressInUse, InvalidConfig


def replay(
    file: File,
    speed: Annotated[
        float | None,
        typer.Option(min=0.0, help="Simulated seconds per second. Default: as fast as it was recorded."),
    ] = None,
    begin: Annotated[
        str | None, typer.Option("--from", metavar="TIME", help="Simulated time of the first sample, 07-03T08:00.")
    ] = None,
    end: Annotated[
        str | None, typer.Option("--to", metavar="TIME", help="Simulated time of the last sample, 07-03T18:00.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name on the bus. Default: that of the recorded node.")] = None,
    listen: Listen = None,
    connect: Peers = None,
    no_listen: NoListen = False,
    expose: Expose = False,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Publish a recording under its node's keys, so that monitors and gateways see the building again.

    The node on the bus takes no commands and no requests. Ctrl-C ends the replay.

    Example: `zenostat replay run.mcap --speed 600 --from 07-03T06:00`
    """
    from topics.extras import requires_extra

    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from bridge.recording.reader import RecordingReader
        from bridge.recording.replay import Replay, ReplayRange
    from bridge.transport.session import open_session
    from topics.keys import Role

    if no_listen and (listen or not connect):
        raise InvalidConfig("--no-listen needs --connect, and no --listen")
    if speed is not None and not 0.0 < speed < float("inf"):
        raise InvalidConfig(f"--speed {speed:g}: expected a finite number above 0")
    with ExitStack() as stack:
        stop = stack.enter_context(until_signal())
        reader = stack.enter_context(RecordingReader(file))
        year = datetime.fromisoformat(reader.manifest.begin).year
        selected = ReplayRange(_moment(begin, "--from", year), _moment(end, "--to", year))
        endpoints = [] if no_listen else [listen or default_endpoint(keys)]
        settings = {"expose": expose, "keys": keys, "role": Role.NODE, "certificate": certificate}
        try:
            session = open_session(listen=endpoints, connect=connect or [], **settings)  # type: ignore[arg-type]
        except AddressInUse:
            if listen:
                raise
            session = open_session(connect=connect or endpoints, **settings)  # type: ignore[arg-type]
        stack.enter_context(session)
        replayed = stack.enter_context(Replay(reader, session, name=name, speed=speed, selected=selected))
        bars = stack.enter_context(progress())
        task = bars.add_task(f"replaying {file.name} as {replayed.manifest.node}", total=reader.manifest.steps, rate="")
        count = replayed.run(stop, lambda time, step: bars.update(task, completed=step, rate=time))
    out.print(f"{replayed.manifest.node}: replayed {count:,} samples", markup=False, soft_wrap=True)


def _moment(text: str | None, option: str, year: int) -> datetime | None:
    from topics.calendar import parse_moment

    if text is None:
        return None
    try:
        return parse_moment(text, year)
    except ValueError as error:
        raise InvalidConfig(f"{option} {text}: {error}") from None
