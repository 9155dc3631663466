"""The bus of a gateway: asynchronous queries, liveliness tokens, and messages of nodes.

`NodeClient` adds the state of one node for asyncio programs: its manifest, its latest sample, its presence, and typed
requests. The ZeroMQ gateway uses `BusSide` directly, since it forwards the bytes of any number of nodes, and posts
messages and replies to one queue: so it forwards the events, samples and replies of a node in the order in which the
node sent them. Speed is not the reason: with asyncio, the step of a REQ peer took 0.95 to 1.2 times as long.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import zenoh
from zenoh.handlers import Callback

from zenostat.topics import codec, errors, keys
from zenostat.topics.client_protocol import attachment
from zenostat.topics.errors import NodeNotFound, PeerError, did_you_mean
from zenostat.topics.keys import Topic
from zenostat.topics.messages import ErrorReply, Message

_QUERY_S = 600.0  # a node's disconnection is noticed at once; the start of a large building takes long

Post = Callable[[Callable[[], None]], None]


@dataclass(frozen=True, slots=True)
class BusMessage:
    """A received message: key, encoding and payload."""

    key: str
    encoding: str
    payload: bytes

    @property
    def denied(self) -> bool:
        """Whether it is an error reply."""
        return self.encoding == codec.encoding(ErrorReply)


ReplyCallback = Callable[[BusMessage | None], None]
"""Called with a reply, or None if there was none."""


class BusSide:
    """Queries, subscriptions and liveliness tokens on an open session.

    Args:
        session: the session, which the caller closes.
        post: posts a task to the gateway's thread; Zenoh's threads call it.
        via: the protocol of the gateway's clients, which recordings show as the way in.
    """

    def __init__(self, session: zenoh.Session, post: Post, via: str = "") -> None:
        self._session, self._attachment = session, attachment(via)
        self._post = post
        self._close = ExitStack()
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._holders: Counter[str] = Counter()

    def close(self) -> None:
        """Undeclare the subscriptions and all tokens; idempotent."""
        self._close.close()
        while self._tokens:
            self._tokens.popitem()[1].undeclare()  # type: ignore[no-untyped-call]

    def listen(
        self, node: str, deliver: Callable[[BusMessage], None], presence: Callable[[str, str, bool], None]
    ) -> None:
        """Subscribe to the stream and the liveliness tokens of a node (`*`: all).

        Args:
            node: the node's name.
            deliver: called with each message, in a thread of Zenoh's.
            presence: called with node, instance and whether it is on the bus, in the gateway's thread.
        """

        def on_message(sample: zenoh.Sample) -> None:
            deliver(BusMessage(str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes()))

        def on_token(token: zenoh.Sample) -> None:
            key, is_connected = str(token.key_expr), token.kind == zenoh.SampleKind.PUT
            self._post(lambda: presence(keys.node_of(key), keys.last_chunk(key), is_connected))

        stream = self._session.declare_subscriber(keys.stream(node), Callback(on_message, indirect=False))
        self._close.enter_context(stream)
        tokens = keys.NODE_TOKEN.at(node, name="*")
        watch = self._session.liveliness().declare_subscriber(tokens, Callback(on_token, indirect=False), history=True)
        self._close.callback(watch.undeclare)

    def nodes(self, wanted: str) -> list[str]:
        """Return the names of the connected nodes; waits for the reply.

        Raises:
            NodeNotFound: `wanted` is the name of a node that is not connected.
        """
        replies = self._session.liveliness().get(keys.NODE_TOKEN.at("*", name="*"))
        names = sorted({keys.node_of(str(reply.ok.key_expr)) for reply in replies if reply.ok})
        if wanted == "*":
            return names
        if wanted not in names:
            raise NodeNotFound(f"no node {wanted!r} on the bus; {did_you_mean(wanted, names)}")
        return [wanted]

    def fetch(self, topic: Topic, node: str) -> BusMessage | None:
        """Query a node and wait for its reply."""
        for reply in self._session.get(topic.at(node), consolidation=zenoh.ConsolidationMode.NONE):
            if reply.ok is not None:
                return BusMessage(str(reply.ok.key_expr), str(reply.ok.encoding), reply.ok.payload.to_bytes())
        return None

    def ask(
        self,
        topic: Topic,
        node: str,
        question: bytes | None,
        then: ReplyCallback,
        *,
        name: str = "",
        sender: str = "",
        timeout_s: float = _QUERY_S,
    ) -> None:
        """Query a node; `then` is called once, in the gateway's thread."""
        key, answered, failure = topic.at(node, name=name, sender=sender), False, None

        def on_reply(reply: zenoh.Reply) -> None:
            nonlocal answered, failure
            if answered:  # a second node of that name
                return
            if reply.ok is not None:
                answered = True
                message = BusMessage(key, str(reply.ok.encoding), reply.ok.payload.to_bytes())
                self._post(lambda: then(message))
            else:  # of one way to the node; the reply may come on another one
                reason = reply.err.payload.to_string() if reply.err else "no reason given"
                error = ErrorReply(**errors.to_wire(PeerError(f"node {node!r} did not answer {topic.key}: {reason}")))
                failure = BusMessage(key, codec.encoding(ErrorReply), codec.encode(error))

        def on_end() -> None:
            if not answered:
                self._post(lambda: then(failure))

        self._session.get(
            key,
            Callback(on_reply, on_end, indirect=False),
            payload=question,
            encoding=_encoding(topic) if question is not None else None,
            attachment=self._attachment if sender else None,
            consolidation=zenoh.ConsolidationMode.NONE,  # see `transport.request.send_request`
            timeout=timeout_s,
        )

    def has_token(self, node: str, controller: str, then: Callable[[bool], None]) -> None:
        """Query whether a controller whose token is not this object's is on the bus; `then` gets the answer.

        `then` is called once, in the gateway's thread.
        """
        key, replies = keys.CONTROLLER_TOKEN.at(node, sender=controller), list[bool]()
        is_own = self._holders[key] > 0

        def on_reply(reply: zenoh.Reply) -> None:
            replies.append(reply.ok is not None)

        def on_end() -> None:
            self._post(lambda: then(any(replies) and not is_own))

        self._session.liveliness().get(key, Callback(on_reply, on_end, indirect=False))

    def token(self, node: str, controller: str) -> Callable[[], None]:
        """Declare a controller's token until each returned function has been called."""
        key = keys.CONTROLLER_TOKEN.at(node, sender=controller)
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
