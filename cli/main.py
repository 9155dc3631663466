"""The `zenostat` command."""

from __future__ import annotations

import sys

import typer

from cli import buildings, demo, evaluate, monitor, node, packs, points, run, status, weathers
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
    buildings.buildings,
    weathers.weathers,
    points.points,
    demo.demo,
)
for command in _COMMANDS:
    app.command()(command)
app.add_typer(scenarios, name="scenarios")
app.add_typer(packs.app, name="packs")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"zenostat {VERSION}")
        raise typer.Exit


@app.callback()
def _root(version: bool = typer.Option(False, "--version", callback=_version, is_eager=True)) -> None:
    """Zenostat."""


def main() -> None:
    """Runs the command line: 2 for a mistake in the call, 1 for what went wrong on the way."""
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
