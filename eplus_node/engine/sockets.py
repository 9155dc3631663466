"""The sockets between a node and an engine."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from typing import NamedTuple

from bridge.runtime.idle_watch import LOOK_S
from eplus_node.engine.protocol import PROCESS_ID

_SOCKET_BYTES = 1 << 20
# The kernel's own timeout costs nothing where the answer comes in time.
_TIMEOUT = struct.pack("@ll", int(LOOK_S), int(LOOK_S % 1 * 1e6))


def _socket_pair() -> tuple[socket.socket, socket.socket]:
    pair = socket.socketpair()
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BYTES)
    return pair


def fill(link: socket.socket, into: memoryview, look: Callable[[], None]) -> bool:
    """Reads until `into` is full; false if the other side has ended. `look` is called while nothing comes."""
    while into:
        try:
            got = link.recv_into(into)
        except BlockingIOError:
            look()
            continue
        except ConnectionResetError:
            return False
        if not got:
            return False
        into = into[got:]
    return True


def send_all(link: socket.socket, data: bytes, look: Callable[[], None]) -> None:
    """Sends all of it; `look` is called while the other side takes nothing."""
    rest = memoryview(data)
    while rest:
        try:
            rest = rest[link.send(rest) :]
        except BlockingIOError:
            look()


def read_process_id(link: socket.socket, look: Callable[[], None]) -> int:
    """A process id, or the negative number of an error; 0 if whoever should say it has ended."""
    said = bytearray(PROCESS_ID.size)
    return int(PROCESS_ID.unpack(said)[0]) if fill(link, memoryview(said), look) else 0


class SocketPair(NamedTuple):
    """One side's sockets: orders go to the engine on one, frames to the node on the other."""

    orders: socket.socket
    frames: socket.socket

    @property
    def descriptors(self) -> list[int]:
        """Their numbers."""
        return [end.fileno() for end in self]

    def close(self) -> None:
        """Closes both; twice is fine."""
        for end in self:
            end.close()

    def __enter__(self) -> SocketPair:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def socket_pairs() -> tuple[SocketPair, SocketPair]:
    """The node's side and the engine's."""
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
