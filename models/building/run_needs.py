"""Determine what a run needs that a model may lack, and say what is assumed instead."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from zenostat.models.input_format.source_model import ModelObjects

_SIZING_FIELDS = ("do_zone_sizing_calculation", "do_system_sizing_calculation", "do_plant_sizing_calculation")

_FINITE_DIFFERENCE = "conductionfinitedifference"
_FINITE_DIFFERENCE_STEPS = 20


def simulation_control(objects: ModelObjects) -> dict[str, Any]:
    """Return the fields of `SimulationControl` for an episode: sizing as the model requests it, then the run period.

    A model without that object that has both `Autosize` fields and sizing objects could not run: it is sized.
    """
    control = dict(next(iter(objects.get("SimulationControl", {}).values()), {}))
    if _lacks_control(objects):
        control |= dict.fromkeys(_SIZING_FIELDS[:2], "Yes")
        control[_SIZING_FIELDS[2]] = "Yes" if "Sizing:Plant" in objects else "No"
    control["run_simulation_for_sizing_periods"] = "No"
    control["run_simulation_for_weather_file_run_periods"] = "Yes"
    return control


def lacks_design_days(objects: ModelObjects) -> bool:
    """Whether a model requests sizing and has no sizing periods, with which EnergyPlus ends."""
    control = simulation_control(objects)
    is_sized = any(str(control.get(field, "")).casefold() == "yes" for field in _SIZING_FIELDS)
    return is_sized and not any(items for kind, items in objects.items() if kind.startswith("SizingPeriod:"))


def changed_timesteps(objects: ModelObjects, steps_per_hour: int) -> tuple[str, str, str, int] | None:
    """Return the field because of which EnergyPlus takes another number of timesteps per hour, and that number.

    The rules were determined by experiment with EnergyPlus 25.2.

    Returns:
        Type and name of the object, its field, and the number; None if EnergyPlus takes `steps_per_hour`.
    """
    for name, fields in objects.get("PerformancePrecisionTradeoffs", {}).items():
        if str(fields.get("override_mode")).casefold().startswith("mode"):
            return None if steps_per_hour == 1 else ("PerformancePrecisionTradeoffs", name, "override_mode", 1)
    for kind, items in objects.items() if steps_per_hour < _FINITE_DIFFERENCE_STEPS else ():
        if kind.startswith(("HeatBalanceAlgorithm", "SurfaceProperty:HeatTransferAlgorithm")):
            for name, fields in items.items():
                if str(fields.get("algorithm")).casefold() == _FINITE_DIFFERENCE:
                    return kind, name, "algorithm", _FINITE_DIFFERENCE_STEPS
    return None


def assumptions(objects: ModelObjects, *, has_dates: bool) -> Iterator[str]:
    """Yield a sentence for each thing that a run of the model assumes.

    Args:
        objects: the model.
        has_dates: whether the scenario has a run period of its own.
    """
    periods = list(objects.get("RunPeriod", {}))
    if not has_dates and not periods:
        yield "the model has no RunPeriod, so an episode is a whole year; choose begin and end"
    if not has_dates and len(periods) > 1:
        rest = ", ".join(map(repr, periods[1:]))
        yield f"the model has several RunPeriod objects; {periods[0]!r} is simulated, not {rest}; choose begin and end"
    control: Mapping[str, Any] = next(iter(objects.get("SimulationControl", {}).values()), {})
    is_weather_run = str(control.get("run_simulation_for_weather_file_run_periods", "Yes")).casefold() != "no"
    if not has_dates and not periods and not is_weather_run:
        yield "the model simulates its sizing periods only; an episode simulates the weather file"
    if _lacks_control(objects):
        yield "the model has no SimulationControl; it is sized, since fields of it are Autosize"
    if lacks_design_days(objects):
        yield "the model has no sizing periods; it is sized for the design days of the weather file"


def _lacks_control(objects: ModelObjects) -> bool:
    has_sizing = any(kind in objects for kind in ("Sizing:Zone", "Sizing:System", "Sizing:Plant"))
    return not objects.get("SimulationControl") and has_sizing and _has_autosize(objects)


def _has_autosize(value: object) -> bool:
    if isinstance(value, Mapping):
        return any(map(_has_autosize, value.values()))
    if isinstance(value, list):
        return any(map(_has_autosize, value))
    return isinstance(value, str) and value.casefold() == "autosize"
