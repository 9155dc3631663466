"""What a node hears: commands, and, on a shelf, everything else.

Commands come through a FIFO, the quickest way to wait for a message in Zenoh, which knows no timeout. Whatever
else happens is put on a shelf by the thread that hears of it, which then wakes the node's own thread with a
message that never leaves the process.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import zenoh
from zenoh.handlers import Callback, FifoChannel

from bridge.wake import Wake
from topics import codec, errors, keys
from topics.errors import ZenostatError
from topics.messages import Denied, Message

INBOX = 4096
_WAKE = "-"  # no controller can have this name

Take = Callable[[str, bytes, str], None]
"""Takes a message: the last chunk of its key, its payload, its encoding."""


class Inlets:
    """The subscribers and queryables of a node; `with Inlets(session, node) as inlets`.

    Attributes:
        wake: wakes the node's own thread; any thread may call it.
    """

    def __init__(self, session: zenoh.Session, node: str) -> None:
        self._session = session
        self._node = node
        self._shelf: deque[Callable[[], None]] = deque()
        self._close = ExitStack()
        self.wake = Wake(session, keys.COMMAND.at(node, name=_WAKE))
        commands = session.declare_subscriber(keys.COMMAND.at(node, name="*"), FifoChannel(INBOX))
        self._commands = self._close.enter_context(commands)
        self._recv, self._try_recv = commands.recv, commands.try_recv
        self._prefix = len(keys.COMMAND.at(node))

    def __enter__(self) -> Inlets:
        return self

    def __exit__(self, *_: object) -> None:
        self.wake.close()
        self._close.close()

    # The node's own thread

    def receive(self, *, wait: bool) -> tuple[str, zenoh.Sample] | None:
        """The next command and its controller; None if it was woken for the shelf, or nothing came."""
        message = self._recv() if wait else self._try_recv()
        if message is None:
            return None
        controller = str(message.key_expr)[self._prefix :]
        return None if controller == _WAKE else (controller, message)

    def clear_shelf(self) -> None:
        """Does what other threads have put on the shelf."""
        while self._shelf:
            self._shelf.popleft()()

    # Any thread

    def shelve(self, work: Callable[[], None]) -> None:
        """Has the node's own thread do something."""
        self._shelf.append(work)
        self.wake()

    # What is listened to besides commands

    def listen(self, topic: keys.Topic, take: Take) -> None:
        """A topic whose messages the node's own thread takes."""

        def on_message(message: zenoh.Sample) -> None:
            name, payload, said = keys.last_of(str(message.key_expr)), message.payload.to_bytes(), str(message.encoding)
            self.shelve(lambda: take(name, payload, said))

        self._session.declare_subscriber(topic.at(self._node, name="*"), Callback(on_message, indirect=False))

    def watch(self, topic: keys.Topic, gone: Callable[[str], None]) -> None:
        """Presence: the node's own thread is told who has gone."""

        def on_token(token: zenoh.Sample) -> None:
            if token.kind == zenoh.SampleKind.DELETE:
                name = keys.last_of(str(token.key_expr))
                self.shelve(lambda: gone(name))

        tokens = topic.at(self._node, name="*")
        self._session.liveliness().declare_subscriber(tokens, Callback(on_token, indirect=False))

    def answer(self, topic: keys.Topic, answer: Callable[[], bytes]) -> None:
        """A question that is answered by the thread that hears it: `answer` only reads."""
        key = topic.at(self._node)
        said = zenoh.Encoding(codec.encoding(topic.reply)) if topic.reply else None

        def on_query(query: zenoh.Query) -> None:
            with query:
                query.reply(key, answer(), encoding=said)

        self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True)

    def request(
        self,
        topic: keys.Topic,
        kind: type[Any],
        take: Callable[[Any], Message],
        *,
        at_once: Callable[[], None] = lambda: None,
    ) -> None:
        """A request that the node's own thread takes; `at_once` is done by the thread that hears it."""
        key = topic.at(self._node)

        def work(query: zenoh.Query) -> None:
            with query:
                reply: Message
                try:
                    payload = query.payload.to_bytes() if query.payload else b""
                    reply = take(codec.decode(kind, payload, str(query.encoding)))
                except ZenostatError as error:
                    reply = Denied(**errors.to_wire(error))
                query.reply(key, codec.encode(reply), encoding=zenoh.Encoding(codec.encoding(type(reply))))

        def on_query(query: zenoh.Query) -> None:
            at_once()
            self.shelve(lambda: work(query))

        self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True)
