"""The gateway's ZeroMQ sockets: where they may be bound, waiting on all of them, and who has gone.

They belong to one thread. Others put work on the shelf, which wakes it.
"""

from __future__ import annotations

import re
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import zmq
from zmq.utils.monitor import recv_monitor_message

from topics import codec
from topics.errors import EndpointTaken, InvalidConfig

DEFAULT_PUBLISH = "tcp://127.0.0.1:5556"
DEFAULT_COMMAND = "tcp://127.0.0.1:5557"

_FORM = re.compile(r"tcp://[^\s:/]+:(\d{1,5}|\*)|ipc:///\S+")
_LOOPBACK = re.compile(r"tcp://127\.\d+\.\d+\.\d+:.*|ipc:.*")
_BURST = 256
_PING = 3  # of a lease: a peer that has answered none of three pings is gone


def check_endpoint(endpoint: str, *, expose: bool) -> str:
    """`endpoint`, or `InvalidConfig` that says what would be right."""
    if not _FORM.fullmatch(endpoint):
        raise InvalidConfig(
            f"{endpoint!r} is no ZeroMQ endpoint to listen on; "
            f"write tcp://ADDRESS:PORT (for example {DEFAULT_PUBLISH}) or ipc:///PATH"
        )
    if not _LOOPBACK.fullmatch(endpoint) and not expose:
        raise InvalidConfig(
            f"{endpoint} can be reached from other machines, without encryption or a password; "
            "ask for it with --expose if that is meant"
        )
    return endpoint


class Sockets:
    """A publisher and a router; `with Sockets(publish, command, lease_s=10.0) as sockets`.

    Args:
        publish: endpoint of the publisher (XPUB, so that who subscribes is known).
        command: endpoint of the router.
        lease_s: a peer that is silent for so long, heartbeats included, is gone.

    Raises:
        EndpointTaken: another program listens there.
        InvalidConfig: there is no such address on this machine.

    Attributes:
        publish, command: the endpoints as bound, `*` replaced by the port.
        dropped: answers that a peer did not fetch.
    """

    def __init__(self, publish: str, command: str, *, lease_s: float) -> None:
        self.dropped = 0
        self._shelf: deque[Callable[[], None]] = deque()
        self._connected: set[int] = set()
        self._lease_ms = int(lease_s * 1000)
        self._close = ExitStack()
        with ExitStack() as undo:
            undo.callback(self.close)
            self._wakes, self._woken = socket.socketpair()
            self._close.callback(self._wakes.close)
            self._close.callback(self._woken.close)
            self._wakes.settimeout(0)
            self._woken.settimeout(0)
            self._context = zmq.Context()
            self._close.callback(self._context.destroy, linger=0)
            self._publisher = self._socket(zmq.XPUB)
            self._publisher.xpub_verbose = True
            self._router = self._socket(zmq.ROUTER)
            self._router.router_mandatory = True
            self._router.maxmsgsize = 2 * codec.MAX_BYTES
            self._monitor = self._router.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
            self._close.callback(self._router.disable_monitor)
            self.publish = _bind(self._publisher, publish)
            self.command = _bind(self._router, command)
            self._poller = zmq.Poller()
            for waited in (self._publisher, self._router, self._monitor, self._woken):
                self._poller.register(waited, zmq.POLLIN)
            undo.pop_all()

    def _socket(self, kind: int) -> zmq.Socket[bytes]:
        made = self._context.socket(kind)
        made.linger = 0
        made.heartbeat_ivl = max(1, self._lease_ms // _PING)
        made.heartbeat_timeout = self._lease_ms
        return made

    def __enter__(self) -> Sockets:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes all; twice is fine."""
        self._close.close()

    # Any thread

    def shelve(self, work: Callable[[], None]) -> None:
        """Has the sockets' own thread do something."""
        self._shelf.append(work)
        with suppress(OSError):  # full: it is awake; closed: nobody does anything any more
            self._wakes.send(b"\0")

    # The sockets' own thread

    def wait(self) -> None:
        """Until anything has come."""
        self._poller.poll()

    def clear_shelf(self) -> None:
        """Does what other threads have put on the shelf."""
        with suppress(BlockingIOError):
            self._woken.recv(4096)
        while self._shelf:
            self._shelf.popleft()()

    def requests(self, gone: Callable[[int], None]) -> Iterator[tuple[list[bytes], int]]:
        """Messages that have come, with the descriptor of their connection; `gone` hears of those that are closed.

        What a peer sent before it went may be read after that was told, and a descriptor is used again by the next
        peer. So the monitor is read after each message: libzmq tells it of a connection before it hands that one's
        messages over, and of the end of the one before on the same descriptor. What a peer said that has gone is
        left out: nobody waits for the answer.
        """
        for _ in range(_BURST):
            try:
                frames = self._router.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                self._watch(gone)
                return
            self._watch(gone)
            fd = int(frames[-1].get(zmq.SRCFD))
            if fd in self._connected:
                yield [frame.bytes for frame in frames], fd

    def _watch(self, gone: Callable[[int], None]) -> None:
        while self._monitor.poll(0):
            told = recv_monitor_message(self._monitor, zmq.NOBLOCK)
            fd = int(told["value"])
            if told["event"] == zmq.EVENT_DISCONNECTED:
                self._connected.discard(fd)
                gone(fd)
            else:
                self._connected.add(fd)

    def subscriptions(self) -> Iterator[bytes]:
        """Prefixes that were subscribed to."""
        for _ in range(_BURST):
            try:
                said = self._publisher.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            if said[:1] == b"\1":
                yield said[1:]

    def send(self, frames: Sequence[bytes]) -> None:
        """An answer; a peer that is gone or fetches none does not hold the others up."""
        try:
            self._router.send_multipart(frames, zmq.NOBLOCK)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EHOSTUNREACH, zmq.EAGAIN):
                raise
            self.dropped += 1

    def put(self, frames: Sequence[bytes]) -> None:
        """To all subscribers; it never waits: one that is slow misses messages."""
        self._publisher.send_multipart(frames, zmq.NOBLOCK)


def _bind(made: zmq.Socket[bytes], endpoint: str) -> str:
    kind, _, path = endpoint.partition("://")
    # libzmq takes over the path of a socket that is in use; its owner would not notice.
    if kind == "ipc" and Path(path).exists():
        raise EndpointTaken(f"{path} exists already; name another path, or remove it if nobody listens there")
    try:
        made.bind(endpoint)
    except zmq.ZMQError as error:
        if error.errno == zmq.EADDRINUSE:
            raise EndpointTaken(f"another program listens on {endpoint}; name another port") from None
        raise InvalidConfig(f"{endpoint}: {error.strerror}; name an address of this machine and a port") from None
    return bytes(made.getsockopt(zmq.LAST_ENDPOINT)).rstrip(b"\0").decode()
