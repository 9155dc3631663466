"""Records of an MCAP file, read one after the other, and whether a file that ends early was cut off or is damaged."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk

from zenostat.bridge.recording.chunk_writer import COMPRESSION
from zenostat.bridge.recording.file import MAGIC

MAX_DROPPED = 8 << 20
"""Largest number of bytes that a killed node had begun to write; more is damage."""

MESSAGE = struct.Struct("<HIQQ")
"""Head of a message: channel, sequence, log time, publish time; its payload follows."""

_HEAD = struct.Struct("<BQ")
_FOOTER_SIZE = 20
"""Bytes of the content of a footer, of which the last four are the checksum of the summary section and the rest."""
_MAX_CHUNK = 1 << 30
_MAX_ATTEMPTS = 1000
_MARK = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()
"""The name of the compression, which each chunk has after times, size and checksum."""
_BEFORE_MARK = _HEAD.size + struct.calcsize("<QQQI")


class Record(NamedTuple):
    """A record of the file, with its opcode and content."""

    opcode: int
    body: bytes

    @property
    def size(self) -> int:
        """Number of bytes in the file."""
        return _HEAD.size + len(self.body)

    def checksum(self, before: int) -> int:
        """Return the CRC-32 of what precedes the record, `before`, and the record."""
        return zlib.crc32(self.body, zlib.crc32(_HEAD.pack(self.opcode, len(self.body)), before))


def next_record(file: BinaryIO, size: int) -> Record | None:
    """Return the next record; None if the file, of `size` bytes, ends before it is complete, or has no record there."""
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    if not opcode or length > size - file.tell():  # a file that lost its power may end in zeros
        return None
    return Record(opcode, file.read(length))


def completed_end(file: BinaryIO, size: int) -> tuple[int, bool] | None:
    """Read a file, of `size` bytes, from behind its data to its end, as the recorder writes it.

    Returns:
        Where it ends, and whether the checksum of its summary section matches; None if there is no such end.
    """
    checksum = 0
    while (record := next_record(file, size)) is not None and record.opcode != Opcode.CHUNK:
        if record.opcode == Opcode.DATA_END:
            checksum = 0  # the summary section begins
        elif record.opcode == Opcode.FOOTER and len(record.body) == _FOOTER_SIZE:
            head, expected = record.body[:-4], int.from_bytes(record.body[-4:], "little")
            checksum = zlib.crc32(head, zlib.crc32(_HEAD.pack(record.opcode, _FOOTER_SIZE), checksum))
            has_end = file.read(len(MAGIC)) == MAGIC
            return (file.tell(), checksum == expected) if has_end else None
        else:
            checksum = record.checksum(checksum)
    return None


def chunk_data(body: bytes) -> bytes:
    """Return the content of a chunk; `ValueError` if it is damaged."""
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
        if chunk.compression != COMPRESSION or chunk.uncompressed_size > _MAX_CHUNK:
            raise ValueError(f"a chunk with compression {chunk.compression!r} and {chunk.uncompressed_size} bytes")
        data = zstandard.decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    except Exception as error:  # the libraries raise what their parsing meets
        raise ValueError(str(error)) from None
    if len(data) != chunk.uncompressed_size or zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum does not match its content")
    return data


def chunk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Iterate over the records in the content of a chunk: opcode, and where its body begins and ends."""
    position, size, head = 0, len(data), _HEAD.unpack_from
    while position < size:
        opcode, length = head(data, position)
        begin = position + _HEAD.size
        position = begin + length
        yield opcode, begin, position


def is_cut_off(file: BinaryIO, offset: int, size: int) -> bool:
    """Return whether the bytes from `offset`, where no complete record begins, are the rest that a killed node leaves.

    Otherwise the file is damaged there: more than a node had begun to write follows, the end of a completed file, or a
    complete chunk.
    """
    if size - offset > MAX_DROPPED:
        return False
    file.seek(offset)
    rest = file.read(size - offset)
    return not (rest.endswith(MAGIC) or has_later_chunk(rest))


def has_later_chunk(data: bytes) -> bool:
    """Return whether there is a chunk that is not damaged anywhere after the first byte."""
    attempts, mark = 0, data.find(_MARK, _BEFORE_MARK + 1)
    while mark >= 0 and attempts < _MAX_ATTEMPTS:
        opcode, length = _HEAD.unpack_from(data, mark - _BEFORE_MARK)
        begin = mark - _BEFORE_MARK + _HEAD.size
        if opcode == Opcode.CHUNK and length <= len(data) - begin:
            attempts += 1
            try:
                chunk_data(data[begin : begin + length])
            except ValueError:
                pass
            else:
                return True
        mark = data.find(_MARK, mark + 1)
    return False
