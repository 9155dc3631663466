"""Record the messages of a node: an append on the node's thread, and a thread that writes.

Nothing is dropped: if the file cannot be written as fast as the node simulates, the node waits, or the recording ends
with a reason. The file is complete up to its last chunk, whatever ends the process; a chunk is written at least
once per second.
"""

from __future__ import annotations

import itertools
import json
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from time import monotonic, time_ns
from typing import TYPE_CHECKING

from zenostat.bridge.node.plant import PlantDescription
from zenostat.bridge.recording.audit_chain import AuditChain
from zenostat.bridge.recording.channels import AUDIT, CHANNELS, ORDERS, OTHERS, SENDERS
from zenostat.bridge.recording.chunk_writer import ChunkWriter, FileLost
from zenostat.bridge.recording.file import file_digest
from zenostat.topics import VERSION, codec, keys, recording
from zenostat.topics.messages import (
    SCHEMA_VERSION,
    Geometry,
    Manifest,
    Message,
    OnFull,
    RecordingState,
    RecordingStatus,
)
from zenostat.topics.recording import RecordedMessage, RecordedRequest, RecordedSender

if TYPE_CHECKING:
    from zenostat.bridge.recording.complete_part import Written

BUFFER_BYTES = 64 << 20
"""Largest number of bytes that may wait to be written."""

MAX_CHANNELS = 4096
"""Largest number of channels for controllers and actuators; messages of further ones share the channel `others`."""

_CHUNK_BYTES = 1 << 20
_CHUNK_S = 0.7
_INTERVAL_S = 0.25
"""A message waits for at most both together, which is less than a second, before it is written."""
_LOOK_S = 0.25
"""Time after which the thread looks whether the file is still where it was."""
_TURN = 128
"""Messages that the thread adds to a chunk before it lets the node's thread have the GIL."""
_CLOSE_TIMEOUT_S = 30.0

Attachments = Callable[[], Mapping[str, bytes]]
"""Returns the attachments by name; called once, by the thread that writes."""


class Recorder:
    """Records to a file. All methods are for the node's thread, unless noted.

    Args:
        descriptor: of the file, empty and locked; the recorder closes it.
        path: of the file, for the status.
        node: the node's name.
        attachments: content of the attachments.
        on_full: what to do when the buffer is full.
        on_stopped: called once if the recording ends early, with the reason; in any thread.
        buffer_bytes: size of the buffer.
        cpus: cores of the thread that writes; empty leaves it on the node's.
        written: what is complete of the file, if the recorder goes on with it; `attachments` is not called then.

    Attributes:
        is_ending: returns whether the node is ending and must not wait for the disk.
        senders: by the name in their keys, the senders of recorded messages: the proven name and the way in.
    """

    def __init__(
        self,
        descriptor: int,
        path: Path,
        node: str,
        attachments: Attachments,
        *,
        on_full: OnFull = OnFull.WAIT,
        on_stopped: Callable[[str], None] = lambda _: None,
        buffer_bytes: int = BUFFER_BYTES,
        cpus: Sequence[int] = (),
        written: Written | None = None,
    ) -> None:
        self._descriptor, self.path, self._root = descriptor, path, keys.root(node)
        self._attachments, self._on_full, self._on_stopped = attachments, on_full, on_stopped
        self._limit, self._cpus = buffer_bytes, cpus
        self._is_waiting = False
        self.is_ending: Callable[[], bool] = lambda: False
        self.senders: dict[str, tuple[str, str]] = {}
        self._chain, self._own_bytes = AuditChain(), 0
        self._pending: deque[tuple[int, int, bytes]] = deque()
        self._added = self._written = 0
        self._named: dict[str, int] = {}
        self._new_channels: deque[tuple[int, str, type[Message]]] = deque(
            (number, topic, kind) for number, (topic, kind) in enumerate(CHANNELS)
        )
        self._next_channel = itertools.count(len(CHANNELS))
        self._continued = written
        if written is not None:
            self._continue(written)
        self._order_heads: dict[tuple[int, ...], bytes] = {}
        self._waits, self._waited_s = 0, 0.0
        self._messages = self._bytes = 0
        self.reason = ""
        self._closing = self._is_closed = False
        self._looked_s = monotonic()
        self._wake, self._room = threading.Event(), threading.Condition()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def _continue(self, written: Written) -> None:
        self._new_channels.clear()
        self._named = written.topics()
        self._next_channel = itertools.count(max(written.channels) + 1)
        if written.audit is not None:
            self._chain.resume(written.audit)
        for number, channel in written.channels.items():
            name = next(name for name, schema in written.schemas.items() if schema.id == channel.schema_id)
            self._chain.add_channel(number, channel.topic.removeprefix(f"{self._root}/"), name)

    # For the node's thread

    def add(self, channel: int, payload: bytes) -> None:
        """Record a message on one of the fixed channels."""
        self._pending.append((channel, time_ns(), payload))
        self._added += len(payload)
        if self._added - self._written > self._limit:
            self._on_limit()

    def order(self, values: bytes, slots: Sequence[int]) -> None:
        """Record the actuator values that the plant receives for the next timestep of some slots."""
        key = tuple(slots)
        head = self._order_heads.get(key)
        if head is None:
            head = codec.pack(slots=[*key], values=values)[: -len(values) or None]
            if len(self._order_heads) < MAX_CHANNELS:
                self._order_heads[key] = head
        self.add(ORDERS, head + values)

    def sender(self, name: str, proven: str, via: str) -> None:
        """Record who the sender of the next message is, unless that is known.

        Args:
            name: the sender's name in the message's key.
            proven: the certificate's name that proves it; empty without keys.
            via: the way in.
        """
        if self.senders.get(name) == (proven, via):
            return
        if len(self.senders) < MAX_CHANNELS:
            self.senders[name] = (proven, via)
        self.record(SENDERS, RecordedSender(sender=name, proven=proven, via=via))

    def received(self, topic: keys.Topic, key: str, payload: bytes, encoding: str) -> None:
        """Record a command or a write that the node received; `key` is below the node's root."""
        if topic.message is not None and encoding == codec.encoding(topic.message):
            channel = self._channel(key, topic.message)
            if channel != OTHERS:
                self.add(channel, payload)
                return
        self.add(OTHERS, codec.encode(RecordedMessage(topic=key, encoding=encoding, payload=payload)))

    def request(self, key: str, payload: bytes, encoding: str, reply: bytes, reply_encoding: str) -> None:
        """Record a request and its reply; `key` is below the node's root."""
        record = RecordedRequest(payload=payload, encoding=encoding, reply=reply, reply_encoding=reply_encoding)
        raw = codec.encode(record)
        channel = self._channel(key, RecordedRequest)
        if channel == OTHERS:
            raw = codec.encode(RecordedMessage(topic=key, encoding=codec.encoding(RecordedRequest), payload=raw))
        self.add(channel, raw)

    def record(self, channel: int, message: Message) -> None:
        """Record a message that is not encoded yet."""
        self.add(channel, codec.encode(message))

    def _channel(self, key: str, kind: type[Message]) -> int:
        """Return the channel of a key; `OTHERS` if there are too many."""
        channel = self._named.get(key)
        if channel is None:
            if len(self._named) >= MAX_CHANNELS:
                return OTHERS
            channel = self._named[key] = next(self._next_channel)
            self._new_channels.append((channel, key, kind))
        return channel

    def _on_limit(self) -> None:
        if self._on_full is OnFull.STOP:
            self._stop(f"the disk is slower than the node: {self._limit >> 20} MB are waiting to be written")
            return
        self._waits += 1
        started_s = monotonic()
        self._is_waiting = True
        self._wake.set()
        with self._room:
            while self._added - self._written > self._limit // 2 and not (self._is_over or self.is_ending()):
                self._room.wait(0.05)
        self._is_waiting = False
        self._waited_s += monotonic() - started_s

    @property
    def _is_over(self) -> bool:
        return bool(self.reason) or self._closing

    def _stop(self, reason: str) -> None:
        """End the recording early: record nothing more, and complete the file if possible."""
        if self.reason:
            return
        self.reason = reason
        self.add = lambda *_: None  # type: ignore[method-assign]  # nothing after a gap is recorded
        self._closing = True
        self._wake.set()
        self._on_stopped(reason)

    def close(self) -> None:
        """Write what is left and complete the file; idempotent."""
        self._closing = True
        self._wake.set()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def status(self) -> RecordingStatus:
        """Return the state of the recording; thread-safe."""
        state = RecordingState.STOPPED if self.reason else RecordingState.RECORDING
        return RecordingStatus(
            path=str(self.path),
            state=RecordingState.ENDED if self._is_closed and not self.reason else state,
            messages=self._messages,
            bytes=self._bytes,
            waits=self._waits,
            waited_s=self._waited_s,
            reason=self.reason,
        )

    # The thread that writes

    def _run(self) -> None:
        if self._cpus:
            os.sched_setaffinity(0, self._cpus)  # not only the node's own core
        try:
            self._write_all()
        except Exception as error:  # whatever it is, it ends the recording and not the node
            text = error.strerror if isinstance(error, OSError) and error.strerror else f"{error}"
            self._pending.clear()
            if isinstance(error, FileLost):
                self._messages = self._bytes = 0
            self._stop(f"cannot write {self.path}: {text}")
            self._pending.clear()
        finally:
            os.close(self._descriptor)
            self._is_closed = True
            with self._room:
                self._room.notify_all()

    def _write_all(self) -> None:
        writer = ChunkWriter(
            self._descriptor, profile=recording.PROFILE, library=f"zenostat {VERSION}", written=self._continued
        )
        if self._continued is None:
            self._write_head(writer)
        while True:
            self._wake.wait(_INTERVAL_S)
            self._wake.clear()
            is_last = self._closing
            self._write_pending(writer)
            if is_last:
                break
            self._check_file(writer)
        self._flush(writer)
        writer.add_metadata(recording.SUMMARY, self._summary())
        writer.finish()
        self._update(writer)
        self._check_file(writer, at_once=True)

    def _write_head(self, writer: ChunkWriter) -> None:
        about = {
            "format": str(recording.FORMAT),
            "zenostat": VERSION,
            "schema_version": str(SCHEMA_VERSION),
            "root": self._root,
            recording.AUDIT: recording.AUDIT_HASH,
        }
        attachments = self._attachments()
        self._chain.begin(about, attachments)
        writer.add_metadata(recording.ABOUT, about)
        for name, content in attachments.items():
            writer.add_attachment(name, _media_type(name), content, time_ns())

    def _check_file(self, writer: ChunkWriter, *, at_once: bool = False) -> None:
        """Stop if the file has been moved, and raise `FileLost` if it is lost: no write reports that."""
        is_due = at_once or monotonic() - self._looked_s >= _LOOK_S
        if not writer.is_regular or self.reason or not is_due:
            return
        self._looked_s = monotonic()
        writer.check_file()
        if not _is_same(self.path, self._descriptor):
            self._stop(f"{self.path} has been moved; the moved file ends there")

    def _write_pending(self, writer: ChunkWriter) -> None:
        pending = self._pending
        while pending:
            for _ in range(min(len(pending), _TURN)):
                channel, at_ns, payload = pending.popleft()
                if self._new_channels:  # announced before their first message was added
                    self._add_channels(writer)
                writer.add(channel, at_ns, payload)
                self._chain.add(channel, at_ns, payload)
            if writer.size >= _CHUNK_BYTES:
                self._flush(writer)
            self._check_file(writer)
            os.sched_yield()
        if self._is_waiting or writer.age_s >= _CHUNK_S:
            self._flush(writer)

    def _flush(self, writer: ChunkWriter) -> None:
        """Write the present chunk, with the digests of its entries of the audit log."""
        record = self._chain.seal()
        if record is not None:
            payload = codec.encode(record)
            writer.add(AUDIT, time_ns(), payload)
            self._own_bytes += len(payload)
        writer.flush()
        self._update(writer)

    def _add_channels(self, writer: ChunkWriter) -> None:
        while self._new_channels:
            number, topic, kind = self._new_channels.popleft()
            writer.add_channel(number, f"{self._root}/{topic}", kind.__name__, _json_schema(kind))
            self._chain.add_channel(number, topic, kind.__name__)

    def _update(self, writer: ChunkWriter) -> None:
        """Update the counts after a chunk has been written."""
        self._messages, self._bytes = writer.messages, writer.offset
        self._written = writer.payload_bytes - self._own_bytes
        if self._waits:
            with self._room:
                self._room.notify_all()

    def _summary(self) -> dict[str, str]:
        return {
            "messages": str(self._messages),
            "waits": str(self._waits),
            "waited_s": f"{self._waited_s:.3f}",
            "reason": self.reason,
            **self._chain.summary(),
        }


def _is_same(path: Path, descriptor: int) -> bool:
    """Return whether a path is that of an open file, and not of a new one in its place."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False


@cache
def _json_schema(kind: type[Message]) -> bytes:
    return json.dumps(kind.model_json_schema()).encode()


def _media_type(name: str) -> str:
    return {"yaml": "application/yaml", "msgpack": "application/msgpack"}.get(
        name.rpartition(".")[2], "application/json"
    )


def attachments(manifest: Manifest, plant: PlantDescription, geometry: Geometry | None = None) -> dict[str, bytes]:
    """Return the attachments of a recording; hashes the files of the plant, which takes a moment."""
    provenance = {
        "kind": plant.provenance.kind,
        "settings": dict(plant.provenance.settings),
        "versions": plant.versions.model_dump(),
        "files": {
            role: {"path": str(path), "sha256": file_digest(path)} for role, path in plant.provenance.files.items()
        },
    }
    contents = {
        recording.MANIFEST: manifest.model_dump_json(indent=1).encode(),
        recording.SCENARIO: plant.scenario.encode(),
        recording.PROVENANCE: json.dumps(provenance, indent=1).encode(),
    }
    if geometry is not None:
        contents[recording.GEOMETRY] = codec.encode(geometry)
    if plant.systems is not None:
        contents[recording.SYSTEMS] = codec.encode(plant.systems)
    return contents
