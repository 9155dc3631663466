"""Rules on comfort bands, for any building whose zones have thermostats."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from agent_sdk.controllers.base import Controller, Values
from agent_sdk.rewards import LinearReward
from agent_sdk.sample import SampleView
from topics.errors import InvalidConfig
from topics.messages import Actuator, Manifest

THERMOSTAT = "zone temperature control"
OCCUPANTS = "zone people occupant count"

MARGIN_K = 0.3
SETBACK_K = 6.0
LEAD = timedelta(hours=1)
OPEN_HOURS = range(6, 22)


@dataclass(frozen=True, slots=True)
class _Zone:
    """A zone's thermostat and, where it is measured, its occupancy."""

    heating: Actuator | None
    cooling: Actuator | None
    occupants: str | None


class ComfortBandRules(Controller):
    """Keeps zones within the season's comfort band while they are in use, and sets them back else.

    In use, the setpoints are the ends of the band, 0.3 K inside; else they lie 6 K outside, as far as the
    actuators' bounds allow. A zone is in use while people are in it, or (where that is not measured) from 6 to 22
    o'clock; it is brought back an hour before the hour at which people came the day before.

    The bands are those of `LinearReward`: 20 to 23.5 degC, and 23 to 26 degC from 1 June to 30 September.
    """

    def __init__(self, manifest: Manifest) -> None:
        super().__init__(manifest)
        self._band = LinearReward().band
        self._zones = _zones(manifest)
        self._came: list[datetime | None] = [None] * len(self._zones)
        self._step = timedelta(hours=1 / manifest.steps_per_hour)

    def act(self, sample: SampleView) -> Values:
        """Setpoints for the timestep that begins at `sample.time`."""
        now = sample.time
        low, high = self._band(now)
        values: Values = {}
        for index, zone in enumerate(self._zones):
            shift = MARGIN_K if self._in_use(index, zone, sample, now) else -SETBACK_K
            if zone.heating:
                values[zone.heating.name] = _within(zone.heating, low + shift)
            if zone.cooling:
                values[zone.cooling.name] = _within(zone.cooling, high - shift)
        return values

    def _in_use(self, index: int, zone: _Zone, sample: SampleView, now: datetime) -> bool:
        if zone.occupants is None:
            return now.hour in OPEN_HOURS
        if sample[zone.occupants] > 0.0:
            came = self._came[index]
            if came is None or came.date() != now.date():
                self._came[index] = now - self._step
            return True
        came = self._came[index]
        if came is None:
            return now.hour in OPEN_HOURS  # nobody has been seen yet: comfort first
        back = came.replace(year=now.year, month=now.month, day=now.day)
        return back - LEAD <= now < back + self._step and now.date() != came.date()


def _within(actuator: Actuator, value: float) -> float:
    low = value if actuator.low is None else max(value, actuator.low)
    return low if actuator.high is None else min(low, actuator.high)


def _zones(manifest: Manifest) -> list[_Zone]:
    occupants = {s.key.casefold(): s.name for s in manifest.sensors if s.variable.casefold() == OCCUPANTS}
    pairs: dict[str, dict[str, Actuator]] = {}
    for actuator in manifest.actuators:
        if actuator.component_type.casefold() == THERMOSTAT:
            pairs.setdefault(actuator.key.casefold(), {})[actuator.control_type.casefold()] = actuator
    if not pairs:
        raise InvalidConfig(
            f"the rule-based controller needs thermostat setpoints ('Zone Temperature Control'); node "
            f"{manifest.node!r} has none among its actuators"
        )
    return [
        _Zone(pair.get("heating setpoint"), pair.get("cooling setpoint"), occupants.get(key))
        for key, pair in pairs.items()
    ]
