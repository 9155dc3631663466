"""Handlers of signals for a while."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

TERMINATION_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""What Ctrl-C sends, and what `kill` sends."""


@contextmanager
def override_signals(handler: Callable[[int, Any], Any] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    """Has `handler` called on these signals, and puts back what was there before. In the main thread only."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
