"""Bounds of thermostat setpoints: a usual range, widened to what the building's own schedules do."""

from __future__ import annotations

from collections.abc import Iterator

from zenostat.models.building.model import Building
from zenostat.models.building.schedule_files import file_values
from zenostat.models.building.schedule_limits import SCHEDULES, schedule_values
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT

_DEFAULT = {HEATING_SETPOINT: (15.0, 22.5), COOLING_SETPOINT: (22.5, 30.0)}
"""Bounds of the medium office in the paper that Zenostat follows (Sinergym), degC. They meet, because EnergyPlus aborts
the run when a heating setpoint is above the cooling setpoint of the same zone."""

_LOWEST_DEGC, _HIGHEST_DEGC = 5.0, 40.0
"""Setpoints from there on switch heating or cooling off, and are no range to search."""

_FIELDS = {
    HEATING_SETPOINT: ("heating_setpoint_temperature_schedule_name", "setpoint_temperature_schedule_name"),
    COOLING_SETPOINT: ("cooling_setpoint_temperature_schedule_name", "setpoint_temperature_schedule_name"),
}
_THERMOSTATS = {
    HEATING_SETPOINT: ("DualSetpoint", "SingleHeating", "SingleHeatingOrCooling"),
    COOLING_SETPOINT: ("DualSetpoint", "SingleCooling", "SingleHeatingOrCooling"),
}


def setpoint_bounds(building: Building, control_type: str) -> tuple[float, float] | None:
    """Return the bounds of the heating or the cooling setpoints of a building, degC; None of another control type.

    All zones have the same: one setpoint for the whole building can then do what each zone's schedule does. Heating
    ends and cooling begins at 22.5 degC in any case.
    """
    if control_type not in _DEFAULT:
        return None
    low, high = _DEFAULT[control_type]
    scheduled = [v for v in _scheduled(building, control_type) if _LOWEST_DEGC < v < _HIGHEST_DEGC]
    if control_type == HEATING_SETPOINT:
        return min([low, *scheduled]), high
    return low, max([high, *scheduled])


def _scheduled(building: Building, control_type: str) -> Iterator[float]:
    """Yield the values of all schedules that thermostats use for setpoints of this type."""
    for kind in _THERMOSTATS[control_type]:
        for thermostat in building.objects.get(f"ThermostatSetpoint:{kind}", {}).values():
            for field in _FIELDS[control_type]:
                if field in thermostat:
                    yield from _values(building, str(thermostat[field]))


def _values(building: Building, name: str) -> Iterator[float]:
    """Yield the values of a schedule on all days but design days."""
    for kind in SCHEDULES:
        if fields := building.find(kind, name):
            yield from (value for _, value in schedule_values(building.objects, kind, fields, design_days=False))
    if fields := building.find("Schedule:File", name):
        yield from file_values(fields)
