"""Compare schedules with the limits of their type: EnergyPlus ends at a value beyond them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from zenostat.models.building.compact_schedules import compact_values
from zenostat.models.building.findings import FieldFinding, RuleFinding, finding
from zenostat.models.building.schedule_fields import has_other_days
from zenostat.models.input_format.source_model import ModelObjects

SCHEDULES = ("Schedule:Constant", "Schedule:Compact", "Schedule:Year")
_TOLERANCE = 1.2e-7
"""EnergyPlus's own, the resolution of a 32-bit float."""


def limit_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield the findings on limits, and on the schedules that do not keep them."""
    limits = dict[str, tuple[str, float, float]]()
    for name, fields in objects.get("ScheduleTypeLimits", {}).items():
        low, high = fields.get("lower_limit_value"), fields.get("upper_limit_value")
        if low is None or high is None:
            continue
        text = ""
        if not fields.get("numeric_type"):
            text = ": it lacks 'numeric_type', Continuous or Discrete, which limits need"
            yield finding("ScheduleTypeLimits", name, FieldFinding("", text))
        elif low > high:
            text = f": lower_limit_value is {low:g}, which is above upper_limit_value, {high:g}"
            yield finding("ScheduleTypeLimits", name, FieldFinding("lower_limit_value", text))
        if not text:
            limits[name.casefold()] = (name, float(low), float(high))
    for kind, name, schedule in schedules(objects):
        own = limits.get(str(schedule.get("schedule_type_limits_name", "")).casefold())
        for path, value in schedule_values(objects, kind, schedule) if own else ():
            if own and not own[1] - _TOLERANCE <= value <= own[2] + _TOLERANCE:
                text = f"but its type {own[0]!r} has the limits {own[1]:g} and {own[2]:g}"
                shown = f": {path} is {value:g}, {text}" if path else f": a value is {value:g}, {text}"
                yield finding(kind, name, FieldFinding(path, shown))
                break


def schedules(objects: ModelObjects) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield type, name and fields of the schedules whose values `schedule_values` knows."""
    for kind in SCHEDULES:
        for name, fields in objects.get(kind, {}).items():
            yield kind, name, fields


def schedule_values(
    objects: ModelObjects, kind: str, fields: Mapping[str, Any], *, design_days: bool = True
) -> list[tuple[str, float]]:
    """Return path and value of a schedule's values; without a path, the values of other objects that it refers to."""
    if kind == "Schedule:Constant":
        value = fields.get("hourly_value", 0.0)
        return [("hourly_value", value)] if isinstance(value, (int, float)) else []
    if kind == "Schedule:Compact":
        return compact_values(fields, design_days=design_days)
    weeks = {str(entry.get("schedule_week_name", "")).casefold() for entry in fields.get("schedule_weeks", ())}
    days = set[str]()
    for week in ("Schedule:Week:Daily", "Schedule:Week:Compact"):
        for name, own in objects.get(week, {}).items():
            if name.casefold() in weeks:
                days |= {
                    str(day).casefold()
                    for part in (own, *own.get("data", ()))
                    for field, day in part.items()
                    if field.endswith("day_name") and (design_days or has_other_days(part.get("daytype_list", field)))
                }
    return [("", value) for value in _day_values(objects, days)]


def _day_values(objects: ModelObjects, days: set[str]) -> Iterator[float]:
    for kind in ("Schedule:Day:Hourly", "Schedule:Day:Interval", "Schedule:Day:List"):
        for name, fields in objects.get(kind, {}).items():
            if name.casefold() in days:
                entries = (*fields.get("data", ()), *fields.get("extensions", ()))
                values = [value for field, value in fields.items() if field.startswith("hour_")]
                values += [entry.get(key) for entry in entries for key in ("value_until_time", "value")]
                yield from (value for value in values if isinstance(value, (int, float)))
