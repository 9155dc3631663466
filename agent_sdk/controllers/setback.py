"""Controller with a setpoint schedule."""

from __future__ import annotations

from datetime import datetime, timedelta

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import Band, comfort_bands, default_setback, inside
from zenostat.agent_sdk.controllers.fixed import DAYS, check_deadband, default_values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.calendar import parse_weekdays
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest
from zenostat.topics.points import contains, describe_bounds


class ScheduledSetback(Controller):
    """Use one pair of setpoints while the building is open, and another while it is closed.

    The building is open from `opens` (inclusive) to `closes` (exclusive) on `days`; if `closes` is before `opens`, it
    closes on the next day. Actions that are not setpoints are as in `FixedSetpoints`.

    Args:
        manifest: manifest of the node.
        opens: opening time, h, 0 to 24, local standard time.
        closes: closing time, h, 0 to 24.
        days: days on which it opens, such as `mon-fri` or `mon,wed,sat-sun`.
        heating: heating setpoint while open, degC; None: 1 K above the lower limit of the day's comfort band, but at
            most a third of the band.
        cooling: cooling setpoint while open, degC; None: as far below the upper limit.
        heating_setback: heating setpoint while closed, degC; None: below the lower limit of the band, or `heating`, by
            6 K if the task's reward counts comfort only in occupied zones (`OccupiedComfort`), else by 1 K; without
            any occupant count, as in a data center, as while open.
        cooling_setback: cooling setpoint while closed, degC; None: above, correspondingly.

    Raises:
        InvalidConfig: the task has no setpoints, a parameter is invalid or outside the bounds of all its actions, or
            heating is above cooling.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        opens: float = 6.0,
        closes: float = 22.0,
        days: str = "mon-sun",
        heating: float | None = None,
        cooling: float | None = None,
        heating_setback: float | None = None,
        cooling_setback: float | None = None,
    ) -> None:
        super().__init__(manifest)
        self._bindings = bind_actions(manifest)
        if not any(binding.role in SETPOINTS for binding in self._bindings):
            raise ControllerMismatch(
                f"setback needs an action that sets a heating or cooling setpoint; {_describe_actions(manifest)}"
            )
        self._opens, self._closes = (
            number(*x, minimum=0.0, maximum=24.0) for x in (("opens", opens), ("closes", closes))
        )
        if self._opens == self._closes:
            raise InvalidConfig(
                f"opens = closes = {self._opens:g}; expected two different hours (0 and 24: always open)"
            )
        self._days = parse_weekdays(days, "days")
        self._band = comfort_bands(manifest)
        has_counts = any(binding.people for binding in self._bindings)  # else zones may always be occupied
        self._setback_k = default_setback(manifest) if has_counts else 0.0
        self._open_setpoints = (self._check_setpoint("heating", heating), self._check_setpoint("cooling", cooling))
        self._closed_setpoints = (
            self._check_setpoint("heating_setback", heating_setback),
            self._check_setpoint("cooling_setback", cooling_setback),
        )
        for low, high, words in (
            (*self._open_setpoints, "heating, cooling"),
            (*self._closed_setpoints, "heating_setback, cooling_setback"),
        ):
            if low is not None and high is not None and low > high:
                raise InvalidConfig(f"{words} = {low:g}, {high:g}; the first has to be below the second")
        if any(value is not None for value in (*self._open_setpoints, *self._closed_setpoints)):
            for day in DAYS:
                for is_open in (True, False):
                    check_deadband(self._bindings, self._values(self._band(day), is_open=is_open))

    def _check_setpoint(self, name: str, value: float | None) -> float | None:
        if value is None:
            return None
        setpoint, role = number(name, value), Role.HEATING if name.startswith("heating") else Role.COOLING
        actions = [binding.action for binding in self._bindings if binding.role is role]
        if not any(contains(action, setpoint) for action in actions):
            reason = f"its bounds are {describe_bounds(actions[0])}" if actions else f"there is no {role}"
            raise InvalidConfig(f"{name} = {setpoint:g}; {reason}")
        return setpoint

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints for the timestep that begins at `sample.time`."""
        now = sample.time
        return self._values(self._band(now), is_open=self._is_open(now))

    def _values(self, band: Band, *, is_open: bool) -> Values:
        low, high = _replace(self._open_setpoints, inside(band))
        if not is_open:
            if self._setback_k > 0.0:
                limits = _replace(self._open_setpoints, band)
                low, high = limits[0] - self._setback_k, limits[1] + self._setback_k
            low, high = _replace(self._closed_setpoints, (low, high))
        values: Values = {}
        for binding in self._bindings:
            values |= default_values(binding, (low, high))
        return values

    def _is_open(self, now: datetime) -> bool:
        hour = now.hour + now.minute / 60
        if self._opens < self._closes:
            return now.weekday() in self._days and self._opens <= hour < self._closes
        if hour >= self._opens:
            return now.weekday() in self._days
        return hour < self._closes and (now - timedelta(days=1)).weekday() in self._days


def _replace(fixed: tuple[float | None, float | None], default: Band) -> Band:
    low, high = fixed
    return (default[0] if low is None else low, default[1] if high is None else high)


def _describe_actions(manifest: Manifest) -> str:
    names = ", ".join(repr(action.name) for action in manifest.task.actions[:5])
    return f"those of node {manifest.node!r} are {names}" if names else f"node {manifest.node!r} has no actions"
