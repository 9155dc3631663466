"""The `zenostat` command."""

from __future__ import annotations

import signal
import sys

import typer

from cli import (
    buildings,
    contract,
    demo,
    evaluate,
    keys,
    monitor,
    node,
    pace,
    packs,
    points,
    probe,
    read,
    router,
    run,
    status,
    watch,
    weathers,
    write,
    zmq,
)
from cli.console import say_error
from cli.scenarios import scenarios
from topics import VERSION
from topics.errors import UsageError, ZenostatError

app = typer.Typer(
    name="zenostat",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Put a real EnergyPlus building on a Zenoh bus, control it from other processes, watch it live.",
)
_COMMANDS = (
    node.node,
    run.run,
    evaluate.evaluate,
    monitor.monitor,
    status.status,
    router.router,
    read.read,
    watch.watch,
    buildings.buildings,
    weathers.weathers,
    points.points,
    probe.probe,
    demo.demo,
    write.release,
    pace.pace,
    pace.pause,
    pace.resume,
    pace.step,
    pace.faults,
    contract.contract,
    zmq.zmq,
)
for command in _COMMANDS:
    app.command()(command)
app.command(context_settings={"ignore_unknown_options": True})(write.write)  # a value may be negative
app.add_typer(scenarios, name="scenarios")
app.add_typer(packs.app, name="packs")
app.add_typer(keys.app, name="keys")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"zenostat {VERSION}")
        raise typer.Exit


@app.callback()
def _root(version: bool = typer.Option(False, "--version", callback=_version, is_eager=True)) -> None:
    """Zenostat."""


def main() -> None:
    """Runs the command line: 2 for a mistake in the call, 1 for what went wrong on the way, 128 and the signal."""
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # what runs is ended in good order
    try:
        app()
    except UsageError as error:
        say_error(str(error))
        sys.exit(2)
    except ZenostatError as error:
        say_error(str(error))
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
