"""Points that the agent does not observe: a scenario's own, and those that pictures, reports and metrics need."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace

from zenostat.models.building.conflicts import thermostat_setpoints
from zenostat.models.building.model import Building
from zenostat.models.points.discovery import PointCatalog
from zenostat.models.points.selection import Points, default_meters, default_sensors, select_points, thermostat_zones
from zenostat.models.points.system_sensors import system_sensors
from zenostat.topics.energyplus_names import (
    COOLING_SETPOINT,
    COOLING_SETPOINT_VARIABLE,
    END_USES,
    FUELS,
    GENERATION_METERS,
    HEATING_SETPOINT,
    HEATING_SETPOINT_VARIABLE,
    HVAC_METERS,
    OCCUPANTS,
    UNMET_COOLING,
    UNMET_HEATING,
    ZONE_TEMPERATURE,
    ZONE_TEMPERATURES,
)
from zenostat.topics.points import PointIndex

_UNOBSERVED = {"observed": False}
_OUTDOORS = "outdoor_temperature"
_UNMET = {"unmet_heating_time": UNMET_HEATING, "unmet_cooling_time": UNMET_COOLING}
_ZONE_SENSORS = {
    "air_temperature": ZONE_TEMPERATURE,
    "occupants": OCCUPANTS,
    "thermostat_heating_setpoint": HEATING_SETPOINT_VARIABLE,
    "thermostat_cooling_setpoint": COOLING_SETPOINT_VARIABLE,
}


def with_unobserved(points: Points, names: Collection[str]) -> Points:
    """Return the points of a run with these sensors and meters unobserved.

    Raises:
        UnknownName: there is no such sensor or meter.
    """
    measured = [*(sensor.name for sensor in points.sensors), *(meter.name for meter in points.meters)]
    PointIndex(measured, "sensor or meter").require(names)
    return replace(
        points,
        sensors=tuple(s.model_copy(update=_UNOBSERVED) if s.name in names else s for s in points.sensors),
        meters=tuple(m.model_copy(update=_UNOBSERVED) if m.name in names else m for m in points.meters),
    )


_SETPOINTS = {
    "thermostat_heating_setpoint": HEATING_SETPOINT.casefold(),
    "thermostat_cooling_setpoint": COOLING_SETPOINT.casefold(),
}


def with_monitoring(building: Building, available: PointCatalog, points: Points) -> Points:
    """Return the points of a run, followed by unobserved ones; none is measured twice.

    Added are `monitoring_sensors` after the sensors and `monitoring_meters` after the meters; a name that is taken gets
    a number.
    """
    return _with_added(
        building, available, points, monitoring_sensors(building, available), monitoring_meters(available)
    )


def with_systems(building: Building, available: PointCatalog, points: Points) -> Points:
    """Return the points of a run, followed by the unobserved `system_sensors`; none is measured twice."""
    return _with_added(building, available, points, system_sensors(building, available), {})


def _with_added(
    building: Building,
    available: PointCatalog,
    points: Points,
    more_sensors: Mapping[str, tuple[str, str]],
    more_meters: Mapping[str, str],
) -> Points:
    """Return points followed by unobserved ones, without those that are measured already."""
    taken = {sensor.name for sensor in points.sensors} | {meter.name for meter in points.meters}
    variables = {(_quantity(sensor.variable), points.own_key(sensor).casefold()) for sensor in points.sensors}
    measured = {meter.meter.casefold() for meter in points.meters}
    sensors = {
        _free_name(name, taken): (variable, key)
        for name, (variable, key) in more_sensors.items()
        if (_quantity(variable), key.casefold()) not in variables
    }
    meters = {_free_name(name, taken): meter for name, meter in more_meters.items() if meter.casefold() not in measured}
    added = select_points(building, available, sensors, meters, {})
    return Points(
        sensors=(*points.sensors, *(sensor.model_copy(update=_UNOBSERVED) for sensor in added.sensors)),
        meters=(*points.meters, *(meter.model_copy(update=_UNOBSERVED) for meter in added.meters)),
        actuators=points.actuators,
        system=(*points.system, *added.system),
        meter_parts=(*points.meter_parts, *added.meter_parts),
        own_keys=added.own_keys,
    )


def monitoring_sensors(building: Building, available: PointCatalog) -> dict[str, tuple[str, str]]:
    """Return by name the outdoor temperature, unmet hours, and each conditioned zone's air, occupants and setpoints.

    A setpoint that a zone's thermostat never has is left out: EnergyPlus reports 0 degC for it.
    """
    used = {(zone, control) for zone, control, _ in thermostat_setpoints(building.objects)}
    controlled = {zone for zone, _ in used}
    sensors = {name: spec for name, spec in default_sensors(available).items() if name == _OUTDOORS}
    sensors |= {
        name: (variable, "Facility")
        for name, variable in _UNMET.items()
        if (variable.casefold(), "facility") in available.by_variable
    }
    for zone, name in thermostat_zones(available).items():
        for suffix, variable in _ZONE_SENSORS.items():
            control = _SETPOINTS.get(suffix)
            if control is not None and zone.casefold() in controlled and (zone.casefold(), control) not in used:
                continue
            if (variable.casefold(), zone.casefold()) in available.by_variable:
                sensors[f"{name}_{suffix}"] = (variable, zone)
    return sensors


def monitoring_meters(available: PointCatalog) -> dict[str, str]:
    """Return by name the default meters, those of the HVAC by fuel, of all end uses of the model and of generation."""
    names = {meter.name for meter in available.meters}
    uses = [*HVAC_METERS, *(f"{end_use}:{fuel}" for end_use in END_USES for fuel in FUELS)]
    if GENERATION_METERS[0] in names:
        uses += GENERATION_METERS
    return default_meters(available) | {_snake_case(name): name for name in uses if name in names}


def _quantity(variable: str) -> str:
    """Return the output variable, case-folded; the same for those that measure the same."""
    folded = variable.casefold()
    return ZONE_TEMPERATURES[0] if folded in ZONE_TEMPERATURES else folded


def _free_name(name: str, taken: set[str]) -> str:
    """Return the name, with a number where it is taken, and add it to those that are."""
    free, number = name, 2
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free


def _snake_case(meter: str) -> str:
    """Return `interior_lights_natural_gas` for `InteriorLights:NaturalGas`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z0-9])", "_", meter.replace(":", "_")).lower()
