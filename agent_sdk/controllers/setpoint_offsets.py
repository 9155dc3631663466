"""Rule-based controller that shifts the building's own setpoints."""

from __future__ import annotations

from datetime import datetime, timedelta

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions, setpoint_pairs
from zenostat.agent_sdk.controllers.agent import at_offset
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import apart
from zenostat.agent_sdk.controllers.occupancy_times import OccupancyTimes
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.agent_sdk.controllers.price_peaks import PriceShifts
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Action, Manifest
from zenostat.topics.points import bounds

Offsets = tuple[float, float]
"""Offset of heating setpoints and of cooling setpoints, K."""


class SetpointOffsets(Controller):
    """Shift the setpoints of the building's own control, which keeps its schedules, and by default changes nothing.

    Zones are occupied while there are people in any of them, and from `lead` hours before the time of the first arrival
    on the day before; until the first arrival is observed, they count as occupied from 6 to 22 o'clock. Before hours of
    high prices occupied zones are cooled or heated further, and during these hours setpoints are relaxed; see
    `PriceShifts`. Where bounds do not keep a heating setpoint below the cooling setpoint, and its offset is above the
    other's, both have the mean of their offsets, so they stay as far apart as the building keeps them.

    It suits buildings whose thermostats have schedules of their own, such as a heated office in an unheated hall: one
    setpoint for all cannot express these, one offset can.

    Args:
        manifest: manifest of the node, whose actions are relative to the building's own control (`relative`).
        heating_occupied: offset of heating setpoints of occupied zones, K.
        cooling_occupied: offset of cooling setpoints of occupied zones, K.
        heating_empty: offset of heating setpoints of empty zones, K; negative: a deeper setback.
        cooling_empty: offset of cooling setpoints of empty zones, K; positive: a deeper setback.
        lead: time before an expected arrival in which zones count as occupied, h, 0 to 23.
        occupancy_threshold: share of the largest number of people in the zones so far, 0 to 1, above which they count
            as occupied; 0: anybody occupies them, 1: nobody does.
        precooling: lowering of cooling setpoints before hours of high prices, K, at least 0.
        preheating: raise of heating setpoints before these hours, K, at least 0.
        price_lead: time before these hours, h, 0 to 12.
        shed_cooling: raise of cooling setpoints during these hours, K, at least 0.
        shed_heating: lowering of heating setpoints during these hours, K, at least 0.

    Raises:
        InvalidConfig: no action is an offset to a setpoint, a parameter is invalid, or the node lacks a price.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        heating_occupied: float = 0.0,
        cooling_occupied: float = 0.0,
        heating_empty: float = 0.0,
        cooling_empty: float = 0.0,
        lead: float = 1.0,
        occupancy_threshold: float = 0.0,
        precooling: float = 0.0,
        preheating: float = 0.0,
        price_lead: float = 2.0,
        shed_cooling: float = 0.0,
        shed_heating: float = 0.0,
    ) -> None:
        super().__init__(manifest)
        actions = zip(bind_actions(manifest), manifest.task.actions, strict=True)
        self._bindings = [(b, action) for b, action in actions if action.relative and b.role in SETPOINTS]
        if not self._bindings:
            raise ControllerMismatch(
                f"offsets shifts the building's own setpoints, but no action of node {manifest.node!r} is an offset to "
                "a heating or cooling setpoint: set relative: 3 in the scenario"
            )
        self._can_cross = bool(setpoint_pairs(manifest))
        self._occupied = number("heating_occupied", heating_occupied), number("cooling_occupied", cooling_occupied)
        self._empty = number("heating_empty", heating_empty), number("cooling_empty", cooling_empty)
        self._lead = timedelta(hours=number("lead", lead, minimum=0.0, maximum=23.0))
        threshold = number("occupancy_threshold", occupancy_threshold, minimum=0.0, maximum=1.0)
        self._occupancy = OccupancyTimes(manifest.timestep, threshold)
        self._shifts = PriceShifts(
            manifest,
            precooling=precooling,
            preheating=preheating,
            price_lead=price_lead,
            shed_cooling=shed_cooling,
            shed_heating=shed_heating,
        )

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the arrival times."""
        self._occupancy.begin()

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints for the timestep that begins at `sample.time`; None where the building's own apply."""
        now, measured = sample.time, sample.values
        heating, cooling = self._shifts.at(now)
        occupied = self._apart((self._occupied[0] + heating, self._occupied[1] + cooling))
        empty = self._apart(self._empty)
        values: Values = {}
        for binding, action in self._bindings:
            offsets = occupied if self._is_occupied(binding, measured, now) else empty
            values |= at_offset(action, _clip(action, offsets[binding.role is Role.COOLING]), sample)
        return values

    def _is_occupied(self, binding: ActionBinding, measured: Floats, now: datetime) -> bool:
        return self._occupancy.is_occupied(binding.people, measured, now, lambda arrival: arrival - self._lead <= now)

    def _apart(self, offsets: Offsets) -> Offsets:
        return apart(offsets) if self._can_cross else offsets


def _clip(action: Action, offset: float) -> float:
    low, high = bounds(action)
    return min(max(offset, low), high)
