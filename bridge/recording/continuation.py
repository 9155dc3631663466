"""Read the complete part of a recording that ended, so that a recorder can append to it.

A node that is killed loses what it had not written. What is after the last complete chunk, the part of a chunk or the
end of a completed file, is dropped when the first chunk is appended, and nothing before it changes.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, Metadata, MetadataIndex, Schema

from zenostat.bridge.recording.channels import AUDIT, CHANNELS
from zenostat.bridge.recording.chunk_writer import COMPRESSION, message_index
from zenostat.bridge.recording.complete_part import Written
from zenostat.bridge.recording.file import MAGIC
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.recording.records import (
    MAX_DROPPED,
    MESSAGE,
    Record,
    chunk_data,
    chunk_records,
    completed_end,
    has_later_chunk,
    is_cut_off,
    next_record,
)
from zenostat.topics import codec, recording
from zenostat.topics.errors import BadMessage, InvalidRecording
from zenostat.topics.recording import RecordedAudit

_COMPLETE = (Opcode.DATA_END, Opcode.METADATA)


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
        while not is_over and (record := next_record(file, written.size)) is not None:
            is_over = _add(written, record, file)
        at = written.offset
        if is_over and record is not None and record.opcode in _COMPLETE:  # a completed file; its end is written again
            completed = completed_end(file, written.size)
            file.seek(at)
            if completed is None and not has_later_chunk(file.read()):
                return _checked(written)
            at = at if completed is None else completed[0]
        written.dropped = written.size - at
        is_damaged = not is_cut_off(file, at, written.size)
    what = f"{path} {'is damaged' if at == written.offset else 'ends'}"
    if is_damaged and written.dropped > MAX_DROPPED:
        raise InvalidRecording(
            f"{what} after byte {at:,}, and {written.dropped:,} bytes follow, which going on with it would drop"
        )
    if is_damaged:
        raise InvalidRecording(
            f"{what} at byte {at:,}, and complete data follow, which going on with it would overwrite; to go on from "
            f"there, keep a copy, and cut the file: truncate -s {at} {path}"
        )
    return _checked(written)


def has_messages(path: Path) -> bool:
    """Return whether a file is there with anything but the beginning of a recording.

    Raises:
        InvalidRecording: see `RecordingReader`.
    """
    if not path.exists() or not path.stat().st_size:
        return False
    try:
        with RecordingReader(path) as reader:
            return next(reader.messages(), None) is not None or reader.end.is_damaged
    except InvalidRecording:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) == MAGIC and _is_cut_off_before_chunk(file):
                return False
        raise


def _is_cut_off_before_chunk(file: BinaryIO) -> bool:
    offset, size = file.tell(), os.fstat(file.fileno()).st_size
    while (record := next_record(file, size)) is not None:
        if record.opcode == Opcode.CHUNK:
            return False
        offset = file.tell()
    return is_cut_off(file, offset, size)


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


def _add(written: Written, record: Record, file: BinaryIO) -> bool:
    """Add a record; return whether nothing after it, or of it, is kept."""
    opcode, stream = record.opcode, ReadDataStream(io.BytesIO(record.body))
    try:
        if opcode == Opcode.CHUNK:
            return _add_chunk(written, record, file)
        if opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            if metadata.name == recording.SUMMARY:
                return True
            if metadata.name == recording.ABOUT:
                written.root = metadata.metadata["root"]
            written.metadata.append(MetadataIndex(offset=written.offset, length=record.size, name=metadata.name))
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            written.attachments.append(
                AttachmentIndex(
                    offset=written.offset,
                    length=record.size,
                    log_time=attachment.log_time,
                    create_time=attachment.create_time,
                    data_size=len(attachment.data),
                    name=attachment.name,
                    media_type=attachment.media_type,
                )
            )
        elif opcode != Opcode.HEADER:  # the end of a completed file, or damage
            return True
    except Exception:  # the library raises what its parsing meets
        return True
    written.offset += record.size
    return False


def _add_chunk(written: Written, record: Record, file: BinaryIO) -> bool:
    try:
        data = chunk_data(record.body)
    except ValueError:
        return True
    chunk = Chunk.read(ReadDataStream(io.BytesIO(record.body)))
    index = _read_messages(written, data)
    start, end = written.offset, written.offset + record.size
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
            chunk_length=record.size,
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
    place = 0
    for opcode, begin, end in chunk_records(data):
        if opcode == Opcode.MESSAGE:
            number, _, time_ns, _ = MESSAGE.unpack_from(data, begin)
            index.setdefault(number, []).extend((time_ns, place))
            written.counts[number] = written.counts.get(number, 0) + 1
            written.messages += 1
            if number == AUDIT:
                _read_audit(written, data[begin + MESSAGE.size : end])
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(io.BytesIO(data[begin:end])))
            written.schemas[schema.name] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(io.BytesIO(data[begin:end])))
            written.channels[channel.id] = channel
            written.counts.setdefault(channel.id, 0)
        place = end
    return index


def _read_audit(written: Written, payload: bytes) -> None:
    try:
        written.audit = codec.decode(RecordedAudit, payload)
    except BadMessage as error:
        raise InvalidRecording(f"{written.path} is damaged: its audit log: {error}") from None
