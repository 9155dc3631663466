"""The gateway's side of the bus: questions whose answers come later, and what nodes say, in the order it came.

Zenoh's threads only put work on the gateway's shelf. One shelf takes all, so events, samples and answers of a node are
seen in the order in which it sent them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import zenoh
from zenoh import CongestionControl
from zenoh.handlers import Callback

from topics import codec, errors, keys
from topics.errors import NodeNotFound, PeerError, did_you_mean
from topics.keys import Topic
from topics.messages import ErrorReply, Message

_QUESTION_S = 600.0  # a node's death is noticed at once; a start of a large building takes long

Post = Callable[[Callable[[], None]], None]


@dataclass(frozen=True, slots=True)
class BusMessage:
    """A message as it came: key, encoding, payload."""

    key: str
    encoding: str
    payload: bytes

    @property
    def denied(self) -> bool:
        """Whether it is a refusal."""
        return self.encoding == codec.encoding(ErrorReply)


ReplyCallback = Callable[[BusMessage | None], None]
"""What is done with an answer; None: nobody answered."""


class BusSide:
    """Puts, questions, subscriptions and tokens on an open session.

    Args:
        session: it stays the caller's.
        shelve: has the gateway's thread do something; Zenoh's threads call it.
    """

    def __init__(self, session: zenoh.Session, shelve: Post) -> None:
        self._session = session
        self._shelve = shelve
        self._close = ExitStack()
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._holders: Counter[str] = Counter()

    def close(self) -> None:
        """Listens no more, and all controllers have left; twice is fine."""
        self._close.close()
        while self._tokens:
            self._tokens.popitem()[1].undeclare()  # type: ignore[no-untyped-call]

    def listen(
        self, node: str, heard: Callable[[BusMessage], None], presence: Callable[[str, str, bool], None]
    ) -> None:
        """What a node (`*`: all) says under one chunk, and which instance of it is there or gone."""

        def on_message(message: zenoh.Sample) -> None:
            said = BusMessage(str(message.key_expr), str(message.encoding), message.payload.to_bytes())
            self._shelve(lambda: heard(said))

        def on_token(token: zenoh.Sample) -> None:
            key, there = str(token.key_expr), token.kind == zenoh.SampleKind.PUT
            self._shelve(lambda: presence(keys.node_of(key), keys.last_chunk(key), there))

        stream = self._session.declare_subscriber(keys.stream(node), Callback(on_message, indirect=False))
        self._close.enter_context(stream)
        tokens = keys.NODE_TOKEN.at(node, name="*")
        watch = self._session.liveliness().declare_subscriber(tokens, Callback(on_token, indirect=False), history=True)
        self._close.callback(watch.undeclare)

    def nodes(self, wanted: str) -> list[str]:
        """Names of the nodes that are there; waits for the answer.

        Raises:
            NodeNotFound: a node is `wanted` by name, and is not among them.
        """
        replies = self._session.liveliness().get(keys.NODE_TOKEN.at("*", name="*"))
        found = sorted({keys.node_of(str(reply.ok.key_expr)) for reply in replies if reply.ok})
        if wanted == "*":
            return found
        if wanted not in found:
            raise NodeNotFound(f"no node {wanted!r} on the bus; {did_you_mean(wanted, found)}")
        return [wanted]

    def fetch(self, topic: Topic, node: str) -> BusMessage | None:
        """What a node answers at once, waited for."""
        for reply in self._session.get(topic.at(node)):
            if reply.ok is not None:
                return BusMessage(str(reply.ok.key_expr), str(reply.ok.encoding), reply.ok.payload.to_bytes())
        return None

    def ask(self, topic: Topic, node: str, question: bytes | None, then: ReplyCallback) -> None:
        """Asks a node; `then` is done by the gateway's thread."""
        key, answered = topic.at(node), False

        def on_reply(reply: zenoh.Reply) -> None:
            nonlocal answered
            answered = True
            if reply.ok is not None:
                said = BusMessage(key, str(reply.ok.encoding), reply.ok.payload.to_bytes())
            else:
                why = reply.err.payload.to_string() if reply.err else "no reason given"
                denied = ErrorReply(**errors.to_wire(PeerError(f"node {node!r} did not answer {topic.key}: {why}")))
                said = BusMessage(key, codec.encoding(ErrorReply), codec.encode(denied))
            self._shelve(lambda: then(said))

        def on_end() -> None:
            if not answered:
                self._shelve(lambda: then(None))

        self._session.get(
            key,
            Callback(on_reply, on_end, indirect=False),
            payload=question,
            encoding=_encoding(topic) if question is not None else None,
            timeout=_QUESTION_S,
        )

    def put(self, key: str, topic: Topic, payload: bytes) -> None:
        """Sends a command or a write; nothing of it is lost."""
        self._session.put(key, payload, encoding=_encoding(topic), congestion_control=CongestionControl.BLOCK)

    def token(self, node: str, controller: str) -> Callable[[], None]:
        """Says that a controller is there, until what is returned is called as often as this was."""
        key = keys.CONTROLLER_TOKEN.at(node, name=controller)
        if self._holders[key] == 0:
            self._tokens[key] = self._session.liveliness().declare_token(key)
        self._holders[key] += 1

        def leave() -> None:
            self._holders[key] -= 1
            if self._holders[key] == 0:
                self._tokens.pop(key).undeclare()  # type: ignore[no-untyped-call]

        return leave


def _encoding(topic: Topic) -> zenoh.Encoding | None:
    kind: type[Message] | None = topic.message
    return zenoh.Encoding(codec.encoding(kind)) if kind is not None else None
