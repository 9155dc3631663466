"""Observation of the benchmark's tasks: sensors of each building, and wrappers that add what the reward depends on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zenostat.topics.energyplus_names import OCCUPANTS, SCHEDULE_VALUE
from zenostat.topics.keys import safe_name

_APARTMENTS = tuple(f"{side} APARTMENT" for side in ("N1", "N2", "NE", "NW", "S1", "S2", "SE", "SW"))
_GROUND_FLOOR = tuple(name for name in _APARTMENTS if name != "SE APARTMENT")
"""Its south-east corner is the office."""

_OCCUPIED = {
    "ref-small-office": ("CORE_ZN", *(f"PERIMETER_ZN_{number}" for number in range(1, 5))),
    "ref-warehouse": ("OFFICE",),
    "ref-stand-alone-retail": ("BACK_SPACE", "CORE_RETAIL", "FRONT_ENTRY", "FRONT_RETAIL", "POINT_OF_SALE"),
    "ref-quick-service-restaurant": ("DINING", "KITCHEN"),
    "ref-midrise-apartment": (
        *(f"G {name}" for name in _GROUND_FLOOR), *(f"M {name}" for name in _APARTMENTS), "OFFICE",
        *(f"T {name}" for name in _APARTMENTS),
    ),
}  # fmt: skip
"""Zones with people."""

_EMPTY = {
    "ref-warehouse": ("BULKSTORAGE", "FINESTORAGE"),
    "ref-midrise-apartment": tuple(f"{floor} CORRIDOR" for floor in "GMT"),
}
"""Zones with a thermostat and without people."""

_OCCUPANCY = {"ref-midrise-apartment": ("APT_OCC_SCH", "OFF_OCC_SCH")}
"""Schedules of the number of people, where they are not `_BUILDING_OCCUPANCY`."""
_BUILDING_OCCUPANCY = ("BLDG_OCC_SCH",)

_SETPOINTS = ("HTGSETP_SCH", "CLGSETP_SCH")
"""Schedules of the setpoints of zones with people under baseline control."""
_CONSTANT_SETPOINTS = ("ref-midrise-apartment",)
"""Buildings whose zones with people have constant setpoints under baseline control (but for one small office)."""

_STEP_H = 0.25
_OCCUPANCY_LEADS_H = (_STEP_H, 1.0, 2.0, 4.0, 8.0)
_SETPOINT_LEADS_H = (_STEP_H, 1.0, 2.0, 4.0)
"""Hours ahead."""

_PRICE_HOURS = (0, 1, 2, 4, 8)
_FORECAST_HOURS, _FORECAST_SPACING_H = 4, 2.0

_SITE = {
    "outdoor_temperature": ["Site Outdoor Air Drybulb Temperature", "Environment"],
    "outdoor_humidity": ["Site Outdoor Air Relative Humidity", "Environment"],
    "hvac_and_plant_power": ["Facility Total HVAC Electricity Demand Rate", "Whole Building"],
}


def sensors(building: str) -> dict[str, list[Any]]:
    """Return the sensors of a task, as the argument `sensors` of an environment."""
    occupied = _OCCUPIED[building]
    zones = (*occupied, *_EMPTY.get(building, ()))
    temperatures = {f"{safe_name(zone)}_air_temperature": ["Zone Air Temperature", zone] for zone in zones}
    people = {f"{safe_name(zone)}_occupants": [OCCUPANTS, zone] for zone in occupied}
    return {**_SITE, **temperatures, **people, **_schedules(building)}


def _schedules(building: str) -> dict[str, list[Any]]:
    """Return the sensors of schedules ahead of time: those of people and of the setpoints under baseline control."""
    leads: dict[str, tuple[float, ...]] = dict.fromkeys(
        _OCCUPANCY.get(building, _BUILDING_OCCUPANCY), _OCCUPANCY_LEADS_H
    )
    if building not in _CONSTANT_SETPOINTS:
        leads |= dict.fromkeys(_SETPOINTS, _SETPOINT_LEADS_H)
    return {
        f"{safe_name(schedule)}_{_horizon(hours)}": [SCHEDULE_VALUE, schedule, None, hours]
        for schedule, all_hours in leads.items()
        for hours in all_hours
    }


def _horizon(hours: float) -> str:
    return "next" if hours == _STEP_H else f"in_{hours:g}h"


def wrappers(building: str, price: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the wrappers of a task, innermost first.

    They leave out the number of people in each zone, which is in proportion to its schedule, and add a cyclic clock,
    the price, the peak so far and the weather of the next hours.

    Args:
        building: a building of the benchmark.
        price: the price of electricity of the task's reward.
    """
    points = [name for name in sensors(building) if not name.endswith("_occupants")]
    meters = ["electricity_facility", "electricity_hvac", "naturalgas_hvac"]
    return [
        {"wrapper": "ReducedObservation", "keep": ["day_of_week", "hour", *points, *meters]},
        {"wrapper": "CyclicTime", "fields": ["day_of_week", "hour"]},
        {"wrapper": "TimeSeriesObservation", "signals": {"price": dict(price)}, "hours": list(_PRICE_HOURS)},
        {"wrapper": "MetricObservation", "metrics": ["peak_kw"]},
        {
            "wrapper": "WeatherForecast", "columns": ["dry_bulb_temperature", "global_horizontal_radiation"],
            "n": _FORECAST_HOURS, "spacing_h": _FORECAST_SPACING_H,
        },
    ]  # fmt: skip
