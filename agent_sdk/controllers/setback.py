"""Setpoints by the clock."""

from __future__ import annotations

from datetime import datetime, timedelta

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import SETPOINTS, Role, bind_actions
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.comfort_band import Band, comfort_bands, default_setback, inside
from agent_sdk.controllers.fixed import DAYS, check_deadband, default
from agent_sdk.controllers.parameters import ControllerMismatch, bounds, number
from topics.errors import InvalidConfig
from topics.messages import Manifest

_DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


class ScheduledSetback(Controller):
    """Setpoints while the building is open, and others while it is closed.

    The building is open from `opens` (included) to `closes` (not included) on `days`; if it closes before it opens,
    on the day after. What is no setpoint is as in `FixedSetpoints`.

    Args:
        manifest: of the node.
        opens: h, 0 to 24, local standard time.
        closes: h, 0 to 24.
        days: `mon-fri`, or `mon,wed,sat-sun`.
        heating: heating setpoint while open, degC; None: 1 K above the lower end of the day's comfort
            band, and a third of a band that is narrower than 3 K.
        cooling: cooling setpoint while open; None: as far below the upper end.
        heating_setback: heating setpoint while closed; None: below the band's lower end or `heating`, by 6 K where
            the task's reward counts comfort only while people are there (`OccupiedReward`), else by 1 K; where people
            are not measured, as in a data center, the same as while open.
        cooling_setback: cooling setpoint while closed; None: likewise above.

    Raises:
        InvalidConfig: no setpoints in the task, a parameter that cannot be or that leaves the bounds of all actions
            that it is for, or heating above cooling.
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
        self._parts = bind_actions(manifest)
        if not any(part.role in SETPOINTS for part in self._parts):
            raise ControllerMismatch(
                f"setback needs an action that sets a heating or cooling setpoint; {_no(manifest)}"
            )
        self._opens, self._closes = (number(*x, least=0.0, most=24.0) for x in (("opens", opens), ("closes", closes)))
        if self._opens == self._closes:
            raise InvalidConfig(f"opens = closes = {self._opens:g}; two different hours expected (0 and 24 for always)")
        self._days = weekdays(days)
        self._band = comfort_bands(manifest)
        counted = any(part.people for part in self._parts)  # else nobody says that a zone is ever empty
        self._setback_k = default_setback(manifest) if counted else 0.0
        self._open = (self._checked("heating", heating), self._checked("cooling", cooling))
        self._closed = (
            self._checked("heating_setback", heating_setback),
            self._checked("cooling_setback", cooling_setback),
        )
        for low, high, words in (
            (*self._open, "heating, cooling"),
            (*self._closed, "heating_setback, cooling_setback"),
        ):
            if low is not None and high is not None and low > high:
                raise InvalidConfig(f"{words} = {low:g}, {high:g}; the first has to be below the second")
        if any(value is not None for value in (*self._open, *self._closed)):
            for day in DAYS:
                for is_open in (True, False):
                    check_deadband(self._parts, self._on(self._band(day), is_open=is_open))

    def _checked(self, what: str, value: float | None) -> float | None:
        if value is None:
            return None
        found, role = number(what, value), Role.HEATING if what.startswith("heating") else Role.COOLING
        ranges = [bounds(part.action) for part in self._parts if part.role is role]
        if not any(low <= found <= high for low, high in ranges):
            said = f"its bounds are {ranges[0][0]:g} to {ranges[0][1]:g}" if ranges else f"there is no {role}"
            raise InvalidConfig(f"{what} = {found:g}; {said}")
        return found

    def act(self, sample: SampleView) -> Values:
        """The setpoints of the timestep that begins at `sample.time`."""
        now = sample.time
        return self._on(self._band(now), is_open=self._is_open(now))

    def _on(self, band: Band, *, is_open: bool) -> Values:
        low, high = _given(self._open, inside(band))
        if not is_open:
            if self._setback_k > 0.0:
                ends = _given(self._open, band)
                low, high = ends[0] - self._setback_k, ends[1] + self._setback_k
            low, high = _given(self._closed, (low, high))
        values: Values = {}
        for part in self._parts:
            values |= default(part, (low, high))
        return values

    def _is_open(self, now: datetime) -> bool:
        hour = now.hour + now.minute / 60
        if self._opens < self._closes:
            return now.weekday() in self._days and self._opens <= hour < self._closes
        if hour >= self._opens:
            return now.weekday() in self._days
        return hour < self._closes and (now - timedelta(days=1)).weekday() in self._days


def _given(own: tuple[float | None, float | None], default: Band) -> Band:
    low, high = own
    return (default[0] if low is None else low, default[1] if high is None else high)


def _no(manifest: Manifest) -> str:
    names = ", ".join(repr(action.name) for action in manifest.task.actions[:5])
    return f"those of node {manifest.node!r} are {names}" if names else f"node {manifest.node!r} has no actions"


def weekdays(text: str) -> frozenset[int]:
    """`mon-fri` or `mon,wed,sat-sun` as numbers from 0 (Monday).

    Raises:
        InvalidConfig: other words than those.
    """
    found: set[int] = set()
    for part in str(text).casefold().replace(" ", "").split(","):
        first, dash, last = part.partition("-")
        if first not in _DAYS or (dash and last not in _DAYS):
            raise InvalidConfig(f"days = {text!r}; weekdays expected, as 'mon-fri' or 'mon,wed,sat-sun'")
        begin, end = _DAYS.index(first), _DAYS.index(last or first)
        found |= {day % 7 for day in range(begin, end + 1 if end >= begin else end + 8)}
    return frozenset(found)
