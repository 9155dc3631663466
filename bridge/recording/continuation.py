"""Read the complete part of a recording that ended, so that a recorder can append to it.

A node that is killed loses what it had not written. What is after the last complete chunk, the part of a chunk or the
end of a completed file, is dropped when the first chunk is appended, and nothing before it changes.
"""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Metadata,
    MetadataIndex,
    Schema,
)

from zenostat.bridge.recording.channels import AUDIT, CHANNELS
from zenostat.bridge.recording.chunk_writer import COMPRESSION, message_index
from zenostat.bridge.recording.complete_part import Written
from zenostat.bridge.recording.file import MAGIC
from zenostat.bridge.recording.reader import RecordingReader, chunk_data
from zenostat.topics import codec, recording
from zenostat.topics.errors import BadMessage, InvalidRecording
from zenostat.topics.recording import RecordedAudit

MAX_DROPPED = 8 << 20
"""Largest number of bytes that are dropped: more than what a killed node had begun to write is damage."""

_MAX_ATTEMPTS = 1000

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_COMPLETE = (Opcode.DATA_END, Opcode.METADATA)
_MARK = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()
"""The name of the compression, which each chunk has after times, size and checksum."""
_BEFORE_MARK = _HEAD.size + struct.calcsize("<QQQI")


def read_written(path: Path) -> Written:
    """Read what is complete of a recording, of which `RecordingReader` has checked the beginning.

    Raises:
        InvalidRecording: an earlier release wrote it, or it is damaged, and not only cut off: more is left than a node
            had begun to write, or there is complete data behind the damage.
    """
    written = Written(path)
    with path.open("rb") as file:
        written.size = os.fstat(file.fileno()).st_size
        file.seek(len(MAGIC))
        written.offset = len(MAGIC)
        is_over = False
        while not is_over and (raw := _next_record(file, written.size)):
            is_over = _add(written, raw, file)
        if is_over and raw and raw[0] in _COMPLETE:  # a completed file; its end is written again
            return _checked(written)
        if (dropped := written.size - written.offset) > MAX_DROPPED:
            raise InvalidRecording(
                f"{path} is damaged after byte {written.offset:,}, and {dropped:,} bytes follow, which going on with "
                "it would drop"
            )
        file.seek(written.offset)
        rest = file.read(dropped)
    if rest.endswith(MAGIC) or _has_later_chunk(rest):
        raise InvalidRecording(
            f"{path} is damaged at byte {written.offset:,}, and complete data follow, which going on with it would "
            f"overwrite; to go on from the damage, keep a copy, and cut the file: truncate -s {written.offset} {path}"
        )
    written.dropped = dropped
    return _checked(written)


def _has_later_chunk(data: bytes) -> bool:
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


def has_messages(path: Path) -> bool:
    """Return whether a file is there with anything but the beginning of a recording.

    Raises:
        InvalidRecording: see `RecordingReader`.
    """
    if not path.exists() or not path.stat().st_size:
        return False
    try:
        with RecordingReader(path) as reader:
            return next(reader.messages(), None) is not None
    except InvalidRecording:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) == MAGIC and path.stat().st_size < MAX_DROPPED and not _has_chunk(file):
                return False
        raise


def _has_chunk(file: io.BufferedReader) -> bool:
    size = os.fstat(file.fileno()).st_size
    while raw := _next_record(file, size):
        if raw[0] == Opcode.CHUNK:
            return True
    return False


def _checked(written: Written) -> Written:
    fixed = [(f"{written.root}/{topic}", kind.__name__) for topic, kind in CHANNELS]
    names = {schema.id: name for name, schema in written.schemas.items()}
    present = [
        (written.channels[number].topic, names.get(written.channels[number].schema_id, ""))
        for number in range(len(CHANNELS))
        if number in written.channels
    ]
    if present != fixed and written.messages:
        raise InvalidRecording(f"another release of Zenostat recorded {written.path}; only that one can go on with it")
    return written


def _next_record(file: io.BufferedReader, size: int) -> bytes:
    """Return the next record with its head; empty if the file ends before it is complete, or has no record there."""
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return b""
    opcode, length = _HEAD.unpack(head)
    if not opcode or length > size - file.tell():  # a file that lost its power may end in zeros
        return b""
    return head + file.read(length)


def _add(written: Written, raw: bytes, file: io.BufferedReader) -> bool:
    """Add a record; return whether nothing after it, or of it, is kept."""
    opcode, body = raw[0], raw[_HEAD.size :]
    stream = ReadDataStream(io.BytesIO(body))
    try:
        if opcode == Opcode.CHUNK:
            return _add_chunk(written, raw, file)
        if opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            if metadata.name == recording.SUMMARY:
                return True
            if metadata.name == recording.ABOUT:
                written.root = metadata.metadata["root"]
            written.metadata.append(MetadataIndex(offset=written.offset, length=len(raw), name=metadata.name))
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            written.attachments.append(
                AttachmentIndex(
                    offset=written.offset,
                    length=len(raw),
                    log_time=attachment.log_time,
                    create_time=attachment.create_time,
                    data_size=len(attachment.data),
                    name=attachment.name,
                    media_type=attachment.media_type,
                )
            )
        elif opcode == Opcode.DATA_END:
            return True
    except Exception:  # the library raises what its parsing meets
        return True
    written.offset += len(raw)
    return False


def _add_chunk(written: Written, raw: bytes, file: io.BufferedReader) -> bool:
    try:
        data = chunk_data(raw[_HEAD.size :])
    except ValueError:
        return True
    chunk = Chunk.read(ReadDataStream(io.BytesIO(raw[_HEAD.size :])))
    index = _read_messages(written, data)
    start, end = written.offset, written.offset + len(raw)
    expected, offsets = message_index(index, end)
    written.offset = end
    is_whole = file.read(len(expected)) == expected
    if is_whole:
        written.offset += len(expected)
    else:
        written.missing_index = expected
    written.chunks.append(
        ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=start,
            chunk_length=len(raw),
            message_index_offsets=offsets,
            message_index_length=len(expected),
            compression=COMPRESSION,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    written.first_ns = written.first_ns or chunk.message_start_time
    written.last_ns = chunk.message_end_time
    return not is_whole


def _read_messages(written: Written, data: bytes) -> dict[int, list[int]]:
    """Add the channels and messages of a chunk; return the time and the place of each message by channel."""
    index: dict[int, list[int]] = {}
    position, size = 0, len(data)
    while position < size:
        opcode, length = _HEAD.unpack_from(data, position)
        body = position + _HEAD.size
        if opcode == Opcode.MESSAGE:
            number, _, time_ns, _ = _MESSAGE.unpack_from(data, body)
            index.setdefault(number, []).extend((time_ns, position))
            written.counts[number] = written.counts.get(number, 0) + 1
            written.messages += 1
            if number == AUDIT:
                _read_audit(written, data[body + _MESSAGE.size : body + length])
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(io.BytesIO(data[body : body + length])))
            written.schemas[schema.name] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(io.BytesIO(data[body : body + length])))
            written.channels[channel.id] = channel
            written.counts.setdefault(channel.id, 0)
        position = body + length
    return index


def _read_audit(written: Written, payload: bytes) -> None:
    try:
        written.audit = codec.decode(RecordedAudit, payload)
    except BadMessage as error:
        raise InvalidRecording(f"{written.path} is damaged: its audit log: {error}") from None
