"""Claims, commands and writes: each with its answer, although the bus gives commands and writes none.

What a node does with a command it says nowhere, but it shows:

- Rejected: an event with the controller as its source. A node's events and samples arrive in the order it sent them.
- Taken, and nobody else was waited for: the next sample. A required controller that has not answered holds the node, so
  the sample after the one it answered cannot come before its command was taken, nor after its refusal was told.
- Taken, and others are waited for (or nobody is): the count of its commands in the node's status.

The status is answered by the thread of the node that hears the question, which may be before the node's own thread
takes the command. So it is asked for after a question that the node's own thread answers (a question without a body: it
is refused unread). That one can still overtake the command if the node was about to clear its shelf when both came;
then the status shows no change, and both are asked again, or, while a timestep is simulated, after the next message of
the node. Nothing is guessed from time, nothing is asked while nothing can have changed.

A node tells only so many refusals a step. If more were counted than told, and the command was not taken, it was
refused, and the reason stays unknown.

Counting takes one message at a time: a controller's claims, commands and writes wait for each other in a lane.
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
    """A command or write whose fate is open.

    Attributes:
        owner: of a command.
        sent, asked: whether it, and a question about it, is on its way.
        silent, counted: refusals untold before it, and all that the latest status counted.
    """

    request: Request
    node: NodeView
    lane: DeliveryQueue
    owner: Owner | None = None
    answered: frozenset[tuple[int, int, int]] = frozenset()
    sent: bool = False
    asked: bool = False
    silent: int = 0
    counted: int | None = None


@dataclass(slots=True, eq=False)
class DeliveryQueue:
    """What waits under one name at one node; `busy` while one of it is on its way."""

    node: str
    source: str
    waiting: deque[Request] = field(default_factory=deque)
    busy: bool = False
    pending: Pending | None = None


class DeliveryQueues:
    """All lanes.

    Args:
        bus: where it goes.
        nodes: the nodes that are there, by name.
        answer: answers a request; called once for each that was taken.
    """

    def __init__(self, bus: BusSide, nodes: dict[str, NodeView], answer: Answer) -> None:
        self._bus = bus
        self._nodes = nodes
        self._answer = answer
        self._lanes: dict[tuple[str, str], DeliveryQueue] = {}
        self._claiming: list[Owner] = []

    def take(self, request: Request) -> None:
        """A claim, command or write."""
        source = _source(request)
        lane = self._lanes.setdefault((request.node, source), DeliveryQueue(request.node, source))
        lane.waiting.append(request)
        self._next(lane)

    def _next(self, lane: DeliveryQueue) -> None:
        while lane.waiting and not lane.busy:
            request, lane.busy = lane.waiting.popleft(), True
            node = self._nodes.get(lane.node)
            if node is None:
                self._finish(lane, request, denied(NodeNotFound(f"no node {lane.node!r} on the bus")))
            elif isinstance(request.message, Claim):
                self._claim(lane, node, request)
            elif isinstance(request.message, Write):
                self._write(Pending(request, node, lane))
            else:
                self._command(lane, node, request)
        if not lane.waiting and not lane.busy:
            self._lanes.pop((lane.node, lane.source), None)

    def _finish(self, lane: DeliveryQueue, request: Request, answer: Message | BusMessage) -> None:
        """Answers; the next one of the lane is begun by the caller."""
        lane.busy, lane.pending = False, None
        self._answer(request, answer)

    def _settle(self, pending: Pending, answer: Message) -> None:
        if pending.lane.pending is pending:
            self._finish(pending.lane, pending.request, answer)
            self._next(pending.lane)

    # Claims

    def _claim(self, lane: DeliveryQueue, node: NodeView, request: Request) -> None:
        """Presence first: a node that has taken a claim must learn of the controller's end, however soon it comes."""
        claim, peer, name = request.message, request.peer, lane.source
        assert isinstance(claim, Claim)
        owner = Owner(name, peer.route, peer.fd, claim.required, self._bus.token(node.name, name))
        self._claiming.append(owner)

        def then(said: BusMessage | None) -> None:
            if owner in self._claiming:  # else its connection has ended
                self._claiming.remove(owner)
                former: Owner | None = owner
                if said is not None and not said.denied and self._nodes.get(node.name) is node:
                    former = node.owners.get(name)
                    node.owners[name], node.required = owner, None
                if former is not None:
                    former.leave()
            self._finish(lane, request, said or denied(_nobody(node)))
            self._next(lane)

        self._bus.ask(keys.CLAIM, node.name, request.payload, then)

    def gone(self, fd: int) -> None:
        """A connection has ended: so have its controllers."""
        self._leave(lambda owner: owner.fd == fd)

    def heard_from(self, route: bytes, fd: int) -> None:
        """A connection spoke: whoever had its descriptor or its identity before is gone."""
        self._leave(lambda owner: (owner.fd == fd) != (owner.route == route))

    def _leave(self, who: Callable[[Owner], bool]) -> None:
        for owner in [owner for owner in self._claiming if who(owner)]:
            self._claiming.remove(owner)
            owner.leave()
        for node in self._nodes.values():
            for owner in [owner for owner in node.owners.values() if who(owner)]:
                del node.owners[owner.name]
                owner.leave()

    # Commands

    def _command(self, lane: DeliveryQueue, node: NodeView, request: Request) -> None:
        owner = node.owners.get(lane.source)
        if owner is None or owner.route != request.peer.route:
            how = "has claimed nothing" if owner is None else "was claimed again through another connection"
            error = RequestRejected(
                f"{lane.source!r} {how}; claim first, through this connection: {keys.CLAIM.at(node.name)}"
            )
            self._finish(lane, request, denied(error))
            return
        assert isinstance(request.message, Command)
        pending = Pending(request, node, lane, owner, answers(request.message))
        lane.pending = pending
        if owner.accepted is None or node.silent is None or node.refusing:
            self._bus.ask(keys.STATUS, node.name, b"", lambda said: self._counted(pending, said))
        else:
            self._send(pending)

    def _counted(self, pending: Pending, said: BusMessage | None) -> None:
        """The counts before the command."""
        status = self._status(pending, said)
        if status is not None and pending.owner is not None:
            node, owner = pending.node, pending.owner
            found = node.note_status(status, owner)
            owner.accepted = found.accepted if found else 0
            node.silent = refusals(status) - node.told
            self._send(pending)

    def _send(self, pending: Pending) -> None:
        node, owner, request = pending.node, pending.owner, pending.request
        pending.sent, pending.silent = True, node.silent or 0
        self._bus.put(request.key, request.row, request.payload)
        # In a step with refusals the next one may be untold, and no sample follows it.
        if owner is None or node.refusing or not node.waits_only_for(owner):
            self._ask(pending)

    def _ask(self, pending: Pending) -> None:
        pending.asked = True
        self._bus.ask(keys.WEATHER, pending.node.name, b"", lambda said: self._passed(pending, said))

    def _passed(self, pending: Pending, said: BusMessage | None) -> None:
        """The node's own thread has been there."""
        if pending.lane.pending is not pending:
            return
        node = pending.node
        if said is None:
            self._settle(pending, denied(_nobody(node)))
        elif pending.owner is None or (pending.counted is not None and pending.counted - node.told > pending.silent):
            node.silent = None
            self._settle(pending, denied(RequestRejected(f"node {node.name!r} did not take it, and did not say why")))
        else:
            heard = node.heard
            self._bus.ask(keys.STATUS, node.name, b"", lambda said: self._stands(pending, heard, said))

    def _stands(self, pending: Pending, heard: int, said: BusMessage | None) -> None:
        """The counts after the command."""
        status = self._status(pending, said)
        if status is None or pending.owner is None:
            return
        node, owner = pending.node, pending.owner
        found = node.note_status(status, owner)
        if found is not None and found.accepted > (owner.accepted or 0):
            self._accept(pending, failed=status.state is State.FAILED)
        elif status.state in _BUSY and node.heard == heard:
            pending.asked = False
        else:
            pending.counted = refusals(status) if status.state not in _BUSY else None
            self._ask(pending)

    def _status(self, pending: Pending, said: BusMessage | None) -> Status | None:
        if pending.lane.pending is not pending:
            return None
        if said is None:
            self._settle(pending, denied(_nobody(pending.node)))
            return None
        return codec.decode(Status, said.payload, said.encoding)

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
        """A write and the question behind it are done in turn by the node's own thread; the event comes between."""
        pending.lane.pending, pending.sent = pending, True
        self._bus.put(pending.request.key, pending.request.row, pending.request.payload)
        self._ask(pending)

    # What the node says

    def sample(self, node: NodeView, payload: bytes) -> None:
        """A sample came."""
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
        """Whether a sample can show that it was taken: the node waits for it, and did not have it already."""
        owner = pending.owner
        if owner is None or not pending.node.waits:
            return False
        return owner.required and not pending.answered & owner.answered

    def event(self, node: NodeView, event: Event) -> None:
        """An event came."""
        for pending in self._sent(node):
            told = event.source == pending.lane.source
            if told and event.kind in REFUSALS:
                self._settle(pending, denied(RequestRejected(event.text)))
            elif told and event.kind is EventKind.WRITTEN and pending.owner is None:
                self._settle(pending, Ack(episode=[event.episode]))
            elif not pending.asked:
                self._ask(pending)

    def _open(self, node: NodeView) -> list[Pending]:
        return [lane.pending for lane in self._lanes.values() if lane.pending and lane.pending.node is node]

    def _sent(self, node: NodeView) -> list[Pending]:
        return [pending for pending in self._open(node) if pending.sent]

    def lost(self, node: NodeView) -> None:
        """A node is gone, and all that was claimed of it; call it when it is no longer among the nodes."""
        for owner in node.owners.values():
            owner.leave()
        node.owners.clear()
        for pending in self._open(node):
            self._settle(pending, denied(_nobody(node)))


def _source(request: Request) -> str:
    """Under which name a node counts a request and tells of it."""
    if isinstance(request.message, Claim):
        return request.message.controller
    return request.message.source if isinstance(request.message, Write) else request.name


def _nobody(node: NodeView) -> ZenostatError:
    return NodeLost(f"node {node.name!r} is gone")
