"""Bounds of thermostat setpoints: a usual range, as far as the building's own schedules permit and require it."""

from __future__ import annotations

from collections.abc import Iterator

from zenostat.models.building.conflicts import thermostat_setpoints
from zenostat.models.building.model import Building
from zenostat.models.building.schedule_files import file_values
from zenostat.models.building.schedule_limits import SCHEDULES, schedule_values
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT

_DEFAULT = {HEATING_SETPOINT: (15.0, 22.5), COOLING_SETPOINT: (22.5, 30.0)}
"""Bounds of the medium office in the paper that Zenostat follows (Sinergym), degC. They meet, because EnergyPlus aborts
the run when a heating setpoint is above the cooling setpoint of the same zone."""

_LOWEST_DEGC, _HIGHEST_DEGC = 5.0, 40.0
"""Setpoints from there on switch heating or cooling off, and are no range to search."""

_LEAST_RANGE_K = 1.0
"""Distance of the bounds, at the least."""


def setpoint_bounds(building: Building, control_type: str, zone: str | None) -> tuple[float, float] | None:
    """Return the bounds of a zone's heating or cooling setpoint, degC; None of another control type.

    The usual range is widened to the lowest heating and the highest cooling setpoint of all zones: one setpoint for
    the whole building can then do what each zone's schedule does. Where the other setpoint is left to the zone's own
    schedule, a value within the bounds never crosses it: heating ends at the zone's lowest cooling setpoint, or at
    22.5 degC if that is lower, and cooling begins at the zone's highest heating setpoint, or at 22.5 degC if that is
    higher. Without a zone they are the bounds of a pair of setpoints for all zones, which meet at 22.5 degC.
    """
    if control_type not in _DEFAULT:
        return None
    low, high = _DEFAULT[control_type]
    scheduled = [v for v in _scheduled(building, control_type) if _LOWEST_DEGC < v < _HIGHEST_DEGC]
    if control_type == HEATING_SETPOINT:
        if zone is not None:
            high = min([high, *_scheduled(building, COOLING_SETPOINT, zone)])
        return min([low, *scheduled, high - _LEAST_RANGE_K]), high
    if zone is not None:
        low = max([low, *_scheduled(building, HEATING_SETPOINT, zone)])
    return low, max([high, *scheduled, low + _LEAST_RANGE_K])


def _scheduled(building: Building, control_type: str, zone: str = "") -> Iterator[float]:
    """Yield the values of the schedules of this setpoint, of one zone or of all."""
    control, zone = control_type.casefold(), zone.casefold()
    setpoints = thermostat_setpoints(building.objects)
    for schedule in {name for own, kind, name in setpoints if kind == control and zone in ("", own)}:
        yield from _values(building, schedule)


def _values(building: Building, name: str) -> Iterator[float]:
    """Yield the values of a schedule on all days but design days."""
    for kind in SCHEDULES:
        if fields := building.find(kind, name):
            yield from (value for _, value in schedule_values(building.objects, kind, fields, design_days=False))
    if fields := building.find("Schedule:File", name):
        yield from file_values(fields)
