"""The `zenostat` command."""

from __future__ import annotations

import sys

import typer

from cli import demo, monitor, node, points, run, status
from cli.console import say_error
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
for command in (node.node, monitor.monitor, run.run, status.status, points.points, demo.demo):
    app.command()(command)


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
