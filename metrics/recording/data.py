"""The content of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from zenostat.metrics.recording.log import LogEntry
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.messages import Event, Manifest


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording of a node.

    Attributes:
        path: Of the file.
        manifest: Of the node, at the begin of the recording.
        scenario: Text of the scenario file; empty for a plant without one.
        provenance: What creates the same plant again, and the SHA-256 of the files that it read.
        episodes: In the order of their numbers, then of their slots.
        events: The events that the node published, with the UTC of each.
        log: What was requested of the node, with the results.
        is_complete: Whether the recorder completed the file.
        note: Why the recording ends early; empty if it does not.
    """

    path: Path
    manifest: Manifest = field(repr=False)
    scenario: str = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    episodes: tuple[Trajectory, ...] = field(repr=False)
    events: tuple[tuple[datetime, Event], ...] = field(repr=False)
    log: tuple[LogEntry, ...] = field(repr=False)
    is_complete: bool
    note: str
