"""Waking a thread that waits for messages, with a message that does not leave the process.

Receiving from Zenoh's handlers has no timeout. So other threads wake such a thread by a message to its subscriber.
Receivers of one session hear each other's wake-ups, so each has a key of its own; and since any program can send to
that key, a wake-up only has the receiver look at its own state.
"""

from __future__ import annotations

import itertools
import threading

import zenoh
from zenoh import Locality

from zenostat.topics import keys

_receivers = itertools.count(1)


class Wake:
    """Callable that wakes the receiver of `key` in this session, from any thread."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session = session
        self.key = key
        # A session must not be closed during a put of another thread. Reentrant: signal handlers wake as well.
        self._lock = threading.RLock()
        self._closed = False

    def __call__(self) -> None:
        """Wake the receiver; no effect after `close`."""
        with self._lock:
            if not self._closed:
                self._session.put(self.key, b"", allowed_destination=Locality.SESSION_LOCAL)

    def close(self) -> None:
        """Disable wake-ups, and wait for one in progress; idempotent."""
        with self._lock:
            self._closed = True


def stream_wake(session: zenoh.Session, node: str) -> Wake:
    """Return a wake-up, with a new key, for one receiver of a node's stream."""
    return Wake(session, keys.wake(node, next(_receivers)))
