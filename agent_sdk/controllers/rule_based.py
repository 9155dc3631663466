"""Rule-based controller that keeps comfort bands, for any building."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import comfort_bands, default_setback, inside
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.agent_sdk.controllers.plant import PlantRules
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.messages import Manifest

OPEN_HOURS = range(6, 22)


class RuleBasedController(Controller):
    """Keep zones within the day's comfort band while they are occupied, and set them back otherwise.

    While the zones of an action are occupied, its setpoint is `margin` inside the limit of the band; otherwise it is
    `setback` outside, within the action's bounds. Zones are occupied while there are people in any of them. Zones
    without an occupant count follow all other zones; if no zone has one, all are always occupied. Preconditioning
    starts `preconditioning` hours before the time of the first arrival on the day before; until the first arrival is
    observed, zones count as occupied from 6 to 22 o'clock.

    `PlantRules` controls water temperatures, availabilities and storage. Other actions are not commanded.

    Args:
        manifest: manifest of the node.
        low: lower limit of the comfort band, degC; None: that of the task's reward, or of `LinearReward`.
        high: upper limit, degC.
        margin: margin, K, since zones overshoot their setpoints; None: 1, but at most a third of the band.
        setback: setback, K; None: 6 if the task's reward counts comfort only in occupied zones (`OccupiedComfort`),
            else 1.
        preconditioning: preconditioning time, h, 0 to 23.

    Raises:
        InvalidConfig: the task has no action that these rules support, or a parameter is invalid.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        low: float | None = None,
        high: float | None = None,
        margin: float | None = None,
        setback: float | None = None,
        preconditioning: float = 1.0,
    ) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest, low, high)
        self._margin_k = None if margin is None else number("margin", margin, minimum=0.0)
        self._setback_k = default_setback(manifest) if setback is None else number("setback", setback, minimum=0.0)
        self._preconditioning = timedelta(hours=number("preconditioning", preconditioning, minimum=0.0, maximum=23.0))
        self._bindings = tuple(b for b in bind_actions(manifest) if b.role is not Role.OTHER)
        if not self._bindings:
            raise ControllerMismatch(
                f"the rule-based controller needs an action that sets a heating or cooling setpoint, a water "
                f"temperature, an availability or a storage; node {manifest.node!r} has none"
            )
        self._step = manifest.timestep
        self._plant = PlantRules(self._margin_k)
        self._arrivals: dict[tuple[int, ...], datetime] = {}

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the arrival times, and the state of the availabilities."""
        self._arrivals.clear()
        self._plant.begin()

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints and plant values for the timestep that begins at `sample.time`."""
        now, measured = sample.time, sample.values
        band = self._band(now)
        occupied = inside(band, self._margin_k)
        unoccupied = (band[0] - self._setback_k, band[1] + self._setback_k)
        values: Values = {}
        for binding in self._bindings:
            if binding.role in SETPOINTS:
                low, high = occupied if self._is_occupied(binding, measured, now) else unoccupied
                values |= binding.at(low if binding.role is Role.HEATING else high)
            else:
                values |= self._plant.act(binding, measured, band)
        return values

    def _is_occupied(self, binding: ActionBinding, measured: NDArray[np.float64], now: datetime) -> bool:
        if not binding.people:
            return True
        arrival = self._arrivals.get(binding.people)
        if measured[list(binding.people)].max() > 0.0:
            if arrival is None or arrival.date() != now.date():
                self._arrivals[binding.people] = now - self._step
            return True
        if arrival is None:
            return now.hour in OPEN_HOURS  # no arrival observed yet: comfort first
        today = arrival.replace(year=now.year, month=now.month, day=now.day)
        for expected in (today, today + timedelta(days=1)):  # preconditioning may start before midnight
            if expected.date() != arrival.date() and expected - self._preconditioning <= now < expected + self._step:
                return True
        return False
