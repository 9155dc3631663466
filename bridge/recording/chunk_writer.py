"""Write an MCAP file in compressed chunks.

`mcap.writer.Writer` needs 10 µs per message, in the node's process and with its GIL. This writer uses the library for
all records but messages, which it only concatenates; that takes a tenth of the time.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

if TYPE_CHECKING:
    from zenostat.bridge.recording.complete_part import Written

_MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message record: opcode, length, channel, sequence, log time, publish time; its payload follows."""
_MESSAGE_FIELDS = _MESSAGE.size - 9
_OPCODE = int(Opcode.MESSAGE)
_WRAP = 0xFFFFFFFF
_CHUNK = struct.Struct("<BQQQQI")
COMPRESSION = "zstd"
_LEVEL = 3
_BLOCK = 1 << 20


class FileLost(OSError):
    """The file has no name any more, or not what was written to it."""


class ChunkWriter:
    """An MCAP file, written chunk by chunk to a file descriptor.

    Args:
        descriptor: of an empty file, opened for writing; the caller closes it.
        profile, library: of the file's header.
        written: what is complete of a file that is not empty; what is after it is dropped.

    Attributes:
        size: bytes of the present chunk, not compressed.
        messages: number of messages written, including those of the present chunk.
        payload_bytes: bytes of the payloads of all messages that are written, without the present chunk.
        offset: bytes written; what is before it is complete.
        is_regular: whether it is a regular file, and no pipe.

    Raises (in all methods that write):
        FileLost: another program has removed, truncated or overwritten the file.
        OSError: the file cannot be written; it is cut to what was complete.
    """

    def __init__(self, descriptor: int, *, profile: str, library: str, written: Written | None = None) -> None:
        self._descriptor = descriptor
        self.is_regular = stat.S_ISREG(os.fstat(descriptor).st_mode)
        self._checksum = self.offset = self.messages = self.size = self.payload_bytes = self._chunk_payload_bytes = 0
        self._parts: list[bytes] = []
        self._index: dict[int, list[int]] = {}
        self._start_ns = self._end_ns = 0
        self._begun_s = 0.0
        self._first_ns = self._last_ns = 0
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        if written is None:
            self._write(MCAP0_MAGIC + _record(Header(profile=profile, library=library)))
        else:
            self._continue(written)

    def _continue(self, written: Written) -> None:
        self._schemas, self._channels, self._counts = written.schemas, written.channels, written.counts
        self._chunks, self._attachments, self._metadata = written.chunks, written.attachments, written.metadata
        self._first_ns, self._last_ns = written.first_ns, written.last_ns
        self.messages, self.offset = written.messages, written.offset
        for begin in range(0, self.offset, _BLOCK):
            block = os.pread(self._descriptor, min(_BLOCK, self.offset - begin), begin)
            self._checksum = zlib.crc32(block, self._checksum)
        os.ftruncate(self._descriptor, self.offset)
        os.lseek(self._descriptor, self.offset, os.SEEK_SET)
        self._write(written.missing_index)

    def check_file(self) -> None:
        """Check that the file still has a name, and what was written to it.

        Raises:
            FileLost: another program has removed, truncated or overwritten it.
        """
        if not self.is_regular:
            return
        status = os.fstat(self._descriptor)
        if not status.st_nlink:
            raise FileLost(errno.ENOENT, "the file has been removed")
        if status.st_size != self.offset:
            reason = f"another program has changed the file: it has {status.st_size:,} of {self.offset:,} bytes"
            raise FileLost(errno.EIO, reason)

    def _write(self, data: bytes) -> None:
        """Write all of `data`; of what cannot be written completely, nothing remains."""
        self.check_file()
        view, written = memoryview(data), 0
        try:
            while written < len(data):
                written += os.write(self._descriptor, view[written:])
        except OSError:
            with suppress(OSError):  # not a regular file
                os.ftruncate(self._descriptor, self.offset)
            raise
        self.offset += len(data)
        self._checksum = zlib.crc32(data, self._checksum)

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write an attachment."""
        raw = _record(Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data))
        self._attachments.append(
            AttachmentIndex(
                offset=self.offset,
                length=len(raw),
                log_time=time_ns,
                create_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._write(raw)

    def add_metadata(self, name: str, fields: Mapping[str, str]) -> None:
        """Write a metadata record."""
        raw = _record(Metadata(name=name, metadata=dict(fields)))
        self._metadata.append(MetadataIndex(offset=self.offset, length=len(raw), name=name))
        self._write(raw)

    def add_channel(self, channel: int, topic: str, schema: str, json_schema: bytes) -> None:
        """Add a channel, and its schema if it is new, to the present chunk.

        Args:
            channel: its number, from 0.
            topic: its name.
            schema: name of its schema.
            json_schema: the schema; used only for the first channel that has it.
        """
        records = []
        if schema not in self._schemas:
            self._schemas[schema] = Schema(
                id=len(self._schemas) + 1, name=schema, encoding="jsonschema", data=json_schema
            )
            records.append(self._schemas[schema])
        self._channels[channel] = Channel(
            id=channel, topic=topic, message_encoding="msgpack", metadata={}, schema_id=self._schemas[schema].id
        )
        raw = b"".join(map(_record, [*records, self._channels[channel]]))
        self._parts.append(raw)
        self.size += len(raw)
        self._counts[channel] = 0

    def add(self, channel: int, time_ns: int, payload: bytes) -> None:
        """Add a message to the present chunk; writes nothing."""
        length, size = len(payload), self.size
        if not self._index:
            self._start_ns = self._end_ns = time_ns
            self._begun_s = monotonic()
        elif time_ns >= self._end_ns:
            self._end_ns = time_ns
        elif time_ns < self._start_ns:  # the clock has been set back
            self._start_ns = time_ns
        self._parts.append(
            _MESSAGE.pack(_OPCODE, _MESSAGE_FIELDS + length, channel, self.messages & _WRAP, time_ns, time_ns)
        )
        self._parts.append(payload)
        index = self._index.get(channel)
        if index is None:
            self._index[channel] = [time_ns, size]
        else:
            index += (time_ns, size)
        self.messages += 1
        self.size = size + _MESSAGE.size + length
        self._chunk_payload_bytes += length

    @property
    def age_s(self) -> float:
        """Time since the first message was added to the present chunk, by a clock that nobody sets; 0 without any."""
        return monotonic() - self._begun_s if self._index else 0.0

    def flush(self) -> None:
        """Write the present chunk, if it contains a message."""
        if not self._index:
            return
        data = b"".join(self._parts)
        packed = self._compressor.compress(data)
        name = COMPRESSION.encode()
        body = b"".join((struct.pack("<I", len(name)), name, struct.pack("<Q", len(packed)), packed))
        head = _CHUNK.pack(
            int(Opcode.CHUNK), _CHUNK.size - 9 + len(body), self._start_ns, self._end_ns, len(data), zlib.crc32(data)
        )
        chunk = head + body
        index, offsets = message_index(self._index, self.offset + len(chunk))
        start = self.offset
        self._write(chunk + index)
        self._chunks.append(
            ChunkIndex(
                message_start_time=self._start_ns,
                message_end_time=self._end_ns,
                chunk_start_offset=start,
                chunk_length=len(chunk),
                message_index_offsets=offsets,
                message_index_length=len(index),
                compression=COMPRESSION,
                compressed_size=len(packed),
                uncompressed_size=len(data),
            )
        )
        self._first_ns = min(self._first_ns or self._start_ns, self._start_ns)
        self._last_ns = max(self._last_ns, self._end_ns)
        for channel, entries in self._index.items():
            self._counts[channel] += len(entries) // 2
        self._parts, self._index, self.size = [], {}, 0
        self.payload_bytes += self._chunk_payload_bytes
        self._chunk_payload_bytes = 0

    def finish(self) -> None:
        """Write the present chunk and the summary; the file is then complete."""
        self.flush()
        end = _record(DataEnd(data_section_crc=self._checksum))
        summary_start = self.offset + len(end)
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas.values()]),
            (Opcode.CHANNEL, [*self._channels.values()]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]
        parts, offsets, at = [], [], summary_start
        for opcode, records in groups:
            raw = b"".join(map(_record, records))
            if raw:
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(raw)))
                parts.append(raw)
                at += len(raw)
        summary = b"".join([*parts, *map(_record, offsets)])
        footer = struct.pack("<BQQQ", int(Opcode.FOOTER), 20, summary_start, at)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        foot = _record(Footer(summary_start=summary_start, summary_offset_start=at, summary_crc=crc))
        self._write(end + summary + foot + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_start_time=self._first_ns,
            message_end_time=self._last_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def message_index(index: Mapping[int, Sequence[int]], offset: int) -> tuple[bytes, dict[int, int]]:
    """Return the message index of a chunk, which is written at `offset`, and the place of each part.

    Args:
        index: the time and the place in the chunk of each message, one after the other, by channel.
        offset: where the index is written.
    """
    parts, offsets = [], {}
    for channel, entries in index.items():
        offsets[channel] = offset
        length = 8 * len(entries)
        parts.append(
            struct.pack(f"<BQHI{len(entries)}Q", int(Opcode.MESSAGE_INDEX), 6 + length, channel, length, *entries)
        )
        offset += len(parts[-1])
    return b"".join(parts), offsets


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    raw: bytes = builder.end()  # type: ignore[no-untyped-call]
    return raw
