"""Models of earlier EnergyPlus versions: each rule, what no rule covers, and the bundled models there and back."""

from __future__ import annotations

import copy
import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.old_versions import HEAT_PUMP_COIL, as_idf, taken_back
from support.variable_runs import run

from zenostat.models import catalog, energyplus, schema
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.models.upgrade.apply import apply
from zenostat.models.upgrade.files import upgrade_file
from zenostat.models.upgrade.step import UpgradingModel
from zenostat.models.upgrade.upgrade import UpgradedModel, upgrade_epjson, upgrade_idf
from zenostat.models.upgrade.versions import STEPS, schema_document
from zenostat.topics.errors import InvalidConfig

pytestmark = pytest.mark.skipif(not energyplus.version().startswith("25.2"), reason="the steps end at 25.2")
needs_schemas = pytest.mark.usefixtures("idfkit")

NEW_FIELDS = {"no_load_supply_air_flow_rate_control_set_to_low_speed": "No", "cell_control": "MinimalCell"}
"""Values that an upgrade writes where the bundled models leave the field empty."""

LIST_NAME = "zone_or_zonelist_or_space_or_spacelist_name"


@pytest.fixture
def idfkit() -> None:
    pytest.importorskip("idfkit")


def model(version: str | None, **objects: Any) -> dict[str, Any]:
    """A part of a model."""
    return ({"Version": {"v": {"version_identifier": version}}} if version else {}) | objects


def applied(before: str, objects: dict[str, Any]) -> UpgradingModel:
    """Apply the step from a version."""
    upgrading = UpgradingModel(objects)
    (step,) = (step for step in STEPS if step.before == before)
    apply(step, upgrading)
    return upgrading


def refused(model_data: dict[str, Any] | str) -> str:
    """The error of a model that cannot be upgraded."""
    is_idf = isinstance(model_data, str)
    upgrade: Any = upgrade_idf if is_idf else upgrade_epjson
    with pytest.raises(InvalidConfig) as raised:
        upgrade(model_data, name="old.idf" if is_idf else "old.epJSON")
    return str(raised.value)


# Versions


def test_upgrade__steps_follow_each_other_to_this_engine() -> None:
    assert [step.after for step in STEPS[:-1]] == [step.before for step in STEPS[1:]]
    assert energyplus.version().startswith(STEPS[-1].after)
    assert all(step.source for step in STEPS)


@pytest.mark.parametrize("version", ["25.2", "25.2.0", " 25.2", None])
def test_upgrade__engines_own_version_and_none_are_taken_as_they_are(version: str | None) -> None:
    model_data = model(version, Zone={"core": {"nothing_that_energyplus_knows": 1}})
    result = upgrade_epjson(model_data, name="m")
    assert (result.objects, result.changes, result.summary) == (model_data, (), "")


def test_upgrade__what_is_no_version_is_refused_with_its_line() -> None:
    assert "old.epJSON: Version is 'new', which is no version" in refused(model("new", Zone={"core": {}}))
    with pytest.raises(
        InvalidConfig, match=r"old\.idf, line 4: Version is 'new', which is no version of EnergyPlus, such"
    ):
        upgrade_idf("! mine\n\nVersion,\n  new;", name="old.idf")


@pytest.mark.parametrize("version", ["8.9", "24.3", "26.1", "8"])
def test_upgrade__other_versions_are_refused(version: str) -> None:
    reason = f"is for EnergyPlus {version}; the engine's version is 25.2, and models for 9.0 to 25.1 are upgraded"
    assert reason in refused(model(version, Zone={"core": {}}))
    assert reason in refused(f"Version,{version};\nZone, core;")


def test_upgrade__version_in_a_comment_is_none() -> None:
    text = "! Version, 9.0;\nZone, core; ! Version,8.9;"
    assert upgrade_idf(text, name="m").objects == {"Zone": {"core": {}}}


def test_upgrade__newer_engine_takes_its_own_version_only() -> None:
    assert upgrade_epjson(model("26.1"), name="m", engine="26.1.0").changes == ()
    with pytest.raises(InvalidConfig, match=r"the engine's version is 26\.1"):
        upgrade_epjson(model("25.1"), name="m", engine="26.1.0")


def test_upgrade__model_without_what_changed_only_gets_the_engines_version() -> None:
    result = upgrade_epjson(model("9.4", Zone={"core": {}}), name="m")
    assert result.objects == model("25.2", Zone={"core": {}})
    assert result.summary == "upgraded from EnergyPlus 9.4 to 25.2: nothing had to be changed"


def test_upgrade__input_is_untouched() -> None:
    objects = taken_back(dict(read_building(find_building("ref-small-office")).objects), "9.0")
    before = copy.deepcopy(objects)
    assert upgrade_epjson(objects, name="m").changes
    assert objects == before


# Rules

PAIRS = {"temperature_2": 30.0, "temperature_1": 20.0, "enthalpy_1": 1.0, "enthalpy_2": 9.0}


@pytest.mark.parametrize(
    ("before", "kind", "old", "new"),
    [
        ("9.0", "PlantEquipmentList", {"equipment_1_object_type": "Boiler:HotWater", "equipment_1_name": "B"},
         {"equipment": [{"equipment_object_type": "Boiler:HotWater", "equipment_name": "B"}]}),
        ("9.1", "InternalMass", {"zone_name": "Z"}, {"zone_or_zonelist_name": "Z"}),
        ("9.1", "CoolingTower:SingleSpeed",
         {"free_convection_air_flow_rate_sizing_factor": 0.1, "free_convection_u_factor_times_area_value": 2.0},
         {"free_convection_regime_air_flow_rate_sizing_factor": 0.1,
          "free_convection_regime_u_factor_times_area_value": 2.0}),
        ("9.1", "Schedule:File", {"column_separator": "Fixed"}, {"column_separator": "Space"}),
        ("9.1", "ThermalStorage:Ice:Detailed",
         {"discharging_curve_object_type": "QuadraticLinear", "charging_curve_object_type": "CubicLinear"},
         {"discharging_curve_variable_specifications": "FractionDischargedLMTD",
          "charging_curve_variable_specifications": "LMTDMassFlow"}),
        ("9.2", "Boiler:HotWater", {"fuel_type": "FuelOil#1"}, {"fuel_type": "FuelOilNo1"}),
        ("9.2", "Coil:Heating:Fuel", {"fuel_type": "Gas"}, {"fuel_type": "NaturalGas"}),
        ("9.2", "HVACTemplate:Zone:VAV", {"reheat_coil_type": "Gas"}, {"reheat_coil_type": "Gas"}),
        ("9.2", "Building", {}, {"minimum_number_of_warmup_days": 6}),
        ("9.2", "GlobalGeometryRules", {"starting_vertex_position": "ULC", "vertex_entry_direction": "CCW",
                                        "coordinate_system": "WCS"},
         {"starting_vertex_position": "UpperLeftCorner", "vertex_entry_direction": "Counterclockwise",
          "coordinate_system": "World"}),
        ("9.2", "ShadowCalculation", {"calculation_method": "TimestepFrequency", "calculation_frequency": 7,
                                      "external_shading_calculation_method": "ImportedShading"},
         {"shading_calculation_update_frequency_method": "Timestep", "shading_calculation_update_frequency": 7,
          "shading_calculation_method": "Imported"}),
        ("9.2", "EnergyManagementSystem:Program", {"lines": [{"program_line": "SET c = @CpAirFnWTdb W T"}]},
         {"lines": [{"program_line": "SET c = @CpAirFnW W"}]}),
        ("9.3", "EnergyManagementSystem:Actuator", {"actuated_component_control_type": "Electric Power Level"},
         {"actuated_component_control_type": "Electricity Rate"}),
        ("9.3", "EnergyManagementSystem:Sensor", {"output_variable_or_output_meter_name": "Fan Electric Power"},
         {"output_variable_or_output_meter_name": "Fan Electricity Rate"}),
        ("9.3", "UtilityCost:Tariff", {"output_meter_name": "Gas:Facility"},
         {"output_meter_name": "NaturalGas:Facility"}),
        ("9.3", "Curve:DoubleExponentialDecay", {"coefficient3_c4": 4.0}, {"coefficient4_c4": 4.0}),
        ("9.3", "Output:DebuggingData", {"report_debugging_data": 1, "report_during_warmup": 0},
         {"report_debugging_data": "Yes", "report_during_warmup": "No"}),
        ("9.3", "Controller:WaterCoil", {}, {"minimum_actuated_flow": 1e-07}),
        ("9.4", "Construction:AirBoundary", {"solar_and_daylighting_method": "GroupedZones"}, {}),
        ("9.4", "ZoneAirMassFlowConservation", {"adjust_zone_mixing_for_zone_air_mass_flow_balance": "Yes"},
         {"adjust_zone_mixing_and_return_for_air_mass_flow_balance": "AdjustMixingOnly"}),
        ("9.5", "Lights", {"zone_or_zonelist_name": "Z"}, {LIST_NAME: "Z"}),
        ("9.5", "People", {"zone_floor_area_per_person": 9.0}, {"floor_area_per_person": 9.0}),
        ("9.5", "Sizing:System", {"system_outdoor_air_method": "VentilationRateProcedure"},
         {"system_outdoor_air_method": "Standard62.1VentilationRateProcedure"}),
        ("9.5", "Daylighting:Controls", {"control_data": [{"fraction_of_zone_controlled_by_reference_point": 0.5}]},
         {"control_data": [{"fraction_of_lights_controlled_by_reference_point": 0.5}]}),
        ("9.5", "AirLoopHVAC:OutdoorAirSystem", {"availability_manager_list_name": "A"}, {}),
        ("9.6", "Output:Meter", {"key_name": "ElectricEmissions:CO2"}, {"key_name": "ElectricityEmissions:CO2"}),
        ("22.1", "Coil:Cooling:DX:MultiSpeed", {"speed_3_rated_evaporator_fan_power_per_volume_flow_rate": 700.0},
         {"2017_speed_3_rated_evaporator_fan_power_per_volume_flow_rate": 700.0}),
        ("22.1", "ZoneInfiltration:DesignFlowRate", {"zone_or_zonelist_name": "Z", "flow_per_zone_floor_area": 1.0},
         {LIST_NAME: "Z", "flow_rate_per_floor_area": 1.0}),
        ("22.1", "ZoneMixing", {"minimum_source_zone_temperature_schedule_name": "S"},
         {"minimum_source_temperature_schedule_name": "S"}),
        ("22.1", "CoolingTower:TwoSpeed", {"cell_control": "MaximalCell"}, {"cell_control": "MaximalCell"}),
        ("23.1", "Boiler:HotWater", {"parasitic_electric_load": 9.0}, {"on_cycle_parasitic_electric_load": 9.0}),
        ("23.1", "OtherEquipment", {"fuel_type": "DistrictHeating"}, {"fuel_type": "DistrictHeatingWater"}),
        ("23.1", "Output:Variable", {"variable_name": "Zone Other Equipment DistrictHeating Rate"},
         {"variable_name": "Zone Other Equipment DistrictHeatingWater Rate"}),
        ("23.1", "Output:Variable", {"variable_name": "Exterior Equipment Steam Energy"},
         {"variable_name": "Exterior Equipment DistrictHeatingSteam Energy"}),
        ("23.1", "Output:Variable", {"variable_name": "Steam Equipment Total Heating Energy"},
         {"variable_name": "Steam Equipment Total Heating Energy"}),
        ("23.1", "Output:Meter", {"key_name": "InteriorEquipment:Steam:Zone:Z1"},
         {"key_name": "InteriorEquipment:DistrictHeatingSteam:Zone:Z1"}),
        ("23.1", "UtilityCost:Tariff", {"output_meter_name": "Steam:Facility"},
         {"output_meter_name": "DistrictHeatingSteam:Facility"}),
        ("23.1", "Output:Variable", {"variable_name": "District Heating Rate"},
         {"variable_name": "District Heating Water Rate"}),
        ("23.1", "AirLoopHVAC:UnitarySystem", {"maximum_cycling_rate": 2.5}, {}),
        ("23.2", "Lights", {"watts_per_zone_floor_area": 9.0}, {"watts_per_floor_area": 9.0}),
        ("23.2", "People", {"mean_radiant_temperature_calculation_type": "ZoneAveraged"},
         {"mean_radiant_temperature_calculation_type": "EnclosureAveraged"}),
        ("23.2", "ZoneHVAC:WaterToAirHeatPump", {},
         {"no_load_supply_air_flow_rate_control_set_to_low_speed": "No"}),
        ("23.2", "ZoneHVAC:PackagedTerminalAirConditioner",
         {"cooling_coil_object_type": "Coil:Cooling:DX:VariableSpeed"},
         {"cooling_coil_object_type": "Coil:Cooling:DX:VariableSpeed"}),
        ("24.1", "Output:IlluminanceMap", {"zone_name": "Z"}, {"zone_or_space_name": "Z"}),
        ("24.1", "ZoneRefrigerationDoorMixing", {"zone_1_name": "A", "zone_2_name": "B"},
         {"zone_or_space_name_1": "A", "zone_or_space_name_2": "B"}),
        ("24.1", "ZoneThermalChimney",
         {"zone_name": "C", "zone_12_name": "A", "relative_ratios_of_air_flow_rates_passing_through_zone_12": 0.5},
         {"zone_name": "C", "zone_or_space_name_12": "A",
          "relative_ratios_of_air_flow_rates_passing_through_inlet_12": 0.5}),
        ("24.1", "MaterialProperty:PhaseChange",
         {"temperature_coefficient_for_thermal_conductivity": 0.1, **PAIRS},
         {"temperature_coefficient_for_thermal_conductivity": 0.1,
          "values": [{"temperature": 20.0, "enthalpy": 1.0}, {"temperature": 30.0, "enthalpy": 9.0}]}),
        ("25.1", "Coil:Cooling:DX:VariableSpeed",
         {"speed_7_reference_unit_condenser_flow_rate": 1.0, "speed_10_reference_unit_condenser_air_flow_rate": 2.0},
         {"speed_7_reference_unit_rated_condenser_air_flow_rate": 1.0,
          "speed_10_reference_unit_rated_condenser_air_flow_rate": 2.0}),
        ("25.1", "Coil:WaterHeating:AirToWaterHeatPump:VariableSpeed",
         {"rated_water_heating_cop_at_speed_10": 3.0, "rated_water_heating_capacity": 8.0},
         {"speed_10_rated_water_heating_cop": 3.0, "rated_water_heating_capacity": 8.0}),
        ("25.1", "ComfortViewFactorAngles", {"surface_1_name": "S", "angle_factor_1": 0.4},
         {"angles": [{"surface_name": "S", "angle_factor": 0.4}]}),
        ("25.1", "HeatExchanger:Desiccant:BalancedFlow", {}, {"economizer_lockout": "No"}),
        ("25.1", "HeatExchanger:Desiccant:BalancedFlow", {"economizer_lockout": "Yes"}, {"economizer_lockout": "Yes"}),
    ],
)  # fmt: skip
def test_version_step__changes_the_fields(before: str, kind: str, old: dict[str, Any], new: dict[str, Any]) -> None:
    result = applied(before, {kind: {"it": copy.deepcopy(old)}})
    assert result.objects == {kind: {"it": new}}
    assert {(change.kind, change.name) for change in result.changes} == ({(kind, "it")} if old != new else set())


def test_version_step__name_in_a_field_becomes_the_objects_name() -> None:
    result = applied("25.1", {"Output:Table:ReportPeriod": {"1": {"name_": "Outage", "report_name_": "R"}}})
    assert result.objects == {"Output:Table:ReportPeriod": {"Outage": {"report_name": "R"}}}
    assert result.origin("Output:Table:ReportPeriod", "Outage") == ("Output:Table:ReportPeriod", "1")


def test_version_step__renamed_type_is_renamed_where_it_is_named() -> None:
    branch = {"components": [{"component_object_type": "DistrictHeating", "component_name": "Purchased"}]}
    result = applied("23.1", {"DistrictHeating": {"Purchased": {}}, "Branch": {"B": branch}})
    assert result.objects["DistrictHeating:Water"] == {"Purchased": {}}
    assert result.objects["Branch"]["B"]["components"][0]["component_object_type"] == "DistrictHeating:Water"


def test_version_step__renamed_type_is_renamed_in_an_actuator_of_plant_equipment() -> None:
    actuator = {"actuated_component_type": "Plant Component DistrictHeating"}
    result = applied("23.1", {"EnergyManagementSystem:Actuator": {"On": actuator}})
    renamed = result.objects["EnergyManagementSystem:Actuator"]["On"]
    assert renamed == {"actuated_component_type": "Plant Component DistrictHeating:Water"}


VARIABLES = {
    "Electricity:Facility": "Electricity:Facility",
    "InteriorEquipment:Gas": "InteriorEquipment:NaturalGas",
    "Zone Lights Electric Power": "Zone Lights Electricity Rate",
    "Facility Total HVAC Electric Demand Power": "Facility Total HVAC Electricity Demand Rate",
    "Facility Total Electric Demand Power": "Facility Total Electricity Demand Rate",
    "Generator Produced Electric Power": "Generator Produced AC Electricity Rate",
    "Generator Produced Electric Energy": "Generator Produced AC Electricity Energy",
    "Generator Produced DC Electric Power": "Generator Produced DC Electricity Rate",
    "Generator Gas HHV Basis Rate": "Generator NaturalGas HHV Basis Rate",
    "Chiller Gas Mass Flow Rate": "Chiller NaturalGas Mass Flow Rate",
    "Converter Electric Loss Power": "Converter Electricity Loss Rate",
    "Converter Electric Loss Decrement Energy": "Converter Electricity Loss Decrement Energy",
    "ITE CPU Electric Power at Design Inlet Conditions": "ITE CPU Electricity Rate at Design Inlet Conditions",
    "Chiller Heater Cooling Electric Power Unit 1": "Chiller Heater Cooling Electricity Rate Unit 1",
    "Humidifier Gas Use Rate": "Humidifier NaturalGas Rate",
    "Humidifier Gas Use Thermal Efficiency": "Humidifier NaturalGas Use Thermal Efficiency",
    "Environmental Impact Fuel Oil #2 Source Energy": "Environmental Impact FuelOilNo2 Source Energy",
    "Environmental Impact Natural Gas CO2 Emissions Mass": "Environmental Impact NaturalGas CO2 Emissions Mass",
    "Cooling Coil FuelOil#1 Power": "Cooling Coil FuelOilNo1 Rate",
    "Cooling Coil FuelOil#1 Energy": "Cooling Coil FuelOilNo1 Energy",
    "Cooling Coil NaturalGas Power": "Cooling Coil NaturalGas Rate",
    "Cooling Coil OtherFuel2 Power": "Cooling Coil OtherFuel2 Rate",
    "Cooling Coil Waste Heat Power": "Cooling Coil Waste Heat Power",
    "Refrigeration Zone Air Chiller Fan Electric Energy": "Refrigeration Zone Air Chiller Fan Electric Energy",
    "Electric Storage Charge Power": "Electric Storage Charge Power",
}
"""Names of 9.3 and of 9.4, by EnergyPlus's table of renamed report variables; of a cooling coil's fuels, as EnergyPlus
itself has them."""


@pytest.mark.parametrize("old", VARIABLES)
def test_version_step__renames_output_variables_and_meters(old: str) -> None:
    result = applied("9.3", {"EnergyManagementSystem:Sensor": {"S": {"output_variable_or_output_meter_name": old}}})
    sensor = result.objects["EnergyManagementSystem:Sensor"]["S"]
    assert sensor["output_variable_or_output_meter_name"] == VARIABLES[old]


def test_version_step__meters_of_a_transformer_are_renamed() -> None:
    meters = {"meters": [{"meter_name": "InteriorLights:Electric"}, {"meter_name": "Electric:Facility"}]}
    result = applied("9.3", {"ElectricLoadCenter:Transformer": {"Grid": meters}})
    renamed = [meter["meter_name"] for meter in result.objects["ElectricLoadCenter:Transformer"]["Grid"]["meters"]]
    assert renamed == ["InteriorLights:Electricity", "Electricity:Facility"]


def test_version_step__custom_meters_keep_their_names() -> None:
    meters = {"Meter:Custom": {"Gas:Mine": {"variable_details": [{"output_variable_or_meter_name": "Gas:Zone:Core"}]}}}
    result = applied("9.3", meters | {"Output:Meter": {"1": {"key_name": "Gas:Mine"}}})
    assert result.objects["Output:Meter"] == {"1": {"key_name": "Gas:Mine"}}
    (detail,) = result.objects["Meter:Custom"]["Gas:Mine"]["variable_details"]
    assert detail["output_variable_or_meter_name"] == "NaturalGas:Zone:Core"


def test_version_step__several_diagnostics_become_one() -> None:
    result = applied("9.3", {"Output:Diagnostics": {"1": {"key_1": "A", "key_2": "B"}, "2": {"key_1": "C"}}})
    assert result.objects == {"Output:Diagnostics": {"1": {"diagnostics": [{"key": key} for key in "ABC"]}}}


def test_version_step__construction_with_a_source_is_split() -> None:
    old = {"source_present_after_layer_number": 2, "tube_spacing": 0.15, "outside_layer": "A", "layer_2": "B"}
    result = applied("9.4", {"Construction:InternalSource": {"Floor": old}})
    assert result.objects == {
        "Construction": {"Floor": {"outside_layer": "A", "layer_2": "B"}},
        "ConstructionProperty:InternalHeatSource": {
            "Floor Heat Source": {
                "construction_name": "Floor",
                "thermal_source_present_after_layer_number": 2,
                "tube_spacing": 0.15,
            }
        },
    }
    assert result.origin("Construction", "Floor") == ("Construction:InternalSource", "Floor")


def test_version_step__fields_of_radiant_systems_move_to_design_objects() -> None:
    kind = "ZoneHVAC:LowTemperatureRadiant:VariableFlow"
    result = applied("9.4", {kind: {"Floor": {"zone_name": "Z", "hydronic_tubing_inside_diameter": 0.012}}})
    assert result.objects == {
        kind: {"Floor": {"zone_name": "Z", "design_object": "Floor Design Object"}},
        f"{kind}:Design": {"Floor Design Object": {"hydronic_tubing_inside_diameter": 0.012}},
    }


def test_version_step__coefficients_of_heat_pumps_become_curves() -> None:
    """The function stays c1 + c2·TWb + c3·TS + c4·Vair + c5·Vwater."""
    coefficients = {
        f"heating_capacity_coefficient_{i}": value for i, value in enumerate([1.0, -2.0, 3.0, 0.5, 0.25], 1)
    }
    result = applied("9.4", {"HeatPump:WaterToWater:EquationFit:Heating": {"HP": coefficients}})
    ((name, curve),) = result.objects["Curve:QuadLinear"].items()
    assert result.objects["HeatPump:WaterToWater:EquationFit:Heating"]["HP"] == {"heating_capacity_curve_name": name}
    values = {"w": 1.1, "x": 1.2, "y": 0.9, "z": 0.8}
    fields = zip("wxyz", ("coefficient2_w", "coefficient3_x", "coefficient4_y", "coefficient5_z"), strict=True)
    assert curve["coefficient1_constant"] + sum(curve[field] * values[letter] for letter, field in fields) == (
        pytest.approx(1.0 - 2.0 * 1.1 + 3.0 * 1.2 + 0.5 * 0.9 + 0.25 * 0.8)
    )
    assert schema.schema_errors({"Curve:QuadLinear": {name: curve}}, complete=True) == []


def test_version_step__effectiveness_at_partial_flow_becomes_a_table() -> None:
    kind = "HeatExchanger:AirToAir:SensibleAndLatent"
    old = {"sensible_effectiveness_at_100_heating_air_flow": 0.7, "sensible_effectiveness_at_75_heating_air_flow": 0.8}
    result = applied("23.2", {kind: {"A": dict(old), "B": dict(old)}})
    for name in "AB":
        curve = result.objects[kind][name].pop("sensible_effectiveness_of_heating_air_flow_curve_name")
        assert result.objects[kind][name] == {"sensible_effectiveness_at_100_heating_air_flow": 0.7}
        table = result.objects["Table:Lookup"][curve]
        assert (table["normalization_divisor"], table["values"]) == (
            0.7,
            [{"output_value": 0.8}, {"output_value": 0.7}],
        )
    ((_, variable),) = result.objects["Table:IndependentVariable"].items()
    assert variable["values"] == [{"value": 0.75}, {"value": 1.0}]
    tables = {kind: items for kind, items in result.objects.items() if kind.startswith("Table")}
    assert schema.schema_errors(tables, complete=True) == []


def test_version_step__constant_effectiveness_needs_no_table() -> None:
    kind = "HeatExchanger:AirToAir:SensibleAndLatent"
    old = {"latent_effectiveness_at_100_cooling_air_flow": 0.6, "latent_effectiveness_at_75_cooling_air_flow": 0.6}
    assert applied("23.2", {kind: {"A": old}}).objects == {
        kind: {"A": {"latent_effectiveness_at_100_cooling_air_flow": 0.6}}
    }


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("Table:TwoIndependentVariables",
         {"values": [{"x_value_1": x, "y_value_1": y, "output_value_1": 10 * x + y}
                     for y in (5, 4) for x in (1, 2, 3)]}),
        ("Table:MultiVariableLookup",  # three values of x, two of y; x changes fastest
         {"number_of_independent_variables": 2, "number_of_values_for_independent_variable_x1": 3,
          "field_1_determined_by_the_number_of_independent_variables": 2,
          "field_2_determined_by_the_number_of_independent_variables": 1,
          "values": [{"field_determined_by_the_number_of_independent_variables": value}
                     for value in (2, 3, 4, 5, 14, 24, 34, 15, 25, 35)]}),
    ],
)  # fmt: skip
def test_version_step__table_keeps_its_values(kind: str, fields: dict[str, Any]) -> None:
    extra = {"interpolation_method": "LinearInterpolationOfTable", "normalization_reference": 2.0}
    result = applied("9.1", {kind: {"T": fields | extra}})
    assert kind not in result.objects
    table = result.objects["Table:Lookup"]["T"]
    assert [entry["output_value"] for entry in table["values"]] == [14, 15, 24, 25, 34, 35]
    assert table["normalization_divisor"] == 2.0
    axes = [[e["value"] for e in v["values"]] for v in result.objects["Table:IndependentVariable"].values()]
    assert axes == [[1, 2, 3], [4, 5]]
    assert schema.schema_errors(result.objects, complete=True) == []


def test_version_step__table_in_a_file_is_refused() -> None:
    result = applied("9.1", {"Table:MultiVariableLookup": {"T": {"external_file_name": "t.csv"}}})
    assert [refusal.text for refusal in result.refusals] == [
        "its data are in an external file; write them into the object"
    ]


def test_version_step__uncontrolled_terminal_gets_a_node_and_a_unit() -> None:
    objects = {
        "AirTerminal:SingleDuct:Uncontrolled": {
            "Direct": {"zone_supply_air_node_name": "In", "maximum_air_flow_rate": 1.0,
                       "design_specification_air_terminal_sizing_object_name": "Size"}
        },
        "ZoneHVAC:EquipmentList": {
            "E": {"equipment": [{"zone_equipment_object_type": "AirTerminal:SingleDuct:Uncontrolled",
                                 "zone_equipment_name": "DIRECT", "zone_equipment_cooling_sequence": 1}]}
        },
        "AirLoopHVAC:ZoneSplitter": {"S": {"inlet_node_name": "X", "nodes": [{"outlet_node_name": "IN"}]}},
        "NodeList": {"L": {"nodes": [{"node_name": "In"}, {"node_name": "Other"}]}},
        "AirLoopHVAC": {"A": {"demand_side_inlet_node_names": "L"}},
    }  # fmt: skip
    result = applied("9.2", objects).objects
    assert "AirTerminal:SingleDuct:Uncontrolled" not in result
    assert result["AirTerminal:SingleDuct:ConstantVolume:NoReheat"]["Direct"] == {
        "air_inlet_node_name": "In ATInlet", "air_outlet_node_name": "In", "maximum_air_flow_rate": 1.0
    }  # fmt: skip
    assert result["ZoneHVAC:AirDistributionUnit"]["Direct ADU"] == {
        "air_distribution_unit_outlet_node_name": "In",
        "air_terminal_object_type": "AirTerminal:SingleDuct:ConstantVolume:NoReheat",
        "air_terminal_name": "Direct",
        "design_specification_air_terminal_sizing_object_name": "Size",
    }
    (entry,) = result["ZoneHVAC:EquipmentList"]["E"]["equipment"]
    assert (entry["zone_equipment_object_type"], entry["zone_equipment_name"]) == (
        "ZoneHVAC:AirDistributionUnit", "Direct ADU"
    )  # fmt: skip
    assert result["AirLoopHVAC:ZoneSplitter"]["S"]["nodes"] == [{"outlet_node_name": "In ATInlet"}]
    assert result["AirLoopHVAC"]["A"]["demand_side_inlet_node_names"] == "L ATInlet"
    assert result["NodeList"]["L ATInlet"]["nodes"] == [{"node_name": "In ATInlet"}, {"node_name": "Other"}]
    assert result["NodeList"]["L"]["nodes"][0] == {"node_name": "In"}


def test_version_step__sequential_fraction_becomes_a_schedule() -> None:
    entry = {"zone_equipment_name": "U", "zone_equipment_sequential_cooling_fraction": 0.6,
             "zone_equipment_sequential_heating_fraction": 1}  # fmt: skip
    result = applied("9.1", {"ZoneHVAC:EquipmentList": {"E": {"equipment": [entry]}}}).objects
    ((name, schedule),) = result["Schedule:Constant"].items()
    assert schedule["hourly_value"] == 0.6
    assert result["ZoneHVAC:EquipmentList"]["E"]["equipment"] == [
        {"zone_equipment_name": "U", "zone_equipment_sequential_cooling_fraction_schedule_name": name}
    ]


@needs_schemas
@pytest.mark.parametrize("version", ["9.0", "9.1"])
def test_upgrade__run_periods_without_names_get_some(version: str) -> None:
    """A run period needed no name before 9.2."""
    idf = f"Version,{version};\nRunPeriod, , 1, 2, , 3, 4;\nRunPeriod, , 5, 6, , 7, 8;"
    days = {"begin_month": 1, "begin_day_of_month": 2, "end_month": 3, "end_day_of_month": 4}
    periods = {"RunPeriod 1": days, "RunPeriod 2": {key: value + 4 for key, value in days.items()}}
    assert upgrade_idf(idf, name="m").objects["RunPeriod"] == periods
    assert upgrade_epjson(model(version, RunPeriod={"": days}), name="m").objects["RunPeriod"] == {"RunPeriod 1": days}
    assert "is in the file twice" in refused(f"Version,{version};\nRunPeriod, a, 1;\nRunPeriod, A, 2;")


# All differences of the schemas

UNCHANGED_DEFAULTS = {
    ("UtilityCost:Charge:Block", "season"),  # costs do not act on the simulation
    ("Coil:Heating:Fuel", "fuel_type"),  # Gas is now NaturalGas
    ("Controller:MechanicalVentilation", "system_outdoor_air_method"),  # a new name of the same method
    ("People", "mean_radiant_temperature_calculation_type"),  # the same
    ("ThermalStorage:ChilledWater:Stratified", "deadband_temperature_difference"),  # 0 is no longer allowed
}


def rules_of(document: dict[str, Any], kind: str) -> dict[str, Any]:
    """The fields of a type, with those of its list as `LIST.FIELD`."""
    (shape,) = document["properties"][kind]["patternProperties"].values()
    fields = dict(shape["properties"])
    for name, rule in shape["properties"].items():
        if "items" in rule:
            fields |= {f"{name}.{inner}": value for inner, value in rule["items"]["properties"].items()}
    return fields


def plain(default: Any) -> Any:
    try:
        return float(default)
    except (TypeError, ValueError):
        return str(default).casefold()


@needs_schemas
@pytest.mark.parametrize(
    "step", [pytest.param(s, id=s.before, marks=[] if s.before in ("9.1", "23.1") else pytest.mark.slow) for s in STEPS]
)
def test_version_step__covers_what_the_schemas_removed_and_changed(step: Any) -> None:
    """Each removed field and each changed default of the older schema is moved, dropped, kept or refused; no other."""
    old, new = schema_document(step.before), schema_document(step.after)
    missed = []
    for kind in old["properties"]:
        before = rules_of(old, kind)
        after = rules_of(new, kind) if kind in new["properties"] else None
        # A pattern of renames must not match a field that stays.
        kept = {field for field, rule in (after or {}).items() if kind not in step.fields or "items" in rule}
        for field in [""] if after is None else before.keys() - kept - {"name"}:
            missed += [f"{kind}.{name}" for name in left_by(step.before, kind, field) if name not in (after or ())]
        for field in before.keys() & (after or {}).keys():
            default = before[field].get("default")
            if default is not None and plain(default) != plain(after[field].get("default")) and kind != "Version":
                (values,) = (fields for _, fields in applied(step.before, {kind: {"it": {}}}).items(kind))
                if field not in values and (kind, field) not in UNCHANGED_DEFAULTS:
                    missed.append(f"default of {kind}.{field}")
    assert missed == []


def left_by(before: str, kind: str, field: str) -> list[str]:
    """The fields that an object with one field has after a step; none if it is refused or has another type."""
    list_name, _, inner = field.rpartition(".")
    fields = {list_name: [{inner: 1}]} if list_name else {field: 1} if field else {}
    result = applied(before, {kind: {"it": fields}})
    if result.refusals:
        return []
    left = []
    for values in result.objects.get(kind, {}).values():
        entries = values.get(list_name, []) if list_name else []
        left += [f"{list_name}.{name}" for entry in entries for name in entry] if list_name else list(values)
        left += [] if field else [""]
    return left


@needs_schemas
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("Version,9.4;\nZone,\n  Core\n  0;\n", "line 3: Zone 'Core 0': ',' or ';' is missing within 'Core 0'"),
        ("Version,9.4;\nZone,\n  Core,\n  0,\nZone,\n  Attic;\n", "line 5: Zone 'Core' does not end: ';' is missing"),
        ("Version,9.4;\nZone,\n  Core,\n  0", "line 4: Zone 'Core' does not end: ';' is missing after its last field"),
        ("Version,9.4,\n 1;", "line 2: Version 'Version 1' has 2 fields, but the type has 1"),
        ("Version,9.4;\nZone,Core;\nZone,\nCORE;", "line 3: Zone 'CORE' is in the file twice; first in line 2"),
        ("Version,9.4;\nZonne,Core;", "line 2: EnergyPlus has no object type 'Zonne'; did you mean 'Zone"),
    ],
)
def test_upgrade__syntax_error_of_an_earlier_version_is_named_with_its_line(text: str, reason: str) -> None:
    head, error = refused(text).split("\n")
    assert head == "old.idf is not an IDF for EnergyPlus 9.4:"
    assert error.strip().startswith(reason)


# What no rule covers


@needs_schemas
def test_upgrade__what_still_does_not_fit_is_refused_by_line() -> None:
    text = "Version,9.4;\n\nLights,\n  Office Lights,\n  Core,\n  S,\n  Watts/Area,\n  ,\n  -3;\nZone,Core;\n"
    message = refused(text)
    assert message.startswith("old.idf is for EnergyPlus 9.4 and cannot be upgraded to 25.2:")
    assert re.search(r"line 9: Lights 'Office Lights': watts_per_floor_area is -3; expected a number", message)


@needs_schemas
def test_upgrade__words_that_had_no_list_are_taken_in_any_case() -> None:
    rules = {
        "starting_vertex_position": "UPPERLEFTCORNER",
        "vertex_entry_direction": "CounterClockWise",
        "coordinate_system": "RELATIVE",
    }
    upgraded = upgrade_epjson(model("9.2", GlobalGeometryRules={"G": rules}), name="old.epJSON")
    assert upgraded.objects["GlobalGeometryRules"]["G"] == {
        "starting_vertex_position": "UpperLeftCorner",
        "vertex_entry_direction": "Counterclockwise",
        "coordinate_system": "Relative",
    }


def test_upgrade__type_without_a_rule_is_refused_with_the_reason() -> None:
    message = refused(f"Version,23.1;\n\n\n{HEAT_PUMP_COIL},\n  Coil A;\n")
    assert f"line 4: {HEAT_PUMP_COIL} 'Coil A': its part-load losses came from a cycling rate" in message
    kind = "FaultModel:PressureSensorOffset:OutdoorAir"
    assert refused(model("9.0", **{kind: {"F": {}}})).split("\n")[1:] == [
        f"  {kind} 'F': EnergyPlus has no such fault since 9.1; remove it"
    ]


def test_upgrade__unknown_field_and_type_of_an_epjson_are_refused_by_name() -> None:
    message = refused(model("25.1", Zone={"core": {"multiplyer": 2}}, Zonne={}))
    field, kind = message.split("\n")[1:]
    assert field.startswith("  Zone 'core': has no field 'multiplyer'; did you mean 'multiplier'")
    assert kind.startswith("  Zonne: EnergyPlus has no object type 'Zonne'; did you mean ")


def test_upgrade__what_does_not_fit_is_refused_by_the_line_of_an_epjson(tmp_path: Path) -> None:
    rules = {"starting_vertex_position": "UpperLeftCorner", "vertex_entry_direction": "Around"}
    old = model("9.2", Building={"B": {}}, GlobalGeometryRules={"G": rules | {"coordinate_system": "World"}})
    path = tmp_path / "old.epJSON"
    path.write_text(json.dumps(old, indent=1))
    line = 1 + next(i for i, text in enumerate(path.read_text().splitlines()) if "Around" in text)
    for read in (lambda: upgrade_file(path), lambda: read_building(find_building(str(path)))):
        with pytest.raises(InvalidConfig, match=rf"\n  line {line}: GlobalGeometryRules 'G': .*'Around'"):
            read()


def test_upgrade__objects_that_are_none_are_refused() -> None:
    assert refused(model("25.1", Zone={"core": 3})).endswith("\nZone 'core': expected fields by name, got 3")
    assert "Version: expected objects by name, got '25.1'" in refused({"Version": "25.1"})


@needs_schemas
def test_upgrade__idf_is_read_by_its_own_versions_order() -> None:
    """Space is a field of surfaces since 9.6; before, the outside boundary was at its place."""
    text = "Version,{};\nBuildingSurface:Detailed,W,Wall,C,Z,{}Outdoors,,SunExposed,WindExposed,,3,0,0,3,0,0,0,3,0,0;"
    old = upgrade_idf(text.format("9.5", ""), name="m").objects["BuildingSurface:Detailed"]
    new = upgrade_idf(text.format("9.6", ","), name="m").objects["BuildingSurface:Detailed"]
    assert old == new
    assert old["W"]["outside_boundary_condition"] == "Outdoors"


# The bundled models, there and back

QUICK = (("9.0", "ref-small-office"), ("22.1", "office-medium"))
CASES = [(version, entry.name) for version in ("9.0", "9.4", "22.1", "24.1") for entry in catalog.bundled_buildings()]


def there_and_back(version: str, name: str) -> tuple[Any, UpgradedModel]:
    building = read_building(find_building(name))
    if version != "24.1" and HEAT_PUMP_COIL in building.objects:
        pytest.skip("water-to-air heat pumps of 23.1 and earlier are refused")
    return building, upgrade_idf(as_idf(building.objects, version), name=name)


@needs_schemas
@pytest.mark.parametrize(
    ("version", "name"), [pytest.param(*c, marks=[] if c in QUICK else pytest.mark.slow) for c in CASES]
)
def test_upgrade__model_of_an_earlier_version_is_the_same_after_its_return(version: str, name: str) -> None:
    building, upgraded = there_and_back(version, name)
    tables = ("Table:Lookup", "Table:IndependentVariable", "Table:IndependentVariableList")
    for kind in (building.objects.keys() | upgraded.objects.keys()) - {*tables, "Version"}:
        before, after = building.objects.get(kind, {}), upgraded.objects.get(kind, {})
        assert before.keys() == after.keys(), kind
        for key, fields in before.items():
            added = {f for f, v in after[key].items() if f not in fields and NEW_FIELDS.get(f) == v}
            assert compared(fields) == compared({f: v for f, v in after[key].items() if f not in added}), (kind, key)


def compared(fields: dict[str, Any]) -> dict[str, Any]:
    """Leave out defaults that old versions do not have, and the names of curves that the upgrade adds."""
    return {f: v for f, v in fields.items() if not f.startswith(("idf_", "2023_")) and "curve_name" not in f}


@needs_schemas
@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", [entry.name for entry in catalog.bundled_buildings()])
def test_upgrade__model_of_9_0_runs_equal_to_the_bit_after_its_return(name: str, tmp_path: Path) -> None:
    building, upgraded = there_and_back("9.0", name)
    returned = dataclasses.replace(building, objects=upgraded.objects)
    points = [("Zone Mean Air Temperature", zone) for zone in building.objects["Zone"]]
    points.append(("Facility Total HVAC Electricity Demand Rate", "Whole Building"))
    before = run(building, points, tmp_path / "before", begin="07-15", end="07-15")
    after = run(returned, points, tmp_path / "after", begin="07-15", end="07-15")
    np.testing.assert_array_equal(after, before)
