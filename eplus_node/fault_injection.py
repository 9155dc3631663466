"""Faults on purpose, as a runner meets them: raw bytes in and out, and what is to be told of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bridge.faults import LinkFaults, PointFaults, Transition
from topics.errors import ErrorCollector
from topics.fault_plan import FaultPlan

if TYPE_CHECKING:
    from eplus_node.config import Plan

State = tuple[FaultPlan, list[Any], dict[str, Any]]
"""A plan, and where the faults of points and of the link stand."""

NO_FAULTS: State = (FaultPlan(), [], {})
"""What a snapshot of an undisturbed node goes back to."""


class FaultInjection:
    """The faults of one runner.

    Args:
        faults: what goes wrong.
        plan: what is simulated.
        slots: engines.

    Raises:
        InvalidConfig: unknown points, values out of bounds, windows without a sample; all of them.
    """

    def __init__(self, faults: FaultPlan, plan: Plan, slots: int) -> None:
        points, period = plan.points, plan.period
        self.plan = faults
        self._shape = (slots, len(points.sensors) + len(points.meters))
        self._commands = (slots, len(points.actuators))
        when = {"step_s": period.step_s, "begin": period.time(0), "end": period.time(period.steps)}
        names = [*(sensor.name for sensor in points.sensors), *(meter.name for meter in points.meters)]
        gathered = ErrorCollector()
        found = gathered.collect(lambda: PointFaults(faults, names, points.actuators, slots=slots, **when))  # type: ignore[arg-type]
        link = gathered.collect(lambda: LinkFaults(faults, **when))  # type: ignore[arg-type]
        gathered.raise_if_any()
        assert found is not None
        assert link is not None
        self._points, self.link = found, link

    def begin(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """New episodes in some slots."""
        self._points.reset(slots, seeds)
        if 0 in slots:
            self.link.reset(seeds[list(slots).index(0)])

    def apply_to_commands(self, values: bytes, steps: Sequence[int]) -> bytes:
        """What reaches the engines of what was commanded."""
        if not self._points.disturbs_actuators:
            return values
        return self._points.apply_to_commands(np.frombuffer(values).reshape(self._commands), steps).tobytes()

    def heard(self, values: bytes) -> None:
        """What reached the engines last, of faults that are set amid an episode: an actuator may go on with it."""
        self.apply_to_commands(
            values, [-1] * self._shape[0]
        )  # before an episode no fault is on; those that remember do so

    def apply_to_sensors(self, values: bytes, steps: Sequence[int]) -> bytes:
        """What goes on the bus of what EnergyPlus says."""
        self.link.move(steps[0])
        if not self._points.disturbs_points:
            return values
        return self._points.apply_to_sensors(np.frombuffer(values).reshape(self._shape), steps).tobytes()

    def drain_transitions(self) -> list[str]:
        """What began and ended since this was asked last."""
        return [
            f"{told.fault} {'begins' if told.turn is Transition.BEGAN else 'ends'}"
            + (f" in slot {told.slot}" if told.slot else "")
            for told in (*self._points.drain_transitions(), *self.link.drain_transitions())
        ]

    def on(self) -> list[str]:
        """The faults that are on in slot 0; those of the link with how many messages they hit."""
        return [
            *self._points.on(),
            *(f"{name} ({count} messages)" for name, count in self.link.counts.items() if count),
        ]

    def state(self) -> State:
        """Where they stand."""
        return self.plan, self._points.state(), self.link.state()

    def restore(self, state: State, slot: int | None = None) -> None:
        """Goes on from there; `slot`: all slots from that one."""
        _, points, link = state
        # The samples' flow has no name; the one at which they stood is said again.
        flows = {name: number - (not name) for name, number in link["flows"].items()}
        self._points.restore(points if slot is None else [points[slot]] * self._shape[0])
        self.link.restore(link | {"flows": flows})
