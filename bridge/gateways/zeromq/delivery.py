"""Delivery of claims, commands and writes, each with a reply, although the bus has none for commands and writes.

A node does not report what it does with a command, but the gateway can infer it:

- Rejected: an event with the controller as its source. A node's events and samples arrive in the order it sent them.
- Accepted, and the node waited for no other controller: the next sample. The node waits for a required controller that
  has not answered, so the sample after the answered one arrives after its command was accepted, and a rejection would
  have arrived before.
- Accepted, and the node waits for others (or for none): the count of its commands in the node's status.

The node thread that receives a status query replies to it, which may be before the node's main thread processes the
command. So the status is queried after a query that the main thread replies to (one without a payload, which it rejects
unread). That one can still overtake the command if the node was about to run its task queue when both arrived. Then the
status shows no change, and both queries are repeated, or, while a timestep is simulated, sent after the node's next
message. Nothing is inferred from time, and nothing is queried while nothing can have changed.

A node publishes a limited number of rejections per step. If it counted more than it published, and the command was not
accepted, it was rejected for an unknown reason.

Counting requires one message at a time: the claims, commands and writes of a controller wait in a queue.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from bridge.gateways.zeromq.frames import Request, denied
from bridge.gateways.zeromq.node_state import REFUSALS, NodeView, Owner, answers, leads_to, refusals
from bridge.gateways.zeromq.zenoh_side import BusMessage, BusSide
from topics import codec, keys
from topics.errors import NodeLost, NodeNotFound, RequestRejected, ZenostatError, from_wire
from topics.messages import Ack, Claim, Command, Event, EventKind, Message, Sample, State, Status, Write

Answer = Callable[[Request, Message | BusMessage], None]
_BUSY = (State.RUNNING, State.STARTING)


@dataclass(slots=True, eq=False)
class Pending:
    """A command or write whose outcome is unknown.

    Attributes:
        owner: the controller, of a command.
        sent, asked: whether it was sent, and whether a query about it was sent.
        unpublished, counted: unpublished rejections before it, and all rejections in the latest status.
    """

    request: Request
    node: NodeView
    queue: DeliveryQueue
    owner: Owner | None = None
    answered: frozenset[tuple[int, int, int]] = frozenset()
    sent: bool = False
    asked: bool = False
    unpublished: int = 0
    counted: int | None = None


@dataclass(slots=True, eq=False)
class DeliveryQueue:
    """Requests of one name to one node; `busy` while one of them is in progress."""

    node: str
    source: str
    waiting: deque[Request] = field(default_factory=deque)
    busy: bool = False
    pending: Pending | None = None


class DeliveryQueues:
    """All queues.

    Args:
        bus: the bus.
        nodes: the connected nodes, by name.
        answer: replies to a request; called once for each request.
    """

    def __init__(self, bus: BusSide, nodes: dict[str, NodeView], answer: Answer) -> None:
        self._bus = bus
        self._nodes = nodes
        self._answer = answer
        self._queues: dict[tuple[str, str], DeliveryQueue] = {}
        self._claiming: list[Owner] = []

    def take(self, request: Request) -> None:
        """Queue a claim, command or write."""
        source = _source(request)
        queue = self._queues.setdefault((request.node, source), DeliveryQueue(request.node, source))
        queue.waiting.append(request)
        self._next(queue)

    def _next(self, queue: DeliveryQueue) -> None:
        while queue.waiting and not queue.busy:
            request, queue.busy = queue.waiting.popleft(), True
            node = self._nodes.get(queue.node)
            if node is None:
                self._finish(queue, request, denied(NodeNotFound(f"no node {queue.node!r} on the bus")))
            elif isinstance(request.message, Claim):
                self._claim(queue, node, request)
            elif isinstance(request.message, Write):
                self._write(Pending(request, node, queue))
            else:
                self._command(queue, node, request)
        if not queue.waiting and not queue.busy:
            self._queues.pop((queue.node, queue.source), None)

    def _finish(self, queue: DeliveryQueue, request: Request, answer: Message | BusMessage) -> None:
        """Reply to a request; the caller starts the next one of the queue."""
        queue.busy, queue.pending = False, None
        self._answer(request, answer)

    def _settle(self, pending: Pending, answer: Message) -> None:
        if pending.queue.pending is pending:
            self._finish(pending.queue, pending.request, answer)
            self._next(pending.queue)

    # Claims

    def _claim(self, queue: DeliveryQueue, node: NodeView, request: Request) -> None:
        """Declare the token first: a node with the claim must notice the controller's disconnection, however early."""
        claim, peer, name = request.message, request.peer, queue.source
        assert isinstance(claim, Claim)
        owner = Owner(name, peer.route, peer.fd, claim.required, self._bus.token(node.name, name))
        self._claiming.append(owner)

        def then(reply: BusMessage | None) -> None:
            if owner in self._claiming:  # else its connection has ended
                self._claiming.remove(owner)
                former: Owner | None = owner
                if reply is not None and not reply.denied and self._nodes.get(node.name) is node:
                    former = node.owners.get(name)
                    node.owners[name], node.required = owner, None
                if former is not None:
                    former.leave()
            self._finish(queue, request, reply or denied(_node_lost(node)))
            self._next(queue)

        self._bus.ask(keys.CLAIM, node.name, request.payload, then)

    def gone(self, fd: int) -> None:
        """Disconnect the controllers of a connection that has ended."""
        self._leave(lambda owner: owner.fd == fd)

    def drop_superseded(self, route: bytes, fd: int) -> None:
        """Disconnect earlier controllers with the descriptor or the identity of a connection that sent a message."""
        self._leave(lambda owner: (owner.fd == fd) != (owner.route == route))

    def _leave(self, matches: Callable[[Owner], bool]) -> None:
        for owner in [owner for owner in self._claiming if matches(owner)]:
            self._claiming.remove(owner)
            owner.leave()
        for node in self._nodes.values():
            for owner in [owner for owner in node.owners.values() if matches(owner)]:
                del node.owners[owner.name]
                owner.leave()

    # Commands

    def _command(self, queue: DeliveryQueue, node: NodeView, request: Request) -> None:
        owner = node.owners.get(queue.source)
        if owner is None or owner.route != request.peer.route:
            how = "has claimed nothing" if owner is None else "was claimed again through another connection"
            error = RequestRejected(
                f"{queue.source!r} {how}; claim first, through this connection: {keys.CLAIM.at(node.name)}"
            )
            self._finish(queue, request, denied(error))
            return
        assert isinstance(request.message, Command)
        pending = Pending(request, node, queue, owner, answers(request.message))
        queue.pending = pending
        if owner.accepted is None or node.unpublished is None or node.refusing:
            self._bus.ask(keys.STATUS, node.name, b"", lambda reply: self._on_counts(pending, reply))
        else:
            self._send(pending)

    def _on_counts(self, pending: Pending, reply: BusMessage | None) -> None:
        """Record the counts before the command."""
        status = self._status(pending, reply)
        if status is not None and pending.owner is not None:
            node, owner = pending.node, pending.owner
            controller = node.note_status(status, owner)
            owner.accepted = controller.accepted if controller else 0
            node.unpublished = refusals(status) - node.published
            self._send(pending)

    def _send(self, pending: Pending) -> None:
        node, owner, request = pending.node, pending.owner, pending.request
        pending.sent, pending.unpublished = True, node.unpublished or 0
        self._bus.put(request.key, request.row, request.payload)
        # In a step with rejections, the next one may not be published, and no sample follows it.
        if owner is None or node.refusing or not node.waits_only_for(owner):
            self._ask(pending)

    def _ask(self, pending: Pending) -> None:
        pending.asked = True
        self._bus.ask(keys.WEATHER, pending.node.name, b"", lambda reply: self._on_processed(pending, reply))

    def _on_processed(self, pending: Pending, reply: BusMessage | None) -> None:
        """Continue once the node's main thread has processed the command."""
        if pending.queue.pending is not pending:
            return
        node = pending.node
        if reply is None:
            self._settle(pending, denied(_node_lost(node)))
        elif pending.owner is None or (
            pending.counted is not None and pending.counted - node.published > pending.unpublished
        ):
            node.unpublished = None
            self._settle(pending, denied(RequestRejected(f"node {node.name!r} rejected it without a reason")))
        else:
            received = node.received
            self._bus.ask(keys.STATUS, node.name, b"", lambda reply: self._compare_counts(pending, received, reply))

    def _compare_counts(self, pending: Pending, received: int, reply: BusMessage | None) -> None:
        """Compare the counts after the command."""
        status = self._status(pending, reply)
        if status is None or pending.owner is None:
            return
        node, owner = pending.node, pending.owner
        controller = node.note_status(status, owner)
        if controller is not None and controller.accepted > (owner.accepted or 0):
            self._accept(pending, failed=status.state is State.FAILED)
        elif status.state in _BUSY and node.received == received:
            pending.asked = False
        else:
            pending.counted = refusals(status) if status.state not in _BUSY else None
            self._ask(pending)

    def _status(self, pending: Pending, reply: BusMessage | None) -> Status | None:
        if pending.queue.pending is not pending:
            return None
        if reply is None:
            self._settle(pending, denied(_node_lost(pending.node)))
            return None
        return codec.decode(Status, reply.payload, reply.encoding)

    def _accept(self, pending: Pending, *, failed: bool = False) -> None:
        owner, command, failure = pending.owner, pending.request.message, pending.node.failure
        assert owner is not None
        assert isinstance(command, Command)
        owner.accepted = (owner.accepted or 0) + 1
        owner.answered = pending.answered
        if failed and failure is not None:
            self._settle(pending, denied(from_wire({"error": failure.error, "message": failure.text})))
        else:
            self._settle(pending, Ack(episode=command.episode))

    # Writes

    def _write(self, pending: Pending) -> None:
        """Send a write and a query; the node's main thread processes them in order, and the event comes in between."""
        pending.queue.pending, pending.sent = pending, True
        self._bus.put(pending.request.key, pending.request.row, pending.request.payload)
        self._ask(pending)

    # Messages of the node

    def sample(self, node: NodeView, payload: bytes) -> None:
        """Process a sample."""
        sent = self._sent(node)
        if not sent:
            return
        sample = codec.decode(Sample, payload)
        for pending in sent:
            if self._shown(pending) and leads_to(pending.answered, sample.episode, sample.step):
                self._accept(pending)
            elif not pending.asked:
                self._ask(pending)

    @staticmethod
    def _shown(pending: Pending) -> bool:
        """Whether a sample can show that it was accepted: the node waits for it and has no answer yet."""
        owner = pending.owner
        if owner is None or not pending.node.waits:
            return False
        return owner.required and not pending.answered & owner.answered

    def event(self, node: NodeView, event: Event) -> None:
        """Process an event."""
        for pending in self._sent(node):
            is_source = event.source == pending.queue.source
            if is_source and event.kind in REFUSALS:
                self._settle(pending, denied(RequestRejected(event.text)))
            elif is_source and event.kind is EventKind.WRITTEN and pending.owner is None:
                self._settle(pending, Ack(episode=[event.episode]))
            elif not pending.asked:
                self._ask(pending)

    def _open(self, node: NodeView) -> list[Pending]:
        return [queue.pending for queue in self._queues.values() if queue.pending and queue.pending.node is node]

    def _sent(self, node: NodeView) -> list[Pending]:
        return [pending for pending in self._open(node) if pending.sent]

    def lost(self, node: NodeView) -> None:
        """Process a node's disconnection; call it after the node was removed from the nodes."""
        for owner in node.owners.values():
            owner.leave()
        node.owners.clear()
        for pending in self._open(node):
            self._settle(pending, denied(_node_lost(node)))


def _source(request: Request) -> str:
    """Return the source under which a node counts and reports a request."""
    if isinstance(request.message, Claim):
        return request.message.controller
    return request.message.source if isinstance(request.message, Write) else request.name


def _node_lost(node: NodeView) -> ZenostatError:
    return NodeLost(f"node {node.name!r} is gone")
