"""All open engines of a node, so that a node that ends can kill them from any thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from zenostat.bridge.runtime.contention import CorePlacement
from zenostat.topics.errors import EngineDied

UNRESPONSIVE_S = 10.0
"""Default time after which an engine that neither answers nor uses processor time is killed."""
_CLOSING_UNRESPONSIVE_S = 1.0
"""Time limit while the node is ending."""


class Interruptible(Protocol):
    """An engine."""

    def interrupt(self, reason: str = ...) -> None:
        """Kill the process; thread-safe."""

    def order_close(self) -> bool:
        """Tell it to end, if it has something to release."""

    def await_close(self) -> None:
        """Wait until it has ended, for a limited time."""


class EngineRegistry:
    """All engines of a node that have not been closed; thread-safe.

    Args:
        unresponsive_s: time within which an engine that is waited for must answer or use processor time.

    Attributes:
        closing: whether the node is ending; no more engines start.
        placement: cores of its only engine, if these are fixed.
    """

    def __init__(self, unresponsive_s: float = UNRESPONSIVE_S) -> None:
        self._unresponsive_s = unresponsive_s
        self._clients: set[Interruptible] = set()
        self._lock = threading.Lock()
        self._copies: list[Interruptible] = []
        self._copying_thread, self._cancelled = 0, ""
        self.closing = False
        self.placement: CorePlacement | None = None

    @property
    def unresponsive_s(self) -> float:
        """Time within which an engine must answer or use processor time; short once the node is ending."""
        return min(self._unresponsive_s, _CLOSING_UNRESPONSIVE_S) if self.closing else self._unresponsive_s

    def check_open(self) -> None:
        """Raise `EngineDied` if the node is ending, or the copy is cancelled, and no engine may start."""
        if self.closing:
            raise EngineDied("the node is ending and starts no more engines")
        if self._cancelled and threading.get_ident() == self._copying_thread:
            raise EngineDied(self._cancelled)

    def add(self, client: Interruptible) -> None:
        """Register an engine, so that `interrupt` kills it."""
        with self._lock:
            self._clients.add(client)
            if threading.get_ident() == self._copying_thread:
                self._copies.append(client)

    def remove(self, client: Interruptible) -> None:
        """Unregister an engine that has ended; idempotent."""
        with self._lock:
            self._clients.discard(client)

    @contextmanager
    def copying(self) -> Iterator[None]:
        """Let `cancel_copying` end what starts in this thread within the `with` statement."""
        with self._lock:
            self._copying_thread = threading.get_ident()
        try:
            yield
        finally:
            with self._lock:
                self._copying_thread, self._cancelled = 0, ""
                self._copies.clear()

    def cancel_copying(self, reason: str) -> None:
        """Kill the engines of the copy that is being made, if any, and let no more of it start; thread-safe."""
        with self._lock:
            if not self._copying_thread:
                return
            self._cancelled, copies = reason, [*self._copies]
        for client in copies:
            client.interrupt(reason)

    def close(self) -> None:
        """Let no more engines start, and shorten the time allowed to unresponsive ones."""
        self.closing = True

    def interrupt(self) -> None:
        """Kill all engines, so that threads waiting for them continue; no more engines start."""
        self.close()
        with self._lock:
            clients = [*self._clients]
        for client in clients:
            client.interrupt()

    def end(self) -> None:
        """Let simulators that have something to release do so, all at the same time; then kill all engines."""
        self.close()
        with self._lock:
            clients = [*self._clients]
        closing = [client for client in clients if client.order_close()]
        for client in closing:
            client.await_close()
        self.interrupt()
