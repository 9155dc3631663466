"""Events: what happened on a node."""

from __future__ import annotations

from enum import StrEnum

from topics.messages.base import Count, Message


class EventKind(StrEnum):
    """What an event tells.

    `REJECTED`, `LATE`, `DUPLICATE`: a message that was not taken and changed nothing. `ACCEPTED_LATE`: a command that
    was taken, although the deadline of its step was over.
    """

    STARTED = "started"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"
    REJECTED = "rejected"
    LATE = "late"
    ACCEPTED_LATE = "accepted_late"
    DUPLICATE = "duplicate"
    WRITTEN = "written"
    EXPIRED = "expired"
    CONNECTED = "connected"
    DISCONNECTED = "disconnected"
    WARNING = "warning"
    FALLBACK = "fallback"
    PACE = "pace"
    FAULT = "fault"
    SNAPSHOT = "snapshot"
    BRANCH_CREATED = "branch_created"


class Event(Message):
    """What happened on a node; `source` is the controller or device that it is about.

    `late_s`, in seconds of wall time: how long after its step had gone on a `late` command came, or how long after the
    deadline an `accepted_late` one.
    """

    kind: EventKind
    text: str
    source: str = ""
    error: str = ""
    episode: Count = 0
    step: Count = 0
    late_s: float | None = None
