"""Models taken back to earlier versions: hand-made inverses of what the bundled models use, and IDF files of them.

Written from EnergyPlus's schemas, independently of the rules of `models/upgrade`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.upgrade.versions import layout_of

Objects = dict[str, dict[str, dict[str, Any]]]

ORDER = (
    *("9.0", "9.1", "9.2", "9.3", "9.4", "9.5", "9.6"),
    *("22.1", "22.2", "23.1", "23.2", "24.1", "24.2", "25.1", "25.2"),
)
HEAT_PUMP_COIL = "Coil:Cooling:WaterToAirHeatPump:EquationFit"
"""A type that cannot be upgraded from 23.1 and earlier."""

_LISTS, _SPACES = "zone_or_zonelist_or_space_or_spacelist_name", "zone_or_space_name"
_LOADS = ("ElectricEquipment", "GasEquipment", "Lights", "OtherEquipment", "People")
_EXCHANGER = "HeatExchanger:AirToAir:SensibleAndLatent"
_NEW_IN_22_2 = 934.4  # W/(m³/s): default of the fan power in the test conditions of 2023


def as_idf(objects: Objects, version: str) -> str:
    """Return a model of the engine's version as an IDF of an earlier one."""
    return write_idf(taken_back(objects, version), layout_of(version, name="test"))


def taken_back(objects: Objects, version: str) -> Objects:
    """Return a model of the engine's version as an epJSON of an earlier one."""
    model = copy.deepcopy(objects)
    for before in reversed(ORDER[ORDER.index(version) : -1]):
        for change in INVERSE.get(before, ()):
            change(model)
    model["Version"] = {"Version 1": {"version_identifier": version}}
    return model


def rename(kinds: str | tuple[str, ...], new: str, old: str, list_name: str = "") -> Callable[[Objects], None]:
    def change(model: Objects) -> None:
        for kind in (kinds,) if isinstance(kinds, str) else kinds:
            for fields in model.get(kind, {}).values():
                for entry in fields.get(list_name, ()) if list_name else (fields,):
                    if new in entry:
                        entry[old] = entry.pop(new)

    return change


def remove(kind: str, field: str, value: Any) -> Callable[[Objects], None]:
    """A field that the earlier version does not have, with the only value that it can have then."""

    def change(model: Objects) -> None:
        for fields in model.get(kind, {}).values():
            assert fields.pop(field, value) == value, (kind, field)

    return change


def word(kind: str, field: str, new: str, old: str) -> Callable[[Objects], None]:
    def change(model: Objects) -> None:
        for fields in model.get(kind, {}).values():
            if fields.get(field) == new:
                fields[field] = old

    return change


def number(kind: str, list_name: str, names: dict[str, str]) -> Callable[[Objects], None]:
    """Numbered fields in place of a list."""

    def change(model: Objects) -> None:
        for fields in model.get(kind, {}).values():
            for index, entry in enumerate(fields.pop(list_name, ()), 1):
                fields.update({pattern.format(index): entry[field] for field, pattern in names.items()})

    return change


def constant_effectiveness(model: Objects) -> None:
    """Effectiveness at 75 % of the air flow in place of the curves of heat exchangers."""
    replaced: set[str] = set()
    for fields in model.get(_EXCHANGER, {}).values():
        for mode in ("heating", "cooling"):
            for kind in ("sensible", "latent"):
                partial = fields.get(f"{kind}_effectiveness_at_100_{mode}_air_flow", 0.0)
                if curve := fields.pop(f"{kind}_effectiveness_of_{mode}_air_flow_curve_name", None):
                    partial = model["Table:Lookup"][curve]["values"][0]["output_value"]
                    replaced.add(curve)
                fields[f"{kind}_effectiveness_at_75_{mode}_air_flow"] = partial
    lists = {model["Table:Lookup"][curve]["independent_variable_list_name"] for curve in replaced}
    for curve in replaced:
        _remove(model, "Table:Lookup", curve)
    for name in lists:
        (variable,) = model["Table:IndependentVariableList"][name]["independent_variables"]
        _remove(model, "Table:IndependentVariable", variable["independent_variable_name"])
        _remove(model, "Table:IndependentVariableList", name)


def _remove(model: Objects, kind: str, name: str) -> None:
    del model[kind][name]
    if not model[kind]:
        del model[kind]


def fuel_factor_fields(model: Objects) -> None:
    for fields in model.get("FuelFactors", {}).values():
        fields |= {"units_of_measure": "J", "energy_per_unit_factor": 1.0}


_FAN_POWER = (
    ("Coil:Cooling:DX:SingleSpeed", "{}_rated_evaporator_fan_power_per_volume_flow_rate"),
    ("Coil:Cooling:DX:MultiSpeed", "{}_speed_1_rated_evaporator_fan_power_per_volume_flow_rate"),
    ("Coil:Cooling:DX:MultiSpeed", "{}_speed_2_rated_evaporator_fan_power_per_volume_flow_rate"),
    ("Coil:Heating:DX:SingleSpeed", "{}_rated_supply_fan_power_per_volume_flow_rate"),
)

INVERSE: dict[str, tuple[Callable[[Objects], None], ...]] = {
    "23.2": (
        rename(("ElectricEquipment", "Lights"), "watts_per_floor_area", "watts_per_zone_floor_area"),
        rename(("GasEquipment", "OtherEquipment"), "power_per_floor_area", "power_per_zone_floor_area"),
        word("People", "mean_radiant_temperature_calculation_type", "EnclosureAveraged", "ZoneAveraged"),
        remove("AirLoopHVAC:UnitarySystem", "no_load_supply_air_flow_rate_control_set_to_low_speed", "No"),
        constant_effectiveness,
    ),
    "23.1": (
        rename("Boiler:HotWater", "on_cycle_parasitic_electric_load", "parasitic_electric_load"),
        rename("Coil:Heating:Fuel", "on_cycle_parasitic_electric_load", "parasitic_electric_load"),
        rename("Coil:Heating:Fuel", "off_cycle_parasitic_fuel_load", "parasitic_fuel_load"),
        rename("EnvironmentalImpactFactors", "district_heating_water_efficiency", "district_heating_efficiency"),
        rename("EnvironmentalImpactFactors", "district_heating_steam_conversion_efficiency",
               "steam_conversion_efficiency"),
    ),
    "22.1": (
        rename("ZoneInfiltration:DesignFlowRate", _LISTS, "zone_or_zonelist_name"),
        rename("ZoneInfiltration:DesignFlowRate", "flow_rate_per_exterior_surface_area",
               "flow_per_exterior_surface_area"),
        rename("ZoneVentilation:DesignFlowRate", _LISTS, "zone_or_zonelist_name"),
        rename("ZoneVentilation:DesignFlowRate", "flow_rate_per_floor_area", "flow_rate_per_zone_floor_area"),
        rename("ZoneVentilation:WindandStackOpenArea", _SPACES, "zone_name"),
        rename("ZoneMixing", _SPACES, "zone_name"),
        rename("ZoneMixing", "source_zone_or_space_name", "source_zone_name"),
        rename("ZoneMixing", "flow_rate_per_floor_area", "flow_rate_per_zone_floor_area"),
        *(rename(kind, field.format(2017), field.format("").removeprefix("_")) for kind, field in _FAN_POWER),
        *(remove(kind, field.format(2023), _NEW_IN_22_2) for kind, field in _FAN_POWER),
        fuel_factor_fields,
    ),
    "9.5": (
        rename(_LOADS, _LISTS, "zone_or_zonelist_name"),
        rename("People", "people_per_floor_area", "people_per_zone_floor_area"),
        rename("People", "floor_area_per_person", "zone_floor_area_per_person"),
        rename(("Daylighting:Controls", "Daylighting:ReferencePoint"), _SPACES, "zone_name"),
        rename("Daylighting:Controls", "fraction_of_lights_controlled_by_reference_point",
               "fraction_of_zone_controlled_by_reference_point", "control_data"),
        word("Controller:MechanicalVentilation", "system_outdoor_air_method", "Standard62.1VentilationRateProcedure",
             "VentilationRateProcedure"),
        word("Sizing:System", "system_outdoor_air_method", "Standard62.1VentilationRateProcedure",
             "VentilationRateProcedure"),
    ),
    "9.3": (
        rename(("Meter:Custom", "Meter:CustomDecrement"), "resource_type", "fuel_type"),
        number("Output:Diagnostics", "diagnostics", {"key": "key_{}"}),
    ),
    "9.2": (
        rename("ShadowCalculation", "shading_calculation_update_frequency_method", "calculation_method"),
        rename("ShadowCalculation", "shading_calculation_update_frequency", "calculation_frequency"),
        rename("ShadowCalculation", "shading_calculation_method", "external_shading_calculation_method"),
        word("ShadowCalculation", "calculation_method", "Periodic", "AverageOverDaysInFrequency"),
        word("ShadowCalculation", "external_shading_calculation_method", "PolygonClipping", "InternalCalculation"),
        rename("Controller:MechanicalVentilation", "zone_or_zonelist_name", "zone_name", "zone_specifications"),
        word("Coil:Heating:Fuel", "fuel_type", "NaturalGas", "Gas"),
    ),
    "9.1": (
        rename("InternalMass", "zone_or_zonelist_name", "zone_name"),
        rename("CoolingTower:SingleSpeed", "free_convection_regime_air_flow_rate", "free_convection_air_flow_rate"),
        rename("CoolingTower:SingleSpeed", "free_convection_regime_u_factor_times_area_value",
               "free_convection_u_factor_times_area_value"),
    ),
    "9.0": (
        number("PlantEquipmentList", "equipment",
               {"equipment_object_type": "equipment_{}_object_type", "equipment_name": "equipment_{}_name"}),
        number("CondenserEquipmentList", "equipment",
               {"equipment_object_type": "equipment_{}_object_type", "equipment_name": "equipment_{}_name"}),
    ),
}  # fmt: skip
"""Changes by the version before the step, newest first within a model."""
