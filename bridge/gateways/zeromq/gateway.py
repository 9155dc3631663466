"""The gateway's loop: requests from ZeroMQ to the bus, what nodes say from the bus to ZeroMQ.

One thread owns the sockets and all that is known; it waits on the publisher (subscriptions), the router (requests),
its monitor (connections that end) and a shelf, on which Zenoh's threads put what comes from the bus.
"""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass, field

import zenoh

from bridge.gateways.zeromq.delivery import DeliveryQueues
from bridge.gateways.zeromq.frames import Peer, Request, answer, denied, read, split
from bridge.gateways.zeromq.node_state import NodeView
from bridge.gateways.zeromq.sockets import DEFAULT_COMMAND, DEFAULT_PUBLISH, Sockets, check_endpoint
from bridge.gateways.zeromq.zenoh_side import BusMessage, BusSide
from topics import codec, errors, keys
from topics.errors import (
    BadMessage,
    InvalidConfig,
    NodeLost,
    NodeNotFound,
    RequestRejected,
    ZenostatError,
    did_you_mean,
)
from topics.keys import Delivery, Role
from topics.messages import ErrorReply, Event, EventKind, Manifest, Message

LEASE_S = 10.0

_ECHO = 256  # bytes of a topic that makes no sense
_MOST_WAITING = 1000  # requests for a node whose manifest has not come yet


@dataclass(slots=True)
class _Announced:
    """A node whose presence is known, and whose manifest has not come yet; what is asked of it waits."""

    instances: set[str] = field(default_factory=set)
    waiting: list[Request] = field(default_factory=list)


@dataclass(slots=True)
class Counts:
    """What went through."""

    samples: int = 0
    requests: int = 0
    denied: int = 0


class Gateway:
    """Joins ZeroMQ peers to a bus: `with Gateway(session) as gateway: gateway.run()`.

    Once it is made it is ready: it listens, and knows the nodes that are there. Requests and subscriptions that come
    while it is being made are kept until `run`.

    Args:
        session: an open Zenoh session; it stays the caller's.
        node: a node's name, or `*` for all of the bus.
        publish: endpoint for samples, events and manifests.
        command: endpoint for requests.
        lease_s: a peer that answers no heartbeat for so long is gone; 0.1 to 3600.
        expose: allow endpoints beyond this machine.

    Raises:
        InvalidConfig: an endpoint or a lease that cannot be.
        AddressInUse: another program listens there.
        NodeNotFound: the node that was named is not on the bus.

    Attributes:
        counts: what went through.
        publish, command: the endpoints as bound.
    """

    def __init__(
        self,
        session: zenoh.Session,
        node: str = "*",
        *,
        publish: str = DEFAULT_PUBLISH,
        command: str = DEFAULT_COMMAND,
        lease_s: float = LEASE_S,
        expose: bool = False,
    ) -> None:
        if not 0.1 <= lease_s <= 3600:
            raise InvalidConfig(f"a lease of {lease_s} s; 0.1 to 3600 expected")
        self.node = node if node == "*" else keys.check_name(node, "the node")
        for endpoint in (publish, command):
            check_endpoint(endpoint, expose=expose)
        self.counts = Counts()
        self._stopped = False
        self._nodes: dict[str, NodeView] = {}
        self._announced: dict[str, _Announced] = {}
        self._close = ExitStack()
        with ExitStack() as undo:
            undo.callback(self.close)
            self._sockets = self._close.enter_context(Sockets(publish, command, lease_s=lease_s))
            self.publish, self.command = self._sockets.publish, self._sockets.command
            self._bus = BusSide(session, self._sockets.post)
            self._close.callback(self._bus.close)
            self._lanes = DeliveryQueues(self._bus, self._nodes, self._answer)
            there = self._bus.nodes(self.node)  # first: Zenoh answers emptily while a history of tokens is on its way
            self._bus.listen(self.node, self._heard, self._presence)
            for name in there:
                self._meet(self._bus.fetch(keys.MANIFEST, name))
                self._first_sample(self._bus.fetch(keys.SAMPLE, name))
            undo.pop_all()

    def __enter__(self) -> Gateway:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leaves the bus and closes the sockets; twice is fine."""
        self._close.close()

    def stop(self) -> None:
        """Ends `run`; any thread or signal handler may call it."""
        self._stopped = True
        self._sockets.post(lambda: None)

    def run(self) -> None:
        """Passes messages on until it is stopped."""
        while not self._stopped:
            self._sockets.wait()
            self._sockets.run_pending()
            for prefix in self._sockets.subscriptions():
                self._catch_up(prefix)
            for frames, fd in self._sockets.requests(self._lanes.gone):
                self._lanes.heard_from(frames[0], fd)
                self._request(frames, fd)

    # From the bus

    def _heard(self, said: BusMessage) -> None:
        """A node's manifest, sample or event; what is none is passed over."""
        with suppress(BadMessage):
            self._take(said)

    def _take(self, said: BusMessage) -> None:
        if said.key == keys.MANIFEST.at(keys.node_of(said.key)):
            self._meet(said)
            return
        self._publish(said)
        node = self._nodes.get(keys.node_of(said.key))
        if node is None:
            return
        if said.key == keys.SAMPLE.at(node.name):
            self.counts.samples += 1
            node.latest[said.key.encode()] = _frames(said)
            node.note_sample()
            self._lanes.sample(node, said.payload)
        elif said.key == keys.EVENT.at(node.name):
            event = codec.decode(Event, said.payload, said.encoding)
            node.note_event(event)
            self._lanes.event(node, event)

    def _meet(self, said: BusMessage | None) -> None:
        """A manifest: of a node that has come, or that has changed."""
        if said is None or said.denied:
            return
        try:
            manifest = codec.decode(Manifest, said.payload, said.encoding)
        except BadMessage:
            return
        node = self._nodes.setdefault(manifest.node, NodeView(manifest.node))
        node.note_manifest(manifest)
        node.latest[said.key.encode()] = _frames(said)
        self._publish(said)

    def _first_sample(self, said: BusMessage | None) -> None:
        """The sample that a node stands at which came after the gateway, or was there before it."""
        node = self._nodes.get(keys.node_of(said.key)) if said is not None else None
        if said is not None and node is not None and said.key.encode() not in node.latest:
            node.latest[said.key.encode()] = _frames(said)
            self._publish(said)

    def _presence(self, name: str, instance: str, there: bool) -> None:  # noqa: FBT001
        node = self._nodes.get(name)
        if node is None:
            self._announce(name, instance, there=there)
        elif there:
            node.instances.add(instance)
        else:
            node.instances.discard(instance)
            if not node.instances:
                self._lost(node)

    def _announce(self, name: str, instance: str, *, there: bool) -> None:
        announced = self._announced.setdefault(name, _Announced())
        if there:
            announced.instances.add(instance)
            self._bus.ask(keys.MANIFEST, name, None, lambda said: self._came(name, said))
        else:
            announced.instances.discard(instance)
        if not announced.instances:
            self._settle(name)

    def _came(self, name: str, said: BusMessage | None) -> None:
        """An announced node has said what it is; its sample is asked for only now, so that it finds its node."""
        self._meet(said)
        if name in self._nodes:
            self._bus.ask(keys.SAMPLE, name, None, self._first_sample)
        self._settle(name)

    def _settle(self, name: str) -> None:
        """What waited for an announced node is done, or refused if it has gone."""
        announced = self._announced.pop(name, None)
        if announced is None:
            return
        if node := self._nodes.get(name):
            node.instances |= announced.instances
        for request in announced.waiting:
            self._do(request)

    def _lost(self, node: NodeView) -> None:
        """A node that could not say so itself is said to have failed."""
        del self._nodes[node.name]
        self._lanes.lost(node)
        if not node.stopped:
            error = NodeLost(f"node {node.name!r} is gone")
            event = Event(kind=EventKind.FAILED, text=str(error), error=errors.to_wire(error)["error"])
            self._publish(BusMessage(keys.EVENT.at(node.name), codec.encoding(Event), codec.encode(event)))

    def _publish(self, said: BusMessage) -> None:
        self._sockets.put(_frames(said))

    def _catch_up(self, prefix: bytes) -> None:
        """Somebody has subscribed: the latest of what was asked for, so that nobody waits for what has been said.

        A subscription takes its time. A controller that claims meanwhile could miss the sample that it must answer;
        this way whoever has seen any sample has seen the latest.
        """
        for node in self._nodes.values():
            for topic, frames in node.latest.items():
                if topic.startswith(prefix):
                    self._sockets.put(frames)

    # From ZeroMQ

    def _request(self, frames: list[bytes], fd: int) -> None:
        self.counts.requests += 1
        peer, rest = split(frames, fd)
        try:
            request = read(peer, rest)
            if self.node not in ("*", request.node):
                raise NodeNotFound(f"this gateway is for node {self.node!r} alone, not for {request.node!r}")
        except ZenostatError as error:
            self._send(peer, rest[0][:_ECHO] if rest else b"", denied(error))
            return
        announced = self._announced.get(request.node)
        if announced is None:
            self._do(request)
        elif len(announced.waiting) < _MOST_WAITING:
            announced.waiting.append(request)
        else:
            self._answer(
                request, denied(RequestRejected(f"node {request.node!r} has not said yet what it is; ask again later"))
            )

    def _do(self, request: Request) -> None:
        if request.node not in self._nodes:
            why = f"no node {request.node!r} on the bus; {did_you_mean(request.node, self._nodes)}"
            self._answer(request, denied(NodeNotFound(why)))
        elif request.row in (keys.COMMAND, keys.CLAIM, keys.ACTUATOR):
            self._lanes.take(request)
        else:
            self._query(request)

    def _query(self, request: Request) -> None:
        lost = NodeLost(f"node {request.node!r} is gone")
        fetched = request.row.sender is Role.NODE or request.row.delivery is not Delivery.QUERY
        question = None if fetched else request.payload
        self._bus.ask(request.row, request.node, question, lambda said: self._answer(request, said or denied(lost)))

    def _answer(self, request: Request, answered: Message | BusMessage) -> None:
        self._send(request.peer, request.topic, answered)

    def _send(self, peer: Peer, topic: bytes, answered: Message | BusMessage) -> None:
        if isinstance(answered, Message):
            said = BusMessage("", codec.encoding(type(answered)), codec.encode(answered))
        else:
            said = answered
        self.counts.denied += said.encoding == codec.encoding(ErrorReply)
        self._sockets.send(answer(peer, topic, said.encoding, said.payload))


def _frames(said: BusMessage) -> list[bytes]:
    return [said.key.encode(), said.encoding.encode(), said.payload]
