"""`zenostat replay`: publish a recording under its node's keys, or command another node with it."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from zenostat.bridge.transport.session import default_endpoint
from zenostat.cli.console import err, out, progress, until_signal
from zenostat.cli.node_options import Connect as Peers
from zenostat.cli.node_options import Listen, NoListen
from zenostat.cli.options import BusOptions, CertificateName, Expose, Keys
from zenostat.cli.verify import File
from zenostat.topics.errors import AddressInUse, InvalidConfig
from zenostat.topics.plurals import counted


def replay(
    file: File,
    speed: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="Simulated seconds per second. Default: as it was recorded, with pauses of up to a minute."
        ),
    ] = None,
    begin: Annotated[
        str | None, typer.Option("--from", metavar="TIME", help="Simulated time of the first sample, 07-03T08:00.")
    ] = None,
    end: Annotated[
        str | None, typer.Option("--to", metavar="TIME", help="Simulated time of the last sample, 07-03T18:00.")
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(help="Name on the bus. Default: that of the recorded node, or `replay` as a controller."),
    ] = None,
    only_commands: Annotated[
        bool, typer.Option("--only-commands", help="Command the node of `--node` as the recorded one was commanded.")
    ] = False,
    node: Annotated[str | None, typer.Option(help="Node to command, in lockstep.")] = None,
    priority: Annotated[
        int | None, typer.Option(min=1, max=16, metavar="1-16", help="Priority of the commands. Default: 10.")
    ] = None,
    listen: Listen = None,
    connect: Peers = None,
    no_listen: NoListen = False,
    expose: Expose = False,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Publish a recording under its node's keys, so that monitors and gateways see the building again.

    The node on the bus takes no commands. Ctrl-C ends the replay. With `--only-commands`, nothing is
    published: a controller commands another node as the recorded one was commanded.

    Example: `zenostat replay run.mcap --speed 600 --from 07-03T06:00`

    Example: `zenostat replay run.mcap --only-commands --node twin`
    """
    if speed is not None and not 0.0 < speed < float("inf"):
        raise InvalidConfig(f"--speed {speed:g}: expected a finite number above 0")
    if only_commands:
        if node is None:
            raise InvalidConfig("--only-commands needs the node to command: --node NAME")
        others = {"--from": begin, "--to": end, "--listen": listen, "--no-listen": no_listen, "--expose": expose}
        refused = [option for option, value in others.items() if value]
        if refused or len(connect or ()) > 1:
            raise InvalidConfig(
                f"{', '.join(refused) or 'several --connect'}: --only-commands connects to one bus, as a controller, "
                "and replays whole episodes"
            )
        options = BusOptions(connect[0] if connect else None, keys, certificate)
        _drive(file, node, options, name or "replay", priority, speed)
        return
    if node is not None or priority is not None:
        raise InvalidConfig("--node and --priority need --only-commands")
    from zenostat.topics.extras import requires_extra

    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.reader import RecordingReader
        from zenostat.bridge.recording.replay import Replay, ReplayRange
        from zenostat.eplus_node.verify_recording import RecordedPlant
    from zenostat.bridge.transport.session import open_session
    from zenostat.topics.keys import Role

    if no_listen and (listen or not connect):
        raise InvalidConfig("--no-listen needs --connect, and no --listen")
    with ExitStack() as stack:
        stop = stack.enter_context(until_signal())
        reader = stack.enter_context(RecordingReader(file))
        period = tuple(map(datetime.fromisoformat, (reader.manifest.begin, reader.manifest.end)))
        selected = ReplayRange(_moment(begin, "--from", *period), _moment(end, "--to", *period))
        endpoints = [] if no_listen else [listen or default_endpoint(keys)]
        settings = {"expose": expose, "keys": keys, "role": Role.NODE, "certificate": certificate, "warn": err.warning}
        try:
            opened = open_session(listen=endpoints, connect=connect or [], **settings)  # type: ignore[arg-type]
        except AddressInUse:
            if listen:
                raise
            opened = open_session(connect=connect or endpoints, **settings)  # type: ignore[arg-type]
        session = stack.enter_context(opened)
        semantic = RecordedPlant(reader, exact=True).semantic_turtle
        replayed = stack.enter_context(
            Replay(reader, session, name=name, speed=speed, selected=selected, semantic=semantic)
        )
        bars = stack.enter_context(progress())
        task = bars.add_task(f"replaying {file.name} as {replayed.manifest.node}", total=reader.manifest.steps, rate="")
        count = replayed.run(stop, lambda time, step: bars.update(task, completed=step, rate=time))
    out.print(f"{replayed.manifest.node}: replayed {counted(count, 'sample', ',')}")


def _drive(file: Path, node: str, options: BusOptions, name: str, priority: int | None, speed: float | None) -> None:
    from zenostat.lab.drive import drive

    with options.open_bus(resets=True) as bus, progress() as bars:
        task = bars.add_task(f"{node}: commands of {file.name}", total=None, rate="")
        result = drive(
            file, bus, node, name=name, priority=priority or 10, speed=speed,
            progress=lambda time, step: bars.update(task, completed=step, rate=time),
        )  # fmt: skip
    for text in result.skipped:
        err.print(f"not replayed: {text}")
    episodes = counted(result.episodes, "episode")
    out.print(f"{node}: {counted(result.steps, 'step', ',')} of {episodes} commanded")


def _moment(text: str | None, option: str, first: datetime, last: datetime) -> datetime | None:
    from zenostat.topics.calendar import parse_moment_within

    if text is None:
        return None
    try:
        return parse_moment_within(text, first, last)
    except ValueError as error:
        raise InvalidConfig(f"{option} {text}: {error}") from None
