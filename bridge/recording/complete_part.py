"""The complete part of a recording, with which a recorder goes on."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import AttachmentIndex, Channel, ChunkIndex, MetadataIndex, Schema

from zenostat.bridge.recording.channels import CHANNELS
from zenostat.topics.recording import RecordedAudit


@dataclass(slots=True)
class Written:
    """The complete part of a recording.

    Attributes:
        path: of the file.
        offset: its first bytes, which stay.
        size: bytes of the file.
        dropped: bytes after these that are no complete part, and are lost.
        missing_index: the message index of the last chunk, if the file ends within it.
        messages: number of messages.
        schemas, channels, counts, chunks, attachments, metadata: for the summary at the end of the file.
        first_ns, last_ns: times of the first and the last message.
        audit: the latest record of the audit log's chain.
    """

    path: Path
    offset: int = 0
    size: int = 0
    dropped: int = 0
    missing_index: bytes = b""
    messages: int = 0
    schemas: dict[str, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    first_ns: int = 0
    last_ns: int = 0
    audit: RecordedAudit | None = None
    root: str = ""

    def topics(self) -> dict[str, int]:
        """Return the numbers of the channels by their topics below the node's root, without the fixed ones."""
        return {
            channel.topic.removeprefix(f"{self.root}/"): number
            for number, channel in self.channels.items()
            if number >= len(CHANNELS)
        }
