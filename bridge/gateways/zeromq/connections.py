"""Connections of a ZeroMQ socket, and the end of those that send a message without an end.

libzmq hands a message over once its last frame has come, and limits each frame, not their sum. How much it holds of a
message that is not whole it does not say. For TCP the kernel does: all that a connection has received (`TCP_INFO`),
less what it had received when a whole message of it was read. Linux does not count for `ipc:`.
"""

from __future__ import annotations

import os
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

from topics import codec

MAX_UNREAD = 4 * codec.MAX_BYTES
"""Bytes of a message that is not whole yet: the largest two frames that are read at all."""

MAX_UNREAD_IN_ALL = 8 * MAX_UNREAD
"""The same of all connections together; of more, the one that holds most ends."""

CHECK_S = 0.1

_HEARTBEAT_BYTES = 256  # of one interval: a ping and a pong, and those of a peer that asks several times as often
_TCP_INFO = struct.Struct("=128xQ")  # tcpi_bytes_received in struct tcp_info, linux/tcp.h
_RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # struct linger: on, for 0 s


@dataclass(slots=True)
class _Read:
    """What a connection had received when nothing of it was unread, and when that was."""

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
        """A connection was accepted."""
        self._read[fd] = _Read(0, monotonic())

    def closed(self, fd: int) -> None:
        """It has ended."""
        self._read.pop(fd, None)
        self._fresh.discard(fd)

    def read(self, fd: int) -> None:
        """A whole message of it was read."""
        self._fresh.add(fd)

    def end_endless(self) -> None:
        """Ends connections with too much unread; call it when all whole messages have been read."""
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
    """A socket of its own on libzmq's connection, which may be closed, and its number used again, at any time."""
    return socket.socket(socket.AF_INET, socket.SOCK_STREAM, 0, fileno=os.dup(fd))


def _received(fd: int) -> int:
    """Bytes that it has received; 0 where the kernel does not count them, and of one that is closed."""
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
