"""The states of an alarm, without messages, a clock or points.

Two tables in a row: the monitored value determines BACnet's Event_State (algorithm OUT_OF_RANGE of ASHRAE 135), and its
transitions and what operators do determine the state of the alarm (ISA-18.2).

    state           to_offnormal, to_fault   to_normal   acknowledge
    normal          active
    active          active                   returned    acknowledged
    acknowledged    active                   normal
    returned        active                               normal

Three states set an alarm aside: its value is followed, but nobody is alerted. From all of the states above, `suppress`
leads to suppressed, `shelve` to shelved, and `remove_from_service` to out_of_service; an operator's decision prevails
over the condition, and out_of_service over shelved.

    state           unsuppress   shelve    unshelve   remove_from_service   return_to_service   expire
    suppressed      normal       shelved              out_of_service
    shelved                      shelved   normal     out_of_service                            normal
    out_of_service                                    out_of_service        normal              normal

An alarm that is no longer set aside is normal for an instant. If its condition of suppression holds, it becomes
suppressed; otherwise, if its value is off-normal, it is raised again.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan
from typing import NamedTuple

from zenostat.topics.messages import AlarmState, AlarmTransition, EventState

_NORMAL, _ACTIVE = AlarmState.NORMAL, AlarmState.ACTIVE
_ACKNOWLEDGED, _RETURNED = AlarmState.ACKNOWLEDGED, AlarmState.RETURNED
_SUPPRESSED, _SHELVED, _OUT_OF_SERVICE = AlarmState.SUPPRESSED, AlarmState.SHELVED, AlarmState.OUT_OF_SERVICE
_TO_OFFNORMAL, _TO_FAULT = AlarmTransition.TO_OFFNORMAL, AlarmTransition.TO_FAULT
_TO_NORMAL, _ACKNOWLEDGE = AlarmTransition.TO_NORMAL, AlarmTransition.ACKNOWLEDGE
_SUPPRESS, _UNSUPPRESS = AlarmTransition.SUPPRESS, AlarmTransition.UNSUPPRESS
_SHELVE, _UNSHELVE = AlarmTransition.SHELVE, AlarmTransition.UNSHELVE
_REMOVE, _RETURN = AlarmTransition.REMOVE_FROM_SERVICE, AlarmTransition.RETURN_TO_SERVICE
_EXPIRE = AlarmTransition.EXPIRE

ALERTING = (_NORMAL, _ACTIVE, _ACKNOWLEDGED, _RETURNED)
"""States in which an alarm alerts operators when its value becomes off-normal."""

SET_ASIDE = (_SUPPRESSED, _SHELVED, _OUT_OF_SERVICE)
"""States in which it does not."""

TRANSITIONS: dict[tuple[AlarmState, AlarmTransition], AlarmState] = {
    **{(state, trigger): _ACTIVE for state in ALERTING for trigger in (_TO_OFFNORMAL, _TO_FAULT)},
    (_ACTIVE, _TO_NORMAL): _RETURNED,
    (_ACTIVE, _ACKNOWLEDGE): _ACKNOWLEDGED,
    (_ACKNOWLEDGED, _TO_NORMAL): _NORMAL,
    (_RETURNED, _ACKNOWLEDGE): _NORMAL,
    **{(state, trigger): state for state in SET_ASIDE for trigger in (_TO_OFFNORMAL, _TO_FAULT, _TO_NORMAL)},
    **{(state, _SUPPRESS): _SUPPRESSED for state in ALERTING},
    (_SUPPRESSED, _UNSUPPRESS): _NORMAL,
    **{(state, _SHELVE): _SHELVED for state in (*ALERTING, _SUPPRESSED, _SHELVED)},
    (_SHELVED, _UNSHELVE): _NORMAL,
    **{(state, _REMOVE): _OUT_OF_SERVICE for state in AlarmState},
    (_OUT_OF_SERVICE, _RETURN): _NORMAL,
    (_SHELVED, _EXPIRE): _NORMAL,
    (_OUT_OF_SERVICE, _EXPIRE): _NORMAL,
}
"""The next state of an alarm; a pair that is not listed is not possible, or a request without a reason."""

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


class Change(NamedTuple):
    """A transition of an alarm.

    Attributes:
        transition: what happened.
        before, state: states of the alarm before it and after it.
        event_state: state of its value at that moment.
    """

    transition: AlarmTransition
    before: AlarmState
    state: AlarmState
    event_state: EventState


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
        suppressed: whether its condition of suppression held at the latest step.
        until: the step at which it is no longer shelved or out of service; None has no limit.
    """

    limits: Limits
    needs_acknowledgment: bool = True
    event_state: EventState = EventState.NORMAL
    state: AlarmState = AlarmState.NORMAL
    pending: EventState | None = None
    since: int = 0
    suppressed: bool = False
    until: int | None = None

    def update(self, value: float, step: int, *, inhibited: bool = False, suppressed: bool = False) -> list[Change]:
        """Take the value of a step, later than the last one; return the transitions, in their order.

        Args:
            value: the value; NaN is missing.
            step: number of the step.
            inhibited: whether the limits do not apply.
            suppressed: whether the condition of suppression holds. It takes effect before the value does when it
                begins, and after it when it ends, so a value that changes with the condition raises no alarm.
        """
        changes: list[Change] = []
        self.suppressed = suppressed
        if suppressed and self.state in ALERTING:
            self._apply(_SUPPRESS, changes)
        trigger = self._take(value, step, inhibited=inhibited)
        if trigger is not None:
            self._apply(trigger, changes)
        if self.until is not None and step >= self.until:
            self._apply(_EXPIRE, changes)
        elif self.state is _SUPPRESSED and not suppressed:
            self._apply(_UNSUPPRESS, changes)
        return changes

    def _take(self, value: float, step: int, *, inhibited: bool) -> AlarmTransition | None:
        """Update the event state; return the transition to a new one."""
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
        return TRIGGERS[target]

    def _apply(self, transition: AlarmTransition, changes: list[Change]) -> None:
        before = self.state
        self.state = TRANSITIONS[before, transition]
        if self.state is _ACTIVE and not self.needs_acknowledgment:
            self.state = TRANSITIONS[self.state, _ACKNOWLEDGE]
        if self.state not in (_SHELVED, _OUT_OF_SERVICE):
            self.until = None
        changes.append(Change(transition, before, self.state, self.event_state))
        if before not in SET_ASIDE or self.state is not _NORMAL:
            return
        if self.suppressed:
            self._apply(_SUPPRESS, changes)
        elif self.event_state is not EventState.NORMAL:
            self._apply(TRIGGERS[self.event_state], changes)

    def allows(self, transition: AlarmTransition) -> bool:
        """Return whether a request for a transition has a reason in the present state."""
        return (self.state, transition) in TRANSITIONS

    def request(self, transition: AlarmTransition, until: int | None = None) -> list[Change]:
        """Carry out a transition that an operator requests, and that the state allows; return what it led to.

        Args:
            transition: what is requested.
            until: the step at which it ends by itself, if the alarm is shelved or removed from service.
        """
        changes: list[Change] = []
        self._apply(transition, changes)
        if self.state in (_SHELVED, _OUT_OF_SERVICE):
            self.until = until
        return changes
