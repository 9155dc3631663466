"""Events: what happened on a node."""

from __future__ import annotations

from enum import StrEnum

from zenostat.topics.messages.alarms import AlarmChange
from zenostat.topics.messages.base import Count, Lines, Message


class EventKind(StrEnum):
    """Kind of an event.

    `REJECTED`, `LATE`, `DUPLICATE`: a message was not accepted and changed nothing. `ACCEPTED_LATE`: a command was
    accepted after the deadline of its step. `REVOKED`: a certificate's name is revoked; its claims have ended.
    `RESUMED`: a new node goes on where the recording of an ended one stops.
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
    RECORDING = "recording"
    ALARM = "alarm"
    REVOKED = "revoked"
    RESUMED = "resumed"


REJECTIONS = (EventKind.REJECTED, EventKind.LATE, EventKind.DUPLICATE)
"""Kinds of events that report a message which was not accepted."""


class Event(Message):
    """Something that happened on a node; `source` is the controller or device concerned.

    `late_s`, in seconds of wall time: how long after the end of its step's intake a `late` command arrived, or how long
    after the deadline an `accepted_late` command arrived. `alarm`: of an event of kind `alarm`, the transition.
    """

    kind: EventKind
    text: Lines
    source: str = ""
    error: str = ""
    episode: Count = 0
    step: Count = 0
    late_s: float | None = None
    alarm: AlarmChange | None = None
