"""Frames of the gateway: parsing of requests, construction of replies. No I/O.

A request is `[topic]` or `[topic, payload]`; replies and published messages are `[topic, encoding, payload]`. A leading
envelope, up to the first empty frame, is returned unchanged (a REQ socket sends only the empty frame, proxies add their
own frames).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zenostat.topics import codec, errors, keys
from zenostat.topics.errors import BadMessage, InvalidConfig, ZenostatError, did_you_mean
from zenostat.topics.keys import Role, Topic
from zenostat.topics.messages import ErrorReply, Message, Query

_ENVELOPE = 8
_SHOWN = 300

_NAME = "{name}"

QUERIES = {row.key: row for row in keys.TOPICS if row.reply is not None and not row.key.endswith(_NAME)}
"""Topics that can be queried, by their key below the node's root."""

NAMED = {
    key.removesuffix(_NAME): request
    for put, request in ((keys.COMMAND, keys.COMMAND_REQUEST), (keys.ACTUATOR, keys.WRITE_REQUEST))
    for key in (put.key, request.key)
}
"""Topics with a name, which are queried as well: commands and writes; by what stands before the name."""


@dataclass(frozen=True, slots=True)
class Peer:
    """Address of a reply: the connection's routing id, the envelope and the connection's file descriptor."""

    route: bytes
    envelope: tuple[bytes, ...]
    fd: int


@dataclass(frozen=True, slots=True)
class Request:
    """A valid request: the row that is queried, the node, the name (of a command or write) and the message."""

    peer: Peer
    topic: bytes
    row: Topic
    node: str
    name: str
    payload: bytes
    message: Message


def split(frames: Sequence[bytes], fd: int) -> tuple[Peer, Sequence[bytes]]:
    """Split frames, which begin with the routing id, into the peer's address and the request."""
    route, rest = frames[0], frames[1:]
    for place, frame in enumerate(rest[:_ENVELOPE]):
        if not frame and place + 1 < len(rest):
            return Peer(route, tuple(rest[: place + 1]), fd), rest[place + 1 :]
    return Peer(route, (), fd), rest


def read(peer: Peer, frames: Sequence[bytes]) -> Request:
    """Parse a request.

    Raises:
        BadMessage: the request is not valid.
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
    for prefix, row in NAMED.items():
        if rest.startswith(prefix):
            return row, node, _checked(rest.removeprefix(prefix), f"the name after {prefix}")
    known = [*QUERIES, *(prefix + _NAME for prefix in NAMED)]
    raise BadMessage(f"no request {_short(rest.encode())}; {did_you_mean(rest[:_SHOWN], known, limit=len(known))}")


def _checked(name: str, what: str) -> str:
    try:
        return keys.check_name(name, what)
    except InvalidConfig as error:
        raise BadMessage(_shortened(str(error))) from None


def _message(row: Topic, payload: bytes) -> Message:
    # Queries of published topics (manifest, sample) have no message, and an empty query message may be omitted.
    kind = row.message if row.message is not None and row.sender is not Role.NODE else Query
    if kind is Query and not payload:
        return Query()
    return codec.decode(kind, payload)


def _short(text: bytes) -> str:
    return _shortened(repr(text.decode(errors="replace")))


def _shortened(text: str) -> str:
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"


def answer(peer: Peer, topic: bytes, encoding: str, payload: bytes) -> list[bytes]:
    """Return the frames of a reply, with the routing id first."""
    return [peer.route, *peer.envelope, topic, encoding.encode(), payload]


def denied(error: ZenostatError) -> ErrorReply:
    """Return the reply for an error."""
    return ErrorReply(**errors.to_wire(error))
