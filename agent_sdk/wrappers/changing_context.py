"""A wrapper that sets actuators which are not part of the action, by a schedule."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.random_streams import SlotRandomStreams
from zenostat.topics.calendar import parse_clock_time
from zenostat.topics.errors import InvalidConfig

Context = Mapping[str, float | None]
Schedule = Callable[[datetime, np.random.Generator], Context]


class _TimeTable:
    """Values at times of the day (`07:30`) or of the year (`07-01 07:30`), each valid until the next.

    Before the first time of a day or year, the last value is valid.

    Args:
        entries: values by time.
        label: names the table in errors.

    Raises:
        InvalidConfig: there are no entries, a time is invalid, or the times are of both forms.
    """

    def __init__(self, entries: Mapping[str, Context], label: str) -> None:
        read = sorted(
            ((parse_clock_time(text, label), value) for text, value in entries.items()), key=lambda entry: entry[0]
        )
        self._keys, self._values = [key for key, _ in read], [value for _, value in read]
        if len({len(key) for key in self._keys}) != 1:
            raise InvalidConfig(f"{label}: the times of a table should all be like '07:30', or all like '07-01 07:30'")
        self._daily = len(self._keys[0]) == 2

    def at(self, time: datetime) -> Context:
        """Return the value that is valid at that time."""
        key = (time.hour, time.minute) if self._daily else (time.month, time.day, time.hour, time.minute)
        return self._values[bisect_right(self._keys, key) - 1]


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, schedule: Mapping[str, Context] | Schedule) -> None:
        super().__init__(view)
        self._table = None if callable(schedule) else _TimeTable(schedule, view.wrapper_name)
        self._schedule = schedule if callable(schedule) else None
        self._randoms = SlotRandomStreams(view.env, view.wrapper_name, view.slots)
        self._now: dict[int, datetime] = {}
        self._set: list[dict[str, float | None]] = [{} for _ in range(view.slots)]

    def start(self, start: ResetBatch) -> Values:
        self._randoms.seed(start.slots, start.seeds)
        for row, slot in enumerate(start.slots):
            self._now[slot], self._set[slot] = start.infos.time(row), {}
        # A caller's own context after the reset replaces that of a table. A function draws once for each timestep,
        # and at a snapshot only after its random generator has been restored.
        if self._table is not None:
            self._apply(start.slots)
        return start.observations

    def act(self, slots: list[int], actions: Values) -> Values:
        self._apply(slots)
        return actions

    def _apply(self, slots: list[int]) -> None:
        contexts = [self._context(slot) for slot in slots]
        changes = [
            {
                name: value
                for name, value in context.items()
                if name not in self._set[slot] or self._set[slot][name] != value
            }
            for slot, context in zip(slots, contexts, strict=True)
        ]
        if any(changes):
            self.view.call_each(slots, "set_context", changes)
        for slot, values in zip(slots, changes, strict=True):
            self._set[slot] |= values

    def _context(self, slot: int) -> Context:
        if self._table is not None:
            return self._table.at(self._now[slot])
        assert self._schedule is not None
        return self._schedule(self._now[slot], self._randoms[slot])

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        for row, slot in enumerate(step.slots):
            self._now[slot] = step.infos.time(row)
        return step.observations, step.rewards

    def get_state(self) -> list[dict[str, Any]]:
        """Return the random generators' state; each episode starts with nothing set."""
        return self._randoms.get_state()

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        self._randoms.set_state(slots)


class ChangingContext(BuildingWrapper):
    """Set actuators that are not part of any action, by the time at which each timestep begins.

    Args:
        schedule: a table of times (`{"07:00": {"occupants": 1.0}, "18:00": {"occupants": 0.0}}`, or with days,
            `"07-01 07:00"`), in which each entry is valid until the next one; or a function of the time and of a
            random generator that `reset(seed=)` seeds. The value None relinquishes an actuator. An actuator that is
            not named keeps its value. A `set_context` after the reset or a step replaces a table's value until the
            table changes it.

    Raises:
        InvalidConfig: the table is invalid. `InvalidAction` at a reset or step: the node does not have the actuator, an
            action sets it, or the value is out of bounds.
    """

    logic = _Logic
