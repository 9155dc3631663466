"""Consoles, progress bars and signals shared by the commands.

What is printed comes from nodes, files and other programs as well: no text is markup, and no control character of a
text reaches the terminal.
"""

from __future__ import annotations

import json
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TimeRemainingColumn
from rich.text import Text
from typing_extensions import override

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.topics.errors import ZenostatError
from zenostat.topics.printable import replace_controls, replace_controls_in_lines


class _PlainConsole(Console):
    """A console on which texts are plain, and only the terminal breaks their lines.

    Attributes:
        is_json: whether it prints a JSON object for each text, in a line.
    """

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)
        self.is_json = False

    @override
    def print(self, *objects: Any, **options: Any) -> None:
        if all(isinstance(each, str) for each in objects):
            options.setdefault("soft_wrap", True)
        if not self.is_json:
            super().print(*objects, **options)
            return
        with self.capture() as printed:
            super().print(*objects, **(options | {"style": None, "soft_wrap": True}))
        self.entry("info", printed.get().strip())

    def warning(self, text: str) -> None:
        """Print a warning."""
        if self.is_json:
            self.entry("warning", text)
        else:
            self.print(f"warning: {text}", style="yellow")

    def entry(self, level: str, message: str, **fields: Any) -> None:
        """Print an entry of a log: time, level and message, and further fields without those that are empty."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        known = {name: value for name, value in fields.items() if value not in (None, "")}
        line = json.dumps({"time": now, "level": level, "message": message, **known}, ensure_ascii=False)
        self.file.write(replace_controls(line) + "\n")
        self.file.flush()

    @override
    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(replace_controls_in_lines(text), **options)


class _PlainColumn(ProgressColumn):
    """A text of a progress bar, such as `{task.description}`."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    @override
    def render(self, task: Task) -> Text:
        return Text(replace_controls(self._text.format(task=task)))


out = _PlainConsole()
err = _PlainConsole(stderr=True)


@contextmanager
def warnings_printed() -> Iterator[None]:
    """Print the warnings of the body of a `with` statement after it, one line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        err.print(str(warning.message))


def log_as_json() -> None:
    """Print a JSON object in each line from now on, on both consoles."""
    out.is_json = err.is_json = True


def print_error(text: str) -> None:
    """Print an error."""
    if err.is_json:
        err.entry("error", text)
        return
    err.print("error:", style="bold red", end=" ")
    err.print(text)


@contextmanager
def progress() -> Iterator[Progress]:
    """Show progress bars over timesteps, with their rate, in a terminal; a `ZenostatError` removes them."""
    bars = Progress(
        _PlainColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _PlainColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=out,
        transient=False,
        disable=out.is_json or not out.is_interactive,
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
    """An event that `TERMINATION_SIGNALS` set, for commands that shut down cleanly."""
    stop = threading.Event()
    with override_signals(lambda *_: stop.set(), *TERMINATION_SIGNALS):
        yield stop
