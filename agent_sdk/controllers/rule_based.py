"""Rules on comfort bands, for any building."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.comfort_band import comfort_bands, default_setback, inside
from agent_sdk.controllers.parameters import ControllerMismatch, number
from agent_sdk.controllers.plant import PlantRules
from topics.messages import Manifest

OPEN_HOURS = range(6, 22)


class RuleBasedController(Controller):
    """Keeps zones within the day's comfort band while they are in use, and sets them back else.

    In use, the setpoints are the ends of the band, `margin` inside; else they lie `setback` outside, as far as the
    actions' bounds allow. Zones are in use while people are in one of them; those whose people are not measured
    follow the other zones; where nobody's are, all are always in use. Zones are brought back `lead` before the hour
    at which people came the day before; until people were seen the first time, from 6 to 22 o'clock.

    Water temperatures, availabilities and storage: see `PlantRules`. Actions that are nothing of that stay as they
    are.

    Args:
        manifest: of the node.
        low: lower end of the comfort band, degC; None: that of the task's reward, or of `LinearReward`.
        high: its upper end.
        margin: K; None: 1, and a third of a band that is narrower than 3 K, so that zones which overshoot their
            setpoints stay within the band.
        setback: K; None: 6 where the task's reward counts comfort only while people are there (`OccupiedReward`),
            else 1.
        lead: h, 0 to 23.

    Raises:
        InvalidConfig: nothing in the task that these rules know, or a parameter that cannot be.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        low: float | None = None,
        high: float | None = None,
        margin: float | None = None,
        setback: float | None = None,
        lead: float = 1.0,
    ) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest, low, high)
        self._margin_k = None if margin is None else number("margin", margin, least=0.0)
        self._setback_k = default_setback(manifest) if setback is None else number("setback", setback, least=0.0)
        self._lead = timedelta(hours=number("lead", lead, least=0.0, most=23.0))
        self._parts = tuple(p for p in bind_actions(manifest) if p.role is not Role.OTHER)
        if not self._parts:
            raise ControllerMismatch(
                f"the rule-based controller needs an action that sets a heating or cooling setpoint, a water "
                f"temperature, an availability or a storage; node {manifest.node!r} has none"
            )
        self._step = timedelta(hours=1 / manifest.steps_per_hour)
        self._plant = PlantRules(self._margin_k)
        self._came: dict[tuple[int, ...], datetime] = {}

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Forgets when people came, and which switches are on."""
        self._came.clear()
        self._plant.begin()

    def act(self, sample: SampleView) -> Values:
        """Values for the timestep that begins at `sample.time`."""
        now, measured = sample.time, sample.values
        band = self._band(now)
        in_use, empty = inside(band, self._margin_k), (band[0] - self._setback_k, band[1] + self._setback_k)
        values: Values = {}
        for part in self._parts:
            if part.role in SETPOINTS:
                low, high = in_use if self._in_use(part, measured, now) else empty
                values |= part.at(low if part.role is Role.HEATING else high)
            else:
                values |= self._plant.act(part, measured, band)
        return values

    def _in_use(self, part: ActionBinding, measured: NDArray[np.float64], now: datetime) -> bool:
        if not part.people:
            return True
        came = self._came.get(part.people)
        if measured[list(part.people)].max() > 0.0:
            if came is None or came.date() != now.date():
                self._came[part.people] = now - self._step
            return True
        if came is None:
            return now.hour in OPEN_HOURS  # nobody has been seen yet: comfort first
        today = came.replace(year=now.year, month=now.month, day=now.day)
        for back in (today, today + timedelta(days=1)):  # whoever comes soon after midnight is awaited the day before
            if back.date() != came.date() and back - self._lead <= now < back + self._step:
                return True
        return False
