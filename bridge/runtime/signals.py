"""Temporary signal handlers."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_ENDS_WITH_TERMINAL = signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN
TERMINATION_SIGNALS = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if _ENDS_WITH_TERMINAL else []))
"""The signals of Ctrl-C, of `kill` and of a closed terminal, which a program that `nohup` has started outlives."""


class Terminated(SystemExit):  # an outcome, as `SystemExit` is
    """A signal ends the program."""


@contextmanager
def override_signals(handler: Callable[[int, Any], Any] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    """Handle these signals with `handler`, and restore the previous handlers on exit. In the main thread only."""
    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in previous.items():
            signal.signal(number, former)


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Let a Ctrl-C of this block take effect at its end; in threads other than the main one, nothing changes."""
    if threading.current_thread() is not threading.main_thread():  # Ctrl-C interrupts only the main thread
        yield
        return
    received: list[int] = []
    with override_signals(lambda number, _: received.append(number), signal.SIGINT):
        yield
    if received:
        signal.raise_signal(signal.SIGINT)
