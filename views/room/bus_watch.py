"""All nodes of a bus, each followed once for all open pages."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.presence import undeclare
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage, NodeNotFound, did_you_mean
from zenostat.topics.messages import Event
from zenostat.views.room.node_watch import NodeWatch
from zenostat.views.room.numbers import to_json
from zenostat.views.room.updates import Updates

MAX_NODES = 500
"""Largest number of nodes that are followed; names on the bus cost nothing to invent."""

OVERVIEW_S = 0.5
"""Least time between two messages with the entries of all nodes, however many nodes change."""

_JOIN_S = 2.0


class BusWatch:
    """Follows presence, states and events of all nodes; to be closed before its bus.

    Args:
        bus: connection to the bus.
        updates: receives the list of nodes (`overview`), and what `NodeWatch` publishes.
    """

    def __init__(self, bus: Bus, updates: Updates) -> None:
        self.bus, self.updates = bus, updates
        self._nodes: dict[str, NodeWatch] = {}
        self._lock = threading.Lock()
        self._quiet: Counter[str] = Counter()
        self._not_followed: set[str] = set()
        self._is_changed, self._closed = threading.Event(), threading.Event()
        self._publisher = threading.Thread(target=self._publish, name="room-overview", daemon=True)
        with ExitStack() as undo:
            session = bus.session
            tokens: Any = session.liveliness().declare_subscriber(
                keys.NODE_TOKEN.at("*", name="*"), Callback(self._on_token, indirect=False), history=True
            )
            undo.callback(undeclare, tokens)
            events: Any = session.declare_subscriber(keys.EVENT.at("*"), Callback(self._on_event, indirect=False))
            undo.callback(undeclare, events)
            self._close = undo.pop_all()
        self._is_changed.set()
        self._publisher.start()

    def close(self) -> None:
        """Stop following; wait a moment for requests that are running."""
        self._closed.set()
        self._is_changed.set()
        self._close.close()
        with self._lock:
            watches = [*self._nodes.values()]
        for watch in watches:
            watch.close()
        deadline = time.monotonic() + _JOIN_S
        for watch in watches:
            watch.join(max(0.0, deadline - time.monotonic()))
        self._publisher.join(max(0.0, deadline - time.monotonic()))

    def find(self, node: str) -> NodeWatch:
        """Return a node that is, or was, on the bus.

        Raises:
            NodeNotFound: there has been none of that name; the text lists similar names.
        """
        with self._lock:
            watch = self._nodes.get(node)
            names = [*self._nodes]
        if watch is None:
            raise NodeNotFound(f"no node {node!r} on the bus; {did_you_mean(node, names)}")
        return watch

    def is_online(self, node: str) -> bool:
        """Return whether a node of a name is on the bus."""
        with self._lock:
            watch = self._nodes.get(node)
        return watch is not None and watch.state is not None

    def watches(self) -> list[NodeWatch]:
        """Return all nodes by name."""
        with self._lock:
            return [self._nodes[name] for name in sorted(self._nodes)]

    @contextmanager
    def without_branches(self, node: str) -> Iterator[Callable[[str], None]]:
        """Do not follow branches that this server makes of a node itself; the function takes the name of each."""
        own: list[str] = []
        with self._lock:
            self._quiet[node] += 1
        try:
            yield own.append
        finally:
            with self._lock:
                self._quiet[node] -= 1
                self._not_followed.difference_update(own)
                if not self._quiet[node]:  # those that are left are of somebody else
                    del self._quiet[node]
                    for name in [name for name in self._not_followed if name.rpartition(".")[0] == node]:
                        self._not_followed.discard(name)
                        self._follow(name)

    def overview(self) -> list[dict[str, Any]]:
        """Return the entries of all nodes; a branch or a replay that has ended has none."""
        entries = [entry for watch in self.watches() if (entry := watch.summary) is not None]
        return [entry for entry in entries if entry["online"] or not (entry["branch_of"] or entry["replay"])]

    # In threads of Zenoh's

    def _on_token(self, token: zenoh.Sample) -> None:
        node = keys.node_of(str(token.key_expr))
        is_present = token.kind == zenoh.SampleKind.PUT
        with self._lock:
            watch = self._nodes.get(node)
            if not is_present:
                self._not_followed.discard(node)
                if watch is not None and watch.description is None:  # nothing of it is known
                    self._forget(node)
            elif watch is None and self._quiet[node.rpartition(".")[0]]:
                self._not_followed.add(node)
            elif watch is None:
                self._follow(node)
        if watch is not None:
            watch.refresh(restarted=is_present)

    def _follow(self, node: str) -> None:
        """Follow a node from now on; with the lock."""
        if self._closed.is_set():
            return
        self._forget_ended_branches()
        if len(self._nodes) >= MAX_NODES:
            self._forget_absent_node()
        if len(self._nodes) < MAX_NODES:
            self._nodes[node] = NodeWatch(self.bus, node, self.updates, self._is_changed.set)

    def _forget_ended_branches(self) -> None:
        """Forget the branches that have ended; planning controllers make many of them."""
        for name, watch in [*self._nodes.items()]:
            description = watch.description
            if watch.state is None and description is not None and description.manifest.branch_of:
                self._forget(name)

    def _forget_absent_node(self) -> None:
        """Forget a node that is not on the bus, one that has never answered before others."""
        absent = [(watch.description is not None, name) for name, watch in self._nodes.items() if watch.is_absent]
        if absent:
            self._forget(min(absent)[1])

    def _forget(self, node: str) -> None:
        watch = self._nodes.pop(node)
        watch.close()
        self.updates.remove(watch.topics)

    def _on_event(self, sample: zenoh.Sample) -> None:
        with self._lock:
            watch = self._nodes.get(keys.node_of(str(sample.key_expr)))
        if watch is None:
            return
        try:
            watch.add_event(codec.decode(Event, sample.payload.to_bytes(), str(sample.encoding)))
        except BadMessage:  # of a stranger
            return

    # In a thread

    def _publish(self) -> None:
        """Publish the entries of all nodes after changes, several of them at once."""
        while self._is_changed.wait() and not self._closed.is_set():
            self._is_changed.clear()
            self.updates.publish("overview", to_json({"nodes": self.overview()}))
            self._closed.wait(OVERVIEW_S)
