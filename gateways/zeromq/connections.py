"""Connections of a ZeroMQ socket, and disconnection of peers that send endless messages.

libzmq delivers a message once its last frame has arrived. It limits the size of each frame, not of the message, and
does not report how much of an incomplete message it has buffered. For TCP the kernel does: the bytes that a connection
has received (`TCP_INFO`), minus those when a complete message was last read. Linux has no such count for `ipc:`.
"""

from __future__ import annotations

import os
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

from zenostat.topics import codec

MAX_UNREAD = 4 * codec.MAX_BYTES
"""Largest number of bytes of an incomplete message: two frames of the largest size."""

MAX_UNREAD_IN_ALL = 8 * MAX_UNREAD
"""The limit for all connections together; beyond it, the connection with most unread bytes is ended."""

CHECK_S = 0.1

_HEARTBEAT_BYTES = 256  # of one interval: a ping and a pong, and those of a peer that asks several times as often
_TCP_INFO = struct.Struct("=128xQ")  # tcpi_bytes_received in struct tcp_info, linux/tcp.h
_RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # struct linger: on, for 0 s


@dataclass(slots=True)
class _Read:
    """Bytes that a connection had received when none were unread, and the time of that."""

    received: int
    at_s: float


class Connections:
    """The open connections of one socket, by their file descriptors.

    Args:
        heartbeat_s: the socket's interval of heartbeats, which count as received.
    """

    def __init__(self, heartbeat_s: float) -> None:
        self._heartbeat_s = heartbeat_s
        self._read: dict[int, _Read] = {}
        self._fresh: set[int] = set()

    def __contains__(self, fd: int) -> bool:
        return fd in self._read

    def __bool__(self) -> bool:
        return bool(self._read)

    def opened(self, fd: int) -> None:
        """Add a connection that was accepted."""
        self._read[fd] = _Read(0, monotonic())

    def closed(self, fd: int) -> None:
        """Remove a connection that has ended."""
        self._read.pop(fd, None)
        self._fresh.discard(fd)

    def read(self, fd: int) -> None:
        """Record that a complete message of a connection was read."""
        self._fresh.add(fd)

    def end_endless(self) -> None:
        """End connections with too many unread bytes; call it when all complete messages have been read."""
        now_s, unread = monotonic(), dict[int, int]()
        for fd, read in self._read.items():
            received = _received(fd)
            if fd in self._fresh:
                read.received, read.at_s = received, now_s
            heartbeats = int((now_s - read.at_s) / self._heartbeat_s + 1) * _HEARTBEAT_BYTES
            unread[fd] = max(0, received - read.received - heartbeats)
        self._fresh.clear()
        ended = {fd for fd, count in unread.items() if count > MAX_UNREAD}
        if sum(count for fd, count in unread.items() if fd not in ended) > MAX_UNREAD_IN_ALL:
            ended.add(max(unread, key=lambda fd: unread[fd] if fd not in ended else -1))
        for fd in ended:
            _end(fd, self._read[fd].received)


def _of(fd: int) -> socket.socket:
    """Return a duplicate socket of libzmq's connection, whose descriptor may be closed and reused at any time."""
    return socket.socket(socket.AF_INET, socket.SOCK_STREAM, 0, fileno=os.dup(fd))


def _received(fd: int) -> int:
    """Return the bytes that a connection has received; 0 if the kernel does not count them, or it is closed."""
    with suppress(OSError), _of(fd) as connection:
        return _counted(connection)
    return 0


def _counted(connection: socket.socket) -> int:
    count: int = _TCP_INFO.unpack(connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO.size))[0]
    return count


def _end(fd: int, read: int) -> None:
    with suppress(OSError), _of(fd) as connection:
        if _counted(connection) > read:  # else it is another connection by now
            # libzmq closes it after the shutdown. That has to reset it: a peer whose window was zero would otherwise
            # probe it for minutes before its send fails.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
            connection.shutdown(socket.SHUT_RDWR)
