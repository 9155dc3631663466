"""Subscribers and queryables of a node server: commands through a FIFO, everything else through a task queue.

A FIFO is the fastest way to wait for a message in Zenoh, but it has no timeout. All other work is therefore posted to a
task queue by the thread that receives it, which then wakes the server's thread, if it is waiting, with a message that
never leaves the process.

A full FIFO blocks the threads that put messages into it until the server's thread empties it, so that thread itself
never puts.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import zenoh
from zenoh.handlers import Callback, FifoChannel

from zenostat.bridge.node.controller_presence import ControllerPresence
from zenostat.bridge.node.waiting import LARGE_BYTES, MAX_LARGE, MAX_PENDING, WaitingQueue, WaitingQueues
from zenostat.bridge.transport.wakeup import Wake
from zenostat.topics import codec, errors, keys
from zenostat.topics.client_protocol import ZENOH, client_protocol
from zenostat.topics.errors import AccessDenied, BadMessage, NodeLost, RequestRejected, ZenostatError
from zenostat.topics.messages import ErrorReply, Message, Query

if TYPE_CHECKING:
    from zenostat.bridge.node.access import Access
    from zenostat.bridge.recording.recorder import Recorder
    from zenostat.bridge.runtime.timer import Timer

M = TypeVar("M", bound=Message)

COMMAND_QUEUE = 256
"""Commands that may wait for the server's thread; beyond it, their senders are blocked."""

_TASKS_PER_TURN = 8
"""Tasks to run before the next command is received."""

_WAKE = "-"  # not a valid name of a controller


def _no_op() -> None:
    """Do nothing; posted to wake the thread."""


def _content(query: zenoh.Query) -> tuple[bytes, str]:
    """Return payload and encoding of a query; empty where it has none."""
    payload, encoding = query.payload, query.encoding
    return payload.to_bytes() if payload is not None else b"", str(encoding) if encoding is not None else ""


class Request:
    """A request that waits for its reply, which any later task of the server's thread may send.

    Args:
        query: the query.
        topic: of the query.
        subscriptions: of the server.

    Attributes:
        sender, name: those in its key, shortened; empty if the topic has none.
        has_wildcard: whether its key has one elsewhere than in place of the node's name.
        payload, encoding: its message.
    """

    __slots__ = (
        "_key", "_query", "_subscriptions", "_topic", "_via", "encoding", "has_wildcard", "name", "payload", "sender",
    )  # fmt: skip

    def __init__(self, query: zenoh.Query, topic: keys.Topic, subscriptions: Subscriptions) -> None:
        self._query: zenoh.Query | None = query
        key = str(query.key_expr)
        self.sender, self.name = map(keys.shortened, topic.names_in(key))
        self._topic, self._subscriptions = topic, subscriptions
        sender, name = topic.chunks_in(key)
        self._key = topic.at(subscriptions.node, name=name, sender=sender)  # a reply has to match the query
        self.has_wildcard = "*" in sender + name or keys.below_node(key) != topic.below(name=name, sender=sender)
        self.payload, self.encoding = _content(query)
        self._via = _client_protocol(query.attachment)

    def answer(self, handler: Callable[[], Message], *, is_recorded: bool = True) -> None:
        """Call `handler` and reply with what it returns or raises; only the first call replies and is recorded."""
        reply: Message
        try:
            reply = handler()
        except Exception as error:  # one of this program shall not end the node
            reply = ErrorReply(**errors.to_wire(error))
            if not isinstance(error, ZenostatError):
                self._subscriptions.on_error(self._topic, self.sender, error)
        query, self._query = self._query, None
        if query is None:
            return
        payload, encoding = codec.encode(reply), codec.encoding(type(reply))
        recorder = self._subscriptions.recorder
        if recorder is not None and is_recorded and self._topic.sender is not keys.Role.ANYONE:  # those only read
            key = self._topic.below(name=self.name, sender=self.sender)
            recorder.sender(self.sender, self._subscriptions.proven(self.sender), self._via)
            recorder.request(key, self.payload, self.encoding, payload, encoding)
        with query:
            try:
                query.reply(self._key, payload, encoding=zenoh.Encoding(encoding))
            except zenoh.ZError as error:  # nothing that a stranger asks shall end the node
                self._subscriptions.on_error(self._topic, self.sender, error)


def _client_protocol(attached: zenoh.ZBytes | None) -> str:
    return ZENOH if attached is None else client_protocol(attached.to_bytes())


def _mismatch(sender: str, named: str) -> str:
    """Return what is wrong with the sender in a key and the one that the message names; empty if they agree."""
    if not keys.is_name(sender):
        return (
            f"{sender!r} is not a sender's name: up to 128 letters, digits, '_', '.' and '-' expected in the key, of "
            "which the first is no '.' or '-'"
        )
    if named not in ("", sender):
        return f"its key names {sender!r} as the sender, and the message {named!r}; send it under one name"
    return ""


def _reject() -> Message:
    raise RequestRejected(f"the node has {MAX_PENDING} pending requests, or {MAX_LARGE} large ones; try again later")


def _refuse_wildcard() -> Message:
    raise BadMessage(
        "the key of the query has a wildcard in place of a name or of the request; only the node's name may be one here"
    )


def _refuse_large(payload: bytes, _: str) -> bytes:
    raise BadMessage(f"{len(payload)} bytes; this query has fewer than {LARGE_BYTES}")


Handler = Callable[[str, str, bytes, str], None]
"""Handles a message: the sender and the name in its key, shortened, its payload, its encoding."""


class Subscriptions:
    """The subscribers and queryables of a server; `with Subscriptions(session, node) as subscriptions`.

    Attributes:
        node: name of the node.
        recorder: records requests with their replies, and the messages of `listen`.
        access: permissions of senders; None without keys.
        on_denied: called in the server's thread with the reason and the sender of each message that is denied.
        on_dropped: called in that thread with a text, and the sender whose messages gave way to others; `rate_limited`
            counts them.
        on_error: called in the server's thread with an error of this program in a request or a write, and its sender.
    """

    def __init__(self, session: zenoh.Session, node: str) -> None:
        self._session = session
        self.node = node
        self.recorder: Recorder | None = None
        self.access: Access | None = None
        self.on_denied: Callable[[str, str], None] = lambda _text, _sender: None
        self.on_dropped: Callable[[str, str], None] = lambda _text, _sender: None
        self.on_error: Callable[[keys.Topic, str, Exception], None] = lambda _topic, _sender, _error: None
        self._tasks: deque[Callable[[], None]] = deque()
        self._queues = WaitingQueues(self.post, self._report_dropped)
        self._before_commands: list[WaitingQueue] = []
        self._close = ExitStack()
        self._presence: ControllerPresence | None = None
        self._thread_id = 0
        self._is_waiting = False
        self._is_command_next = self._has_ended = False
        self._turn = 0
        self._wake = Wake(session, keys.COMMAND.at(node, sender=_WAKE))
        commands = session.declare_subscriber(keys.COMMAND.everywhere(node), FifoChannel(COMMAND_QUEUE))
        self._commands = self._close.enter_context(commands)
        self._recv, self._try_recv = commands.recv, commands.try_recv

    def __enter__(self) -> Subscriptions:
        return self

    def __exit__(self, *_: object) -> None:
        closed = threading.Event()
        # While a full FIFO blocks Zenoh's threads, nothing can be undeclared.
        drain = threading.Thread(target=self._drain, args=(closed,), name="drain", daemon=True)
        try:
            drain.start()
        except RuntimeError:  # the system cannot start a thread
            for _attempt in range(COMMAND_QUEUE):
                self._try_recv()
        try:
            self._wake.close()
            self._close.close()
            self.end()  # requests that arrived meanwhile
        finally:
            closed.set()
            if drain.ident is not None:
                drain.join()
            self._tasks.clear()
            self._queues.clear()  # a query ends once nothing refers to it; its sender would wait for minutes

    def _drain(self, closed: threading.Event) -> None:
        while not closed.is_set():
            try:
                message = self._try_recv()
            except zenoh.ZError:  # undeclared
                return
            except RuntimeError:  # being undeclared: pyo3 lets one thread at a time use it
                message = None
            if message is None:
                closed.wait(0.001)

    @property
    def rate_limited(self) -> int:
        """Number of messages dropped and requests rejected because too many were waiting."""
        return self._queues.rate_limited

    # For the server's thread

    def receive(self, *, wait: bool) -> tuple[str, zenoh.Sample] | None:
        """Return the next command and its controller; None if tasks are pending, or nothing has arrived.

        If both are pending, commands and tasks take turns. Writes that have arrived are carried out first: Zenoh keeps
        the order of one session's messages, so what a controller wrote before its command is waiting by now.
        """
        self._thread_id = threading.get_ident()
        if wait:
            self._is_waiting = True  # set before the check for tasks; `post` reads it after adding one
        if not self._tasks:
            message = self._recv() if wait else self._try_recv()
            self._is_waiting = False
        else:
            self._is_waiting = False
            self._is_command_next = not self._is_command_next
            message = self._try_recv() if self._is_command_next else None
        return None if message is None else self._command(message)

    def try_receive(self) -> tuple[str, zenoh.Sample] | None:
        """Return the next command that has arrived, and its controller; None if there is none."""
        while (message := self._try_recv()) is not None:
            if (command := self._command(message)) is not None:
                return command
        return None

    def _command(self, message: zenoh.Sample) -> tuple[str, zenoh.Sample] | None:
        # The node's name in the key may be a wildcard.
        controller = keys.shortened(str(message.key_expr).rpartition("/")[2])
        if controller == _WAKE:
            return None
        for waiting in self._before_commands:
            waiting.run_all()
        return controller, message

    def run_pending(self) -> None:
        """Run up to `_TASKS_PER_TURN` of the tasks of other threads, or fewer if one ends the turn."""
        self._turn = _TASKS_PER_TURN
        while self._tasks and self._turn > 0:
            self._turn -= 1
            self._tasks.popleft()()

    def end(self) -> None:
        """Answer all requests that are waiting, those to stop with their reply and all others with an error."""
        self._has_ended = True
        self._queues.run_all()

    def end_turn(self) -> None:
        """Run no further tasks in this turn, so that the server's thread simulates a step before them if it can."""
        self._turn = 0

    def _is_refused(self, topic: keys.Topic) -> bool:
        return self._has_ended and topic is not keys.STOP

    def _reject_ending(self) -> Message:
        raise NodeLost(f"node {self.node!r} is ending")

    # For any thread

    def notify(self) -> None:
        """Wake the server's thread; thread-safe, also in a signal handler."""
        self.post(_no_op)

    def post(self, task: Callable[[], None]) -> None:
        """Run a task in the server's thread."""
        self._tasks.append(task)
        self._wake_if_waiting()

    def post_first(self, task: Callable[[], None]) -> None:
        """Run a task in the server's thread before all other pending tasks.

        From one of its tasks, it is the next thing that the thread does: no command and no write comes in between.
        """
        self._tasks.appendleft(task)
        if threading.get_ident() == self._thread_id:
            self._turn += 1
        self._wake_if_waiting()

    def _wake_if_waiting(self) -> None:
        if not self._is_waiting:
            return  # it checks for tasks before it waits
        self._is_waiting = False
        if threading.get_ident() == self._thread_id:  # in a signal handler while it is waiting
            threading.Thread(target=self._wake, name="wake", daemon=True).start()
        else:
            self._wake()

    # Senders

    def checked(self, topic: keys.Topic, sender: str, message: M) -> M:
        """Return a message that has its sender's name, if its class has a field for it; for the server's thread.

        Args:
            topic: of the message.
            sender: the name in its key, which access rules bind to a certificate.
            message: without a sender's name, or with the same one.

        Raises:
            AccessDenied: the message names another sender, or the sender may not send it; it has been reported.
        """
        if not topic.has_sender:
            return message
        field = keys.sender_field(type(message))
        if reason := self._denial(topic, sender, getattr(message, field) if field else ""):
            self.deny(topic, sender, reason)
        return message.model_copy(update={field: sender}) if field else message

    def proven(self, sender: str) -> str:
        """Return the certificate's name that proves a sender's name; empty without keys."""
        return "" if self.access is None else self.access.holder(sender)

    def deny(self, topic: keys.Topic, sender: str, reason: str) -> NoReturn:
        """Report a denied message and raise `AccessDenied`; for the server's thread."""
        self.on_denied(f"{topic.key}: {reason}", sender)
        raise AccessDenied(reason)

    def _report_dropped(self, text: str, sender: str) -> None:
        self.on_dropped(text, sender)

    def _denial(self, topic: keys.Topic, sender: str, named: str) -> str:
        """Return why a message is denied, which names a sender besides that in its key; empty if it is not."""
        reason = _mismatch(sender, named)
        return reason if reason or self.access is None else self.access.denial(topic, sender)

    def _accepted(self, topic: keys.Topic, kind: type[M], request: Request) -> M | None:
        """Return the message of a request that is valid and that its sender may send, else None; for any thread."""
        try:
            message = codec.decode_request(kind, request.payload, request.encoding)
        except BadMessage:
            return None
        field = keys.sender_field(kind)
        named = getattr(message, field) if field else ""
        return message if not topic.has_sender or not self._denial(topic, request.sender, named) else None

    # Subscribers and queryables besides commands

    def _queue(self, topic: keys.Topic) -> WaitingQueue:
        queue = self._queues.add(topic)
        if topic in (keys.ACTUATOR, keys.WRITE_REQUEST):
            self._before_commands.append(queue)
        return queue

    def listen(self, topic: keys.Topic, handler: Handler) -> None:
        """Subscribe to a topic; the server's thread handles its messages."""
        waiting = self._queue(topic)

        def receive(sender: str, name: str, payload: bytes, encoding: str, via: str) -> None:
            if self.recorder is not None:
                self.recorder.sender(sender, self.proven(sender), via)
                self.recorder.received(topic, topic.below(name=name, sender=sender), payload, encoding)
            try:
                handler(sender, name, payload, encoding)
            except Exception as error:  # one of this program shall not end the node
                self.on_error(topic, sender, error)

        def on_message(message: zenoh.Sample) -> None:
            size, key = len(message.payload), str(message.key_expr)
            sender, name = map(keys.shortened, topic.names_in(key))
            if not waiting.admit(size) and not waiting.give_way(size, key):
                return
            payload, encoding, via = (
                message.payload.to_bytes(),
                str(message.encoding),
                _client_protocol(message.attachment),
            )
            waiting.append(
                size, lambda: None if self._has_ended else receive(sender, name, payload, encoding, via), key
            )

        subscriber = self._session.declare_subscriber(topic.everywhere(self.node), Callback(on_message, indirect=False))
        self._close.callback(subscriber.undeclare)

    def watch_presence(self, on_disconnect: Callable[[str], None], on_reconnect: Callable[[str], None]) -> None:
        """Follow the controllers' liveliness tokens; see `ControllerPresence`."""
        self._presence = ControllerPresence(self._session, self.node, self.post, on_disconnect, on_reconnect)
        self._close.callback(self._presence.close)

    def expect_presence(self, controller: str, timer: Timer) -> None:
        """Take a controller with a claim or a copy for disconnected if it has no token; see `ControllerPresence`."""
        if self._presence is not None:
            self._presence.expect(controller, timer)

    def answer_latest(self, topic: keys.Topic, latest: Callable[[], bytes]) -> None:
        """Answer queries without a payload in the thread that receives them; `latest` only reads, b"" is no message."""

        def answer(payload: bytes, _: str) -> bytes:
            if payload:
                raise BadMessage(f"{len(payload)} bytes; a query on {topic.key} has no payload")
            if not (message := latest()):
                raise RequestRejected(f"node {self.node!r} has no {topic.key} yet")
            return message

        self._answer(topic, answer)

    def answer(self, topic: keys.Topic, answer: Callable[[Query], bytes]) -> None:
        """Answer queries, with or without a payload, in the thread that receives them; `answer` only reads."""
        self._answer(topic, lambda payload, encoding: answer(codec.decode_request(Query, payload, encoding)))

    def answer_in_background(self, topic: keys.Topic, answer: Callable[[Query], bytes]) -> None:
        """Answer queries in a thread of its own, one after another; `answer` may take a while, and only reads.

        Queries beyond those that may wait have no answer.
        """
        worker, waiting = ThreadPoolExecutor(1, "background"), threading.Semaphore(MAX_PENDING)

        def compute(query: zenoh.Query) -> None:
            waiting.release()
            self._reply(query, topic, lambda payload, encoding: answer(codec.decode_request(Query, payload, encoding)))

        def on_query(query: zenoh.Query) -> None:
            if query.payload is not None and len(query.payload) >= LARGE_BYTES:
                self._reply(query, topic, _refuse_large)
            elif waiting.acquire(blocking=False):
                worker.submit(compute, query)
            else:
                self._queues.rate_limited += 1

        queryable = self._session.declare_queryable(
            topic.at(self.node), Callback(on_query, indirect=False), complete=True
        )
        self._close.callback(worker.shutdown, wait=False, cancel_futures=True)
        self._close.callback(queryable.undeclare)

    def _answer(self, topic: keys.Topic, answer: Callable[[bytes, str], bytes]) -> None:
        def on_query(query: zenoh.Query) -> None:
            self._reply(query, topic, answer)

        queryable = self._session.declare_queryable(
            topic.at(self.node), Callback(on_query, indirect=False), complete=True
        )
        self._close.callback(queryable.undeclare)

    def _reply(self, query: zenoh.Query, topic: keys.Topic, answer: Callable[[bytes, str], bytes]) -> None:
        """Reply to a query with what `answer` returns for its payload and encoding, or raises."""
        kind: type[Message] = topic.reply or ErrorReply
        with query:
            try:
                payload = answer(*_content(query))
            except Exception as error:  # one of this program shall not leave the query without a reply
                kind, payload = ErrorReply, codec.encode(ErrorReply(**errors.to_wire(error)))
                if not isinstance(error, ZenostatError):
                    self.post(partial(self.on_error, topic, "", error))
            query.reply(topic.at(self.node), payload, encoding=zenoh.Encoding(codec.encoding(kind)))

    def request(
        self,
        topic: keys.Topic,
        kind: type[Any],
        handler: Callable[[Any], Message],
        *,
        on_receipt: Callable[[Any], None] | None = None,
    ) -> None:
        """Answer requests in the server's thread.

        Args:
            topic: of the requests.
            kind: class of the request.
            handler: returns the reply.
            on_receipt: called first with each valid request, in the thread that receives it.
        """

        def on_request(request: Request) -> None:
            request.answer(
                lambda: handler(
                    self.checked(topic, request.sender, codec.decode_request(kind, request.payload, request.encoding))
                )
            )

        def receipt(request: Request) -> None:
            if on_receipt is not None and (message := self._accepted(topic, kind, request)) is not None:
                on_receipt(message)

        self.request_undecoded(topic, on_request, on_receipt=receipt)

    def request_undecoded(
        self,
        topic: keys.Topic,
        handler: Callable[[Request], None],
        *,
        on_receipt: Callable[[Request], None] = lambda _: None,
    ) -> None:
        """Handle requests in the server's thread; `handler` decodes and answers them, at once or later.

        Args:
            topic: of the requests; those of all senders and names.
            handler: is called with each request.
            on_receipt: called first for each request, in the thread that receives it.
        """
        waiting = self._queue(topic)

        def on_query(query: zenoh.Query) -> None:
            request = Request(query, topic, self)
            size = len(request.payload)
            if topic.has_sender and request.has_wildcard:  # as of a program that reads all keys
                request.answer(_refuse_wildcard, is_recorded=False)
                return
            if not waiting.admit(size):
                request.answer(_reject, is_recorded=False)  # in another thread
                return
            on_receipt(request)
            waiting.append(
                size, lambda: request.answer(self._reject_ending) if self._is_refused(topic) else handler(request)
            )

        key = topic.everywhere(self.node)
        queryable = self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True)
        self._close.callback(queryable.undeclare)
