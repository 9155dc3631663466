"""What a node hears: commands, and, on a shelf, everything else.

Commands come through a FIFO, the quickest way to wait for a message in Zenoh, which knows no timeout. Whatever
else happens is put on a shelf by the thread that hears of it, which then wakes the node's own thread, if it waits,
with a message that never leaves the process.

A full FIFO holds up whoever puts into it, and only the node's own thread empties it: that one never puts.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

import zenoh
from zenoh.handlers import Callback, FifoChannel

from bridge.transport.wakeup import Wake
from topics import codec, errors, keys
from topics.errors import BadMessage, ZenostatError
from topics.messages import ErrorReply, Message, Query

COMMAND_QUEUE = 256
"""Commands that may wait for the node's own thread; their senders wait with those beyond."""

MAX_PENDING = 256
"""Messages or requests of a topic that may wait likewise; more are a flood, and passed over or refused."""

_AT_A_TIME = 8
"""Of what is on the shelf, before the next command has its turn."""

_WAKE = "-"  # no controller can have this name
_NO_FIELDS = b"\x80"  # an empty map


def _nothing() -> None:
    """What is to be done when only the waking counts."""


def _asked(query: zenoh.Query) -> tuple[bytes, str]:
    """Payload and encoding of a query; empty where it has none."""
    payload, encoding = query.payload, query.encoding
    return payload.to_bytes() if payload is not None else b"", str(encoding) if encoding is not None else ""


Handler = Callable[[str, bytes, str], None]
"""Takes a message: the last chunk of its key, its payload, its encoding."""


class Subscriptions:
    """The subscribers and queryables of a node; `with Subscriptions(session, node) as subscriptions`.

    Attributes:
        rate_limited: messages and requests that were too many.
    """

    def __init__(self, session: zenoh.Session, node: str) -> None:
        self._session = session
        self._node = node
        self._shelf: deque[Callable[[], None]] = deque()
        self.rate_limited = 0
        self._close = ExitStack()
        self._owner = 0
        self._waits = False
        self._command_next = False
        self._put_wake = Wake(session, keys.COMMAND.at(node, name=_WAKE))
        commands = session.declare_subscriber(keys.COMMAND.at(node, name="*"), FifoChannel(COMMAND_QUEUE))
        self._commands = self._close.enter_context(commands)
        self._recv, self._try_recv = commands.recv, commands.try_recv
        self._prefix = len(keys.COMMAND.at(node))

    def __enter__(self) -> Subscriptions:
        return self

    def __exit__(self, *_: object) -> None:
        over = threading.Event()
        # While a full FIFO holds up Zenoh's threads, nothing can be undeclared.
        drain = threading.Thread(target=self._drain, args=(over,), name="drain", daemon=True)
        drain.start()
        try:
            self._put_wake.close()
            self._close.close()
        finally:
            over.set()
            drain.join()

    def _drain(self, over: threading.Event) -> None:
        while not over.is_set():
            try:
                came = self._try_recv()
            except zenoh.ZError:  # undeclared
                return
            except RuntimeError:  # being undeclared just now: pyo3 lends it to one thread at a time
                came = None
            if came is None:
                over.wait(0.001)

    # The node's own thread

    def receive(self, *, wait: bool) -> tuple[str, zenoh.Sample] | None:
        """The next command and its controller; None if something is on the shelf, or nothing came.

        Where both wait they take turns.
        """
        if wait:
            self._owner = threading.get_ident()
            self._waits = True  # before the look at the shelf, while `notify` looks after something was put there
        if not self._shelf:
            message = self._recv() if wait else self._try_recv()
            self._waits = False
        else:
            self._waits = False
            self._command_next = not self._command_next
            message = self._try_recv() if self._command_next else None
        if message is None:
            return None
        controller = str(message.key_expr)[self._prefix :]
        return None if controller == _WAKE else (controller, message)

    def run_pending(self, *, most: int = _AT_A_TIME) -> None:
        """Does what other threads have put on the shelf, some of it at a time."""
        while self._shelf and most > 0:
            self._shelf.popleft()()
            most -= 1

    # Any thread

    def notify(self) -> None:
        """Has the node's own thread look up; any thread may, and a signal's handler."""
        self.post(_nothing)

    def post(self, work: Callable[[], None]) -> None:
        """Has the node's own thread do something."""
        self._shelf.append(work)
        self._look_up()

    def post_first(self, work: Callable[[], None]) -> None:
        """Has the node's own thread do something before whatever else is on the shelf."""
        self._shelf.appendleft(work)
        self._look_up()

    def _look_up(self) -> None:
        if not self._waits:
            return  # it looks at the shelf before it waits
        self._waits = False
        if threading.get_ident() == self._owner:  # a signal's handler within its waiting
            threading.Thread(target=self._put_wake, name="wake", daemon=True).start()
        else:
            self._put_wake()

    # What is listened to besides commands

    def listen(self, topic: keys.Topic, take: Handler) -> None:
        """A topic whose messages the node's own thread takes."""
        waiting: deque[Callable[[], None]] = deque()

        def on_message(message: zenoh.Sample) -> None:
            if len(waiting) >= MAX_PENDING:
                self.rate_limited += 1
                return
            name, payload, said = (
                keys.last_chunk(str(message.key_expr)),
                message.payload.to_bytes(),
                str(message.encoding),
            )
            waiting.append(lambda: take(name, payload, said))
            self.post(lambda: waiting.popleft()())  # noqa: PLW0108  # which is first is seen then

        hears = self._session.declare_subscriber(topic.at(self._node, name="*"), Callback(on_message, indirect=False))
        self._close.callback(hears.undeclare)

    def watch(self, topic: keys.Topic, gone: Callable[[str], None]) -> None:
        """Presence: the node's own thread is told who has gone."""

        def on_token(token: zenoh.Sample) -> None:
            if token.kind == zenoh.SampleKind.DELETE:
                name = keys.last_chunk(str(token.key_expr))
                self.post(lambda: gone(name))

        tokens = topic.at(self._node, name="*")
        watch = self._session.liveliness().declare_subscriber(tokens, Callback(on_token, indirect=False))
        self._close.callback(watch.undeclare)

    def fetch(self, topic: keys.Topic, latest: Callable[[], bytes]) -> None:
        """A query without a payload, answered by the thread that hears it; `latest` only reads."""

        def answer(payload: bytes, _: str) -> bytes:
            if payload:
                raise BadMessage(f"{len(payload)} bytes; a query on {topic.key} has no payload")
            return latest()

        self._answer(topic, answer)

    def answer(self, topic: keys.Topic, answer: Callable[[Query], bytes]) -> None:
        """A question that is answered by the thread that hears it, and may come without a payload; only reads."""
        self._answer(topic, lambda payload, said: answer(codec.decode(Query, payload or _NO_FIELDS, said)))

    def _answer(self, topic: keys.Topic, answer: Callable[[bytes, str], bytes]) -> None:
        key, kind = topic.at(self._node), topic.reply or ErrorReply

        def on_query(query: zenoh.Query) -> None:
            with query:
                said = kind
                try:
                    payload = answer(*_asked(query))
                except ZenostatError as error:
                    said, payload = ErrorReply, codec.encode(ErrorReply(**errors.to_wire(error)))
                query.reply(key, payload, encoding=zenoh.Encoding(codec.encoding(said)))

        answers = self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True)
        self._close.callback(answers.undeclare)

    def request(
        self,
        topic: keys.Topic,
        kind: type[Any],
        take: Callable[[Any], Message],
        *,
        at_once: Callable[[], None] | None = None,
    ) -> None:
        """A request that the node's own thread takes; `at_once` is done by the thread that hears a valid one."""
        key = topic.at(self._node)
        waiting: deque[Callable[[], None]] = deque()

        def refuse(query: zenoh.Query) -> None:
            busy = ErrorReply(
                error="RequestRejected", message=f"the node has {MAX_PENDING} requests to answer; ask again later"
            )
            with query:
                query.reply(key, codec.encode(busy), encoding=zenoh.Encoding(codec.encoding(ErrorReply)))

        def decoded(query: zenoh.Query) -> Any:
            return codec.decode(kind, *_asked(query))

        def understood(query: zenoh.Query) -> bool:
            with suppress(BadMessage):
                decoded(query)
                return True
            return False

        def work(query: zenoh.Query) -> None:
            with query:
                reply: Message
                try:
                    reply = take(decoded(query))
                except ZenostatError as error:
                    reply = ErrorReply(**errors.to_wire(error))
                query.reply(key, codec.encode(reply), encoding=zenoh.Encoding(codec.encoding(type(reply))))

        def on_query(query: zenoh.Query) -> None:
            if len(waiting) >= MAX_PENDING:
                self.rate_limited += 1
                refuse(query)
                return
            if at_once is not None and understood(query):
                at_once()
            waiting.append(lambda: work(query))
            self.post(lambda: waiting.popleft()())  # noqa: PLW0108  # which is first is seen then

        answers = self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True)
        self._close.callback(answers.undeclare)
