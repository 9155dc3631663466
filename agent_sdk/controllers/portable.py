"""Controllers that ask the semantic model of a building for what they need, and so run on any building unchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import isnan

from zenostat.agent_sdk.controllers.base import Controller, Finder, Values
from zenostat.agent_sdk.controllers.demand_limiting import DemandLimiter
from zenostat.agent_sdk.controllers.occupancy_times import OccupancyTimes
from zenostat.agent_sdk.controllers.optimum_start import OptimumStart
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.messages import Manifest
from zenostat.topics.points import actuator_index, bounds, value_index

_SETPOINTS = {"heating": "heating_setpoints", "cooling": "cooling_setpoints"}


@dataclass(slots=True)
class _Setpoint:
    """A setpoint of one zone.

    Attributes:
        name, index: of the actuator.
        sign: direction in which it relaxes: -1 for heating, 1 for cooling.
        own: the building's own value, last seen while nobody commanded it; NaN if unknown.
        occupied: the most demanding of these while people were present; NaN if unknown.
    """

    name: str
    index: int
    sign: int
    low: float
    high: float
    own: float = float("nan")
    occupied: float = float("nan")

    def relaxed(self, value: float, amount_k: float) -> float:
        """Return a value relaxed by an amount, within the actuator's bounds."""
        return min(max(value + self.sign * amount_k, self.low), self.high)

    def observe(self, sample: SampleView, sources: Mapping[str, str], *, is_present: bool) -> None:
        """Learn the building's own value, if it was in effect in the latest timestep."""
        value = float(sample.effective[self.index])
        if isnan(value) or sources.get(self.name):
            return
        self.own = value
        if is_present and (isnan(self.occupied) or (value - self.occupied) * self.sign < 0.0):
            self.occupied = value


class _Portable(Controller):
    """Base of the controllers: the setpoints of the zones.

    Attributes:
        lacks: what the building lacks of that which the controller asks for, after `use_model`.
    """

    def __init__(self, manifest: Manifest) -> None:
        super().__init__(manifest)
        self.lacks: list[str] = []
        self._zones: dict[str, list[_Setpoint]] = {}

    def use_model(self, model: Finder) -> None:
        """Find the setpoints of the zones.

        Raises:
            ControllerMismatch: the building has none.
        """
        indices = actuator_index(self.manifest)
        for role, pattern in _SETPOINTS.items():
            points = model.find(pattern)
            for point in points:
                actuator = self.manifest.actuators[indices[point.name]]
                setpoint = _Setpoint(point.name, indices[point.name], -1 if role == "heating" else 1, *bounds(actuator))
                self._zones.setdefault(point.place, []).append(setpoint)
            self.lacks += [] if points else [f"{role} setpoints"]
        if not self._zones:
            raise ControllerMismatch(f"the building of node {self.manifest.node!r} has no zone with a setpoint")

    def _sensors(self, model: Finder, pattern: str, what: str) -> dict[str, int]:
        """Return the index of a sensor of each zone, and note in how many zones it is missing."""
        indices = value_index(self.manifest)
        sensors = {point.place: indices[point.name] for point in model.find(pattern)}
        missing = len(self._zones.keys() - sensors.keys())
        if missing:
            self.lacks.append(f"{what} in {missing} of {len(self._zones)} zones")
        return sensors

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Forget what was learned."""
        for setpoint in (each for setpoints in self._zones.values() for each in setpoints):
            setpoint.own = setpoint.occupied = float("nan")


class PortableSetback(_Portable):
    """Set zones back while nobody is in them, and leave the setback by an optimum start.

    Asks the semantic model for zones with setpoints, occupant counts and air temperatures. While people are present the
    building's own control applies; its most demanding setpoint of these times is what the zone returns to. So the first
    day is the building's own. Zones without an occupant count stay with the building's own control.

    Args:
        manifest: manifest of the node.
        setback: distance of the setpoints of empty zones from the occupied ones, K.
        start_rate: rate at which zones recover from the setback, K/h; see `OptimumStart`.
        start_longest: greatest time before people are expected, h, 0 to 23.
        start_learning: weight of each day's measured rate, 0 to 1.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        setback: float = 5.0,
        start_rate: float = 2.0,
        start_longest: float = 3.0,
        start_learning: float = 0.3,
    ) -> None:
        super().__init__(manifest)
        self._setback_k = number("setback", setback, minimum=0.0)
        self._start = OptimumStart(
            number("start_rate", start_rate, minimum=0.01),
            longest=timedelta(hours=number("start_longest", start_longest, minimum=0.0, maximum=23.0)),
            learning=number("start_learning", start_learning, minimum=0.0, maximum=1.0),
        )
        self._occupancy = OccupancyTimes(manifest.timestep)
        self._people: Mapping[str, int] = {}
        self._temperatures: Mapping[str, int] = {}

    def use_model(self, model: Finder) -> None:
        """Find setpoints, occupant counts and temperatures of the zones."""
        super().use_model(model)
        self._people = self._sensors(model, "occupants", "occupant count")
        self._temperatures = self._sensors(model, "zone_temperatures", "air temperature")

    def begin(self, sample: SampleView) -> None:
        """Forget what was learned."""
        super().begin(sample)
        self._occupancy.begin()
        self._start.begin()

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints of all zones; None where the building's own control applies."""
        values: Values = {}
        sources = sample.value_source
        for zone, setpoints in self._zones.items():
            people = self._people.get(zone)
            is_present = people is not None and self._occupancy.is_present((people,), sample.values, sample.time)
            for setpoint in setpoints:
                setpoint.observe(sample, sources, is_present=is_present)
                is_own = people is None or is_present or isnan(setpoint.occupied)
                values[setpoint.name] = None if is_own else self._value(zone, people or 0, setpoint, sample)
        return values

    def _value(self, zone: str, people: int, setpoint: _Setpoint, sample: SampleView) -> float:
        """Return the setpoint of an empty zone."""
        temperature = self._temperatures.get(zone)
        distance_k = self.manifest.step_h
        if temperature is not None:
            distance_k = (float(sample.values[temperature]) - setpoint.occupied) * setpoint.sign
        self._start.observe(setpoint.name, distance_k, sample.time)
        for expected in self._occupancy.expected((people,), sample.time):
            if self._is_started(setpoint, distance_k, expected, sample.time):
                return setpoint.relaxed(setpoint.occupied, 0.0)
        return setpoint.relaxed(setpoint.occupied, self._setback_k)

    def _is_started(self, setpoint: _Setpoint, distance_k: float, expected: datetime, now: datetime) -> bool:
        is_due = now < expected + self.manifest.timestep
        return is_due and self._start.is_started(setpoint.name, distance_k, 0.0, expected, now)


class PortableDemandLimit(_Portable):
    """Relax the setpoints of all zones while the building's power is near a limit; else leave them to the building.

    Asks the semantic model for zones with setpoints and for the building's electricity meter. See `DemandLimiter`.

    Args:
        manifest: manifest of the node.
        limit_kw: limit, kW; the highest power of the month so far if that is higher.
        start: share of the limit at which setpoints begin to give way, 0 to 1.
        amount: greatest change of a setpoint, K.
    """

    def __init__(self, manifest: Manifest, *, limit_kw: float = 0.0, start: float = 0.9, amount: float = 2.0) -> None:
        super().__init__(manifest)
        self._limit_kw = number("limit_kw", limit_kw, minimum=0.0)
        self._share = number("start", start, minimum=0.0, maximum=1.0)
        self._amount_k = number("amount", amount, minimum=0.1)
        self._limiter: DemandLimiter | None = None

    def use_model(self, model: Finder) -> None:
        """Find the setpoints of the zones and the electricity meter; without one, nothing is limited."""
        super().use_model(model)
        meters = model.find("electricity_meter")
        if meters:
            arguments = (self._limit_kw, self._share, self._amount_k, meters[0].name)
            self._limiter = DemandLimiter(self.manifest, *arguments)
        else:
            self.lacks.append("electricity meter")

    def begin(self, sample: SampleView) -> None:
        """Forget the peak, and what was learned."""
        super().begin(sample)
        if self._limiter is not None:
            self._limiter.begin()

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints of all zones; None where the building's own control applies."""
        share = 0.0 if self._limiter is None else self._limiter.share(sample.values, sample.time)
        values: Values = {}
        sources = sample.value_source
        for setpoint in (each for setpoints in self._zones.values() for each in setpoints):
            setpoint.observe(sample, sources, is_present=False)
            is_own = not share or isnan(setpoint.own)
            values[setpoint.name] = None if is_own else setpoint.relaxed(setpoint.own, share * self._amount_k)
        return values
