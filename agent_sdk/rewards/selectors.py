"""Selection of the points that a reward reads, by name or by EnergyPlus output variable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import HVAC_POWER, ZONE_TEMPERATURES
from zenostat.topics.errors import InvalidConfig, did_you_mean, repeated
from zenostat.topics.messages import Aggregation, Manifest, Sensor
from zenostat.topics.points import value_index
from zenostat.topics.units import power_kw, quantity

Indices = NDArray[np.intp]
"""Indices among the values of a sample."""

HVAC_METER = "hvac:electricity"
"""The meter of the HVAC's electricity, case-folded."""


def indices(points: Sequence[int]) -> Indices:
    """Convert to the array type that NumPy indexes fastest with."""
    return np.array(points, np.intp)


def sum_at(values: Floats, points: Indices) -> Any:
    """Return the sum of some points, with the leading shape of `values`."""
    if len(points) == 1:
        return values.take(points[0], axis=-1)
    return np.add.reduce(values.take(points, axis=-1), axis=-1)


def named(kind: str, name: str, manifest: Manifest, units: Sequence[str]) -> int:
    """Return the index of a sensor with one of these units.

    Raises:
        InvalidConfig: the node does not have the sensor, or it has another unit.
    """
    sensor_units = {sensor.name: sensor.unit for sensor in manifest.sensors}
    fitting = [sensor for sensor, unit in sensor_units.items() if unit in units]
    index = value_index(manifest)
    if name not in index:
        raise InvalidConfig(
            f"the {kind} reward names {name!r}, which the node does not have; {did_you_mean(name, fitting)}"
        )
    if sensor_units.get(name) not in units:
        expected = " or ".join(units)
        raise InvalidConfig(
            f"the {kind} reward needs a sensor in {expected}, which {name!r} is not; {did_you_mean(name, fitting)}"
        )
    return index[name]


def check_distinct(kind: str, names: Sequence[str]) -> None:
    """Raise `InvalidConfig` if a reward names a point twice."""
    if twice := repeated(names):
        raise InvalidConfig(f"the {kind} reward names {twice[0]!r} twice, which would count it twice")


def of_variables(manifest: Manifest, *variables: str) -> list[int]:
    """Return the observed sensors of the first of these output variables, in lower case, that has any."""
    for variable in variables:
        sensors = [
            i for i, sensor in enumerate(manifest.sensors) if sensor.observed and sensor.variable.casefold() == variable
        ]
        if sensors:
            return sensors
    return []


def energy_point(kind: str, name: str, manifest: Manifest) -> int:
    """Return the index of a meter or sensor of energy or power.

    Raises:
        InvalidConfig: the node does not have the point, it has another unit, or it does not read a whole timestep.
    """
    index = value_index(manifest)
    fitting = _energy_points(manifest)
    if name not in index:
        raise InvalidConfig(
            f"the {kind} reward names {name!r}, which the node does not have; {did_you_mean(name, fitting)}"
        )
    point = manifest.points[index[name]]
    if name not in fitting:
        raise InvalidConfig(
            f"the {kind} reward needs energy or power, in units such as J or W, which {name!r} is not ({point.unit}); "
            f"{did_you_mean(name, fitting)}"
        )
    if isinstance(point, Sensor) and quantity(point.unit) == "energy" and point.aggregation is not Aggregation.SUM:
        raise InvalidConfig(
            f"the {kind} reward needs the energy of the whole timestep, and {name!r} reads {point.aggregation!s}: "
            f"({point.variable!r}, {point.key!r}, 'sum') in sensors= reads all of it"
        )
    return index[name]


def _energy_points(manifest: Manifest) -> list[str]:
    return [point.name for point in manifest.points if quantity(point.unit) in ("energy", "power")]


def powers(kind: str, names: Sequence[str] | None, manifest: Manifest) -> tuple[Indices, float]:
    """Return points of power or energy and the factor from their sum to the mean power of the timestep in W.

    They are the points that are named, else the meter of the HVAC's electricity, else EnergyPlus's demand rate.
    """
    if names is not None:
        check_distinct(kind, names)
        points = [energy_point(kind, name, manifest) for name in names]
        units = list(dict.fromkeys(manifest.points[point].unit for point in points)) or ["W"]
        if len(units) > 1:
            raise InvalidConfig(f"the {kind} reward adds up its `power`, which is in {' and '.join(units)}; name one")
        return indices(points), 1e3 * power_kw(units[0], manifest.step_s)
    meters = observed_meters(manifest)
    if HVAC_METER in meters:
        return indices([meters[HVAC_METER]]), 1.0 / manifest.step_s
    sensors = of_variables(manifest, HVAC_POWER.casefold())
    if not sensors:
        raise InvalidConfig(
            f"the {kind} reward needs the HVAC's power: name the meter 'HVAC:Electricity' in meters=, or a sensor of "
            f"'{HVAC_POWER}' (key 'Whole Building') in sensors=; or, as of HVAC that needs no electricity, name other "
            f"meters or power sensors as the reward's `power`; {did_you_mean('hvac', _energy_points(manifest))}"
        )
    return indices(sensors[:1]), 1.0


def observed_meters(manifest: Manifest) -> dict[str, int]:
    """Return the indices of the observed meters by EnergyPlus's names, case-folded."""
    return {
        meter.meter.casefold(): index
        for index, meter in enumerate(manifest.meters, len(manifest.sensors))
        if meter.observed
    }


def temperatures(kind: str, names: Sequence[str] | None, manifest: Manifest) -> Indices:
    """Return the sensors of zone air temperatures in degC: those that are named, else all observed ones."""
    if names is not None:
        check_distinct(kind, names)
        return indices([named(kind, name, manifest, ["degC"]) for name in names])
    sensors = of_variables(manifest, *ZONE_TEMPERATURES)
    if not sensors:
        raise InvalidConfig(
            f"the {kind} reward needs at least one sensor of 'Zone Air Temperature': name one in sensors=, "
            "or name the temperature sensors as the reward's `temperatures`"
        )
    return indices(sensors)


def same_zone(zones: Sequence[int], variable: str, manifest: Manifest, *, observed: bool = True) -> list[int | None]:
    """Return, for each of these sensors, the sensor of another output variable with the same key, or None.

    A reward reads observed points only unless it names others, so that no point changes it that is added for pictures;
    with `observed=False` all points are searched, the observed ones first.
    """
    by_key = {
        sensor.key.casefold(): i
        for i, sensor in sorted(enumerate(manifest.sensors), key=lambda entry: (entry[1].observed, -entry[0]))
        if sensor.variable.casefold() == variable.casefold() and (sensor.observed or not observed)
    }
    return [by_key.get(manifest.sensors[zone].key.casefold()) for zone in zones]
