"""Send a request to a node, and decode its reply."""

from __future__ import annotations

from typing import Generic, TypeVar

import zenoh

from zenostat.topics import codec, keys
from zenostat.topics.client_protocol import attachment
from zenostat.topics.errors import BadMessage, PeerError, from_wire
from zenostat.topics.messages import ErrorReply, Message
from zenostat.topics.printable import replace_controls

M = TypeVar("M", bound=Message)


class PendingReply(Generic[M]):
    """A request that was sent to a node, and its reply, which may still be on its way.

    Args:
        replies: of the request.
        topic: of the request.
        node: the node's name.
        reply_type: class of the reply.
        token: gives up the request.
    """

    def __init__(
        self,
        replies: zenoh.Handler[zenoh.Reply],
        topic: keys.Topic,
        node: str,
        reply_type: type[M],
        token: zenoh.CancellationToken,
    ) -> None:
        self._replies, self._topic, self._node, self._type, self._token = replies, topic, node, reply_type, token

    def cancel(self) -> None:
        """Let `wait` return None soon, although the node may still work; thread-safe."""
        self._token.cancel()  # type: ignore[no-untyped-call]  # of zenoh, whose stub lacks the type

    @property
    def is_cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._token.is_cancelled

    def wait(self) -> M | None:
        """Return the reply; None, at once, if no node of that name is on the bus or if it does not know the topic.

        Raises:
            ZenostatError: the error that the node replied with.
            PeerError: the node did not answer.
            BadMessage: the reply is not valid.
            zenoh.ZError: the session is closed.
        """
        reason = None
        for reply in self._replies:
            if reply.ok is None:  # of one way to the node; the reply may come on another one
                reason = reply.err.payload.to_string() if reply.err else "no reason given"
                continue
            encoding, payload = str(reply.ok.encoding), reply.ok.payload.to_bytes()
            if encoding == codec.encoding(ErrorReply):
                raise from_wire(codec.decode(ErrorReply, payload, encoding).__dict__)
            return codec.decode(self._type, payload, encoding)
        if reason is not None:
            what = self._topic.key.partition("/{")[0]
            raise PeerError(f"node {self._node!r} did not answer {what}: {replace_controls(reason)}")
        return None


def send_request(
    session: zenoh.Session,
    topic: keys.Topic,
    node: str,
    request: Message | None,
    reply_type: type[M],
    *,
    name: str = "",
    sender: str = "",
    via: str = "",
    timeout_s: float,
) -> PendingReply[M]:
    """Send a request to a node, without waiting for its reply.

    Args:
        session: where the node is reachable.
        topic: of the request.
        node: the node's name.
        request: None for a query without a payload.
        reply_type: class of the reply.
        name: the one in the topic's key, if it has one.
        sender: the sender's name in the topic's key, if it has one.
        via: the way in of a request that is sent for a client of another protocol.
        timeout_s: time after which a node that is present but does not answer raises an error.

    Raises:
        InvalidConfig: the node's name is not valid, such as a wildcard, which would name several nodes.
        BadMessage: the request is too large and was not sent.
        zenoh.ZError: the session is closed.
    """
    keys.check_name(node, "the node's name")
    payload = codec.encode(request) if request else None
    if payload is not None and len(payload) > codec.MAX_BYTES:  # Zenoh would drop it, if it is much larger
        raise BadMessage(
            f"the request {topic.key} has {len(payload)} bytes; at most {codec.MAX_BYTES} are sent, in several requests"
        )
    token = zenoh.CancellationToken()
    replies = session.get(
        topic.at(node, name=name, sender=sender),
        payload=payload,
        encoding=zenoh.Encoding(codec.encoding(type(request))) if request else None,
        attachment=attachment(via),
        # Otherwise Zenoh waits for the end of the query, which does not come from a router that has just ended.
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=timeout_s,
        cancellation_token=token,
    )
    return PendingReply(replies, topic, node, reply_type, token)
