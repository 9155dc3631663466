"""The gateway's main loop: requests from ZeroMQ to the bus, messages of nodes from the bus to ZeroMQ.

One thread owns the sockets and all state. It waits on the publisher (subscriptions), the router (requests), the
router's monitor (ended connections) and a task queue, to which Zenoh's threads post the messages of the bus.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field

import zenoh

from zenostat.bridge.runtime.service_manager import reported
from zenostat.gateways.bus_side import BusMessage, BusSide
from zenostat.gateways.clients import EVERYTHING, UNRESTRICTED, Clients
from zenostat.gateways.notices import Notices
from zenostat.gateways.zeromq.delivery_queues import DeliveryQueues, NodeView
from zenostat.gateways.zeromq.frames import Peer, Request, answer, denied, read, split
from zenostat.gateways.zeromq.sockets import DEFAULT_COMMAND, DEFAULT_PUBLISH, Sockets, check_endpoint
from zenostat.topics import codec, errors, keys
from zenostat.topics.errors import (
    AccessDenied,
    BadMessage,
    InvalidConfig,
    NodeLost,
    NodeNotFound,
    RequestRejected,
    ZenostatError,
    did_you_mean,
)
from zenostat.topics.keys import Delivery, Role
from zenostat.topics.messages import Claim, ErrorReply, Event, EventKind, Manifest, Message

LEASE_S = 10.0

MAX_IN_PROGRESS = 100
"""Largest number of requests of one connection that are not answered yet; further ones are rejected."""

_ECHO = 256  # bytes of an invalid topic that are returned in the reply
_MAX_WAITING = 1000  # requests for a node whose manifest has not arrived yet


@dataclass(slots=True)
class _Announced:
    """A connected node whose manifest has not arrived yet; its requests wait."""

    instances: set[str] = field(default_factory=set)
    waiting: list[Request] = field(default_factory=list)


@dataclass(slots=True)
class Counts:
    """Counts of forwarded messages."""

    samples: int = 0
    requests: int = 0
    denied: int = 0


class Gateway:
    """Connects ZeroMQ peers to a bus: `with Gateway(session) as gateway: gateway.run()`.

    The constructor queries the nodes and binds the sockets. Requests and subscriptions that arrive meanwhile are kept
    until `run`.

    Args:
        session: an open Zenoh session, which the caller closes.
        node: a node's name, or `*` for all nodes on the bus.
        publish: endpoint for samples, events and manifests.
        command: endpoint for requests.
        lease_s: a peer that answers no heartbeat for this time is disconnected; 0.1 to 3600.
        expose: allow endpoints that other machines can reach.
        identity: the name in the gateway's certificate; its clients send under that name, or names below it.
        why_gone: returns how its own certificate may be the reason that a node is gone, to end a sentence; see
            `zenostat.bridge.transport.session.OpenSession`.
        clients: what the clients may write by the names under which they send; `*` permits all requests.
        notify: called with a line for the operator about each denied request, once.

    Raises:
        InvalidConfig: an invalid endpoint or lease.
        AddressInUse: another program listens there.
        NodeNotFound: the named node is not on the bus.

    Attributes:
        counts: counts of forwarded messages.
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
        identity: str = "",
        why_gone: Callable[[], str] = str,
        clients: Clients = UNRESTRICTED,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        if not 0.1 <= lease_s <= 3600:
            raise InvalidConfig(f"a lease of {lease_s} s; 0.1 to 3600 expected")
        self.node = node if node == "*" else keys.check_name(node, "the node")
        for endpoint in (publish, command):
            check_endpoint(endpoint, expose=expose)
        self.counts = Counts()
        self._identity, self._why_gone = identity, why_gone
        self._clients, self._notices = clients, Notices(notify)
        self._stopped = False
        self._nodes: dict[str, NodeView] = {}
        self._announced: dict[str, _Announced] = {}
        self._in_progress = Counter[bytes]()  # by routing id
        self._close = ExitStack()
        with ExitStack() as undo:
            undo.callback(self.close)
            self._bus = BusSide(session, lambda task: self._sockets.post(task), "zeromq")  # noqa: PLW0108
            self._close.callback(self._bus.close)
            self._queues = DeliveryQueues(self._bus, self._nodes, self._answer)
            # Before the sockets, which would take requests from their peers' queues and lose them if there is no node;
            # and before `listen`: Zenoh replies without tokens while it transfers their history.
            names = self._bus.nodes(self.node)
            self._sockets = self._close.enter_context(Sockets(publish, command, lease_s=lease_s))
            self.publish, self.command = self._sockets.publish, self._sockets.command
            self._bus.listen(self.node, self._receive, self._presence)
            for name in names:
                self._register_node(self._bus.fetch(keys.MANIFEST, name))
                self._first_sample(self._bus.fetch(keys.SAMPLE, name))
            undo.pop_all()

    def __enter__(self) -> Gateway:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect from the bus and close the sockets; idempotent."""
        self._close.close()

    def stop(self) -> None:
        """Stop `run`; any thread or signal handler may call it."""
        self._stopped = True
        self._sockets.post(lambda: None)

    def run(self) -> None:
        """Forward messages until it is stopped."""
        with reported(self._sockets.post):
            while not self._stopped:
                self._forward_pending()

    def _forward_pending(self) -> None:
        """Wait for messages, and forward them."""
        has_messages = self._sockets.wait()
        self._sockets.run_pending()
        if not has_messages:
            return
        for prefix in self._sockets.subscriptions():
            self._catch_up(prefix)
        for frames, fd in self._sockets.requests(self._queues.gone):
            self._queues.drop_superseded(frames[0], fd)
            self._request(frames, fd)

    # From the bus

    def _receive(self, message: BusMessage) -> None:
        """Post a message of a node to the gateway's thread; Zenoh's threads call it."""
        self._sockets.post(lambda: self._on_message(message))

    def _on_message(self, message: BusMessage) -> None:
        """Process a manifest, sample or event of a node; ignore invalid messages."""
        with suppress(BadMessage):
            self._forward(message)

    def _forward(self, message: BusMessage) -> None:
        if message.key == keys.MANIFEST.at(keys.node_of(message.key)):
            self._register_node(message)
            return
        self._publish(message)
        node = self._nodes.get(keys.node_of(message.key))
        if node is None:
            return
        if message.key == keys.SAMPLE.at(node.name):
            self.counts.samples += 1
            node.latest[message.key.encode()] = _frames(message)
        elif message.key == keys.EVENT.at(node.name):
            event = codec.decode(Event, message.payload, message.encoding)
            node.stopped = node.stopped or event.kind is EventKind.STOPPED

    def _register_node(self, message: BusMessage | None) -> None:
        """Process the manifest of a new or changed node."""
        if message is None or message.denied:
            return
        try:
            manifest = codec.decode(Manifest, message.payload, message.encoding)
        except BadMessage:
            return
        node = self._nodes.setdefault(manifest.node, NodeView(manifest.node))
        node.latest[message.key.encode()] = _frames(message)
        self._publish(message)

    def _first_sample(self, message: BusMessage | None) -> None:
        """Process the current sample of a node, unless a later one has already arrived."""
        node = self._nodes.get(keys.node_of(message.key)) if message is not None else None
        if message is not None and node is not None and message.key.encode() not in node.latest:
            node.latest[message.key.encode()] = _frames(message)
            self._publish(message)

    def _presence(self, name: str, instance: str, is_connected: bool) -> None:  # noqa: FBT001
        node = self._nodes.get(name)
        if node is None:
            self._announce(name, instance, is_connected=is_connected)
        elif is_connected:
            node.instances.add(instance)
        else:
            node.instances.discard(instance)
            if not node.instances:
                self._lost(node)

    def _announce(self, name: str, instance: str, *, is_connected: bool) -> None:
        announced = self._announced.setdefault(name, _Announced())
        if is_connected:
            announced.instances.add(instance)
            self._bus.ask(keys.MANIFEST, name, None, lambda message: self._on_manifest(name, message))
        else:
            announced.instances.discard(instance)
        if not announced.instances:
            self._settle(name)

    def _on_manifest(self, name: str, message: BusMessage | None) -> None:
        """Process an announced node's manifest, and query its sample, for which the node must be registered."""
        self._register_node(message)
        if name in self._nodes:
            self._bus.ask(keys.SAMPLE, name, None, self._first_sample)
        self._settle(name)

    def _settle(self, name: str) -> None:
        """Process the waiting requests of an announced node; they are rejected if it has disconnected."""
        announced = self._announced.pop(name, None)
        if announced is None:
            return
        if node := self._nodes.get(name):
            node.instances |= announced.instances
        for request in announced.waiting:
            self._process(request)

    def _lost(self, node: NodeView) -> None:
        """Process a node's disconnection; publish a failure event if the node published no stop event."""
        del self._nodes[node.name]
        self._queues.lost(node)
        if not node.stopped:
            if self._identity:
                self._notices.add(f"{node.name}: gone{self._why_gone()}")
            error = NodeLost(f"node {node.name!r} is gone")
            event = Event(kind=EventKind.FAILED, text=str(error), error=errors.to_wire(error)["error"])
            self._publish(BusMessage(keys.EVENT.at(node.name), codec.encoding(Event), codec.encode(event)))

    def _publish(self, message: BusMessage) -> None:
        self._sockets.put(_frames(message))

    def _catch_up(self, prefix: bytes) -> None:
        """Publish the latest messages to a new subscriber.

        A subscription takes some time. A controller that claims meanwhile could miss the sample that it must answer;
        with this, a peer that has received any sample has received the latest one.
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
            if self._in_progress[peer.route] >= MAX_IN_PROGRESS:
                raise RequestRejected(
                    f"{MAX_IN_PROGRESS} requests of this connection are not answered yet; wait for their replies"
                )
            request = read(peer, rest)
            if self.node not in ("*", request.node):
                raise NodeNotFound(f"this gateway is for node {self.node!r} alone, not for {request.node!r}")
            if self._identity and request.sender and not keys.is_own(self._identity, request.sender):
                raise AccessDenied(
                    f"this gateway sends as {self._identity!r}, and for its clients under names below it; send as "
                    f"{keys.own_name(self._identity, request.sender)!r}"
                )
            self._check_permission(request)
        except ZenostatError as error:
            self._send(peer, rest[0][:_ECHO] if rest else b"", denied(error))
            return
        self._in_progress[peer.route] += 1
        announced = self._announced.get(request.node)
        if announced is None:
            self._process(request)
        elif len(announced.waiting) < _MAX_WAITING:
            announced.waiting.append(request)
        else:
            self._answer(
                request,
                denied(RequestRejected(f"the manifest of node {request.node!r} has not arrived; try again later")),
            )

    def _check_permission(self, request: Request) -> None:
        """Raise `AccessDenied` unless a client may send a request; those that only read are everybody's."""
        if not self._clients.is_restricted or not request.row.has_sender:
            return
        client = self._clients.of_sender(request.sender.removeprefix(f"{self._identity}."))
        if request.row is keys.COMMAND_REQUEST and self._clients.may_write(client):
            return  # the actuators are those of its claim
        try:
            self._clients.check(client, _written(request))
        except AccessDenied as error:
            self._notices.add(f"{request.row.key} of {request.sender} was denied: {error}")
            raise

    def _process(self, request: Request) -> None:
        if request.node not in self._nodes:
            denied_by = "" if self._nodes else self._why_gone()
            why = f"no node {request.node!r} on the bus; {did_you_mean(request.node, self._nodes)}{denied_by}"
            self._answer(request, denied(NodeNotFound(why)))
        elif request.row in (keys.COMMAND_REQUEST, keys.CLAIM):
            self._queues.take(request)
        else:
            self._query(request)

    def _query(self, request: Request) -> None:
        lost = NodeLost(f"node {request.node!r} is gone")
        fetched = request.row.sender is Role.NODE or request.row.delivery is not Delivery.QUERY
        question = None if fetched else request.payload

        def then(reply: BusMessage | None) -> None:
            self._answer(request, reply or denied(lost))

        self._bus.ask(request.row, request.node, question, then, name=request.name, sender=request.sender)

    def _answer(self, request: Request, answered: Message | BusMessage) -> None:
        """Reply to a request; called once for each."""
        route = request.peer.route
        self._in_progress[route] -= 1
        if not self._in_progress[route]:
            del self._in_progress[route]
        self._send(request.peer, request.topic, answered)

    def _send(self, peer: Peer, topic: bytes, answered: Message | BusMessage) -> None:
        if isinstance(answered, Message):
            message = BusMessage("", codec.encoding(type(answered)), codec.encode(answered))
        else:
            message = answered
        self.counts.denied += message.encoding == codec.encoding(ErrorReply)
        self._sockets.send(answer(peer, topic, message.encoding, message.payload))


def _written(request: Request) -> list[str]:
    """Return the actuators that a request writes or claims; `*` for all of them, and for any other request.

    A claim of no actuators is another request: a node in lockstep waits for the controller nevertheless.
    """
    if request.row is keys.WRITE_REQUEST:
        return [request.name]
    if isinstance(request.message, Claim) and request.message.actuators:
        return request.message.actuators
    return [EVERYTHING]


def _frames(message: BusMessage) -> list[bytes]:
    return [message.key.encode(), message.encoding.encode(), message.payload]
