"""Temporary signal handlers."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

TERMINATION_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""The signals of Ctrl-C and of `kill`."""


@contextmanager
def override_signals(handler: Callable[[int, Any], Any] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    """Handle these signals with `handler`, and restore the previous handlers on exit. In the main thread only."""
    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in previous.items():
            signal.signal(number, former)
