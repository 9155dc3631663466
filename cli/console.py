"""Consoles, progress bars and signals shared by the commands."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from topics.errors import ZenostatError

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def print_error(text: str) -> None:
    """Print an error as plain text: names in brackets are not markup."""
    err.print("error:", style="bold red", end=" ")
    err.print(text, markup=False, soft_wrap=True)


@contextmanager
def progress() -> Iterator[Progress]:
    """Show progress bars over timesteps, with their rate, in a terminal; a `ZenostatError` removes them."""
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=out,
        transient=False,
        disable=not out.is_interactive,
    )
    stop = bars.stop
    bars.start()
    try:
        yield bars
    except ZenostatError:
        bars.live.transient, stop = True, bars.live.stop  # `bars.stop` prints an empty line
        raise
    finally:
        stop()


@contextmanager
def until_signal() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set, for commands that shut down cleanly."""
    stop = threading.Event()
    with override_signals(lambda *_: stop.set(), *TERMINATION_SIGNALS):
        yield stop
