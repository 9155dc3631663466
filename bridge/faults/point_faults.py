"""Faults of points: what the bus is told of sensors and meters, and what the building is told of commands.

The true values stay as they are: what is disturbed is a copy. While no fault is on there is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np

from bridge.faults.effects import ACTUATOR_EFFECTS, SENSOR_EFFECTS, Effect, Floats, clipped
from bridge.faults.random_streams import EpisodeKeys, RandomStream
from bridge.faults.schedule import FaultSchedule, FaultTransition, StepGrid
from topics.errors import ErrorCollector, InvalidConfig, did_you_mean
from topics.fault_plan import FaultPlan, PointFault, Stuck
from topics.messages import Actuator
from topics.units import with_unit

State = dict[str, Any]
"""Where one slot stands: plain data that can be pickled."""


class PointFaults:
    """The faults of a node's points. Nothing is drawn or copied where there are none.

    Args:
        points: names of the sensors, then the meters, in the manifest's order.
        actuators: in the manifest's order; a disturbed command stays within their bounds.
        slots: engines in the node.
        step_s: length of a timestep.
        begin: simulated time of sample 0.
        end: of the last sample, if windows after it are to be refused.

    Raises:
        InvalidConfig: unknown points, a value out of bounds, a window without a sample; all of them.
    """

    def __init__(
        self,
        plan: FaultPlan,
        points: Sequence[str],
        actuators: Sequence[Actuator],
        *,
        slots: int = 1,
        step_s: float,
        begin: datetime,
        end: datetime | None = None,
    ) -> None:
        self.plan = plan
        self._slots = slots
        self._episodes = EpisodeKeys(slots)
        gathered = ErrorCollector()
        check_points(plan, points, actuators, gathered)
        windows = gathered.collect(
            lambda: FaultSchedule(plan, PointFault, StepGrid(step_s, begin, end), self._episodes)
        )
        gathered.raise_if_any()
        assert windows is not None
        self._windows = windows
        self._points = self._effects(SENSOR_EFFECTS, "points", points, step_s)
        self._actuators = self._effects(ACTUATOR_EFFECTS, "actuators", [a.name for a in actuators], step_s)
        self._low = np.array([-np.inf if a.low is None else a.low for a in actuators])
        self._high = np.array([np.inf if a.high is None else a.high for a in actuators])

    def _effects(
        self, kinds: Mapping[type[PointFault], type[Effect]], side: str, names: Sequence[str], step_s: float
    ) -> list[Effect]:
        made = []
        for row, fault in enumerate(self._windows.faults):
            asked = getattr(fault, side)
            columns = np.array([c for c, name in enumerate(names) if _any_of(asked, name)], np.intp)
            if len(columns):
                key = (*self._windows.keys[row], int(side == "actuators"))
                new_draws = partial(RandomStream, self.plan.seed, key, width=len(columns), episodes=self._episodes)
                made.append(kinds[type(fault)](row, columns, self._windows, step_s / 3600.0, new_draws))
        return made

    @property
    def disturbs_points(self) -> bool:
        """Whether any fault is one of sensors or meters."""
        return bool(self._points)

    @property
    def disturbs_actuators(self) -> bool:
        """Whether any fault is one of actuators."""
        return bool(self._actuators)

    def reset(self, slots: Sequence[int] | None = None, seeds: Sequence[int | None] | None = None) -> None:
        """New episodes in some slots (None: all).

        Args:
            slots: which.
            seeds: of each of them. The same seed gives the same sequence of episodes, in any slot; with None it goes
                on with the next episode of the former seed.
        """
        chosen = range(self._slots) if slots is None else slots
        self._windows.reset(chosen)
        self._episodes.turn(chosen, seeds if seeds is not None else [None] * len(chosen))
        for effect in (*self._points, *self._actuators):
            effect.memory[list(chosen)] = np.nan

    def apply_to_sensors(self, values: Floats, steps: Sequence[int]) -> Floats:
        """What goes on the bus.

        Args:
            values: of sensors and meters, shape (slots, points); they stay as they are.
            steps: of each slot, the sample's.

        Returns:
            `values` itself if nothing is disturbed; NaN where a point has no value.
        """
        return self._disturbed(self._points, values, steps) if self._points else values

    def apply_to_commands(self, values: Floats, steps: Sequence[int]) -> Floats:
        """What reaches the building.

        Args:
            values: of actuators, shape (slots, actuators), NaN where nobody rules; they stay as they are.
            steps: of each slot, those of the sample that is answered.

        Returns:
            `values` itself if nothing is disturbed; NaN where nobody rules.
        """
        if not self._actuators:
            return values
        out = self._disturbed(self._actuators, values, steps)
        if out is values:
            return values
        return np.where(out != values, clipped(out, self._low, self._high), out)

    def _disturbed(self, effects: Iterable[Effect], values: Floats, steps: Sequence[int]) -> Floats:
        self._windows.move(steps)
        out = values
        for effect in effects:
            on = effect.on
            if on.any():
                if out is values:
                    out = values.copy()
                former = out[:, effect.columns]
                new = effect.disturb(former)
                out[:, effect.columns] = new if on.all() else np.where(on[:, None], new, former)
            elif effect.remembers:
                effect.disturb(out[:, effect.columns])
        return out

    def drain_transitions(self) -> list[FaultTransition]:
        """What began or ended since this was asked last."""
        return self._windows.drain_transitions()

    def on(self, slot: int = 0) -> tuple[str, ...]:
        """The names of the faults that are on in a slot."""
        return tuple(name for name, on in zip(self._windows.names, self._windows.on[:, slot], strict=True) if on)

    def state(self) -> list[State]:
        """Where each slot stands, to go on from there in any slot of any node with the same plan and points."""
        effects = (*self._points, *self._actuators)
        return [
            {
                "episode": self._episodes.keys[slot],
                "windows": self._windows.state(slot),
                "memory": [effect.memory[slot].tobytes() for effect in effects],
            }
            for slot in range(self._slots)
        ]

    def restore(self, states: Sequence[State], slots: Sequence[int] | None = None) -> None:
        """Goes back to where some slots (None: all) stood: the same faults and random numbers follow.

        Args:
            states: of `state`, one for each of the slots; a branch of one slot in several gives it several times.
            slots: which.
        """
        effects = (*self._points, *self._actuators)
        for slot, state in zip(range(self._slots) if slots is None else slots, states, strict=True):
            self._episodes.put(slot, state["episode"])
            self._windows.restore(slot, state["windows"])
            for effect, raw in zip(effects, state["memory"], strict=True):
                effect.memory[slot] = np.frombuffer(raw).reshape(effect.memory.shape[1:])


def _any_of(patterns: Iterable[str], name: str) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def check_points(
    plan: FaultPlan, points: Sequence[str], actuators: Sequence[Actuator], gathered: ErrorCollector
) -> None:
    """Gathers the names that are not there, and values that an actuator cannot have."""
    there = {"points": list(points), "actuators": [a.name for a in actuators]}
    for label, fault in zip(plan.names, plan.faults, strict=True):
        if not isinstance(fault, PointFault):
            continue
        for side, other in (("points", "actuators"), ("actuators", "points")):
            for pattern in getattr(fault, side):
                if not any(fnmatchcase(name, pattern) for name in there[side]):
                    what = {"points": "sensor or meter", "actuators": "actuator"}[side]
                    hint = f"name it under {other}" if pattern in there[other] else did_you_mean(pattern, there[side])
                    gathered.errors.append(InvalidConfig(f"fault {label!r}: no {what} {pattern!r}; {hint}"))
        if isinstance(fault, Stuck):
            for actuator in actuators:
                if _any_of(fault.actuators, actuator.name):
                    _check_bounds(label, fault.value, actuator, gathered)


def _check_bounds(label: str, value: float, actuator: Actuator, gathered: ErrorCollector) -> None:
    low = -np.inf if actuator.low is None else actuator.low
    high = np.inf if actuator.high is None else actuator.high
    if not low <= value <= high:
        bounds = " to ".join("unbounded" if b is None else f"{b:g}" for b in (actuator.low, actuator.high))
        stuck = with_unit(f"{value:g}", actuator.unit)
        text = f"fault {label!r}: {actuator.name} cannot be stuck at {stuck}; its bounds are {bounds}"
        gathered.errors.append(InvalidConfig(text))
