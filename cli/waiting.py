"""Waiting of commands for a bus and a node that are not there yet."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from zenostat.cli.console import out
from zenostat.topics.errors import NodeNotFound

T = TypeVar("T")

RETRY_S = 1.0
"""Time between two attempts."""


def when_there(attempt: Callable[[], T], *, wait: bool) -> T:
    """Return what an attempt returns, the first one or, with `wait`, that for which the bus and the node are there."""
    waiting = Waiting(wait)
    while True:
        try:
            return attempt()
        except NodeNotFound as error:
            waiting.report(error)
        time.sleep(RETRY_S)


class Waiting:
    """Waiting for the bus and the node; each reason is printed once.

    Args:
        is_allowed: whether to wait at all.
    """

    def __init__(self, is_allowed: bool) -> None:
        self._is_allowed, self._reason = is_allowed, ""

    def report(self, error: NodeNotFound) -> None:
        """Print why the command waits; raise the error if it may not."""
        if not self._is_allowed:
            raise error
        if str(error) != self._reason:
            self._reason = str(error)
            out.print(f"{error}; waiting for it, press Ctrl-C to stop")
