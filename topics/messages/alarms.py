"""Alarms of a node, with the terms of BACnet's event reporting and of the alarm states of ISA-18.2."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from zenostat.topics.messages.base import Count, Lines, Message, SourceName

MAX_DURATION_S = 366 * 86400.0
"""Longest time for which an alarm can be set aside, a year."""

Duration = Annotated[float, Field(gt=0, le=MAX_DURATION_S, strict=True)]
"""Simulated seconds."""


class EventState(StrEnum):
    """State of a monitored value, as BACnet's property Event_State: within its limits, beyond one, or missing."""

    NORMAL = "normal"
    HIGH_LIMIT = "high_limit"
    LOW_LIMIT = "low_limit"
    FAULT = "fault"


class AlarmState(StrEnum):
    """State of an alarm.

    In the terms of ISA-18.2, `NORMAL` is normal, `ACTIVE` an unacknowledged alarm, `ACKNOWLEDGED` an acknowledged alarm
    whose condition persists, and `RETURNED` one that returned to normal before it was acknowledged. In the last three,
    the alarm is set aside: its value is followed, but nobody is alerted. `SUPPRESSED` is suppressed by design, by the
    condition of its rule; operators decide on `SHELVED` and `OUT_OF_SERVICE`.
    """

    NORMAL = "normal"
    ACTIVE = "active"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned"
    SUPPRESSED = "suppressed"
    SHELVED = "shelved"
    OUT_OF_SERVICE = "out_of_service"


class AlarmTransition(StrEnum):
    """Cause of a change of an alarm's state.

    The first three are BACnet's, caused by the value. Operators request `ACKNOWLEDGE`, `SHELVE`, `UNSHELVE`,
    `REMOVE_FROM_SERVICE` and `RETURN_TO_SERVICE`. `EXPIRE`: the time for which it was shelved or out of service is
    over. `SUPPRESS`, `UNSUPPRESS`: the condition of its rule begins or ends to hold.
    """

    TO_OFFNORMAL = "to_offnormal"
    TO_FAULT = "to_fault"
    TO_NORMAL = "to_normal"
    ACKNOWLEDGE = "acknowledge"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    REMOVE_FROM_SERVICE = "remove_from_service"
    RETURN_TO_SERVICE = "return_to_service"
    EXPIRE = "expire"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"


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
    `time`: simulated time of the sample. `until`: simulated time until which it is shelved or out of service; empty if
    it is not, or without a limit.
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
    until: str = ""


class AlarmStatus(Message):
    """An alarm of one slot: its rule, and its state.

    `alarm`: the rule's name, followed by `/` and the point if the rule has several. `inhibited`: the rule does not
    apply now, because of occupancy or the hour. `value`: the present one. `raised`: simulated time at which it last
    became active; `changed`: of its latest transition. `times_raised`: how often it became active in this episode.
    `acknowledged`, `acknowledged_by`, `comment`: simulated time, source and comment of the latest acknowledgment since
    it was raised. `set_aside`, `set_aside_by`, `set_aside_comment`, `set_aside_until`: since when it is shelved, out of
    service or suppressed, by whom and why, and until when; empty if it is not, if a condition suppresses it, or without
    a limit. `max_shelve_s`: longest time for which it can be shelved.
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
    set_aside: str = ""
    set_aside_by: SourceName = ""
    set_aside_comment: str = ""
    set_aside_until: str = ""
    max_shelve_s: float = 0.0


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


class AlarmRequest(Message):
    """Fields of all requests of operators. One is rejected if it changes nothing: no alarm that it names allows it.

    `alarm`: the name of an alarm, or of a rule for all of its points; `*` stands for any characters. `slot`: None means
    all slots.
    """

    alarm: Annotated[str, Field(min_length=1, max_length=300)]
    slot: Count | None = None
    source: SourceName = ""
    comment: Annotated[str, Field(max_length=500)] = ""


class Acknowledge(AlarmRequest):
    """Acknowledge alarms that are active, or that have returned to normal without acknowledgment."""


class Shelve(AlarmRequest):
    """Shelve alarms: for `duration_s` simulated seconds they alert nobody. For a shelved alarm, the time begins anew.

    It is rejected if the time is longer than the `max_shelve_s` of one of the alarms.
    """

    duration_s: Duration


class Unshelve(AlarmRequest):
    """End the shelving of alarms; those that are off-normal become active."""


class RemoveFromService(AlarmRequest):
    """Remove alarms from service: for `duration_s` simulated seconds, or until they are returned, they alert nobody."""

    duration_s: Duration | None = None


class ReturnToService(AlarmRequest):
    """Return alarms to service; those that are off-normal become active."""
