"""Rules for equipment that a table of renames cannot express."""

from __future__ import annotations

from typing import Any

from zenostat.models.upgrade.step import UpgradingModel

_SET_TO_LOW_SPEED = "no_load_supply_air_flow_rate_control_set_to_low_speed"
_VARIABLE_SPEED = ("coil:heating:dx:variablespeed", "coil:cooling:dx:variablespeed")
_UNITS = (
    "AirLoopHVAC:UnitarySystem",
    "ZoneHVAC:PackagedTerminalAirConditioner",
    "ZoneHVAC:PackagedTerminalHeatPump",
    "ZoneHVAC:WaterToAirHeatPump",
)

_EXCHANGER = "HeatExchanger:AirToAir:SensibleAndLatent"
_SIDES = tuple((kind, mode) for mode in ("heating", "cooling") for kind in ("sensible", "latent"))
_RATIO, _RATIOS = "HxAirFlowRatio", "effectiveness_IndependentVariableList"

_DESIGN_FIELDS = {
    "ZoneHVAC:Baseboard:RadiantConvective:Steam": (
        "heating_design_capacity_method",
        "heating_design_capacity_per_floor_area",
        "fraction_of_autosized_heating_design_capacity",
        "convergence_tolerance",
        "fraction_radiant",
        "fraction_of_radiant_energy_incident_on_people",
    ),
    "ZoneHVAC:LowTemperatureRadiant:ConstantFlow": (
        "fluid_to_radiant_surface_heat_transfer_model",
        "hydronic_tubing_inside_diameter",
        "hydronic_tubing_outside_diameter",
        "hydronic_tubing_conductivity",
        "temperature_control_type",
        "running_mean_outdoor_dry_bulb_temperature_weighting_factor",
        "motor_efficiency",
        "fraction_of_motor_inefficiencies_to_fluid_stream",
        "condensation_control_type",
        "condensation_control_dewpoint_offset",
        "changeover_delay_time_period_schedule",
    ),
    "ZoneHVAC:LowTemperatureRadiant:VariableFlow": (
        "fluid_to_radiant_surface_heat_transfer_model",
        "hydronic_tubing_inside_diameter",
        "hydronic_tubing_outside_diameter",
        "hydronic_tubing_conductivity",
        "temperature_control_type",
        "setpoint_control_type",
        "heating_design_capacity_method",
        "heating_design_capacity_per_floor_area",
        "fraction_of_autosized_heating_design_capacity",
        "heating_control_throttling_range",
        "heating_control_temperature_schedule_name",
        "cooling_design_capacity_method",
        "cooling_design_capacity_per_floor_area",
        "fraction_of_autosized_cooling_design_capacity",
        "cooling_control_throttling_range",
        "cooling_control_temperature_schedule_name",
        "condensation_control_type",
        "condensation_control_dewpoint_offset",
        "changeover_delay_time_period_schedule",
    ),
}
_DESIGN_FIELDS["ZoneHVAC:Baseboard:RadiantConvective:Water"] = _DESIGN_FIELDS[
    "ZoneHVAC:Baseboard:RadiantConvective:Steam"
]


def no_load_flow_rate(model: UpgradingModel) -> None:
    """Keep the air flow without a load (23.2 to 24.1).

    The new field is `Yes` by default. Up to 23.2 only coils of variable speed set that flow to their lowest speed
    (transition rules V24_1_0); water-to-air heat pumps did not.
    """
    for kind in _UNITS:
        for name, fields in model.items(kind):
            coils = [str(value).casefold() for key, value in fields.items() if key.endswith("coil_object_type")]
            if _SET_TO_LOW_SPEED not in fields and not any(coil in _VARIABLE_SPEED for coil in coils):
                fields[_SET_TO_LOW_SPEED] = "No"
                model.note(kind, name, f"{_SET_TO_LOW_SPEED} is new and set to No, as before")


def heat_exchanger_effectiveness(model: UpgradingModel) -> None:
    """Replace effectiveness at 75 % of the air flow by tables of it (23.2 to 24.1; transition rules V24_1_0)."""
    for name, fields in model.items(_EXCHANGER):
        for number, (kind, mode) in enumerate(_SIDES, 1):
            partial = fields.pop(f"{kind}_effectiveness_at_75_{mode}_air_flow", 0.0)
            full = fields.get(f"{kind}_effectiveness_at_100_{mode}_air_flow", 0.0)
            if partial == full:
                continue
            _add_ratio_variable(model, name)
            table = _effectiveness_table(float(partial), float(full))
            curve = model.add("Table:Lookup", f"{name}_{number}", table, source=(_EXCHANGER, name))
            fields[f"{kind}_effectiveness_of_{mode}_air_flow_curve_name"] = curve
            model.note(_EXCHANGER, name, f"{kind}_effectiveness_at_75_{mode}_air_flow is now the table {curve!r}")


def _effectiveness_table(partial: float, full: float) -> dict[str, Any]:
    return {
        "independent_variable_list_name": _RATIOS,
        "normalization_method": "DivisorOnly",
        "normalization_divisor": full,
        "minimum_output": 0.0,
        "maximum_output": 10.0,
        "output_unit_type": "Dimensionless",
        "values": [{"output_value": partial}, {"output_value": full}],
    }


def _add_ratio_variable(model: UpgradingModel, exchanger: str) -> None:
    if _RATIO in dict(model.items("Table:IndependentVariable")):
        return
    variable = {
        "interpolation_method": "Linear",
        "extrapolation_method": "Linear",
        "minimum_value": 0.0,
        "maximum_value": 10.0,
        "unit_type": "Dimensionless",
        "values": [{"value": 0.75}, {"value": 1.0}],
    }
    source = (_EXCHANGER, exchanger)
    model.add("Table:IndependentVariable", _RATIO, variable, source=source)
    variables = {"independent_variables": [{"independent_variable_name": _RATIO}]}
    model.add("Table:IndependentVariableList", _RATIOS, variables, source=source)


def design_objects(model: UpgradingModel) -> None:
    """Move fields of radiant systems and baseboards into design objects (9.4 to 9.5; transition rules V9_5_0)."""
    for kind, moved in _DESIGN_FIELDS.items():
        for name, fields in model.items(kind):
            design = {key: fields.pop(key) for key in moved if key in fields}
            fields["design_object"] = model.add(f"{kind}:Design", f"{name} Design Object", design, source=(kind, name))
            if design:
                model.note(kind, name, f"{', '.join(design)} moved to its design object")


def sequential_fractions(model: UpgradingModel) -> None:
    """Replace the fractions of sequential loads by schedules of them (9.1 to 9.2; schemas)."""
    kind = "ZoneHVAC:EquipmentList"
    schedules: dict[float, str] = {}
    for name, fields in model.items(kind):
        for entry in fields.get("equipment", ()):
            for mode in ("cooling", "heating"):
                value = entry.pop(f"zone_equipment_sequential_{mode}_fraction", None)
                if value in (None, "", 1):
                    continue
                fraction = float(value)
                if fraction not in schedules:
                    schedule = {"hourly_value": fraction}
                    schedules[fraction] = model.add(
                        "Schedule:Constant", f"Sequential Fraction {fraction:g}", schedule, source=(kind, name)
                    )
                entry[f"zone_equipment_sequential_{mode}_fraction_schedule_name"] = schedules[fraction]
                model.note(kind, name, f"a fraction of {fraction:g} is now the schedule {schedules[fraction]!r}")
