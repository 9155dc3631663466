"""The latest 200 events of each node, kept since the server was started; of 500 nodes, those with the latest ones.

Events of a former instance of a node are forgotten when another one of its name starts.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from contextlib import ExitStack
from dataclasses import dataclass, field
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


@dataclass
class _NodeEvents:
    """Events of one instance of a node; the instance is empty until its token arrives."""

    instance: str = ""
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=_EVENTS))


class EventLog:
    """Events by node; to be closed before its bus."""

    def __init__(self, bus: Bus) -> None:
        self._nodes: OrderedDict[str, _NodeEvents] = OrderedDict()
        self._lock = threading.Lock()
        with ExitStack() as undo:
            tokens: Any = bus.session.liveliness().declare_subscriber(
                keys.NODE_TOKEN.at("*", name="*"), Callback(self._on_token, indirect=False), history=True
            )
            undo.callback(undeclare, tokens)
            events: Any = bus.session.declare_subscriber(keys.EVENT.at("*"), Callback(self._add, indirect=False))
            undo.callback(undeclare, events)
            self._close = undo.pop_all()

    def close(self) -> None:
        """Stop receiving."""
        self._close.close()

    def latest(self, node: str, count: int) -> list[Event]:
        """Return the latest events of a node, the newest one last."""
        with self._lock:
            known = self._nodes.get(node)
            return [] if known is None else [*known.events][-count:]

    # In threads of Zenoh's

    def _on_token(self, token: zenoh.Sample) -> None:
        key = str(token.key_expr)
        node, instance = keys.node_of(key), keys.last_chunk(key)
        with self._lock:
            known = self._nodes.get(node)
            if token.kind == zenoh.SampleKind.DELETE:
                if known is not None and known.instance == instance and not known.events:
                    del self._nodes[node]
            elif known is None:
                self._put(node, _NodeEvents(instance))
            elif not known.instance:
                known.instance = instance
            elif known.instance != instance:
                self._put(node, _NodeEvents(instance))

    def _add(self, sample: zenoh.Sample) -> None:
        try:
            event = codec.decode(Event, sample.payload.to_bytes(), str(sample.encoding))
        except BadMessage:  # of a stranger
            return
        if event.kind in _WITHHELD:
            return
        node = keys.node_of(str(sample.key_expr))
        with self._lock:
            known = self._nodes.get(node) or _NodeEvents()
            known.events.append(event)
            self._put(node, known)

    def _put(self, node: str, events: _NodeEvents) -> None:
        """Make a node the latest one; with the lock."""
        if node not in self._nodes and len(self._nodes) >= _NODES:
            branches = (name for name in self._nodes if name.rpartition(".")[0] in self._nodes)
            del self._nodes[next(branches, next(iter(self._nodes)))]
        self._nodes[node] = events
        self._nodes.move_to_end(node)
