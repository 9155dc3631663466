"""What a node streams, gathered: for listeners that need not know at once.

A listener that is sent each sample costs each step some wake-ups. Monitors are sent ten batches a second instead, by
the timer's thread; the node's own thread only appends.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import zenoh
from zenoh.handlers import Callback

from bridge.runtime.timer import Timer
from topics import codec

BATCH_S = 0.1
"""How long a message waits for its batch at most."""

_BATCH_BYTES = 1 << 20


class SampleBatcher:
    """One node's.

    Args:
        publisher: of the batches; its owner undeclares it, after `close`.
        timer: sends them.

    Attributes:
        wanted: whether anybody listens; if not, there is nothing to add.
    """

    def __init__(self, publisher: zenoh.Publisher, timer: Timer) -> None:
        self.wanted = False
        self._put, self._timer = publisher.put, timer
        self._gathered: deque[dict[str, Any]] = deque()
        self._due = self._closed = False
        self._sending = threading.Lock()
        publisher.declare_matching_listener(Callback(self._on_listeners, indirect=False))

    def _on_listeners(self, status: zenoh.MatchingStatus) -> None:
        self.wanted = status.matching

    def add(self, topic: str, payload: bytes) -> None:
        """A message as it was sent: its topic below the node's root, and its bytes."""
        self._gathered.append({"topic": topic, "payload": payload})
        if not self._due:
            self._due = True
            self._timer.at(self._timer.clock() + BATCH_S, self._send)

    def close(self) -> None:
        """Sends what is left; nothing more after it."""
        self._send()
        with self._sending:
            self._closed = True

    def _send(self) -> None:
        self._due = False  # first: what is added from now on is sent later
        gathered = self._gathered
        with self._sending:
            while gathered and not self._closed:
                messages, size = [], 0
                while gathered and size < _BATCH_BYTES:
                    messages.append(gathered.popleft())
                    size += len(messages[-1]["payload"])
                self._put(codec.pack(messages=messages))
