"""Point faults: affected values of sensors and meters on the bus, and of commands to the building.

The fault-free values are not changed: faults apply to a copy, which is only made while a fault is active.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import datetime
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np

from zenostat.bridge.faults.effects import ACTUATOR_EFFECTS, SENSOR_EFFECTS, Effect, clipped
from zenostat.bridge.faults.random_streams import EpisodeKeys, RandomStream
from zenostat.bridge.faults.schedule import FaultSchedule, FaultTransition, StepGrid
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import ErrorCollector, InvalidConfig, did_you_mean
from zenostat.topics.fault_plan import FaultPlan, PointFault, Stuck
from zenostat.topics.messages import Actuator
from zenostat.topics.points import LARGEST, bound_arrays, contains, describe_bounds

State = dict[str, Any]
"""State of the faults in one slot, as data that can be pickled."""


class PointFaults:
    """The point faults of a node. Without any, nothing is drawn or copied.

    Args:
        plan: the fault plan.
        points: names of the sensors, then the meters, in the manifest's order.
        actuators: in the manifest's order; affected commands stay within their bounds.
        slots: number of engines in the node.
        step_s: length of a timestep in seconds.
        unobserved: names among `points` that no wildcard matches: points added for pictures do not change a plan.
        begin: simulated time of sample 0.
        end: simulated time of the last sample; if it is given, faults that could only be active after it are errors.

    Raises:
        InvalidConfig: unknown points, values out of bounds, faults that are active at no sample; the text lists all.
    """

    def __init__(
        self,
        plan: FaultPlan,
        points: Sequence[str],
        actuators: Sequence[Actuator],
        *,
        unobserved: Collection[str] = (),
        slots: int = 1,
        step_s: float,
        begin: datetime,
        end: datetime | None = None,
    ) -> None:
        self.plan = plan
        self._slots = slots
        self._episodes = EpisodeKeys(slots)
        errors = ErrorCollector()
        check_points(plan, points, actuators, errors, unobserved)
        schedule = errors.collect(lambda: FaultSchedule(plan, PointFault, StepGrid(step_s, begin, end), self._episodes))
        errors.raise_if_any()
        assert schedule is not None
        self._schedule = schedule
        self._points = self._effects(SENSOR_EFFECTS, "points", points, step_s, unobserved)
        self._actuators = self._effects(ACTUATOR_EFFECTS, "actuators", [a.name for a in actuators], step_s)
        self._low, self._high = bound_arrays(actuators)

    def _effects(
        self,
        kinds: Mapping[type[PointFault], type[Effect]],
        side: str,
        names: Sequence[str],
        step_s: float,
        unobserved: Collection[str] = (),
    ) -> list[Effect]:
        effects = []
        for row, fault in enumerate(self._schedule.faults):
            patterns = getattr(fault, side)
            columns = np.array([c for c, name in enumerate(names) if _any_of(patterns, name, unobserved)], np.intp)
            if len(columns):
                key = (*self._schedule.keys[row], int(side == "actuators"))
                new_stream = partial(RandomStream, self.plan.seed, key, width=len(columns), episodes=self._episodes)
                effects.append(kinds[type(fault)](row, columns, self._schedule, step_s / 3600.0, new_stream))
        return effects

    @property
    def disturbs_points(self) -> bool:
        """Whether any fault affects sensors or meters."""
        return bool(self._points)

    @property
    def disturbs_actuators(self) -> bool:
        """Whether any fault affects actuators."""
        return bool(self._actuators)

    def reset(self, slots: Sequence[int] | None = None, seeds: Sequence[int | None] | None = None) -> None:
        """Begin new episodes in some slots.

        Args:
            slots: the slots; None for all.
            seeds: a seed for each of them. Equal seeds give equal sequences of episodes, in any slot; None continues
                with the next episode of the previous seed.
        """
        selected = range(self._slots) if slots is None else slots
        self._schedule.reset(selected)
        self._episodes.advance(selected, seeds if seeds is not None else [None] * len(selected))
        for effect in (*self._points, *self._actuators):
            effect.memory[list(selected)] = np.nan

    def apply_to_sensors(self, values: Floats, steps: Sequence[int]) -> Floats:
        """Apply the faults to the values of a sample.

        Args:
            values: of sensors and meters, of shape (slots, points); they are not changed.
            steps: the sample's step in each slot.

        Returns:
            `values` itself if no fault is active; NaN where a point has no value.
        """
        return self._disturbed(self._points, values, steps) if self._points else values

    def apply_to_commands(self, values: Floats, steps: Sequence[int]) -> Floats:
        """Apply the faults to commanded values.

        Args:
            values: of actuators, of shape (slots, actuators), NaN under baseline control; they are not changed.
            steps: the step of the answered sample in each slot.

        Returns:
            `values` itself if no fault is active; NaN under baseline control.
        """
        if not self._actuators:
            return values
        out = self._disturbed(self._actuators, values, steps)
        if out is values:
            return values
        return np.where(out != values, clipped(out, self._low, self._high), out)

    def _disturbed(self, effects: Iterable[Effect], values: Floats, steps: Sequence[int]) -> Floats:
        self._schedule.move(steps)
        out = values
        for effect in effects:
            on = effect.on
            if on.any():
                if out is values:
                    out = values.copy()
                old = out[:, effect.columns]
                with np.errstate(over="ignore", invalid="ignore"):
                    new = effect.disturb(old)
                if not effect.memory.size:  # it has computed the values, and a sensor measures no infinity
                    new = np.where(np.isinf(new) & np.isfinite(old), np.copysign(LARGEST, new), new)
                out[:, effect.columns] = new if on.all() else np.where(on[:, None], new, old)
            elif effect.is_stateful:
                effect.disturb(out[:, effect.columns])
        return out

    def drain_transitions(self) -> list[FaultTransition]:
        """Return the faults that became active or inactive since the last call."""
        return self._schedule.drain_transitions()

    def on(self, slot: int = 0) -> tuple[str, ...]:
        """Return the names of the faults that are active in a slot."""
        return tuple(name for name, on in zip(self._schedule.names, self._schedule.on[:, slot], strict=True) if on)

    def adopt(self, other: PointFaults) -> bool:
        """Take over the state of the faults that are equal to one of another plan; return whether there are any."""
        rows = self._schedule.adopt(other._schedule)
        for own, theirs in ((self._points, other._points), (self._actuators, other._actuators)):
            by_row = {effect.row: effect for effect in theirs}
            for effect in own:
                if effect.row in rows:
                    effect.memory = by_row[rows[effect.row]].memory.copy()
        return bool(rows)

    def state(self) -> list[State]:
        """Return the state of each slot, for any slot of any node with the same plan and points."""
        effects = (*self._points, *self._actuators)
        return [
            {
                "episode": self._episodes.keys[slot],
                "windows": self._schedule.state(slot),
                "memory": [effect.memory[slot].tobytes() for effect in effects],
            }
            for slot in range(self._slots)
        ]

    def restore(self, states: Sequence[State], slots: Sequence[int] | None = None) -> None:
        """Restore the states of some slots; the same faults and random numbers follow.

        Args:
            states: results of `state`, one for each slot; a branch with several slots repeats the state of one.
            slots: the slots; None for all.
        """
        effects = (*self._points, *self._actuators)
        for slot, state in zip(range(self._slots) if slots is None else slots, states, strict=True):
            self._episodes.put(slot, state["episode"])
            self._schedule.restore(slot, state["windows"])
            for effect, raw in zip(effects, state["memory"], strict=True):
                effect.memory[slot] = np.frombuffer(raw).reshape(effect.memory.shape[1:])


def _any_of(patterns: Iterable[str], name: str, unobserved: Collection[str] = ()) -> bool:
    if name in unobserved:
        return name in patterns
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def check_points(
    plan: FaultPlan,
    points: Sequence[str],
    actuators: Sequence[Actuator],
    errors: ErrorCollector,
    unobserved: Collection[str] = (),
) -> None:
    """Collect unknown names and values outside an actuator's bounds."""
    names = {"points": list(points), "actuators": [a.name for a in actuators]}
    for label, fault in zip(plan.names, plan.faults, strict=True):
        if not isinstance(fault, PointFault):
            continue
        for side, opposite in (("points", "actuators"), ("actuators", "points")):
            for pattern in getattr(fault, side):
                if not any(_any_of([pattern], name, unobserved) for name in names[side]):
                    kind = {"points": "sensor or meter", "actuators": "actuator"}[side]
                    is_opposite = pattern in names[opposite]
                    hint = f"name it under {opposite}" if is_opposite else did_you_mean(pattern, names[side])
                    errors.errors.append(InvalidConfig(f"fault {label!r}: no {kind} {pattern!r}; {hint}"))
        if isinstance(fault, Stuck):
            for actuator in actuators:
                if _any_of(fault.actuators, actuator.name) and not contains(actuator, fault.value):
                    text = f"{actuator.name} cannot be stuck at {fault.value:g}"
                    limits = describe_bounds(actuator)
                    errors.errors.append(InvalidConfig(f"fault {label!r}: {text}; its bounds are {limits}"))
