"""The two socket pairs between a node and an engine."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from typing import NamedTuple

from zenostat.bridge.engine.protocol import PROCESS_ID
from zenostat.bridge.runtime.idle_watch import LOOK_S

_SOCKET_BYTES = 1 << 20
# The kernel's receive timeout costs nothing when the answer arrives in time.
_TIMEOUT = struct.pack("@ll", int(LOOK_S), int(LOOK_S % 1 * 1e6))


def _socket_pair() -> tuple[socket.socket, socket.socket]:
    pair = socket.socketpair()
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BYTES)
    return pair


def fill(source: socket.socket, buffer: memoryview, check: Callable[[], None]) -> bool:
    """Read until `buffer` is full and return True; False if the other side has closed. Call `check` while waiting."""
    while buffer:
        try:
            received = source.recv_into(buffer)
        except BlockingIOError:
            check()
            continue
        except ConnectionResetError:
            return False
        if not received:
            return False
        buffer = buffer[received:]
    return True


def send_all(target: socket.socket, data: bytes, check: Callable[[], None]) -> None:
    """Send all of `data`; call `check` while the other side does not read."""
    rest = memoryview(data)
    while rest:
        try:
            rest = rest[target.send(rest) :]
        except BlockingIOError:
            check()


def read_process_id(source: socket.socket, check: Callable[[], None]) -> int:
    """Read a process id or a negative error number; 0 if the other side has closed."""
    raw = bytearray(PROCESS_ID.size)
    return int(PROCESS_ID.unpack(raw)[0]) if fill(source, memoryview(raw), check) else 0


class SocketPair(NamedTuple):
    """The sockets of one side: one for orders to the engine, one for frames to the node."""

    orders: socket.socket
    frames: socket.socket

    @property
    def descriptors(self) -> list[int]:
        """File descriptors of both sockets."""
        return [end.fileno() for end in self]

    def close(self) -> None:
        """Close both sockets; idempotent."""
        for end in self:
            end.close()

    def __enter__(self) -> SocketPair:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def socket_pairs() -> tuple[SocketPair, SocketPair]:
    """Create the sockets of the node's side and of the engine's side."""
    orders = _socket_pair()
    try:
        frames = _socket_pair()
    except OSError:
        for end in orders:
            end.close()
        raise
    for end in (orders[0], frames[0]):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEOUT)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _TIMEOUT)
    return SocketPair(orders[0], frames[0]), SocketPair(orders[1], frames[1])
