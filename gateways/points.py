"""Points of a manifest in the units of building automation, as gateways for devices offer them."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan

from zenostat.bridge.client.sample import SampleView
from zenostat.topics.keys import is_own
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Meter, Sensor
from zenostat.topics.units import conversion

_RATES = {
    "J": "W", "kJ": "kW", "MJ": "MW", "GJ": "MW", "Wh": "W", "kWh": "kW", "MWh": "MW", "kBtu": "kW", "therm": "kW",
    "L": "L/s", "kg": "kg/s", "m3": "m3/s",
}  # fmt: skip
"""By unit of an amount: the unit of its rate."""

_NOTES = {
    Aggregation.INSTANT: "",
    Aggregation.MEAN: "mean of the timestep",
    Aggregation.SUM: "total of the timestep",
}


@dataclass(frozen=True, slots=True)
class Reading:
    """A sensor or a meter.

    Attributes:
        point: its entry in the manifest.
        index: its index among the values of a sample.
        unit: unit of its readings: the manifest's, but a rate for an amount, such as W for J.
        divisor: a value of the sample divided by its reading: 1, or for an amount that of a rate of 1 in a timestep.
        aggregation: what the readings of several timesteps are together: the last one, their mean, or their sum.
    """

    point: Sensor | Meter
    index: int
    unit: str
    divisor: float
    aggregation: Aggregation

    @property
    def name(self) -> str:
        """Its name in the manifest."""
        return self.point.name

    @property
    def note(self) -> str:
        """Relation of its readings to their timestep; empty for a state at the end."""
        return _NOTES[self.aggregation]

    def of(self, sample: SampleView) -> float | None:
        """Return the reading of a sample; None where the node does not report it."""
        value = float(sample.values[self.index]) / self.divisor
        return None if isnan(value) else value


def readings(manifest: Manifest) -> list[Reading]:
    """Return the sensors, then the meters, in the manifest's order; amounts of a timestep are read as mean rates.

    Amounts are values of meters and of sensors with the aggregation `sum`, in a unit of energy, L, kg or m3. A device
    that reads now and then needs their rates: amounts of the timesteps that it does not read would be lost.
    """
    return [_reading(point, index, manifest.step_s) for index, point in enumerate(manifest.points)]


def _reading(point: Sensor | Meter, index: int, step_s: float) -> Reading:
    aggregation = Aggregation.SUM if isinstance(point, Meter) else point.aggregation
    if aggregation is Aggregation.SUM and point.unit in _RATES:
        unit = _RATES[point.unit]
        power, energy = conversion(unit, "W"), conversion(point.unit, "J")
        amount = power[0] / energy[0] if power and energy else 1.0  # of that rate in a second
        return Reading(point, index, unit, amount * step_s, Aggregation.MEAN)
    return Reading(point, index, point.unit, 1.0, aggregation)


def effective_value(sample: SampleView, actuator: int) -> float | None:
    """Return an actuator's effective value in the latest timestep, or else the command; None if neither is known.

    Args:
        sample: the node's latest sample.
        actuator: index of the actuator in the manifest.
    """
    for values in (sample.effective, sample.commanded):
        value = float(values[actuator])
        if not isnan(value):
            return value
    return sample.manifest.actuators[actuator].default


def is_effective(sample: SampleView, actuator: Actuator, source: str) -> bool:
    """Return whether the value of a source, or of a name below it, was in effect in the latest timestep."""
    return is_own(source, sample.value_source.get(actuator.name) or "")
