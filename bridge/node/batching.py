"""Batches of the messages that a node publishes, for monitors, which can wait for them.

Sending each sample to a listener costs each step several thread wake-ups. Monitors receive ten batches per second
instead, sent by the timer's thread; the server's thread only appends.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import codec

BATCH_S = 0.1
"""Maximum time that a message waits for its batch."""

_BATCH_BYTES = 1 << 20


class SampleBatcher:
    """Collects the messages of one node and publishes them in batches.

    Args:
        publisher: of the batches; the caller undeclares it after `close`.
        timer: calls `_send`.

    Attributes:
        has_listeners: whether anything subscribes to the batches; if not, nothing needs to be added.
    """

    def __init__(self, publisher: zenoh.Publisher, timer: Timer) -> None:
        self.has_listeners = False
        self._put, self._timer = publisher.put, timer
        self._messages: deque[dict[str, Any]] = deque()
        self._is_scheduled = self._is_closed = False
        self._send_lock = threading.Lock()
        publisher.declare_matching_listener(Callback(self._on_listeners, indirect=False))

    def _on_listeners(self, status: zenoh.MatchingStatus) -> None:
        self.has_listeners = status.matching

    def add(self, topic: str, payload: bytes) -> None:
        """Add a message: its topic below the node's root, and its payload as published."""
        self._messages.append({"topic": topic, "payload": payload})
        if not self._is_scheduled:
            self._is_scheduled = True
            self._timer.at(self._timer.clock() + BATCH_S, self._send)

    def close(self) -> None:
        """Send the remaining messages; nothing is sent afterwards."""
        self._send()
        with self._send_lock:
            self._is_closed = True

    def _send(self) -> None:
        self._is_scheduled = False  # first: messages added from now on schedule another batch
        pending = self._messages
        with self._send_lock:
            while pending and not self._is_closed:
                messages, size = [], 0
                while pending and size < _BATCH_BYTES:
                    messages.append(pending.popleft())
                    size += len(messages[-1]["payload"])
                self._put(codec.pack(messages=messages))
