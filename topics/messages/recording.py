"""Requests about recordings, and their state."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from zenostat.topics.messages.base import Count, Lines, Message, SourceName


class OnFull(StrEnum):
    """Response of a node when its recording cannot be written as fast as it simulates.

    `WAIT`: the next step waits until there is room in the buffer. `STOP`: the recording ends, and the node continues.
    """

    WAIT = "wait"
    STOP = "stop"


class RecordingState(StrEnum):
    """State of a node's recording.

    `ARMED`: it begins with the next reset of all slots. `RECORDING`: it is being written. `ENDED`: it is complete.
    `STOPPED`: it ended early; `reason` says why, and the file is readable up to there.
    """

    ARMED = "armed"
    RECORDING = "recording"
    ENDED = "ended"
    STOPPED = "stopped"


class StartRecording(Message):
    """Record the node to a file on the node's machine.

    The recording begins with the next reset of all slots, so that it can be verified, or with `now` at once. `path`:
    a file with the suffix `.mcap`, or a folder in which the node chooses a name. `overwrite`: replace a recording.
    """

    path: Annotated[str, Field(min_length=1, max_length=4096)]
    now: bool = False
    overwrite: bool = False
    on_full: OnFull = OnFull.WAIT
    source: SourceName = ""


class StopRecording(Message):
    """End the node's recording, which completes its file."""

    source: SourceName = ""


class RecordingStatus(Message):
    """A node's recording: its file on the node's machine, and the number of messages and bytes written to it.

    `waits`, `waited_s`: how often and how long in total the node waited for the disk, in seconds of wall time.
    `reason`: why the recording ended early.
    """

    path: str
    state: RecordingState
    messages: Count = 0
    bytes: Count = 0
    waits: Count = 0
    waited_s: float = 0.0
    reason: Lines = ""
