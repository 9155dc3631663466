"""Points of a node under BOPTEST's names, in SI units.

A measurement is the point's name with `_y`; an input is the actuator's name with `_u`, and with `_activate` for the
switch beside it. Clients replace `_u` anywhere in a name, so other occurrences in it are written `_U`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

import numpy as np

from zenostat.gateways.points import Reading, readings
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, repeated
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Meter
from zenostat.topics.points import bounds

KELVIN = 273.15

_SI: Mapping[str, tuple[str, float, float]] = {
    "degC": ("K", 1.0, KELVIN),
    "delta_degC": ("K", 1.0, 0.0),
    "percent": ("1", 0.01, 0.0),
    "fraction": ("1", 1.0, 0.0),
    "count": ("1", 1.0, 0.0),
    "on_off": ("1", 1.0, 0.0),
    "kgWater/kgDryAir": ("kg/kg", 1.0, 0.0),
    "deg": ("rad", pi / 180.0, 0.0),
    "hr": ("s", 3600.0, 0.0),
    "min": ("s", 60.0, 0.0),
    "day": ("s", 86400.0, 0.0),
    "L": ("m3", 1e-3, 0.0),
    "kJ": ("J", 1e3, 0.0),
    "kWh": ("J", 3.6e6, 0.0),
    "kW": ("W", 1e3, 0.0),
    "MW": ("W", 1e6, 0.0),
    "L/s": ("m3/s", 1e-3, 0.0),
    "rev/min": ("rad/s", pi / 30.0, 0.0),
}
"""By unit: the SI unit, and factor and offset from the value to the SI value."""

_UNBOUNDED = 1e9
"""Bound of an actuator without one: clients build action spaces from the bounds."""


@dataclass(frozen=True, slots=True)
class Point:
    """A measurement or an input, as clients see it; limits are in its SI unit."""

    name: str
    unit: str | None
    description: str
    minimum: float | None = None
    maximum: float | None = None

    def as_json(self) -> dict[str, str | float | None]:
        """Return BOPTEST's description of a point."""
        return {"Unit": self.unit, "Description": self.description, "Minimum": self.minimum, "Maximum": self.maximum}


class PointTable:
    """The measurements and inputs of a node.

    Attributes:
        measurements: one for each of `Manifest.points`, in its order.
        inputs: one for each actuator, in manifest order; without the switches.
        activates: the switches' names, in the same order.
    """

    def __init__(self, manifest: Manifest) -> None:
        measured = readings(manifest)
        scales = [_SI.get(reading.unit, (reading.unit, 1.0, 0.0)) for reading in measured]
        self._factor, self._offset = np.array([scale[1:] for scale in scales]).reshape(-1, 2).T
        self._divisor = np.array([reading.divisor for reading in measured])
        self.measurements = tuple(
            Point(f"{_stem(reading.name)}_y", unit, _describe(reading, unit))
            for reading, (unit, *_) in zip(measured, scales, strict=True)
        )
        input_scales = [_SI.get(actuator.unit, (actuator.unit, 1.0, 0.0)) for actuator in manifest.actuators]
        self._input_factor, self._input_offset = np.array([s[1:] for s in input_scales]).reshape(-1, 2).T
        self._bounds = tuple(map(bounds, manifest.actuators))
        self.inputs = tuple(
            map(self._input, manifest.actuators, range(len(input_scales)), (s[0] for s in input_scales))
        )
        self.activates = tuple(f"{point.name.removesuffix('_u')}_activate" for point in self.inputs)
        if twice := repeated(point.name for point in (*self.measurements, *self.inputs)):
            raise InvalidConfig(f"points that differ only by case cannot be BOPTEST points: {sorted(twice)}")
        self.measured = {point.name: index for index, point in enumerate(self.measurements)}
        self.commanded = {point.name: index for index, point in enumerate(self.inputs)}
        self.activated = {name: index for index, name in enumerate(self.activates)}

    def _input(self, actuator: Actuator, index: int, unit: str) -> Point:
        factor, offset = self._input_factor[index], self._input_offset[index]
        low, high = (
            round(float((bound if bound is not None else default) * factor + offset), 9)
            for bound, default in ((actuator.low, -_UNBOUNDED), (actuator.high, _UNBOUNDED))
        )
        text = f"{actuator.component_type} {actuator.control_type}".strip()
        description = f"{text}, {actuator.key}" if actuator.key else text or actuator.name
        return Point(f"{_stem(actuator.name)}_u", unit, f"Override: {description}", low, high)

    def si_values(self, values: Floats) -> Floats:
        """Convert values of `Manifest.points`, shape (..., points)."""
        converted: Floats = values / self._divisor * self._factor + self._offset
        return converted

    def si_inputs(self, values: Floats) -> Floats:
        """Convert values of actuators, shape (..., actuators)."""
        converted: Floats = values * self._input_factor + self._input_offset
        return converted

    def bus_input(self, index: int, value: float) -> float:
        """Convert an input's SI value to the actuator's unit; a bound's rounded value is the bound itself."""
        low, high = self._bounds[index]
        return min(max(float((value - self._input_offset[index]) / self._input_factor[index]), low), high)


def _stem(name: str) -> str:
    return name.replace("_u", "_U")


def _describe(reading: Reading, unit: str) -> str:
    point = reading.point
    if isinstance(point, Meter):
        is_total = reading.aggregation is Aggregation.SUM
        quantity = "Total" if is_total else "Mean power" if unit == "W" else "Mean rate"
        return f"{quantity} of {point.meter or point.name} in the last timestep"
    where = f", {point.key}" if point.key else ""
    return f"{point.variable or point.name}{where} ({reading.aggregation})"
