"""Reports of alarms to operators: the texts of events, the state of each alarm, and why a request has no effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

from zenostat.bridge.alarms.rules import PointAlarm
from zenostat.bridge.alarms.state_machine import SET_ASIDE, Alarm, Change
from zenostat.topics.alarm_rules import SuppressionCondition
from zenostat.topics.messages import AlarmChange, AlarmState, AlarmStatus, AlarmTransition, EventState
from zenostat.topics.messages.alarms import AlarmRequest
from zenostat.topics.units import with_unit

VALUE_TRANSITIONS = (AlarmTransition.TO_OFFNORMAL, AlarmTransition.TO_FAULT, AlarmTransition.TO_NORMAL)
"""What the monitored value causes."""


@dataclass(slots=True)
class Record:
    """Record of an alarm in this episode; see `AlarmStatus`. Steps are -1 before the first time."""

    raised: int = -1
    changed: int = -1
    times_raised: int = 0
    limit: float | None = None
    acknowledged: int = -1
    acknowledged_by: str = ""
    comment: str = ""
    set_aside: int = -1
    set_aside_by: str = ""
    set_aside_comment: str = ""

    def add(self, change: Change, point: PointAlarm, step: int, request: AlarmRequest | None) -> None:
        """Take a transition; `request` is the one that caused it."""
        transition, before, state, event_state = change
        source, comment = (request.source, request.comment) if request is not None else ("", "")
        if transition is AlarmTransition.ACKNOWLEDGE:
            self.acknowledged, self.acknowledged_by, self.comment = step, source, comment
            return
        self.changed = step
        if transition in (AlarmTransition.TO_OFFNORMAL, AlarmTransition.TO_FAULT):
            limits = {EventState.HIGH_LIMIT: point.rule.high, EventState.LOW_LIMIT: point.rule.low}
            self.limit = limits.get(event_state)
            if state not in SET_ASIDE:
                self.raised, self.acknowledged, self.acknowledged_by, self.comment = step, -1, "", ""
                self.times_raised += before in (AlarmState.NORMAL, AlarmState.RETURNED)
        elif transition is not AlarmTransition.TO_NORMAL:
            is_set_aside = state in SET_ASIDE
            self.set_aside = step if is_set_aside else -1
            self.set_aside_by, self.set_aside_comment = (source, comment) if is_set_aside else ("", "")


@dataclass(frozen=True, slots=True)
class Moment:
    """An alarm of a slot at a step.

    Attributes:
        point: its rule and point.
        alarm: its state.
        record: what happened to it.
        value: the present value; NaN is missing.
        inhibited: whether the limits do not apply now.
        time: converts a step to simulated time; empty for a step below 0.
    """

    point: PointAlarm
    alarm: Alarm
    record: Record
    value: float
    inhibited: bool
    time: Callable[[int], str]

    @property
    def until(self) -> str:
        """Simulated time until which it is shelved or out of service; empty without a limit."""
        return "" if self.alarm.until is None else self.time(self.alarm.until)

    def change(self, change: Change, slot: int, step: int) -> AlarmChange:
        """Return a transition as the part of an event."""
        point = self.point
        return AlarmChange(
            alarm=point.name,
            point=point.point.name,
            slot=slot,
            transition=change.transition,
            event_state=change.event_state,
            state=change.state,
            priority=point.rule.priority,
            notify=point.rule.notify,
            value=self.value if isfinite(self.value) else None,
            limit=self.record.limit,
            unit=point.point.unit,
            time=self.time(step),
            until=self.until if change.state in SET_ASIDE else "",
        )

    def status(self) -> AlarmStatus:
        """Return the state of the alarm with its rule."""
        point, alarm, record = self.point, self.alarm, self.record
        rule = point.rule
        return AlarmStatus(
            alarm=point.name,
            text=rule.text,
            point=point.point.name,
            unit=point.point.unit,
            low=rule.low,
            high=rule.high,
            priority=rule.priority,
            notify=rule.notify,
            value=self.value if isfinite(self.value) else None,
            event_state=alarm.event_state,
            state=alarm.state,
            inhibited=self.inhibited,
            raised=self.time(record.raised),
            changed=self.time(record.changed),
            times_raised=record.times_raised,
            acknowledged=self.time(record.acknowledged),
            acknowledged_by=record.acknowledged_by,
            comment=record.comment,
            set_aside=self.time(record.set_aside),
            set_aside_by=record.set_aside_by,
            set_aside_comment=record.set_aside_comment,
            set_aside_until=self.until,
            max_shelve_s=rule.max_shelve_s,
        )

    def text(self, change: Change, request: AlarmRequest | None) -> str:
        """Describe a transition; `request` is the one that caused it."""
        what = self._value_text(change) if change.transition in VALUE_TRANSITIONS else self._decision_text(change)
        by = f" by {request.source}" if request is not None and request.source else ""
        comment = f": {request.comment}" if request is not None and request.comment else ""
        return f"{self.point.rule.name}: {self.point.point.name} {what}{by}{comment}"

    def _value_text(self, change: Change) -> str:
        unit, state, limits = self.point.point.unit, change.event_state, self.point.limits
        aside = f" ({_words(change.state)})" if change.state in SET_ASIDE else ""
        if state is EventState.FAULT:
            return f"has no value{aside}"
        if state is EventState.NORMAL:
            reason = " (the rule does not apply now)" if self.inhibited else ""
            return f"is normal again{reason}{aside}: {with_unit(f'{self.value:.6g}', unit)}"
        is_high = state is EventState.HIGH_LIMIT
        limit = with_unit(f"{limits.high if is_high else limits.low:g}", unit)
        return f"is {'above' if is_high else 'below'} {limit}{aside}: {self.value:.6g}"

    def _decision_text(self, change: Change) -> str:
        if change.transition is AlarmTransition.SUPPRESS:
            condition = self.point.rule.suppress_when
            return f"is suppressed ({_condition_text(condition)})" if condition is not None else "is suppressed"
        if change.state in SET_ASIDE:
            return f"is {_words(change.state)}" + (f" until {self.until}" if self.until else "")
        over = ", as its time is over" if change.transition is AlarmTransition.EXPIRE else ""
        if change.transition is AlarmTransition.ACKNOWLEDGE:
            return "is acknowledged"
        if change.before is AlarmState.OUT_OF_SERVICE:
            return f"is back in service{over}"
        return f"is no longer {_words(change.before)}{over}"

    def refusal(self, transition: AlarmTransition) -> str:
        """Describe why a request for a transition has no effect."""
        name, state, record = self.point.name, self.alarm.state, self.record
        if state in SET_ASIDE:
            until = f" until {self.until}" if self.until else ""
            by = f", by {record.set_aside_by}" if record.set_aside_by else ""
            return f"{name} is {_words(state)} since {self.time(record.set_aside)}{until}{by}"
        if transition is AlarmTransition.UNSHELVE:
            return f"{name} is not shelved"
        if transition is AlarmTransition.RETURN_TO_SERVICE:
            return f"{name} is in service"
        if state is AlarmState.NORMAL:
            return f"{name} is normal, so there is nothing to acknowledge"
        if not self.alarm.needs_acknowledgment:
            return f"{name} needs no acknowledgment (notify: event)"
        by = f" by {record.acknowledged_by}" if record.acknowledged_by else ""
        return f"{name} was acknowledged{by} at {self.time(record.acknowledged)}"


def _words(state: AlarmState) -> str:
    return state.replace("_", " ")


def _condition_text(condition: SuppressionCondition) -> str:
    parts = [
        f"{word} {limit:g}"
        for word, limit in (("above", condition.above), ("below", condition.below))
        if limit is not None
    ]
    return f"{condition.point} is {' and '.join(parts)}"
