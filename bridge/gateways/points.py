"""Points of a manifest in the units of building automation, as gateways for devices offer them."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan

from agent_sdk.bus.sample import SampleView
from topics.messages import Actuator, Manifest, Meter, Sensor


@dataclass(frozen=True, slots=True)
class Reading:
    """A sensor or a meter.

    Attributes:
        point: its entry in the manifest.
        index: its index among the values of a sample.
        unit: unit of its readings: the manifest's, but W for energy.
        factor: factor from a value of the sample to a reading: 1, or 1 / step_s for energy.
    """

    point: Sensor | Meter
    index: int
    unit: str
    factor: float

    @property
    def name(self) -> str:
        """Its name in the manifest."""
        return self.point.name

    def of(self, sample: SampleView) -> float | None:
        """Return the reading of a sample; None where the node does not report it."""
        value = float(sample.values[self.index]) * self.factor
        return None if isnan(value) else value


def readings(manifest: Manifest) -> list[Reading]:
    """Return the sensors, then the meters, in the manifest's order; energy (J) is read as the mean power of a timestep.

    A device that reads now and then needs a power: energies of the timesteps that it does not read would be lost.
    """
    return [
        Reading(point, index, *(("W", 1.0 / manifest.step_s) if point.unit == "J" else (point.unit, 1.0)))
        for index, point in enumerate(manifest.points)
    ]


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
    """Return whether a source's value was in effect for an actuator in the latest timestep."""
    return sample.value_source.get(actuator.name) == source
