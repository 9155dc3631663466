"""Read a recording: what is complete is read, and a file that ends early or is damaged says so.

The records of the file are read with the library `mcap`; only messages, of which a year has a hundred thousand, are cut
out of their chunks here.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from zenostat.bridge.recording.file import MAGIC, open_regular
from zenostat.bridge.recording.records import (
    MESSAGE,
    chunk_data,
    chunk_records,
    completed_end,
    is_cut_off,
    next_record,
)
from zenostat.topics import codec, recording
from zenostat.topics.errors import BadMessage, InvalidConfig, InvalidRecording
from zenostat.topics.messages import SCHEMA_VERSION, Geometry, Manifest, Systems
from zenostat.topics.plurals import counted
from zenostat.topics.printable import replace_controls, replace_controls_in_lines

_WRAP = 0xFFFFFFFF
_IS_MESSAGE, _IS_CHANNEL, _IS_SCHEMA = int(Opcode.MESSAGE), int(Opcode.CHANNEL), int(Opcode.SCHEMA)


class RecordedItem(NamedTuple):
    """A message of a recording.

    Attributes:
        topic: below the node's root: `sample`, `event`, `command/env-1`, `orders`.
        schema: the name of its class.
        time_ns: wall time at which the node recorded it, nanoseconds since 1970.
        payload: as it was recorded.
    """

    topic: str
    schema: str
    time_ns: int
    payload: bytes


@dataclass(slots=True)
class RecordingEnd:
    """End of a recording, known once it has been read to its end.

    Attributes:
        is_complete: whether the recorder completed the file, and all messages were read.
        text: why it is not complete, why the recording ended early, or what is damaged; empty if it is whole.
        is_damaged: whether the file is damaged, and not only cut off; if it is complete, its messages are not.
    """

    is_complete: bool = False
    text: str = ""
    is_damaged: bool = False
    metadata: dict[str, str] = field(default_factory=dict)


class RecordingReader:
    """A recording that is read from its beginning; `with RecordingReader(path) as reader`.

    Args:
        path: of the file.

    Attributes:
        path: of the file.
        about: versions with which it was recorded, by name.
        versions: the same with control characters, which the audit log's chain begins with.
        attachments: content of the attachments by name, which follow there.
        root: the root of the node's keys.
        manifest: at the begin of the recording.
        scenario: the text of the scenario; empty if the plant has none.
        geometry: of the building; None if the plant has none.
        systems: of the building; None if the plant has none.
        provenance: how to create the plant, and the digests of its files.
        end: how the recording ends; set by `messages`.

    Raises:
        InvalidRecording: there is no such file; it is not a recording, was written by a newer release, or ends before
            its first message.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self._file: BinaryIO = os.fdopen(open_regular(self.path, os.O_RDONLY), "rb")
        except OSError as error:
            raise InvalidRecording(f"cannot read {self.path}: {error.strerror}") from None
        except InvalidConfig as error:
            raise InvalidRecording(str(error)) from None
        try:
            self._size = self.path.stat().st_size
            self._read_head()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> RecordingReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def limit(self, size: int) -> None:
        """Read only the first bytes of the file."""
        self._size = size

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()

    # The beginning of the file

    def _read_head(self) -> None:
        magic = self._file.read(len(MAGIC))
        if magic != MAGIC:
            what = "is empty" if not magic else "is not an MCAP file"
            raise InvalidRecording(f"{self.path} {what}; expected a recording of `zenostat node --record`")
        self.about: dict[str, str] = {}
        attached: dict[str, bytes] = {}
        position, self._checksum = self._file.tell(), zlib.crc32(magic)
        while (record := next_record(self._file, self._size)) is not None:
            opcode, body = record
            is_summary = opcode == Opcode.METADATA and self.about  # of a recording without messages
            if opcode in (Opcode.CHUNK, Opcode.DATA_END) or is_summary:
                break
            self._read_head_record(opcode, body, attached)
            position, self._checksum = self._file.tell(), record.checksum(self._checksum)
        self._begin, self.attachments = position, attached
        if not self.about or recording.PROVENANCE not in attached:
            how = "ends" if is_cut_off(self._file, position, self._size) else f"is damaged at byte {position:,},"
            raise InvalidRecording(f"{self.path} {how} before its first message; nothing can be read from it")
        try:
            self.root = self.about["root"]
            self.manifest = Manifest.model_validate_json(attached[recording.MANIFEST])
            self.scenario = replace_controls_in_lines(attached[recording.SCENARIO].decode())
            self.provenance: dict[str, Any] = json.loads(attached[recording.PROVENANCE])
            geometry = attached.get(recording.GEOMETRY)
            self.geometry = None if geometry is None else codec.decode(Geometry, geometry)
            systems = attached.get(recording.SYSTEMS)
            self.systems = None if systems is None else codec.decode(Systems, systems)
        except (BadMessage, KeyError, ValueError) as error:
            raise InvalidRecording(f"{self.path} is damaged: its attachments cannot be read ({error})") from None

    def _read_head_record(self, opcode: int, body: bytes, attached: dict[str, bytes]) -> None:
        stream = ReadDataStream(io.BytesIO(body))
        try:
            if opcode == Opcode.HEADER:
                header = Header.read(stream)
                if header.profile != recording.PROFILE:
                    library = replace_controls(header.library) or "another program"
                    raise InvalidRecording(f"{self.path} is an MCAP file of {library}, not a recording of Zenostat")
            elif opcode == Opcode.METADATA:
                metadata = Metadata.read(stream)
                if metadata.name == recording.ABOUT:
                    self.versions, self.about = metadata.metadata, _printable(metadata.metadata)
                    self._check_version()
            elif opcode == Opcode.ATTACHMENT:
                attachment = Attachment.read(stream)
                crc = struct.unpack("<I", body[-4:])[0]
                if crc != zlib.crc32(body[:-4]):
                    raise InvalidRecording(f"{self.path} is damaged: its attachment {attachment.name!r} has changed")
                attached[attachment.name] = attachment.data
        except InvalidRecording:
            raise
        except Exception as error:  # the library raises what its parsing meets
            raise InvalidRecording(f"{self.path} is damaged at its beginning ({error})") from None

    def _check_version(self) -> None:
        for name, known in (("format", recording.FORMAT), ("schema_version", SCHEMA_VERSION)):
            text = self.about.get(name, "")
            if not text.isdigit() or int(text) != known:
                words, release = name.replace("_", " "), self.about.get("zenostat", "?")
                raise InvalidRecording(
                    f"{self.path} was recorded by Zenostat {release} with {words} {text or '?'}; this release "
                    f"({words} {known}) cannot read it"
                )

    # Messages

    def messages(self, schemas: Collection[str] | None = None) -> Iterator[RecordedItem]:
        """Iterate over the messages in the order in which the node recorded them; `end` is set at the end.

        Args:
            schemas: names of classes to select; None selects all.
        """
        self.end = end = RecordingEnd()
        self._file.seek(self._begin)
        channels: dict[int, tuple[str, str] | None] = {}
        names: dict[int, str] = {}
        expected, checksum = 0, self._checksum
        while True:
            at = self._file.tell()
            record = next_record(self._file, self._size)
            if record is None:
                self._describe_early_end(at)
                return
            opcode, body = record
            if opcode == Opcode.DATA_END:
                self._read_end(at, is_intact=int.from_bytes(body, "little") in (0, checksum))
                return
            checksum = record.checksum(checksum)
            if opcode == Opcode.CHUNK:
                try:
                    data = chunk_data(body)
                except ValueError as error:
                    end.text, end.is_damaged = (
                        f"it is damaged at byte {at:,} ({error}); what is before it is read",
                        True,
                    )
                    return
                selected, expected = self._cut(data, channels, names, schemas, expected)
                yield from selected
                if expected < 0:
                    end.text, end.is_damaged = (
                        f"messages are missing before byte {at:,}; what is before it is read",
                        True,
                    )
                    return
            elif opcode == Opcode.METADATA:
                _read_summary(body, at, expected, end)
                if end.is_damaged:
                    return

    def _read_end(self, at: int, *, is_intact: bool) -> None:
        """Read the end of the file, of which the data end at byte `at`; `is_intact`: their checksum matches."""
        completed = completed_end(self._file, self._size)
        if completed is None or not self.end.metadata:
            self._describe_early_end(at)
            return
        self.end.is_complete = True
        end, is_summary_intact = completed
        if end < self._size:
            foreign = counted(self._size - end, "byte", ",")
            self.end.text, self.end.is_damaged = f"{foreign} after its end at byte {end:,}, not part of it", True
        elif not (is_intact and is_summary_intact):
            part = "summary" if is_intact else "data section"
            self.end.text = f"the checksum of its {part} does not match, but all messages are intact"
            self.end.is_damaged = True

    def _cut(
        self,
        data: bytes,
        channels: dict[int, tuple[str, str] | None],
        names: dict[int, str],
        schemas: Collection[str] | None,
        expected: int,
    ) -> tuple[list[RecordedItem], int]:
        """Return the selected messages of a chunk, and the number expected of the next message; -1 after a gap."""
        items: list[RecordedItem] = []
        message, prefix = MESSAGE.unpack_from, len(self.root) + 1
        for opcode, begin, stop in chunk_records(data):
            if opcode == _IS_MESSAGE:
                number, sequence, time_ns, _ = message(data, begin)
                if sequence != expected:
                    return items, -1
                expected = expected + 1 & _WRAP
                channel = channels.get(number)
                if channel is not None:
                    items.append(RecordedItem(*channel, time_ns, data[begin + MESSAGE.size : stop]))
            elif opcode == _IS_SCHEMA:
                schema = Schema.read(ReadDataStream(io.BytesIO(data[begin:stop])))
                names[schema.id] = replace_controls(schema.name)
            elif opcode == _IS_CHANNEL:
                found_channel = Channel.read(ReadDataStream(io.BytesIO(data[begin:stop])))
                name = names[found_channel.schema_id]
                is_selected = schemas is None or name in schemas
                topic = replace_controls(found_channel.topic[prefix:])
                channels[found_channel.id] = (topic, name) if is_selected else None
        return items, expected

    def _describe_early_end(self, at: int) -> None:
        """Set why no message follows byte `at`, which is not the end of a completed file."""
        if not is_cut_off(self._file, at, self._size):
            text = f"it is damaged at byte {at:,}, and {self._size - at:,} bytes follow; what is before it is read"
            self.end.text, self.end.is_damaged = text, True
        elif self._is_locked():
            self.end.text = "it is still being recorded"
        else:
            self.end.text = (
                f"it was cut off after byte {at:,}, because the node was killed, which loses up to the last second, or "
                "its disk was full"
            )

    def _is_locked(self) -> bool:
        try:
            fcntl.flock(self._file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            fcntl.flock(self._file, fcntl.LOCK_UN)
        except BlockingIOError:
            return True
        return False


def _read_summary(body: bytes, at: int, messages: int, end: RecordingEnd) -> None:
    """Read the metadata record at byte `at`, and compare the number of messages before it."""
    try:
        metadata = Metadata.read(ReadDataStream(io.BytesIO(body)))
    except Exception:  # the library raises what its parsing meets
        end.text, end.is_damaged = f"it is damaged at byte {at:,}: its summary cannot be read", True
        return
    if metadata.name != recording.SUMMARY:
        return
    end.metadata = _printable(metadata.metadata)
    end.text = end.metadata.get("reason", "")
    if end.metadata.get("messages", str(messages)) != str(messages):
        end.text, end.is_damaged = f"messages are missing before byte {at:,}", True


def _printable(metadata: dict[str, str]) -> dict[str, str]:
    return {name: replace_controls_in_lines(text) for name, text in metadata.items()}
