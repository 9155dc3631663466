"""The rule-based controller before it had optional rules, as a reference: its defaults must not change."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import comfort_bands, default_setback, inside
from zenostat.agent_sdk.controllers.plant import PlantRules
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.messages import Manifest


class FirstRules(Controller):
    """Margin, setback, and a fixed preconditioning time."""

    def __init__(
        self,
        manifest: Manifest,
        *,
        margin: float | None = None,
        setback: float | None = None,
        preconditioning: float = 1.0,
    ) -> None:
        super().__init__(manifest)
        self._band, self._margin_k = comfort_bands(manifest), margin
        self._setback_k = default_setback(manifest) if setback is None else setback
        self._preconditioning = timedelta(hours=preconditioning)
        self._bindings = tuple(b for b in bind_actions(manifest) if b.role is not Role.OTHER)
        self._step = manifest.timestep
        self._plant = PlantRules(margin)
        self._arrivals: dict[tuple[int, ...], datetime] = {}

    def begin(self, sample: SampleView) -> None:
        self._arrivals.clear()
        self._plant.begin()

    def act(self, sample: SampleView) -> Values:
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

    def _is_occupied(self, binding: ActionBinding, measured: Any, now: datetime) -> bool:
        if not binding.people:
            return True
        arrival = self._arrivals.get(binding.people)
        if measured[list(binding.people)].max() > 0.0:
            if arrival is None or arrival.date() != now.date():
                self._arrivals[binding.people] = now - self._step
            return True
        if arrival is None:
            return now.hour in range(6, 22)
        today = arrival.replace(year=now.year, month=now.month, day=now.day)
        for expected in (today, today + timedelta(days=1)):
            if expected.date() != arrival.date() and expected - self._preconditioning <= now < expected + self._step:
                return True
        return False
