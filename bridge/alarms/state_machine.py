"""The states of an alarm, without messages, a clock or points.

Two tables in a row: the monitored value determines BACnet's Event_State (algorithm OUT_OF_RANGE of ASHRAE 135), and its
transitions and acknowledgments determine the state of the alarm (ISA-18.2).

    state           to_offnormal, to_fault   to_normal   acknowledge
    normal          active
    active          active                   returned    acknowledged
    acknowledged    active                   normal
    returned        active                               normal
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan

from topics.messages import AlarmState, AlarmTransition, EventState

_NORMAL, _ACTIVE = AlarmState.NORMAL, AlarmState.ACTIVE
_ACKNOWLEDGED, _RETURNED = AlarmState.ACKNOWLEDGED, AlarmState.RETURNED
_TO_OFFNORMAL, _TO_FAULT = AlarmTransition.TO_OFFNORMAL, AlarmTransition.TO_FAULT
_TO_NORMAL, _ACKNOWLEDGE = AlarmTransition.TO_NORMAL, AlarmTransition.ACKNOWLEDGE

TRANSITIONS: dict[tuple[AlarmState, AlarmTransition], AlarmState] = {
    **{(state, trigger): _ACTIVE for state in AlarmState for trigger in (_TO_OFFNORMAL, _TO_FAULT)},
    (_ACTIVE, _TO_NORMAL): _RETURNED,
    (_ACTIVE, _ACKNOWLEDGE): _ACKNOWLEDGED,
    (_ACKNOWLEDGED, _TO_NORMAL): _NORMAL,
    (_RETURNED, _ACKNOWLEDGE): _NORMAL,
}
"""The next state of an alarm; a pair that is not listed is not possible, or an acknowledgment without a reason."""

TRIGGERS: dict[EventState, AlarmTransition] = {
    EventState.NORMAL: _TO_NORMAL,
    EventState.HIGH_LIMIT: _TO_OFFNORMAL,
    EventState.LOW_LIMIT: _TO_OFFNORMAL,
    EventState.FAULT: _TO_FAULT,
}
"""The transition that leads to each event state."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a value, in its unit, and delays in timesteps.

    Attributes:
        low, high: an infinity is no limit.
        deadband: how far a value must be within the limit again to be normal.
        delay: timesteps for which a value must be beyond a limit.
        return_delay: timesteps for which it must be normal again.
    """

    low: float
    high: float
    deadband: float = 0.0
    delay: int = 0
    return_delay: int = 0

    def event_state(self, present: EventState, value: float, *, inhibited: bool = False) -> EventState:
        """Return the event state that a value indicates, delays aside.

        Args:
            present: the event state until now.
            value: the value; NaN is missing.
            inhibited: whether the limits do not apply.
        """
        if isnan(value):
            return EventState.FAULT
        if inhibited or present is EventState.FAULT:  # from a fault, the way leads through normal
            return EventState.NORMAL
        if value > self.high:
            return EventState.HIGH_LIMIT
        if value < self.low:
            return EventState.LOW_LIMIT
        low, high = self.quiet_range(present)
        return present if low <= value <= high else EventState.NORMAL

    def quiet_range(self, present: EventState, *, inhibited: bool = False) -> tuple[float, float]:
        """Return the range of values that indicate the present event state, both ends included; empty for a fault."""
        if present is EventState.FAULT:
            return _INFINITY, -_INFINITY
        if inhibited:
            return (-_INFINITY, _INFINITY) if present is EventState.NORMAL else (_INFINITY, -_INFINITY)
        if present is EventState.HIGH_LIMIT:
            return self.high - self.deadband, _INFINITY
        if present is EventState.LOW_LIMIT:
            return -_INFINITY, self.low + self.deadband
        return self.low, self.high

    def delay_of(self, present: EventState, target: EventState, *, inhibited: bool = False) -> int:
        """Return the timesteps for which a value must indicate another event state before it is taken on."""
        if EventState.FAULT in (present, target) or inhibited:
            return 0
        return self.return_delay if target is EventState.NORMAL else self.delay


_INFINITY = float("inf")


@dataclass(slots=True)
class Alarm:
    """The state of one alarm.

    Attributes:
        limits: of its value.
        needs_acknowledgment: whether an operator has to acknowledge it; otherwise it is acknowledged when it is raised.
        event_state: of its value.
        state: of the alarm.
        pending: the event state that the value indicates, while its delay has not passed; None if it is the present.
        since: the step at which the value first indicated it.
    """

    limits: Limits
    needs_acknowledgment: bool = True
    event_state: EventState = EventState.NORMAL
    state: AlarmState = AlarmState.NORMAL
    pending: EventState | None = None
    since: int = 0

    def update(self, value: float, step: int, *, inhibited: bool = False) -> AlarmTransition | None:
        """Take the value of a step, later than the last one; return the transition, if it causes one."""
        limits, present = self.limits, self.event_state
        target = limits.event_state(present, value, inhibited=inhibited)
        if target is present:
            self.pending = None
            return None
        if target is not self.pending:
            self.pending, self.since = target, step
        if step - self.since < limits.delay_of(present, target, inhibited=inhibited):
            return None
        self.event_state, self.pending = target, None
        trigger = TRIGGERS[target]
        self.state = TRANSITIONS[self.state, trigger]
        if not self.needs_acknowledgment:
            self.state = TRANSITIONS.get((self.state, _ACKNOWLEDGE), self.state)
        return trigger

    @property
    def awaits_acknowledgment(self) -> bool:
        """Whether it is active or has returned to normal, and nobody has acknowledged it."""
        return (self.state, _ACKNOWLEDGE) in TRANSITIONS

    def acknowledge(self) -> None:
        """Acknowledge it; only if it awaits that."""
        self.state = TRANSITIONS[self.state, _ACKNOWLEDGE]
