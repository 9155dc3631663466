"""The gateway's ZeroMQ sockets: permitted endpoints, waiting on all of them, ended connections.

They belong to one thread. Other threads post tasks to its queue, which wakes it.
"""

from __future__ import annotations

import re
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from time import monotonic

import zmq
from zmq.utils.monitor import recv_monitor_message

from zenostat.gateways.zeromq.connections import CHECK_S, Connections
from zenostat.topics import codec
from zenostat.topics.addresses import is_loopback
from zenostat.topics.errors import AddressInUse, InvalidConfig

DEFAULT_PUBLISH = "tcp://127.0.0.1:5556"
DEFAULT_COMMAND = "tcp://127.0.0.1:5557"

_FORM = re.compile(r"tcp://(\[[0-9A-Fa-f:.]+\]|[^\s:/\[\]]+):(\d{1,5}|\*)|ipc:///\S+")
_BURST = 256
_PING = 3  # of a lease: a peer that has answered none of three pings is gone
_MOST_SUBSCRIBED = 1024  # bytes of a subscription; the longest topic has some 300


def is_local(endpoint: str) -> bool:
    """Return whether no other machine can reach an endpoint."""
    host = endpoint.removeprefix("tcp://").rpartition(":")[0]
    return endpoint.startswith("ipc:") or is_loopback(host)


def check_endpoint(endpoint: str, *, expose: bool) -> str:
    """Return a valid endpoint.

    Raises:
        InvalidConfig: it is not an endpoint, or other machines can reach it and `expose` is false.
    """
    if not _FORM.fullmatch(endpoint):
        raise InvalidConfig(
            f"{endpoint!r} is not a ZeroMQ endpoint to listen on; "
            f"write tcp://ADDRESS:PORT (for example {DEFAULT_PUBLISH}) or ipc:///PATH"
        )
    if not is_local(endpoint) and not expose:
        raise InvalidConfig(
            f"{endpoint} can be reached from other machines, without encryption or a password; "
            "if that is intended, allow it with --expose"
        )
    return endpoint


class Sockets:
    """A publisher and a router; `with Sockets(publish, command, lease_s=10.0) as sockets`.

    Args:
        publish: endpoint of the publisher (XPUB, which reports subscriptions).
        command: endpoint of the router.
        lease_s: a peer that sends nothing for this time, not even heartbeats, is disconnected.

    Raises:
        AddressInUse: another program listens there.
        InvalidConfig: there is no such address on this machine.

    Attributes:
        publish, command: the endpoints as bound, `*` replaced by the port.
        dropped: number of replies that could not be delivered.
    """

    def __init__(self, publish: str, command: str, *, lease_s: float) -> None:
        self.dropped = 0
        self._tasks: deque[Callable[[], None]] = deque()
        self._lease_ms = int(lease_s * 1000)
        self._connected = Connections(lease_s / _PING)
        self._subscribed = Connections(lease_s / _PING)
        self._checked_s = 0.0
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
            self._publisher.maxmsgsize = _MOST_SUBSCRIBED
            self._router = self._socket(zmq.ROUTER)
            self._router.router_mandatory = True
            self._router.router_handover = True
            self._router.maxmsgsize = 2 * codec.MAX_BYTES
            self._monitor = self._monitor_of(self._router)
            self._subscribers = self._monitor_of(self._publisher)
            self.publish = _bind(self._publisher, publish)
            self.command = _bind(self._router, command)
            self._poller = zmq.Poller()
            for waited in (self._publisher, self._router, self._monitor, self._subscribers, self._woken):
                self._poller.register(waited, zmq.POLLIN)
            self._only_tasks = [(self._woken.fileno(), zmq.POLLIN)]
            undo.pop_all()

    def _socket(self, kind: int) -> zmq.Socket[bytes]:
        new = self._context.socket(kind)
        new.linger = 0
        new.heartbeat_ivl = max(1, self._lease_ms // _PING)
        new.heartbeat_timeout = self._lease_ms
        return new

    def _monitor_of(self, watched: zmq.Socket[bytes]) -> zmq.Socket[bytes]:
        monitor: zmq.Socket[bytes] = watched.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
        self._close.callback(watched.disable_monitor)
        return monitor

    def __enter__(self) -> Sockets:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all sockets; idempotent."""
        self._close.close()

    # Any thread

    def post(self, work: Callable[[], None]) -> None:
        """Post a task to the sockets' thread."""
        self._tasks.append(work)
        with suppress(OSError):  # full: the thread is awake; closed: no task runs any more
            self._wakes.send(b"\0")

    # The sockets' own thread

    def wait(self) -> bool:
        """Wait for a message, a task, or the next check of connections; return whether there is more than tasks."""
        ready = self._poller.poll(int(CHECK_S * 1000) if self._connected or self._subscribed else None)
        return ready != self._only_tasks or monotonic() - self._checked_s >= CHECK_S

    def run_pending(self) -> None:
        """Run the tasks that other threads have posted."""
        with suppress(BlockingIOError):
            self._woken.recv(4096)
        while self._tasks:
            self._tasks.popleft()()

    def requests(self, gone: Callable[[int], None]) -> Iterator[tuple[list[bytes], int]]:
        """Yield received messages with the descriptor of their connection; `gone` is called for closed connections.

        Messages of a peer may be read after its disconnection was reported, and the next peer may get its descriptor.
        So the monitor is read after each message: libzmq reports a connection before it delivers its messages, and
        after the end of the previous one with the same descriptor. Messages of disconnected peers are skipped.
        """
        for _ in range(_BURST):
            try:
                frames = self._router.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                self._watch(gone)
                self._end_endless()
                return
            self._watch(gone)
            fd = int(frames[-1].get(zmq.SRCFD))
            if fd in self._connected:
                self._connected.read(fd)
                yield [frame.bytes for frame in frames], fd

    def _watch(self, gone: Callable[[int], None]) -> None:
        for fd in _ended(self._monitor, self._connected):
            gone(fd)

    def _end_endless(self) -> None:
        """Periodically end connections that send endless messages."""
        now_s = monotonic()
        if now_s - self._checked_s < CHECK_S:
            return
        self._checked_s = now_s
        for _ in _ended(self._subscribers, self._subscribed):
            pass
        self._connected.end_endless()
        self._subscribed.end_endless()

    def subscriptions(self) -> Iterator[bytes]:
        """Yield the prefixes of new subscriptions."""
        for _ in range(_BURST):
            try:
                frame = self._publisher.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            if frame[:1] == b"\1":
                yield frame[1:]

    def send(self, frames: Sequence[bytes]) -> None:
        """Send a reply; it is dropped if the peer is disconnected or does not receive."""
        try:
            self._router.send_multipart(frames, zmq.NOBLOCK)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EHOSTUNREACH, zmq.EAGAIN):
                raise
            self.dropped += 1

    def put(self, frames: Sequence[bytes]) -> None:
        """Publish to all subscribers without waiting: slow ones miss messages."""
        self._publisher.send_multipart(frames, zmq.NOBLOCK)


def _ended(monitor: zmq.Socket[bytes], connections: Connections) -> Iterator[int]:
    """Process a monitor's events; yield the connections that have ended."""
    while monitor.poll(0):
        event = recv_monitor_message(monitor, zmq.NOBLOCK)
        fd = int(event["value"])
        if event["event"] == zmq.EVENT_DISCONNECTED:
            connections.closed(fd)
            yield fd
        else:
            connections.opened(fd)


def _bind(target: zmq.Socket[bytes], endpoint: str) -> str:
    kind, _, path = endpoint.partition("://")
    # libzmq takes over the path of a socket that is in use, without an error for its owner.
    if kind == "ipc" and Path(path).exists():
        raise AddressInUse(f"{path} already exists; name another path, or remove it if no program listens there")
    target.ipv6 = "[" in endpoint
    try:
        target.bind(endpoint.replace("//localhost:", "//127.0.0.1:"))  # libzmq takes it for an interface
    except zmq.ZMQError as error:
        if error.errno == zmq.EADDRINUSE:
            raise AddressInUse(f"another program listens on {endpoint}; name another port") from None
        raise InvalidConfig(f"{endpoint}: {error.strerror}; name an address of this machine and a port") from None
    return bytes(target.getsockopt(zmq.LAST_ENDPOINT)).rstrip(b"\0").decode()
