"""Writing one actuator, and the node's answer to it."""

from __future__ import annotations

import time
from queue import Empty, SimpleQueue

import zenoh
from zenoh import CongestionControl
from zenoh.handlers import Callback

from topics import codec, keys
from topics.errors import NodeLost, NodeNotFound, PeerError
from topics.messages import Event, EventKind, Manifest, Message, Write

_DISCOVERY_TIMEOUT_S = 10.0
_REPLY_TIMEOUT_S = 60.0  # a node that starts an engine handles a write only after that


def put_write(session: zenoh.Session, manifest: Manifest, point: str, write: Write) -> Event:
    """Subscribe to events, put the write once the node is discovered, and return the event that answers it.

    Raises:
        NodeNotFound: The node is not on the bus.
        NodeLost: It left the bus before it answered.
        PeerError: It did not answer in time.
    """
    node, inbox = manifest.node, SimpleQueue[zenoh.Sample]()
    token, deadline = keys.NODE_TOKEN.at(node, name=manifest.instance), time.monotonic() + _DISCOVERY_TIMEOUT_S
    callback = Callback(inbox.put, indirect=False)
    sent = False
    with (
        session.declare_subscriber(keys.EVENT.at(node), callback),
        session.liveliness().declare_subscriber(token, callback, history=True),
    ):
        while True:
            try:
                message = inbox.get(timeout=max(deadline - time.monotonic(), 0.0))
            except Empty:
                if not sent:
                    raise NodeNotFound(f"node {node!r} is not on the bus") from None
                raise PeerError(
                    f"node {node!r} did not answer the write of {point!r}; read the point to see its value"
                ) from None
            if str(message.key_expr) == token:
                if message.kind == zenoh.SampleKind.DELETE:
                    raise NodeLost(f"node {node!r} is gone")
                if not sent:
                    put(session, keys.ACTUATOR.at(node, name=point), write)
                    sent, deadline = True, time.monotonic() + _REPLY_TIMEOUT_S
                continue
            event = codec.decode(Event, message.payload.to_bytes(), str(message.encoding))
            if event.source == write.source and event.kind in (EventKind.WRITTEN, EventKind.REJECTED):
                return event


def put(session: zenoh.Session, key: str, message: Message) -> None:
    """Publish a message without dropping it under congestion."""
    encoding = zenoh.Encoding(codec.encoding(type(message)))
    session.put(key, codec.encode(message), encoding=encoding, congestion_control=CongestionControl.BLOCK)
