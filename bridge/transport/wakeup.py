"""Waking a thread that waits for messages: by one that never leaves the process.

Zenoh's handlers know no timeout, so whoever has news for such a thread puts a message that its subscriber matches.
"""

from __future__ import annotations

import threading

import zenoh
from zenoh import Locality


class Wake:
    """Wakes the receiver of `key` in this session; any thread may call it, until it is closed."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session = session
        self.key = key
        # A session must not be closed while another thread puts. Reentrant: a signal's handler wakes as well.
        self._lock = threading.RLock()
        self._closed = False

    def __call__(self) -> None:
        """Wakes the receiver; nothing once closed."""
        with self._lock:
            if not self._closed:
                self._session.put(self.key, b"", allowed_destination=Locality.SESSION_LOCAL)

    def close(self) -> None:
        """No more; returns once nobody puts. Twice is fine."""
        with self._lock:
            self._closed = True
