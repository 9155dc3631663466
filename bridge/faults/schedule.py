"""Schedules of faults: windows of steps and of the clock, and random bursts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.faults.random_streams import Distribution, EpisodeKeys, Key, RandomStream, fault_key
from zenostat.topics.calendar import WEEKDAYS, in_hours, parse_moment
from zenostat.topics.errors import ErrorCollector, InvalidConfig
from zenostat.topics.fault_plan import AnyFault, FaultPlan, When

FOREVER = 2**62
_DAY_S, _WEEK_S = 86_400, 7 * 86_400
_BLOCK = 2_000_000
"""Largest number of samples of a table of clock times, and of a part of a search."""

Clock = Callable[[NDArray[np.int64]], NDArray[np.bool_]]
"""Function of steps, which returns whether clock and weekday at each are those of a fault; same shape."""
_NEVER = -1


class Transition(StrEnum):
    """Whether a fault became active or inactive."""

    BEGAN = "began"
    ENDED = "ended"


class FaultTransition(NamedTuple):
    """A fault in a slot that became active, or was no longer active, at a step."""

    turn: Transition
    fault: str
    slot: int
    step: int


@dataclass(frozen=True, slots=True)
class StepGrid:
    """The samples of an episode: every `step_s` from `begin` (sample 0) to `end`, if that is known."""

    step_s: float
    begin: datetime
    end: datetime | None = None

    @property
    def last(self) -> int:
        """The step of the last sample."""
        return FOREVER if self.end is None else self._floor((self.end - self.begin).total_seconds())

    @property
    def cycle(self) -> int:
        """Number of samples after which clock times repeat."""
        step_us = round(self.step_s * 1e6)
        return math.lcm(round(_WEEK_S * 1e6), step_us) // step_us

    def _floor(self, elapsed_s: float) -> int:
        return math.floor(elapsed_s / self.step_s + 1e-9)

    def ceil(self, elapsed_s: float) -> int:
        """Return the first step at or after an elapsed time."""
        return math.ceil(elapsed_s / self.step_s - 1e-9)

    def __str__(self) -> str:
        end = "" if self.end is None else f" to {self.end.isoformat(timespec='minutes')}"
        return f"every {self.step_s:g} s from {self.begin.isoformat(timespec='minutes')}{end}"


def span(when: When, grid: StepGrid) -> tuple[int, int]:
    """Return the first step of a window and the first step after it.

    Raises:
        InvalidConfig: a day without a year that no year of the run period has.
    """
    first = [0, when.from_step or 0, grid.ceil(when.from_s or 0.0)]
    end = [grid.last + 1]
    opening = grid.begin
    if when.from_time is not None:
        start = _from_moment(when.from_time, grid)
        first.append(grid.ceil((start - grid.begin).total_seconds()))
        opening = max(opening, start)
    if when.to_step is not None:
        end.append(when.to_step)
    if when.to_s is not None:
        end.append(grid.ceil(when.to_s))
    if when.to_time is not None:
        end.append(grid.ceil((_to_moment(when.to_time, opening, grid) - grid.begin).total_seconds()))
    return max(first), min(end)


def _from_moment(text: str, grid: StepGrid) -> datetime:
    """Return the first such moment within the run period, or else that of the first year that has it."""
    moments = _moments(text, grid)
    return next(
        (moment for moment in moments if grid.begin <= moment and (grid.end is None or moment < grid.end)), moments[0]
    )


def _to_moment(text: str, opening: datetime, grid: StepGrid) -> datetime:
    """Return the first such moment after the opening of its window, or else that of the first year that has it."""
    moments = _moments(text, grid)
    return next((moment for moment in moments if moment > opening), moments[0])


def _moments(text: str, grid: StepGrid) -> list[datetime]:
    """Return a moment in each year of the run period that has it; once, if it has a year of its own."""
    moments = []
    for year in range(grid.begin.year, (grid.end or grid.begin).year + 1):
        with suppress(ValueError):  # 29 February
            moments.append(parse_moment(text, year))
    if not moments:
        raise InvalidConfig(f"{text!r} does not exist in {grid.begin.year}, the year of the run period")
    return moments


def clock(when: When, grid: StepGrid) -> Clock | None:
    """Return a function of steps that returns whether each meets `hours` and `weekdays`; None if there are neither."""
    if when.hours is None and when.weekdays is None:
        return None
    monday = datetime.combine(grid.begin.date() - timedelta(grid.begin.weekday()), datetime.min.time())
    elapsed = (grid.begin - monday).total_seconds()

    def on(steps: NDArray[np.int64]) -> NDArray[np.bool_]:
        seconds = np.round(elapsed + steps * grid.step_s, 6) % _WEEK_S
        met = np.ones(steps.shape, np.bool_)
        if when.hours is not None:
            met &= in_hours(when.hours, seconds % _DAY_S / 3600.0)
        if when.weekdays is not None:
            met &= np.isin(seconds // _DAY_S, [WEEKDAYS.index(day) for day in when.weekdays])
        return met

    if grid.cycle > _BLOCK:
        return on
    table = on(np.arange(grid.cycle))  # a look-up costs less in each timestep
    return lambda steps: table[steps % len(table)]


def check(name: str, when: When, grid: StepGrid) -> None:
    """Raise `InvalidConfig` if no sample meets the conditions, or a day does not exist."""
    try:
        first, end = span(when, grid)
    except InvalidConfig as error:
        raise InvalidConfig(f"fault {name!r}: {error}") from None
    on = clock(when, grid)
    if first < end and on is not None:
        stop = min(end, first + grid.cycle)
        blocks = (np.arange(begin, min(begin + _BLOCK, stop)) for begin in range(first, stop, _BLOCK))
        end = end if any(on(block).any() for block in blocks) else first
    if first >= end:
        raise InvalidConfig(f"fault {name!r} is never active: no sample is in its window; samples are {grid}")


class FaultSchedule:
    """The point faults or the link faults of a plan, and whether each is active in each slot.

    A burst that starts where another one ends continues it.

    Attributes:
        names, keys, faults: of the faults, in the plan's order.
        on: whether each is active, of shape (faults, slots).
        since: step of the onset, of shape (faults, slots); -1 where it is not active.
        at: the steps of the last `move`, of shape (slots,).

    Raises:
        InvalidConfig: faults that are active at no sample; the text names all of them.
    """

    def __init__(self, plan: FaultPlan, kind: type[AnyFault], grid: StepGrid, episodes: EpisodeKeys) -> None:
        selected = [
            (name, fault_key(fault.name, position), fault)
            for position, (name, fault) in enumerate(zip(plan.names, plan.faults, strict=True))
            if isinstance(fault, kind)
        ]
        self.names = [name for name, _, _ in selected]
        self.keys: list[Key] = [key for _, key, _ in selected]
        self.faults: list[Any] = [fault for _, _, fault in selected]
        errors = ErrorCollector()
        for name, _, fault in selected:
            errors.collect(lambda name=name, fault=fault: check(name, fault.when, grid))  # type: ignore[misc]
        errors.raise_if_any()
        whens = [fault.when for _, _, fault in selected]
        self._slots = len(episodes.keys)
        self._span = np.array([span(when, grid) for when in whens], np.int64).reshape(-1, 2).T[:, :, None]
        self._clocks = [(row, on) for row, when in enumerate(whens) if (on := clock(when, grid)) is not None]
        self._bursts = [
            (
                row,
                when.probability,
                when.lasts_steps or 1,
                RandomStream(plan.seed, self.keys[row], Distribution.BEGIN, 1, episodes),
            )
            for row, when in enumerate(whens)
            if when.probability is not None
        ]
        shape = (len(selected), self._slots)
        self.on = np.zeros(shape, np.bool_)
        self.since = np.full(shape, _NEVER, np.int64)
        self._until = np.zeros(shape, np.int64)
        self.at = np.full(self._slots, _NEVER, np.int64)
        self._steps: list[int] = []
        self._transitions: list[FaultTransition] = []

    def move(self, steps: Sequence[int]) -> None:
        """Set the current step of each slot; a slot may stay at its step."""
        if steps == self._steps:
            return
        self._steps = [*steps]
        self.at = at = np.array(steps, np.int64)
        first, end = self._span
        on = (first <= at) & (at < end)
        for row, meets in self._clocks:
            on[row] &= meets(at)
        for row, probability, duration, stream in self._bursts:
            until = np.where(on[row], self._until[row], 0)
            starts = on[row] & (at >= until) & (stream.at(at)[:, 0] < probability)
            self._until[row] = until = np.where(starts, at + duration, until)
            on[row] &= at < until
        changed = on != self.on
        if changed.any():
            self.since = np.where(on, np.where(self.on, self.since, at), _NEVER)
            self.on = on
            for row, slot in np.argwhere(changed).tolist():
                turn = Transition.BEGAN if on[row, slot] else Transition.ENDED
                self._transitions.append(FaultTransition(turn, self.names[row], slot, self._steps[slot]))

    def drain_transitions(self) -> list[FaultTransition]:
        """Return the faults that became active or inactive since the last call."""
        transitions, self._transitions = self._transitions, []
        return transitions

    def reset(self, slots: Sequence[int]) -> None:
        """Begin new episodes in some slots; active faults end with the previous episode."""
        for row, slot in np.argwhere(self.on).tolist():
            if slot in slots:
                self._transitions.append(FaultTransition(Transition.ENDED, self.names[row], slot, int(self.at[slot])))
        self._clear(slots)

    def _clear(self, slots: Sequence[int]) -> None:
        self._steps = []
        for slot in slots:
            self.on[:, slot], self.since[:, slot], self._until[:, slot], self.at[slot] = False, _NEVER, 0, _NEVER

    def adopt(self, other: FaultSchedule) -> dict[int, int]:
        """Take over the state of the faults that are equal to one of another schedule; return their rows in both."""
        rows, left = dict[int, int](), dict(enumerate(other.faults))
        for row, fault in enumerate(self.faults):
            match = next((number for number, candidate in left.items() if candidate == fault), None)
            if match is not None:
                rows[row] = match
                del left[match]
        own, theirs = [*rows], [*rows.values()]
        self.on[own], self.since[own], self._until[own] = other.on[theirs], other.since[theirs], other._until[theirs]
        self.at, self._steps = other.at.copy(), []
        return rows

    def state(self, slot: int) -> tuple[int, list[int], list[int]]:
        """Return the state of a slot: its step, and of each fault its onset and the end of its burst."""
        return int(self.at[slot]), self.since[:, slot].tolist(), self._until[:, slot].tolist()

    def restore(self, slot: int, state: tuple[int, list[int], list[int]]) -> None:
        """Restore the state of a slot, without transitions."""
        step, since, until = state
        self._clear([slot])
        self._transitions = [transition for transition in self._transitions if transition.slot != slot]
        self.at[slot], self.since[:, slot], self._until[:, slot] = step, since, until
        self.on[:, slot] = self.since[:, slot] != _NEVER
