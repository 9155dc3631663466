"""Frames of the gateway: what a request says, and the answer to it. No I/O.

A request is `[topic]` or `[topic, payload]`; an answer, like what is published, `[topic, encoding, payload]`. Frames
up to the first empty one that stand before (a REQ socket sends just the empty one, proxies add their own) come back as
they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from topics import codec, errors, keys
from topics.errors import BadMessage, InvalidConfig, ZenostatError, did_you_mean
from topics.keys import Delivery, Role, Topic
from topics.messages import ErrorReply, Message, Query

_ENVELOPE = 8
_SHOWN = 300

QUERIES = {row.key: row for row in keys.TOPICS if row.reply is not None}
"""What is asked of a node, by its key below the node's root."""

NAMED = {
    row.key.removesuffix("{name}"): row
    for row in keys.TOPICS
    if row.sender is not Role.NODE and row.delivery is Delivery.BLOCK
}
"""What is sent to a node under a name: commands and writes."""


@dataclass(frozen=True, slots=True)
class Peer:
    """Where an answer goes: the connection's routing id, the frames that come back, its file descriptor."""

    route: bytes
    envelope: tuple[bytes, ...]
    fd: int


@dataclass(frozen=True, slots=True)
class Request:
    """A request that makes sense: its row in the table of topics, node, name (of a command or write), message."""

    peer: Peer
    topic: bytes
    row: Topic
    node: str
    name: str
    payload: bytes
    message: Message

    @property
    def key(self) -> str:
        """The Zenoh key."""
        return self.topic.decode()


def split(frames: Sequence[bytes], fd: int) -> tuple[Peer, Sequence[bytes]]:
    """The peer, and the frames that are the request; `frames` begin with the routing id."""
    route, rest = frames[0], frames[1:]
    for place, frame in enumerate(rest[:_ENVELOPE]):
        if not frame and place + 1 < len(rest):
            return Peer(route, tuple(rest[: place + 1]), fd), rest[place + 1 :]
    return Peer(route, (), fd), rest


def read(peer: Peer, frames: Sequence[bytes]) -> Request:
    """The request in `frames`.

    Raises:
        BadMessage: what was wrong, and what would be right.
    """
    if not 1 <= len(frames) <= 2:
        raise BadMessage(f"{len(frames)} frames; a request has a topic and, where it needs one, a payload")
    topic, payload = frames[0], frames[1] if len(frames) == 2 else b""
    row, node, name = _row(topic)
    if len(payload) > codec.MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes; a request has at most {codec.MAX_BYTES}")
    return Request(peer, topic, row, node, name, payload, _message(row, payload))


def _row(topic: bytes) -> tuple[Topic, str, str]:
    """The row of a topic, its node and its name."""
    try:
        chunks = topic.decode().split("/")
    except UnicodeDecodeError:
        raise BadMessage(f"topic {_short(topic)} is not UTF-8") from None
    root = keys.PREFIX.split("/")
    if chunks[: len(root)] != root or len(chunks) < len(root) + 2:
        raise BadMessage(f"topic {_short(topic)}; {keys.PREFIX}/NODE/… expected, for example {keys.STATUS.at('NODE')}")
    node, rest = _checked(chunks[keys.NODE_CHUNK], "the node"), "/".join(chunks[keys.NODE_CHUNK + 1 :])
    if rest in QUERIES:
        return QUERIES[rest], node, ""
    verb, slash, name = rest.partition("/")
    if verb + slash in NAMED:
        return NAMED[verb + slash], node, _checked(name, f"the name after {verb}/")
    known = [*QUERIES, *(row.key for row in NAMED.values())]
    raise BadMessage(f"no request {_short(rest.encode())}; {did_you_mean(rest[:_SHOWN], known, limit=len(known))}")


def _checked(name: str, what: str) -> str:
    try:
        return keys.check_name(name, what)
    except InvalidConfig as error:
        raise BadMessage(_shortened(str(error))) from None


def _message(row: Topic, payload: bytes) -> Message:
    # What only is fetched (manifest, sample) has no question of its own, and a question without fields may be left out.
    kind = row.message if row.message is not None and row.sender is not Role.NODE else Query
    if kind is Query and not payload:
        return Query()
    return codec.decode(kind, payload)


def _short(text: bytes) -> str:
    return _shortened(repr(text.decode(errors="replace")))


def _shortened(text: str) -> str:
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"


def answer(peer: Peer, topic: bytes, encoding: str, payload: bytes) -> list[bytes]:
    """The frames of an answer, with its route in front."""
    return [peer.route, *peer.envelope, topic, encoding.encode(), payload]


def denied(error: ZenostatError) -> ErrorReply:
    """The refusal that an error is to a peer."""
    return ErrorReply(**errors.to_wire(error))
