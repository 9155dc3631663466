"""Bounds of thermostat setpoints: a usual range, widened to what the building's own schedules do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from zenostat.models.building.model import Building
from zenostat.models.building.schedule_files import file_values
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
_DESIGN_DAYS = ("summerdesignday", "winterdesignday", "customday")


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
    for kind in _SCHEDULES:
        schedule = building.find(kind, name)
        if not schedule:
            continue
        if kind == "Schedule:Compact":
            yield from _compact_values(schedule)
        elif kind == "Schedule:Constant":
            yield float(schedule.get("hourly_value", 0.0))
        elif kind == "Schedule:File":
            yield from file_values(schedule)
        elif kind in _DAYS:
            yield from (float(value) for value in _numbers(schedule))
        else:
            for used in dict.fromkeys(_references(schedule)):
                yield from _values(building, used)


_DAYS = ("Schedule:Day:Hourly", "Schedule:Day:Interval", "Schedule:Day:List")
_SCHEDULES = (
    "Schedule:Compact", "Schedule:Constant", "Schedule:File", "Schedule:Year",
    "Schedule:Week:Daily", "Schedule:Week:Compact", *_DAYS,
)  # fmt: skip


def _compact_values(schedule: dict[str, Any]) -> Iterator[float]:
    is_counted = True
    for entry in schedule.get("data", []):
        field = entry.get("field")
        if isinstance(field, str) and field.strip().casefold().startswith("for"):
            is_counted = _has_other_days(field)
        elif isinstance(field, int | float) and is_counted:
            yield float(field)


def _has_other_days(days: str) -> bool:
    """Return whether a list of day types, such as `For: Weekdays SummerDesignDay`, has others than design days."""
    words = re.findall(r"\w+", days.strip().casefold().removeprefix("for"))
    return any(not word.startswith(_DESIGN_DAYS) for word in words)


def _numbers(schedule: dict[str, Any]) -> Iterator[float]:
    for field, value in schedule.items():
        if isinstance(value, list):
            yield from (float(part["value_until_time"]) for part in value if "value_until_time" in part)
            yield from (float(part["value"]) for part in value if "value" in part)
        elif field.startswith("hour_") and isinstance(value, int | float):
            yield float(value)


def _references(schedule: dict[str, Any]) -> Iterator[str]:
    """Yield the names of the week or day schedules that a year or a week uses."""
    for field, value in schedule.items():
        if isinstance(value, list):
            for part in value:
                if _has_other_days(str(part.get("daytype_list", "AllDays"))):
                    yield from (str(name) for key, name in part.items() if key.startswith("schedule_"))
        elif field.endswith("schedule_day_name") and not any(day in field.replace("_", "") for day in _DESIGN_DAYS):
            yield str(value)
