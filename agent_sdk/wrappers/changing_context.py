"""A wrapper that sets actuators which are not part of the action, by a schedule."""

from __future__ import annotations

import copy
import inspect
import warnings
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.names import require_each_timestep
from zenostat.agent_sdk.wrappers.random_streams import SlotRandomStreams
from zenostat.topics.calendar import parse_clock_time
from zenostat.topics.errors import InvalidConfig

Context = Mapping[str, float | None]
Schedule = Callable[[datetime, np.random.Generator], Context]


class _TimeTable:
    """Values at times of the day (`07:30`) or of the year (`07-01 07:30`), each valid until the next.

    Before the first time of a day, the last value is valid; before the first one of a year, none is set.

    Args:
        entries: values by time.
        label: names the table in errors.

    Raises:
        InvalidConfig: there are no entries, an entry or a time is invalid, or the times are of both forms.
    """

    def __init__(self, entries: Mapping[str, Context], label: str) -> None:
        read = sorted(
            (
                (parse_clock_time(text, label), _values_by_actuator(value, f"{label}: the entry at {text!r} is"))
                for text, value in entries.items()
            ),
            key=lambda entry: entry[0],
        )
        self._keys, self._values = [key for key, _ in read], [value for _, value in read]
        if not read:
            raise InvalidConfig(f"{label}: the table is empty; times with values expected, such as '07:30'")
        if len({len(key) for key in self._keys}) != 1:
            raise InvalidConfig(f"{label}: the times of a table should all be like '07:30', or all like '07-01 07:30'")
        self._daily = len(self._keys[0]) == 2

    def __call__(self, time: datetime, random: np.random.Generator) -> Context:  # noqa: ARG002  # as a `Schedule`
        """Return the value that is valid at that time."""
        key = (time.hour, time.minute) if self._daily else (time.month, time.day, time.hour, time.minute)
        position = bisect_right(self._keys, key) - 1
        return self._values[position] if position >= 0 or self._daily else {}


def _values_by_actuator(values: Any, text: str) -> Context:
    """Return values of actuators by name; `text` precedes other values in the error."""
    if not isinstance(values, Mapping):
        raise InvalidConfig(f"{text} {values!r}; values by actuator expected, such as {{'occupants': 1.0}}")
    return values


def _read_schedule(schedule: Mapping[str, Context] | Schedule, label: str) -> Schedule:
    """Return the schedule of a table or a function; `label` names the wrapper in errors."""
    if isinstance(schedule, Mapping):
        return _TimeTable(schedule, label)
    if not callable(schedule):
        raise InvalidConfig(f"{label}: a table of times or a function of (time, random) expected, got {schedule!r}")
    try:
        inspect.signature(schedule).bind(None, None)
    except TypeError as error:
        raise InvalidConfig(f"{label}: the schedule should be a function of (time, random): {error}") from None
    except ValueError:  # some built-in functions have no signature
        pass
    return schedule


class _Program:
    """Changes of the context of one slot, in an episode.

    Args:
        schedule: gives the values at a time.
        random: generator of the schedule.
        values: values that are set already.

    Attributes:
        begin, changes: the timestep that was begun last, and its changes.
    """

    def __init__(self, schedule: Schedule, random: np.random.Generator, values: Context) -> None:
        self._schedule, self._random, self._values = schedule, random, dict(values)
        self.begin: datetime | None = None
        self.changes: Context = {}

    def __call__(self, time: datetime) -> Context:
        """Return the changes for the timestep that begins at that time: again the same, if its action was refused."""
        if time != self.begin:
            self._values |= self.changes
            context, values = self._schedule(time, self._random), self._values
            _values_by_actuator(context, f"ChangingContext: the schedule returned at {time}")
            changes = {name: value for name, value in context.items() if name not in values or values[name] != value}
            self.begin, self.changes = time, changes
        return self.changes


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, schedule: Mapping[str, Context] | Schedule) -> None:
        super().__init__(view)
        require_each_timestep(view.env, view.wrapper_name)
        self._schedule = _read_schedule(schedule, view.wrapper_name)
        self._randoms = SlotRandomStreams(view.env, view.wrapper_name, view.slots)
        self._now: dict[int, datetime] = {}
        self._programs: dict[int, _Program] = {}

    def start(self, start: ResetBatch) -> Values:
        self._randoms.seed(start.slots, start.seeds)
        values: list[Context] = [{} for _ in start.slots]
        for row, slot in enumerate(start.slots):
            now = self._now[slot] = start.infos.time(row)
            # A caller's own context after the reset replaces that of a table. A function draws once for each timestep,
            # and at a snapshot only after its random generator has been restored.
            if isinstance(self._schedule, _TimeTable):
                values[row] = self._schedule(now, self._randoms[slot])
            self._programs[slot] = _Program(self._schedule, self._randoms[slot], values[row])
        self._set(start.slots, values)
        return start.observations

    def act(self, slots: list[int], actions: Values) -> Values:
        started = [slot for slot in slots if slot in self._programs]  # before the first reset, none
        self._set(started, [self._programs[slot](self._now[slot]) for slot in started])
        return actions

    def _set(self, slots: list[int], changes: Sequence[Context]) -> None:
        if any(changes):
            self.view.call_each(slots, "set_context", changes)

    def context_program(self) -> _Program | None:
        """Return what sets the context of a branch: a copy of the schedule, with the state of its generator."""
        if self.view.vector or not self._programs:
            return None
        try:
            return copy.deepcopy(self._programs[0])
        except Exception as error:
            warnings.warn(
                f"{self.view.wrapper_name}: branches keep the present context, because the schedule cannot be copied: "
                f"{error}", stacklevel=2,
            )  # fmt: skip
            return None

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        for row, slot in enumerate(step.slots):
            self._now[slot] = step.infos.time(row)
        return step.observations, step.rewards

    def get_state(self) -> list[dict[str, Any]]:
        """Return the random generators' state, and the changes of a timestep whose action was refused.

        Each episode starts with nothing set.
        """
        states = self._randoms.get_state()
        for slot, program in self._programs.items():
            if program.begin == self._now[slot]:
                states[slot]["changes"] = dict(program.changes)
        return states

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        self._randoms.set_state(slots)
        for slot, program in self._programs.items():
            program.begin = None
            if "changes" in slots[slot]:
                program.begin, program.changes = self._now[slot], slots[slot]["changes"]


class ChangingContext(BuildingWrapper):
    """Set actuators that are not part of any action, by the time at which each timestep begins.

    Args:
        schedule: a table of times (`{"07:00": {"occupants": 1.0}, "18:00": {"occupants": 0.0}}`, or with days,
            `"07-01 07:00"`), in which each entry is valid until the next one; or a function of the time and of a
            random generator that `reset(seed=)` seeds. A table with days sets nothing in an episode until the first of
            them in the year. The value None relinquishes an actuator. An actuator that is not named keeps its value. A
            `set_context` after the reset or a step replaces a table's value until the table changes it. Branches of
            the building continue with a copy of the schedule and its generator.

    Raises:
        InvalidConfig: the table is invalid, the function does not take two arguments, an inner wrapper repeats
            actions, or (at a step) the function returned no mapping. `InvalidAction` at a reset or step: the node does
            not have the actuator, an action sets it, or the value is out of bounds.
    """

    logic = _Logic
