"""Messages between an FMU of a node and the gateway, over TCP.

A message is a header of two little-endian uint32, its kind and the length of its content in bytes, and the content. An
FMU sends requests one after the other; the gateway answers each with the kind in the table, or with FAILURE, and sends
WORKING every few seconds before an answer that takes longer.

| kind | content | answer |
|---|---|---|
| OPEN | int32 seed, -1 for none; GUID of the FMU in ASCII | SAMPLE of the first sample of a new episode |
| STEP | uint32 number of timesteps; float64 of each actuator, NaN relinquishes it | SAMPLE |
| SAVE | none | SAVED: uint32 number of the snapshot |
| RESTORE | uint32 number of a snapshot | SAMPLE |
| DROP | uint32 number of a snapshot | DROPPED |

The content of SAMPLE is uint32 flags, uint32 step, and a float64 for each output; that of FAILURE is a text in UTF-8.
"""

from __future__ import annotations

import socket
import struct
from enum import IntEnum, IntFlag

HEADER = struct.Struct("<II")
MAX_TEXT = 1000
"""Largest length of the text of a failure, in bytes."""


class Kind(IntEnum):
    """Kinds of messages; those of the gateway begin at 16."""

    OPEN = 1
    STEP = 2
    SAVE = 3
    RESTORE = 4
    DROP = 5
    SAMPLE = 16
    SAVED = 17
    DROPPED = 18
    WORKING = 19
    FAILURE = 20


class Flags(IntFlag):
    """Flags of a sample."""

    TRUNCATED = 1


class MalformedRequest(Exception):
    """Data that is no request of an FMU, or not at its time."""


def encode(kind: Kind, content: bytes = b"") -> bytes:
    """Return a message."""
    return HEADER.pack(kind, len(content)) + content


def encode_failure(text: str) -> bytes:
    """Return a FAILURE; a long text is cut."""
    return encode(Kind.FAILURE, text.encode()[:MAX_TEXT].decode(errors="ignore").encode())


def read_request(connection: socket.socket, largest: int) -> tuple[Kind, bytes] | None:
    """Return the kind and the content of the next request; None at the end of the connection.

    Args:
        connection: the connection.
        largest: largest length of the content in bytes.

    Raises:
        MalformedRequest: an unknown kind, or a longer content.
        OSError: the connection has failed.
    """
    header = _read(connection, HEADER.size)
    if not header:
        return None
    number, length = HEADER.unpack(header)
    if number not in (Kind.OPEN, Kind.STEP, Kind.SAVE, Kind.RESTORE, Kind.DROP) or length > largest:
        raise MalformedRequest("this is the port of FMUs of a node; use one that `--fmu` has written")
    content = _read(connection, length)
    return (Kind(number), content) if len(content) == length else None


def _read(connection: socket.socket, size: int) -> bytes:
    """Return the next bytes; empty if the connection ends before."""
    content = bytearray()
    while len(content) < size:
        part = connection.recv(size - len(content))
        if not part:
            return b""
        content += part
    return bytes(content)
