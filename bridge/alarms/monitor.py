"""Runs the alarms of a node: values in, events out, in simulated time.

Each sample is screened with array operations; only alarms whose value indicates another state, whose delay is running,
or whose inhibition changes are passed to their state machines. The result is the same as if all of them were.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from math import ceil, inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.alarms.reports import Moment, Record
from zenostat.bridge.alarms.rules import ROUNDING, PointAlarm, applies_at, point_alarms
from zenostat.bridge.alarms.state_machine import Alarm, Change
from zenostat.topics.alarm_rules import AlarmRule, AlarmRules
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import RequestRejected, UnknownName, did_you_mean
from zenostat.topics.messages import (
    Acknowledge,
    AlarmList,
    AlarmTransition,
    Event,
    EventKind,
    NotifyType,
    RemoveFromService,
    ReturnToService,
    Shelve,
    Unshelve,
)
from zenostat.topics.messages.alarms import AlarmRequest

if TYPE_CHECKING:
    from zenostat.bridge.node.plant import PlantDescription

REQUESTS: dict[type[AlarmRequest], AlarmTransition] = {
    Acknowledge: AlarmTransition.ACKNOWLEDGE,
    Shelve: AlarmTransition.SHELVE,
    Unshelve: AlarmTransition.UNSHELVE,
    RemoveFromService: AlarmTransition.REMOVE_FROM_SERVICE,
    ReturnToService: AlarmTransition.RETURN_TO_SERVICE,
}
"""The transition that each request of an operator asks for."""

_MAX_TEXT = 1000
_NEVER = np.iinfo(np.int64).max


@dataclass(slots=True)
class AlarmSnapshot:
    """State of all alarms at a sample."""

    alarms: list[list[Alarm]]
    records: list[list[Record]]


def _kept(places: NDArray[np.bool_] | None, former: NDArray[np.bool_], present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the present values, but at some places the former ones; None: at no place."""
    return present if places is None else np.where(places, former, present)


class AlarmMonitor:
    """The alarms of a node; for its thread.

    Args:
        rules: the rules.
        plant: what is simulated.
        slots: number of slots.

    Attributes:
        rules: the alarm rules of the node.

    Raises:
        InvalidConfig: see `point_alarms`.
    """

    def __init__(self, rules: AlarmRules, plant: PlantDescription, slots: int) -> None:
        self.rules, self._plant = rules, plant
        self._points = point_alarms(rules, plant)
        self._period = plant.run_period
        self._slots, self._width = slots, len(plant.sensors) + len(plant.meters)
        self._columns = np.array([point.column for point in self._points], np.intp)
        self._sensors = len(plant.sensors)
        self._of_meter = self._columns >= self._sensors
        self._has_meters = bool(self._of_meter.any())
        self._occupied = np.array([i for i, point in enumerate(self._points) if point.occupants is not None], np.intp)
        self._occupants = np.array([p.occupants for p in self._points if p.occupants is not None], np.intp)
        self._schedules = _schedules(self._points)
        self._conditions = _Conditions(self._points)
        shape = (slots, len(self._points))
        self._inhibited, self._suppressed = np.zeros(shape, bool), np.zeros(shape, bool)
        self._until, self._has_time_limits = np.full(shape, _NEVER), False
        self._low, self._high = np.empty(shape), np.empty(shape)
        self._is_pending = np.zeros(shape, bool)
        self._latest: list[tuple[int, int]] = [(-1, -1)] * slots
        self._is_restored = False
        self._values = np.full(shape, np.nan)
        self._alarms: list[list[Alarm]] = [[] for _ in range(slots)]
        self._records: list[list[Record]] = [[] for _ in range(slots)]
        self.reset(range(slots))

    def reset(self, slots: Sequence[int]) -> None:
        """Begin new episodes in some slots: all alarms are normal."""
        for slot in slots:
            self._alarms[slot] = [Alarm(p.limits, p.rule.notify is NotifyType.ALARM) for p in self._points]
            self._records[slot] = [Record() for _ in self._points]
            self._latest[slot] = (-1, -1)
            self._inhibited[slot] = self._suppressed[slot] = False
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
        self._until[slot, index] = _NEVER if alarm.until is None else alarm.until
        self._has_time_limits |= alarm.until is not None

    # Samples

    def update(self, values: bytes, episode: Sequence[int], step: Sequence[int]) -> list[Event]:
        """Take the published values of a sample, raw float64 of shape (slots, points); return the events.

        A sample that is published again is not evaluated again: that of a slot which waits while others step, and the
        one of a snapshot. Meters have no timestep at step 0, so that their alarms are evaluated from step 1 on; there,
        their values are missing for the conditions of other alarms.
        """
        table = np.frombuffer(values).reshape(self._slots, self._width)
        present = self._values = table[:, self._columns]
        # NaN is in no range.
        visit = ~((present >= self._low) & (present <= self._high)) | self._is_pending
        unmeasured = self._of_meter & (np.array(step) == 0)[:, None] if self._has_meters and 0 in step else None
        if 0 in step:
            table = table.copy()
            table[np.array(step) == 0, self._sensors :] = np.nan
        if len(self._occupied) or self._schedules:
            inhibited = _kept(unmeasured, self._inhibited, self._inhibition(table, step))
            visit |= inhibited != self._inhibited
            self._inhibited = inhibited
        if self._conditions:
            suppressed = _kept(unmeasured, self._suppressed, self._conditions.hold(table, len(self._points)))
            visit |= suppressed != self._suppressed
            self._suppressed = suppressed
        if self._has_time_limits:
            visit |= np.array(step)[:, None] >= self._until
        if self._is_restored:
            self._is_restored = False
            self._screen_all()
            visit[:] = False
        visit = _kept(unmeasured, np.zeros_like(visit), visit)
        if not visit.any():
            self._latest = [*zip(episode, step, strict=True)]
            return []
        events = []
        for slot, index in np.argwhere(visit).tolist():
            if self._latest[slot] != (episode[slot], step[slot]):
                events += self._visit(slot, index, episode[slot], step[slot])
        self._latest = [*zip(episode, step, strict=True)]
        return events

    def _inhibition(self, table: Floats, step: Sequence[int]) -> NDArray[np.bool_]:
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
        value = float(self._values[slot, index])
        inhibited, suppressed = bool(self._inhibited[slot, index]), bool(self._suppressed[slot, index])
        changes = self._alarms[slot][index].update(value, step, inhibited=inhibited, suppressed=suppressed)
        self._screen(slot, index)
        return self._events(slot, index, changes, episode, step)

    def _events(
        self,
        slot: int,
        index: int,
        changes: Sequence[Change],
        episode: int,
        step: int,
        request: AlarmRequest | None = None,
    ) -> list[Event]:
        """Record the transitions of an alarm; return their events. The first is what a request asked for."""
        events, moment = [], self._moment(slot, index)
        for change in changes:
            moment.record.add(change, moment.point, step, request)
            text = moment.text(change, request)
            event = Event(
                kind=EventKind.ALARM,
                text=(f"slot {slot}: {text}" if self._slots > 1 else text)[:_MAX_TEXT],
                source=request.source if request is not None else "",
                episode=episode,
                step=step,
                alarm=moment.change(change, slot, step),
            )
            events.append(event)
            request = None
        return events

    def _moment(self, slot: int, index: int) -> Moment:
        return Moment(
            self._points[index],
            self._alarms[slot][index],
            self._records[slot][index],
            float(self._values[slot, index]),
            bool(self._inhibited[slot, index]),
            self._time,
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
            alarms=[self._moment(slot, index).status() for index in range(len(self._points))],
        )

    def request(self, request: AlarmRequest) -> list[Event]:
        """Carry out what an operator requests; return the events.

        Raises:
            UnknownName: there is no such alarm or rule.
            RequestRejected: none of these alarms allows it, or one of them cannot be shelved for so long.
        """
        indices = [i for i, p in enumerate(self._points) if _is_named(p, request.alarm)]
        if not indices:
            names = dict.fromkeys([*(p.name for p in self._points), *(p.rule.name for p in self._points)])
            raise UnknownName(f"no alarm {request.alarm!r}; {did_you_mean(request.alarm, names)}")
        self._check_duration(request, indices)
        transition = REQUESTS[type(request)]
        slots = range(self._slots) if request.slot is None else (request.slot,)
        pairs = [(slot, index) for slot in slots for index in indices if self._latest[slot][1] >= 0]
        if not pairs:
            raise RequestRejected("no episode has begun")
        allowed = [pair for pair in pairs if self._alarms[pair[0]][pair[1]].allows(transition)]
        if not allowed:
            raise RequestRejected("; ".join(self._moment(*pair).refusal(transition) for pair in pairs[:3]))
        return [event for slot, index in allowed for event in self._carry_out(slot, index, transition, request)]

    def _check_duration(self, request: AlarmRequest, indices: Sequence[int]) -> None:
        if not isinstance(request, Shelve):
            return
        limits = {self._points[index].rule.name: self._points[index].rule.max_shelve_s for index in indices}
        errors = [
            f"{name} can be shelved for at most {limit:.15g} s, not for {request.duration_s:.15g} s (max_shelve_s)"
            if limit
            else f"{name} cannot be shelved (max_shelve_s: 0)"
            for name, limit in limits.items()
            if request.duration_s > limit
        ]
        if errors:
            raise RequestRejected("; ".join(errors))

    def _carry_out(self, slot: int, index: int, transition: AlarmTransition, request: AlarmRequest) -> list[Event]:
        episode, step = self._latest[slot]
        until = None
        if isinstance(request, Shelve | RemoveFromService) and request.duration_s is not None:
            until = step + max(1, ceil(request.duration_s / self._period.step_s - ROUNDING))
        changes = self._alarms[slot][index].request(transition, until)
        self._screen(slot, index)
        return self._events(slot, index, changes, episode, step, request)

    # Snapshots

    def capture(self) -> AlarmSnapshot:
        """Return a copy of the state of all alarms."""
        return AlarmSnapshot([[copy(a) for a in row] for row in self._alarms], [_copies(row) for row in self._records])

    def restore(self, saved: AlarmSnapshot) -> None:
        """Return to a state that `capture` returned; the next `update` has the sample at which it was captured."""
        self._alarms = [[copy(alarm) for alarm in row] for row in saved.alarms]
        self._records = [_copies(row) for row in saved.records]
        self._is_restored = True

    def of_branch(self, slot: int, slots: int, saved: AlarmSnapshot | None) -> AlarmMonitor:
        """Return the alarms of a branch, each of whose slots continues from one slot of a snapshot, or of the present.

        Args:
            slot: the slot to continue.
            slots: number of slots of the branch.
            saved: the snapshot; None is the present state.
        """
        state = saved if saved is not None else AlarmSnapshot(self._alarms, self._records)
        branch = AlarmMonitor(self.rules, self._plant, slots)
        branch.restore(AlarmSnapshot([state.alarms[slot]] * slots, [state.records[slot]] * slots))
        return branch

    def _screen_all(self) -> None:
        for slot in range(self._slots):
            for index in range(len(self._points)):
                self._screen(slot, index)


class _Conditions:
    """The conditions of suppression of all alarms of a slot; false if there are none."""

    def __init__(self, points: Sequence[PointAlarm]) -> None:
        rows = [(i, p.suppressor, p.rule.suppress_when) for i, p in enumerate(points)]
        held = [(i, column, condition) for i, column, condition in rows if column is not None and condition is not None]
        self._indices = np.array([i for i, _, _ in held], np.intp)
        self._columns = np.array([column for _, column, _ in held], np.intp)
        self._above = np.array([-inf if c.above is None else c.above for _, _, c in held])
        self._below = np.array([inf if c.below is None else c.below for _, _, c in held])

    def __bool__(self) -> bool:
        return len(self._indices) > 0

    def hold(self, table: Floats, alarms: int) -> NDArray[np.bool_]:
        """Return which alarms are suppressed by the values of a sample, shape (slots, alarms)."""
        values, suppressed = table[:, self._columns], np.zeros((len(table), alarms), bool)
        suppressed[:, self._indices] = (values > self._above) & (values < self._below)  # not where it is missing
        return suppressed


def _schedules(points: Sequence[PointAlarm]) -> list[tuple[AlarmRule, NDArray[np.intp]]]:
    """Return the rules that depend on the time, with the alarms of each."""
    by_rule: dict[str, list[int]] = {}
    for index, point in enumerate(points):
        if point.rule.hours is not None or point.rule.weekdays is not None:
            by_rule.setdefault(point.rule.name, []).append(index)
    return [(points[indices[0]].rule, np.array(indices, np.intp)) for indices in by_rule.values()]


def _copies(records: Sequence[Record]) -> list[Record]:
    return [replace(record) for record in records]


def _is_named(point: PointAlarm, name: str) -> bool:
    """Return whether a request names an alarm: by its name, its rule or a pattern."""
    return name in (point.name, point.rule.name) or ("*" in name and fnmatchcase(point.name, name))
