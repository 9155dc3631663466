"""Delivery of claims and commands, one at a time for each controller, in the order received.

A controller may command only through the connection through which it claimed. Whether it did is known once the node has
replied to its claim. So its next request waits for that reply.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from zenostat.gateways.bus_side import BusMessage, BusSide
from zenostat.gateways.zeromq.frames import Request, denied
from zenostat.topics import keys
from zenostat.topics.errors import NodeLost, NodeNotFound, RequestRejected, ZenostatError
from zenostat.topics.messages import Claim, Message

Answer = Callable[[Request, Message | BusMessage], None]


@dataclass(slots=True, eq=False)
class Owner:
    """A controller that claimed through the gateway.

    Attributes:
        route, fd: routing id and file descriptor of its connection.
        leave: undeclares its liveliness token, once it has one.
    """

    name: str
    route: bytes
    fd: int
    leave: Callable[[], None] = lambda: None


@dataclass(slots=True, eq=False)
class NodeView:
    """A node.

    Attributes:
        instances: its declared liveliness tokens.
        latest: frames of its manifest and its latest sample, by topic.
        owners: the controllers that use this gateway, by name.
        stopped: whether it published that it stops.
    """

    name: str
    instances: set[str] = field(default_factory=set)
    latest: dict[bytes, list[bytes]] = field(default_factory=dict)
    owners: dict[str, Owner] = field(default_factory=dict)
    stopped: bool = False


class DeliveryQueues:
    """The claims and commands of all controllers.

    Args:
        bus: the bus.
        nodes: the connected nodes, by name.
        answer: replies to a request; called once for each request.
    """

    def __init__(self, bus: BusSide, nodes: dict[str, NodeView], answer: Answer) -> None:
        self._bus = bus
        self._nodes = nodes
        self._answer = answer
        self._queues: dict[tuple[str, str], deque[Request]] = {}  # the first request of each is in progress
        self._claiming: list[Owner] = []

    def take(self, request: Request) -> None:
        """Queue a claim or a command."""
        name = request.sender
        queue = self._queues.setdefault((request.node, name), deque())
        queue.append(request)
        if len(queue) == 1:
            self._next(request.node, name)

    def _next(self, node_name: str, name: str) -> None:
        """Send the first request of a controller to the node; reply to those that cannot be sent."""
        queue = self._queues[node_name, name]
        while queue:
            node = self._nodes.get(node_name)
            error = self._why_not(node, queue[0], name)
            if node is not None and error is None:
                self._send(node, queue[0], name)
                return
            self._answer(queue.popleft(), denied(error or _node_lost(node_name)))
        del self._queues[node_name, name]

    @staticmethod
    def _why_not(node: NodeView | None, request: Request, name: str) -> ZenostatError | None:
        if node is None:
            return NodeNotFound(f"no node {request.node!r} on the bus")
        owner = node.owners.get(name)
        if owner is not None and owner.route == request.peer.route:
            return None
        if isinstance(request.message, Claim):
            return None if owner is None else _is_connected(name)
        how = "has claimed nothing" if owner is None else "is connected through another connection"
        return RequestRejected(
            f"{name!r} {how}; claim first, through this connection: {keys.CLAIM.at(node.name, sender=name)}"
        )

    def _send(self, node: NodeView, request: Request, name: str) -> None:
        def then(reply: BusMessage | None) -> None:
            self._finish(node, name, reply or denied(_node_lost(node.name)))

        if isinstance(request.message, Claim):
            self._claim(node, request, name)
        else:
            self._bus.ask(request.row, node.name, request.payload, then, sender=name)

    def _finish(self, node: NodeView, name: str, reply: Message | BusMessage) -> None:
        """Answer the request in progress of a controller, and send the next one."""
        self._answer(self._queues[node.name, name].popleft(), reply)
        self._next(node.name, name)

    # Owners

    def _claim(self, node: NodeView, request: Request, name: str) -> None:
        """Send a claim unless a controller of that name that does not use this gateway is on the bus.

        The token is declared first: a node with the claim must notice the controller's disconnection, however early.
        """
        owner = Owner(name, request.peer.route, request.peer.fd)
        self._claiming.append(owner)

        def on_reply(reply: BusMessage | None) -> None:
            self._end_claim(node, owner, is_accepted=reply is not None and not reply.denied)
            self._finish(node, name, reply or denied(_node_lost(node.name)))

        def on_token(is_connected: bool) -> None:  # noqa: FBT001
            reason: ZenostatError | None = _is_connected(name) if is_connected else None
            if owner not in self._claiming:
                reason = RequestRejected(f"the connection of {name!r} has ended")
            elif self._nodes.get(node.name) is not node:
                reason = _node_lost(node.name)
            if reason is None:
                owner.leave = self._bus.token(node.name, name)
                self._bus.ask(request.row, node.name, request.payload, on_reply, sender=name)
            else:
                self._end_claim(node, owner, is_accepted=False)
                self._finish(node, name, denied(reason))

        self._bus.has_token(node.name, name, on_token)

    def _end_claim(self, node: NodeView, owner: Owner, *, is_accepted: bool) -> None:
        if owner not in self._claiming:
            return  # its connection has ended
        self._claiming.remove(owner)
        former: Owner | None = owner
        if is_accepted and self._nodes.get(node.name) is node:
            former = node.owners.get(owner.name)
            node.owners[owner.name] = owner
        if former is not None:
            former.leave()

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

    @staticmethod
    def lost(node: NodeView) -> None:
        """Disconnect the controllers of a node that has disconnected; Zenoh ends its queries."""
        for owner in node.owners.values():
            owner.leave()
        node.owners.clear()


def _is_connected(name: str) -> RequestRejected:
    return RequestRejected(
        f"a controller {name!r} is connected already; end its connection first, or choose another name"
    )


def _node_lost(name: str) -> ZenostatError:
    return NodeLost(f"node {name!r} is gone")
