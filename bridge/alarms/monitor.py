"""Runs the alarms of a node: values in, events out, in simulated time.

Each sample is screened with array operations; only alarms whose value indicates another state, whose delay is running,
or whose inhibition changes are passed to their state machines. The result is the same as if all of them were.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bridge.alarms.rules import PointAlarm, applies_at, point_alarms
from bridge.alarms.state_machine import Alarm
from topics.alarm_rules import AlarmRule, AlarmRules
from topics.errors import RequestRejected, UnknownName, did_you_mean
from topics.messages import (
    Acknowledge,
    AlarmChange,
    AlarmList,
    AlarmState,
    AlarmStatus,
    AlarmTransition,
    Event,
    EventKind,
    EventState,
    NotifyType,
)
from topics.units import with_unit

if TYPE_CHECKING:
    from bridge.node.plant import PlantDescription

_MAX_TEXT = 1000


@dataclass(slots=True)
class _Record:
    """What happened to an alarm in this episode; see `AlarmStatus`. Steps are -1 before the first time."""

    raised: int = -1
    changed: int = -1
    times_raised: int = 0
    limit: float | None = None
    acknowledged: int = -1
    acknowledged_by: str = ""
    comment: str = ""


@dataclass(slots=True)
class AlarmSnapshot:
    """State of all alarms at a sample."""

    alarms: list[list[Alarm]]
    records: list[list[_Record]]


class AlarmMonitor:
    """The alarms of a node; for its thread.

    Args:
        rules: the rules.
        plant: what is simulated.
        slots: number of slots.

    Raises:
        InvalidConfig: see `point_alarms`.
    """

    def __init__(self, rules: AlarmRules, plant: PlantDescription, slots: int) -> None:
        self._points = point_alarms(rules, plant)
        self._period = plant.run_period
        self._slots, self._width = slots, len(plant.sensors) + len(plant.meters)
        self._columns = np.array([point.column for point in self._points], np.intp)
        self._occupied = np.array([i for i, point in enumerate(self._points) if point.occupants is not None], np.intp)
        self._occupants = np.array([p.occupants for p in self._points if p.occupants is not None], np.intp)
        self._schedules = _schedules(self._points)
        shape = (slots, len(self._points))
        self._inhibited = np.zeros(shape, bool)
        self._low, self._high = np.empty(shape), np.empty(shape)
        self._is_pending = np.zeros(shape, bool)
        self._latest: list[tuple[int, int]] = [(-1, -1)] * slots
        self._is_restored = False
        self._values = np.full(shape, np.nan)
        self._alarms: list[list[Alarm]] = [[] for _ in range(slots)]
        self._records: list[list[_Record]] = [[] for _ in range(slots)]
        self.reset(range(slots))

    def reset(self, slots: Sequence[int]) -> None:
        """Begin new episodes in some slots: all alarms are normal."""
        for slot in slots:
            self._alarms[slot] = [Alarm(p.limits, p.rule.notify is NotifyType.ALARM) for p in self._points]
            self._records[slot] = [_Record() for _ in self._points]
            self._latest[slot] = (-1, -1)
            self._inhibited[slot] = False
            for index in range(len(self._points)):
                self._screen(slot, index)

    def _screen(self, slot: int, index: int) -> None:
        """Update the arrays for the screening after an alarm or its inhibition has changed."""
        alarm = self._alarms[slot][index]
        inhibited = bool(self._inhibited[slot, index])
        self._low[slot, index], self._high[slot, index] = alarm.limits.quiet_range(
            alarm.event_state, inhibited=inhibited
        )
        self._is_pending[slot, index] = alarm.pending is not None

    # Samples

    def update(self, values: bytes, episode: Sequence[int], step: Sequence[int]) -> list[Event]:
        """Take the published values of a sample, raw float64 of shape (slots, points); return the events.

        A sample that is published again is not evaluated again: that of a slot which waits while others step, and the
        one of a snapshot.
        """
        table = np.frombuffer(values).reshape(self._slots, self._width)
        present = self._values = table[:, self._columns]
        # NaN is in no range.
        visit = ~((present >= self._low) & (present <= self._high)) | self._is_pending
        if len(self._occupied) or self._schedules:
            inhibited = self._inhibition(table, step)
            visit |= inhibited != self._inhibited
            self._inhibited = inhibited
        if self._is_restored:
            self._is_restored = False
            self._screen_all()
            visit[:] = False
        if not visit.any():
            self._latest = [*zip(episode, step, strict=True)]
            return []
        events = []
        for slot, index in np.argwhere(visit).tolist():
            if self._latest[slot] != (episode[slot], step[slot]):
                events += self._visit(slot, index, episode[slot], step[slot])
        self._latest = [*zip(episode, step, strict=True)]
        return events

    def _inhibition(self, table: NDArray[np.float64], step: Sequence[int]) -> NDArray[np.bool_]:
        """Return which alarms do not apply at this sample, shape (slots, alarms)."""
        inhibited = np.zeros(self._inhibited.shape, bool)
        inhibited[:, self._occupied] = table[:, self._occupants] <= 0.0  # not where their number is missing
        if self._schedules:
            for slot, number in enumerate(step):
                moment = self._period.time(number)
                for rule, indices in self._schedules:
                    if not applies_at(rule, moment):
                        inhibited[slot, indices] = True
        return inhibited

    def _visit(self, slot: int, index: int, episode: int, step: int) -> list[Event]:
        """Pass the present value to the state machine of an alarm; return its event, if there is one."""
        alarm, record, point = self._alarms[slot][index], self._records[slot][index], self._points[index]
        value, was_raised = float(self._values[slot, index]), alarm.event_state is not EventState.NORMAL
        transition = alarm.update(value, step, inhibited=bool(self._inhibited[slot, index]))
        self._screen(slot, index)
        if transition is None:
            return []
        record.changed = step
        if transition is not AlarmTransition.TO_NORMAL:
            record.limit = {
                EventState.HIGH_LIMIT: point.rule.high,
                EventState.LOW_LIMIT: point.rule.low,
            }.get(alarm.event_state)
            record.raised, record.acknowledged, record.acknowledged_by, record.comment = step, -1, "", ""
            record.times_raised += not was_raised
        text = self._transition_text(point, alarm, value, inhibited=bool(self._inhibited[slot, index]))
        return [self._event(slot, index, transition, text, episode, step)]

    def _transition_text(self, point: PointAlarm, alarm: Alarm, value: float, *, inhibited: bool) -> str:
        unit, state = point.point.unit, alarm.event_state
        if state is EventState.FAULT:
            what = "has no value"
        elif state is EventState.NORMAL:
            reason = " (the rule does not apply now)" if inhibited else ""
            what = f"is normal again{reason}: {with_unit(f'{value:.6g}', unit)}"
        else:
            is_high = state is EventState.HIGH_LIMIT
            limit = point.limits.high if is_high else point.limits.low
            what = f"is {'above' if is_high else 'below'} {with_unit(f'{limit:g}', unit)}: {value:.6g}"
        return f"{point.rule.name}: {point.point.name} {what}"

    def _event(
        self, slot: int, index: int, transition: AlarmTransition, text: str, episode: int, step: int, source: str = ""
    ) -> Event:
        point, alarm = self._points[index], self._alarms[slot][index]
        value = float(self._values[slot, index])
        text = f"slot {slot}: {text}" if self._slots > 1 else text
        change = AlarmChange(
            alarm=point.name,
            point=point.point.name,
            slot=slot,
            transition=transition,
            event_state=alarm.event_state,
            state=alarm.state,
            priority=point.rule.priority,
            notify=point.rule.notify,
            value=value if isfinite(value) else None,
            limit=self._records[slot][index].limit,
            unit=point.point.unit,
            time=self._time(step),
        )
        return Event(
            kind=EventKind.ALARM, text=text[:_MAX_TEXT], source=source, episode=episode, step=step, alarm=change
        )

    def _time(self, step: int) -> str:
        return "" if step < 0 else self._period.time(step).isoformat()

    # Requests

    def status(self, slot: int) -> AlarmList:
        """Return all alarms of a slot at its present sample."""
        episode, step = self._latest[slot]
        return AlarmList(
            slot=slot,
            episode=max(0, episode),
            step=max(0, step),
            time=self._time(step),
            alarms=[self._status(slot, index) for index in range(len(self._points))],
        )

    def _status(self, slot: int, index: int) -> AlarmStatus:
        point, alarm, record = self._points[index], self._alarms[slot][index], self._records[slot][index]
        rule, value = point.rule, float(self._values[slot, index])
        return AlarmStatus(
            alarm=point.name,
            text=rule.text,
            point=point.point.name,
            unit=point.point.unit,
            low=rule.low,
            high=rule.high,
            priority=rule.priority,
            notify=rule.notify,
            value=value if isfinite(value) else None,
            event_state=alarm.event_state,
            state=alarm.state,
            inhibited=bool(self._inhibited[slot, index]),
            raised=self._time(record.raised),
            changed=self._time(record.changed),
            times_raised=record.times_raised,
            acknowledged=self._time(record.acknowledged),
            acknowledged_by=record.acknowledged_by,
            comment=record.comment,
        )

    def acknowledge(self, request: Acknowledge) -> list[Event]:
        """Acknowledge alarms; return an event for each.

        Raises:
            UnknownName: there is no such alarm or rule.
            RequestRejected: none of these alarms waits for an acknowledgment.
        """
        indices = [i for i, p in enumerate(self._points) if _is_named(p, request.alarm)]
        if not indices:
            names = dict.fromkeys([*(p.name for p in self._points), *(p.rule.name for p in self._points)])
            raise UnknownName(f"no alarm {request.alarm!r}; {did_you_mean(request.alarm, names)}")
        slots = range(self._slots) if request.slot is None else (request.slot,)
        pairs = [(slot, index) for slot in slots for index in indices]
        waiting = [pair for pair in pairs if self._alarms[pair[0]][pair[1]].awaits_acknowledgment]
        if not waiting:
            raise RequestRejected("; ".join(self._why_not(slot, index) for slot, index in pairs[:3]))
        return [self._acknowledge(slot, index, request) for slot, index in waiting]

    def _why_not(self, slot: int, index: int) -> str:
        alarm, record, name = self._alarms[slot][index], self._records[slot][index], self._points[index].name
        if alarm.state is AlarmState.NORMAL:
            return f"{name} is normal, so there is nothing to acknowledge"
        if not alarm.needs_acknowledgment:
            return f"{name} needs no acknowledgment (notify: event)"
        by = f" by {record.acknowledged_by}" if record.acknowledged_by else ""
        return f"{name} was acknowledged{by} at {self._time(record.acknowledged)}"

    def _acknowledge(self, slot: int, index: int, request: Acknowledge) -> Event:
        record, point = self._records[slot][index], self._points[index]
        episode, step = self._latest[slot]
        self._alarms[slot][index].acknowledge()
        record.acknowledged, record.acknowledged_by, record.comment = step, request.source, request.comment
        by = f" by {request.source}" if request.source else ""
        comment = f": {request.comment}" if request.comment else ""
        text = f"{point.rule.name}: {point.point.name} is acknowledged{by}{comment}"
        return self._event(slot, index, AlarmTransition.ACKNOWLEDGE, text, episode, step, request.source)

    # Snapshots

    def capture(self) -> AlarmSnapshot:
        """Return a copy of the state of all alarms."""
        return AlarmSnapshot([[copy(a) for a in row] for row in self._alarms], [_copies(row) for row in self._records])

    def restore(self, saved: AlarmSnapshot) -> None:
        """Return to a state that `capture` returned; the next `update` has the sample at which it was captured."""
        self._alarms = [[copy(alarm) for alarm in row] for row in saved.alarms]
        self._records = [_copies(row) for row in saved.records]
        self._is_restored = True

    def _screen_all(self) -> None:
        for slot in range(self._slots):
            for index in range(len(self._points)):
                self._screen(slot, index)


def _schedules(points: Sequence[PointAlarm]) -> list[tuple[AlarmRule, NDArray[np.intp]]]:
    """Return the rules that depend on the time, with the alarms of each."""
    by_rule: dict[str, list[int]] = {}
    for index, point in enumerate(points):
        if point.rule.hours is not None or point.rule.weekdays is not None:
            by_rule.setdefault(point.rule.name, []).append(index)
    return [(points[indices[0]].rule, np.array(indices, np.intp)) for indices in by_rule.values()]


def _copies(records: Sequence[_Record]) -> list[_Record]:
    return [replace(record) for record in records]


def _is_named(point: PointAlarm, name: str) -> bool:
    """Return whether a request names an alarm: by its name, its rule or a pattern."""
    return name in (point.name, point.rule.name) or ("*" in name and fnmatchcase(point.name, name))
