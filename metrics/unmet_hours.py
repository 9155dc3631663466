"""Unmet hours: the time in which a setpoint is missed while people are there, as EnergyPlus counts it."""

from __future__ import annotations

from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import UNMET_COOLING, UNMET_HEATING
from zenostat.topics.messages import Aggregation, Manifest


class UnmetHours:
    """Accumulate the hours in which at least one occupied zone misses its setpoint.

    EnergyPlus counts them with a tolerance of 0.2 K (`OutputControl:ReportingTolerances`); their sums are those of its
    summary, "Time Setpoint Not Met During Occupied Heating" (and Cooling).

    Args:
        manifest: manifest of the node.

    Attributes:
        heating_h, cooling_h: hours so far; None where the node does not measure them, as `monitoring` does.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._heating, self._cooling = _sensor(manifest, UNMET_HEATING), _sensor(manifest, UNMET_COOLING)
        self.reset()

    def reset(self) -> None:
        """Forget all timesteps."""
        self.heating_h = None if self._heating is None else 0.0
        self.cooling_h = None if self._cooling is None else 0.0

    def add(self, values: Floats) -> None:
        """Add a timestep with the values of the sample that closes it."""
        if self._heating is not None and self.heating_h is not None:
            self.heating_h += float(values[self._heating])
        if self._cooling is not None and self.cooling_h is not None:
            self.cooling_h += float(values[self._cooling])


def _sensor(manifest: Manifest, variable: str) -> int | None:
    """Return the index of the sensor of an output variable that gives the sum over the timestep."""
    return next(
        (
            index
            for index, sensor in enumerate(manifest.sensors)
            if sensor.variable.casefold() == variable.casefold() and sensor.aggregation is Aggregation.SUM
        ),
        None,
    )
