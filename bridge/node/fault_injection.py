"""Fault injection in a node server: applies a fault plan to raw commands, raw sensor values and messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from zenostat.bridge.faults import LinkFaults, PointFaults, Transition
from zenostat.topics.errors import ErrorCollector
from zenostat.topics.fault_plan import FaultPlan

if TYPE_CHECKING:
    from zenostat.bridge.node.plant import PlantDescription
    from zenostat.topics.messages import Meter, Sensor

FaultState = tuple[FaultPlan, list[Any], dict[str, Any]]
"""A plan, and the states of its point faults and of its link faults."""

NO_FAULTS: FaultState = (FaultPlan(), [], {})
"""The state of a node without injected faults."""


class FaultInjection:
    """The injected faults of one server.

    Args:
        faults: what to inject.
        plant: what is simulated.
        slots: number of slots.

    Attributes:
        plan: the fault plan.
        link: faults of the link between node and controllers.

    Raises:
        InvalidConfig: lists all unknown points, values out of bounds and windows without a sample.
    """

    def __init__(self, faults: FaultPlan, plant: PlantDescription, slots: int) -> None:
        period = plant.run_period
        self.plan = faults
        self._sensor_shape = (slots, len(plant.sensors) + len(plant.meters))
        self._command_shape = (slots, len(plant.actuators))
        period_fields = {"step_s": period.step_s, "begin": period.begin, "end": period.end}
        points: list[Sensor | Meter] = [*plant.sensors, *plant.meters]
        names, unobserved = [p.name for p in points], {p.name for p in points if not p.observed}
        errors = ErrorCollector()
        point_faults = errors.collect(
            lambda: PointFaults(
                faults,
                names,
                plant.actuators,
                unobserved=unobserved,
                slots=slots,
                **period_fields,  # type: ignore[arg-type]
            )
        )
        link_faults = errors.collect(lambda: LinkFaults(faults, **period_fields))  # type: ignore[arg-type]
        errors.raise_if_any()
        assert point_faults is not None
        assert link_faults is not None
        self._points, self.link = point_faults, link_faults

    def begin(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """Begin new episodes in some slots."""
        self._points.reset(slots, seeds)
        if 0 in slots:
            self.link.reset(seeds[list(slots).index(0)])

    def adopt(self, previous: FaultInjection) -> None:
        """Go on with the faults that are equal to one of the previous plan, and with its random numbers if any are."""
        adopted = [self._points.adopt(previous._points), self.link.adopt(previous.link)]
        if any(adopted):
            self.set_episodes(previous.episodes)

    @property
    def episodes(self) -> list[list[int]]:
        """Keys of the random numbers of each slot's episode; see `EpisodeKeys`."""
        return [[*state["episode"]] for state in self._points.state()]

    def set_episodes(self, keys: Sequence[Sequence[int]]) -> None:
        """Set the keys of the random numbers, at the start of the episodes."""
        states = zip(self._points.state(), map(tuple, keys), strict=True)
        self._points.restore([state | {"episode": key} for state, key in states])
        self.link.restore(self.link.state() | {"episode": tuple(keys[0])})

    def apply_to_commands(self, values: bytes, steps: Sequence[int]) -> bytes:
        """Return the commands that reach the engines; raw float64."""
        if not self._points.disturbs_actuators:
            return values
        return self._points.apply_to_commands(np.frombuffer(values).reshape(self._command_shape), steps).tobytes()

    def remember_commands(self, values: bytes) -> None:
        """Record the latest commands when faults are set within an episode: a stuck actuator keeps them."""
        # No fault is active before step 0, so this only updates the faults that remember commands.
        self.apply_to_commands(values, [-1] * self._sensor_shape[0])

    def apply_to_sensors(self, values: bytes, steps: Sequence[int]) -> bytes:
        """Return the sensor and meter values to publish; raw float64."""
        self.link.move(steps[0])
        if not self._points.disturbs_points:
            return values
        return self._points.apply_to_sensors(np.frombuffer(values).reshape(self._sensor_shape), steps).tobytes()

    def drain_transitions(self) -> list[str]:
        """Return texts for the faults that began or ended since the last call."""
        return [
            f"{change.fault} {'begins' if change.turn is Transition.BEGAN else 'ends'}"
            + (f" in slot {change.slot}" if change.slot else "")
            for change in (*self._points.drain_transitions(), *self.link.drain_transitions())
        ]

    def active(self) -> list[str]:
        """Return the faults that are active in slot 0; those of the link with the number of affected messages."""
        return [
            *self._points.on(),
            *(f"{name} ({count} messages)" for name, count in self.link.counts.items() if count),
        ]

    def state(self) -> FaultState:
        """Return the state of all faults."""
        return self.plan, self._points.state(), self.link.state()

    def restore(self, state: FaultState, slot: int | None = None) -> None:
        """Restore the state of all slots; with `slot`, of all slots from that one."""
        _, points, link = state
        # The samples' flow has the empty name. The snapshot's sample is published again, so its number goes back by 1.
        flows = {name: number - (not name) for name, number in link["flows"].items()}
        self._points.restore(points if slot is None else [points[slot]] * self._sensor_shape[0])
        self.link.restore(link | {"flows": flows})
