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

QUERIES = {row.key: row for row in keys.TOPICS if row.reply is not None and not row.has_sender}
"""Topics that are queried without a sender's name, by their key below the node's root."""

SENT = {row.key: row for row in keys.TOPICS if row.reply is not None and row.has_sender} | {
    keys.COMMAND.key: keys.COMMAND_REQUEST,
    keys.ACTUATOR.key: keys.WRITE_REQUEST,
}
"""Topics of messages that change something, by their key; commands and writes are queried as well."""

_BY_PREFIX = {key[: key.index("{")]: row for key, row in SENT.items()}


@dataclass(frozen=True, slots=True)
class Peer:
    """Address of a reply: the connection's routing id, the envelope and the connection's file descriptor."""

    route: bytes
    envelope: tuple[bytes, ...]
    fd: int


@dataclass(frozen=True, slots=True)
class Request:
    """A valid request: the row that is queried, the node, the sender, the name (of a write) and the message."""

    peer: Peer
    topic: bytes
    row: Topic
    node: str
    sender: str
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
    row, node, sender, name = _row(topic)
    if len(payload) > codec.MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes; a request has at most {codec.MAX_BYTES}")
    return Request(peer, topic, row, node, sender, name, payload, _message(row, payload))


def _row(topic: bytes) -> tuple[Topic, str, str, str]:
    """The row of a topic, its node, its sender and its name."""
    try:
        chunks = topic.decode().split("/")
    except UnicodeDecodeError:
        raise BadMessage(f"topic {_short(topic)} is not UTF-8") from None
    root = keys.PREFIX.split("/")
    if chunks[: len(root)] != root or len(chunks) < len(root) + 2:
        raise BadMessage(f"topic {_short(topic)}; {keys.PREFIX}/NODE/… expected, for example {keys.STATUS.at('NODE')}")
    node, rest = _checked(chunks[keys.NODE_CHUNK], "the node"), "/".join(chunks[keys.NODE_CHUNK + 1 :])
    if rest in QUERIES:
        return QUERIES[rest], node, "", ""
    for prefix, row in _BY_PREFIX.items():
        if rest.startswith(prefix):
            sender, *names = rest.removeprefix(prefix).split("/", 1 if row.key.endswith(keys.NAME) else 0)
            sender = _checked(sender, f"the sender after {prefix}")
            if row.key.endswith(keys.NAME):
                return row, node, sender, _checked(names[0] if names else "", f"the name after {prefix}{sender}/")
            return row, node, sender, ""
    known = [*QUERIES, *SENT]
    raise BadMessage(f"no request {_short(rest.encode())}; {did_you_mean(rest[:_SHOWN], known, limit=len(known))}")


def _checked(name: str, what: str) -> str:
    try:
        return keys.check_name(name, what)
    except InvalidConfig as error:
        raise BadMessage(_shortened(str(error))) from None


def _message(row: Topic, payload: bytes) -> Message:
    # Queries of published topics (manifest, sample) have no message.
    kind = row.message if row.message is not None and row.sender is not Role.NODE else Query
    return codec.decode_request(kind, payload)


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
