"""Send a request to a node, and decode its reply."""

from __future__ import annotations

from typing import TypeVar

import zenoh

from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage, PeerError, from_wire
from zenostat.topics.messages import ErrorReply, Message
from zenostat.topics.printable import replace_controls
from zenostat.topics.way_in import attachment

M = TypeVar("M", bound=Message)


def ask(
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
) -> M | None:
    """Return a node's reply; None, at once, if no node of that name is on the bus or if it does not know the topic.

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
        ZenostatError: the error that the node replied with.
        PeerError: the node did not answer.
        BadMessage: the request is too large and was not sent, or the reply is not valid.
        zenoh.ZError: the session is closed.
    """
    payload = codec.encode(request) if request else None
    if payload is not None and len(payload) > codec.MAX_BYTES:  # Zenoh would drop it, if it is much larger
        raise BadMessage(
            f"the request {topic.key} has {len(payload)} bytes; at most {codec.MAX_BYTES} are sent, in several requests"
        )
    replies = session.get(
        topic.at(node, name=name, sender=sender),
        payload=payload,
        encoding=zenoh.Encoding(codec.encoding(type(request))) if request else None,
        attachment=attachment(via),
        timeout=timeout_s,
    )
    for reply in replies:
        if reply.ok is None:
            reason = reply.err.payload.to_string() if reply.err else "no reason given"
            raise PeerError(f"node {node!r} did not answer {topic.key}: {replace_controls(reason)}")
        encoding, payload = str(reply.ok.encoding), reply.ok.payload.to_bytes()
        if encoding == codec.encoding(ErrorReply):
            raise from_wire(codec.decode(ErrorReply, payload, encoding).__dict__)
        return codec.decode(reply_type, payload, encoding)
    return None
