"""Alarms of a node, with the terms of BACnet's event reporting and of the alarm states of ISA-18.2."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from topics.messages.base import Count, Lines, Message, SourceName


class EventState(StrEnum):
    """What a monitored value is, as BACnet's property Event_State: within its limits, beyond one, or missing."""

    NORMAL = "normal"
    HIGH_LIMIT = "high_limit"
    LOW_LIMIT = "low_limit"
    FAULT = "fault"


class AlarmState(StrEnum):
    """State of an alarm.

    In the terms of ISA-18.2, `NORMAL` is normal, `ACTIVE` an unacknowledged alarm, `ACKNOWLEDGED` an acknowledged alarm
    whose condition persists, and `RETURNED` one that returned to normal before it was acknowledged.
    """

    NORMAL = "normal"
    ACTIVE = "active"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned"


class AlarmTransition(StrEnum):
    """What changes the state of an alarm: BACnet's three transitions, and the acknowledgment of an operator."""

    TO_OFFNORMAL = "to_offnormal"
    TO_FAULT = "to_fault"
    TO_NORMAL = "to_normal"
    ACKNOWLEDGE = "acknowledge"


class NotifyType(StrEnum):
    """BACnet's property Notify_Type: an `ALARM` has to be acknowledged, an `EVENT` only informs."""

    ALARM = "alarm"
    EVENT = "event"


class AlarmPriority(StrEnum):
    """Priority of an alarm to operators, as in ISA-18.2; it has no effect in the node."""

    CRITICAL = "critical"
    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


class AlarmChange(Message):
    """A transition of an alarm at a sample, part of an event.

    `value`: the monitored value; None if it is missing or not finite. `limit`: the limit that it exceeds or exceeded.
    `time`: simulated time of the sample.
    """

    alarm: str
    point: str
    slot: Count
    transition: AlarmTransition
    event_state: EventState
    state: AlarmState
    priority: AlarmPriority
    notify: NotifyType
    value: float | None = None
    limit: float | None = None
    unit: str
    time: str


class AlarmStatus(Message):
    """An alarm of one slot: its rule, and its state.

    `alarm`: the rule's name, followed by `/` and the point if the rule has several. `inhibited`: the rule does not
    apply now, because of occupancy or the hour. `value`: the present one. `raised`: simulated time at which it last
    became active; `changed`: of its latest transition. `times_raised`: how often it became active in this episode.
    `acknowledged`, `acknowledged_by`, `comment`: simulated time, source and comment of the latest acknowledgment since
    it was raised.
    """

    alarm: str
    text: Lines = ""
    point: str
    unit: str
    low: float | None = None
    high: float | None = None
    priority: AlarmPriority
    notify: NotifyType
    value: float | None = None
    event_state: EventState
    state: AlarmState
    inhibited: bool = False
    raised: str = ""
    changed: str = ""
    times_raised: Count = 0
    acknowledged: str = ""
    acknowledged_by: SourceName = ""
    comment: str = ""


class AlarmQuery(Message):
    """Request the alarms of a slot."""

    slot: Count = 0


class AlarmList(Message):
    """All alarms of a slot at its present sample, in the order of the rules."""

    slot: Count
    episode: Count
    step: Count
    time: str
    alarms: list[AlarmStatus]


class Acknowledge(Message):
    """Acknowledge alarms that are active, or that have returned to normal without acknowledgment.

    `alarm`: the name of an alarm, or of a rule for all of its points; `*` stands for any characters. `slot`: None means
    all slots. It is rejected if none of these alarms waits for an acknowledgment.
    """

    alarm: Annotated[str, Field(min_length=1, max_length=300)]
    slot: Count | None = None
    source: SourceName = ""
    comment: Annotated[str, Field(max_length=500)] = ""
