"""The latest 200 events of each node, kept since the server was started; of 500 nodes, those with the latest ones."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from typing import Any

import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.presence import undeclare
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import Event, EventKind

_EVENTS = 200
_NODES = 500
_WITHHELD = (EventKind.FAULT,)
"""Events of injected faults would tell a model what it is to diagnose."""


class EventLog:
    """Events by node; to be closed before its bus."""

    def __init__(self, bus: Bus) -> None:
        self._events: OrderedDict[str, deque[Event]] = OrderedDict()
        self._lock = threading.Lock()
        callback: Any = Callback(self._add, indirect=False)
        self._subscriber: Any = bus.session.declare_subscriber(keys.EVENT.at("*"), callback)

    def close(self) -> None:
        """Stop receiving."""
        undeclare(self._subscriber)

    def latest(self, node: str, count: int) -> list[Event]:
        """Return the latest events of a node, the newest one last."""
        with self._lock:
            return [*self._events.get(node, ())][-count:]

    def _add(self, sample: zenoh.Sample) -> None:
        try:
            event = codec.decode(Event, sample.payload.to_bytes(), str(sample.encoding))
        except BadMessage:  # of a stranger
            return
        if event.kind in _WITHHELD:
            return
        node = keys.node_of(str(sample.key_expr))
        with self._lock:
            if node not in self._events and len(self._events) >= _NODES:
                branches = (name for name in self._events if name.rpartition(".")[0] in self._events)
                del self._events[next(branches, next(iter(self._events)))]
            self._events.setdefault(node, deque(maxlen=_EVENTS)).append(event)
            self._events.move_to_end(node)
