"""Rules of the steps from 9.0 to 22.1; see `from_22` for their sources."""

from __future__ import annotations

from zenostat.models.upgrade import air_terminal_rules, curve_rules, equipment_rules, simulation_rules
from zenostat.models.upgrade.step import FUEL_FIELD, Renames, VersionStep
from zenostat.models.upgrade.table_rules import lookup_tables

_ZONE_OR_LIST: Renames = (("zone_name", "zone_or_zonelist_name"),)
_SPACE_LISTS: Renames = (("zone_or_zonelist_name", "zone_or_zonelist_or_space_or_spacelist_name"),)
_EQUIPMENT: tuple[str, Renames] = (
    "equipment",
    ((r"equipment_(\d+)_object_type", "equipment_object_type"), (r"equipment_(\d+)_name", "equipment_name")),
)
_FUELS = {
    "Gas": "NaturalGas",
    "Natural Gas": "NaturalGas",
    "Electric": "Electricity",
    "Elec": "Electricity",
    "FuelOil#1": "FuelOilNo1",
    "Fuel Oil #1": "FuelOilNo1",
    "Fuel Oil": "FuelOilNo1",
    "Distillate Oil": "FuelOilNo1",
    "FuelOil#2": "FuelOilNo2",
    "Fuel Oil #2": "FuelOilNo2",
    "Residual Oil": "FuelOilNo2",
    "PropaneGas": "Propane",
    "Propane Gas": "Propane",
    "LPG": "Propane",
}
_COORDINATES = {
    "WCS": "World",
    "WorldCoordinateSystem": "World",
    "Absolute": "World",
    "Rel": "Relative",
    "RelativeCoordinateSystem": "Relative",
    "RelativeToZone": "Relative",
    "Local": "Relative",
}
_REPORTS = {
    "ABUPS": "AnnualBuildingUtilityPerformanceSummary",
    "BEPS": "AnnualBuildingUtilityPerformanceSummary",
    "IVRS": "InputVerificationandResultsSummary",
    "CSS": "ComponentSizingSummary",
    "SHAD": "SurfaceShadowingSummary",
    "EIO": "InitializationSummary",
}
_SUFFIX = "( at Design Inlet Conditions| Unit .*)?"
"""Words after the quantity in the name of an output variable."""
_VENTILATION = {"VentilationRateProcedure": "Standard62.1VentilationRateProcedure"}

STEPS = (
    VersionStep(
        "9.0",
        "9.1",
        "Input Changes 9.0.0 to 9.1.0, schemas 9.0.1 and 9.1",
        listed={"CondenserEquipmentList": _EQUIPMENT, "PlantEquipmentList": _EQUIPMENT},
        refused={"FaultModel:PressureSensorOffset:OutdoorAir": "EnergyPlus has no such fault since 9.1; remove it"},
    ),
    VersionStep(
        "9.1",
        "9.2",
        "Input Changes 9.1.0 to 9.2.0, transition rules V9_2_0, schemas 9.1 and 9.2",
        fields={
            "CoolingTower:SingleSpeed": (
                (r"free_convection_(air_flow_rate.*|u_factor_times_area_value)", r"free_convection_regime_\1"),
            ),
            "InternalMass": _ZONE_OR_LIST,
            "ThermalStorage:Ice:Detailed": (
                (r"(discharging|charging)_curve_object_type", r"\1_curve_variable_specifications"),
            ),
            "WindowShadingControl": (("construction_with_shading_name_", "construction_with_shading_name"),),
            "ZoneProperty:UserViewFactors:bySurfaceName": _ZONE_OR_LIST,
        },
        words=(
            ("Schedule:File", "column_separator", {"Fixed": "Space"}),
            (
                "ThermalStorage:Ice:Detailed",
                "discharging_curve_variable_specifications",
                {"QuadraticLinear": "FractionDischargedLMTD", "CubicLinear": "LMTDMassFlow"},
            ),
            (
                "ThermalStorage:Ice:Detailed",
                "charging_curve_variable_specifications",
                {"QuadraticLinear": "FractionChargedLMTD", "CubicLinear": "LMTDMassFlow"},
            ),
        ),
        functions=(equipment_rules.sequential_fractions, lookup_tables, simulation_rules.run_period_names),
    ),
    VersionStep(
        "9.2",
        "9.3",
        "Input Changes 9.2.0 to 9.3.0, transition rules V9_3_0, Report Variables 9-2-0 to 9-3-0, schemas 9.2 and 9.3",
        types={
            "HeatPump:WaterToWater:EIR:Heating": "HeatPump:PlantLoop:EIR:Heating",
            "HeatPump:WaterToWater:EIR:Cooling": "HeatPump:PlantLoop:EIR:Cooling",
        },
        fields={
            "ShadowCalculation": (
                ("calculation_method", "shading_calculation_update_frequency_method"),
                ("calculation_frequency", "shading_calculation_update_frequency"),
                ("external_shading_calculation_method", "shading_calculation_method"),
            ),
        },
        entries={"Controller:MechanicalVentilation": ("zone_specifications", _ZONE_OR_LIST)},
        defaults={"Building": {"minimum_number_of_warmup_days": 6}},
        words=(
            (r".*", FUEL_FIELD, _FUELS),
            (
                "GlobalGeometryRules",
                "starting_vertex_position",
                {
                    "ULC": "UpperLeftCorner",
                    "LLC": "LowerLeftCorner",
                    "LRC": "LowerRightCorner",
                    "URC": "UpperRightCorner",
                },
            ),
            (
                "GlobalGeometryRules",
                "vertex_entry_direction",
                {"CCW": "Counterclockwise", "CW": "Clockwise"},
            ),
            ("GlobalGeometryRules", r".*coordinate_system", _COORDINATES),
            ("Output:Table:SummaryReports", "report_name", _REPORTS),
            (
                "RoomAir:Node:AirflowNetwork:HVACEquipment",
                "zonehvac_or_air_terminal_equipment_object_type",
                {"AirTerminal:SingleDuct:Uncontrolled": "AirTerminal:SingleDuct:ConstantVolume:NoReheat"},
            ),
            (
                "ShadowCalculation",
                "shading_calculation_update_frequency_method",
                {"AverageOverDaysInFrequency": "Periodic", "TimestepFrequency": "Timestep"},
            ),
            (
                "ShadowCalculation",
                "shading_calculation_method",
                {
                    "InternalCalculation": "PolygonClipping",
                    "ImportedShading": "Imported",
                    "ScheduledShading": "Scheduled",
                },
            ),
        ),
        variables=(
            (
                r"Water to Water Heat Pump ((?:Load|Source) Side (?:Heat Transfer (?:Rate|Energy)|Inlet Temperature"
                r"|Outlet Temperature|Mass Flow Rate)|Electric (?:Power|Energy))",
                r"Heat Pump \1",
            ),
            (r"AirTerminal:SingleDuct:Uncontrolled(.*)", r"AirTerminal:SingleDuct:ConstantVolume:NoReheat\1"),
        ),
        functions=(air_terminal_rules.uncontrolled_terminals, simulation_rules.specific_heat_function),
    ),
    VersionStep(
        "9.3",
        "9.4",
        "Input Changes 9.3.0 to 9.4.0, transition rules V9_4_0, Report Variables 9-3-0 to 9-4-0, schemas 9.3 and 9.4",
        types={"ZoneProperty:UserViewFactors:bySurfaceName": "ZoneProperty:UserViewFactors:BySurfaceName"},
        fields={
            "Curve:DoubleExponentialDecay": (
                ("coefficient3_c4", "coefficient4_c4"),
                ("coefficient3_c5", "coefficient5_c5"),
            ),
            "Meter:Custom": (("fuel_type", "resource_type"),),
            "Meter:CustomDecrement": (("fuel_type", "resource_type"),),
        },
        listed={
            "Output:Diagnostics": ("diagnostics", ((r"key_(\d+)", "key"),)),
            "PythonPlugin:SearchPaths": ("py_search_paths", ((r"search_path_(\d+)", "search_path"),)),
            "PythonPlugin:Variables": ("global_py_vars", ((r"variable_name_(\d+)", "variable_name"),)),
        },
        dropped={"ZoneHVAC:HybridUnitaryHVAC": ("number_of_operating_modes",)},
        defaults={
            "Controller:WaterCoil": {"minimum_actuated_flow": 1e-07},
            # The field is new; up to 9.3 the tables included the fan's heat (transition rules V9_4_0).
            "ZoneHVAC:HybridUnitaryHVAC": {"fan_heat_included_in_lookup_tables": "Yes"},
        },
        words=(
            (r".*", FUEL_FIELD, _FUELS),
            ("EnergyManagementSystem:Actuator", "actuated_component_control_type",
             {"Electric Power Level": "Electricity Rate", "Gas Power Level": "NaturalGas Rate"}),
            ("PerformancePrecisionTradeoffs", "override_mode", {"Mode05": "Mode06"}),
        ),
        # The table of the transition program as patterns, for meters and for output variables.
        variables=(
            (r"(.*:)?Electric(:.*)?", r"\1Electricity\2"),
            (r"(.*:)?Gas(:.*)?", r"\1NaturalGas\2"),
            (r"(.*:)?FuelOil#([12])(:.*)?", r"\1FuelOilNo\2\3"),
            (r"Generator Produced Electric Power", "Generator Produced AC Electricity Rate"),
            (r"Generator Produced Electric Energy", "Generator Produced AC Electricity Energy"),
            (r"(Refrigeration Zone Air Chiller Fan Electric Energy)", r"\1"),
            (rf"(.*) Electric(?:ity)? (Demand |Loss )?Power{_SUFFIX}", r"\1 Electricity \2Rate\3"),
            (rf"(.*) Electric (Loss |Loss Decrement )?(Energy|Rate){_SUFFIX}", r"\1 Electricity \2\3\4"),
            (r"Humidifier Gas Use (Energy|Rate)", r"Humidifier NaturalGas \1"),
            (r"Humidifier Gas (Use Thermal Efficiency)", r"Humidifier NaturalGas \1"),
            (r"(.*)(?<!Natural)\bGas ((?:HHV Basis )?(?:Energy|Rate)|Mass Flow Rate)", r"\1NaturalGas \2"),
            (r"(Environmental Impact )Natural Gas (.*)", r"\1NaturalGas \2"),
            (r"(Environmental Impact )Fuel Oil #([12]) (.*)", r"\1FuelOilNo\2 \3"),
            # The table has 'Power' in the new names of these, but EnergyPlus 'Rate', as for electricity.
            (r"Cooling Coil (?:Natural)?Gas Power", "Cooling Coil NaturalGas Rate"),
            (r"Cooling Coil FuelOil#([12]) Power", r"Cooling Coil FuelOilNo\1 Rate"),
            (r"Cooling Coil (Propane|Diesel|Gasoline|Coal|OtherFuel[12]) Power", r"Cooling Coil \1 Rate"),
            (r"(.*)FuelOil#([12])(.*)", r"\1FuelOilNo\2\3"),
        ),
        functions=(simulation_rules.one_diagnostics_object, simulation_rules.debugging_words),
    ),
    VersionStep(
        "9.4",
        "9.5",
        "Input Changes 9.4.0 to 9.5.0, transition rules V9_5_0, schemas 9.4 and 9.5",
        fields={
            "ZoneAirMassFlowConservation": (
                ("adjust_zone_mixing_for_zone_air_mass_flow_balance",
                 "adjust_zone_mixing_and_return_for_air_mass_flow_balance"),
            ),
        },
        dropped={"Construction:AirBoundary": ("solar_and_daylighting_method", "radiant_exchange_method")},
        words=(
            ("ZoneAirMassFlowConservation", "adjust_zone_mixing_and_return_for_air_mass_flow_balance",
             {"Yes": "AdjustMixingOnly", "No": "None"}),
            ("UtilityCost:Variable", "variable_type", {"Power": "Demand"}),
        ),
        functions=(
            simulation_rules.internal_heat_sources,
            equipment_rules.design_objects,
            curve_rules.heat_pump_curves,
        ),
    ),
    VersionStep(
        "9.5",
        "9.6",
        "Input Changes 9.5.0 to 9.6.0, schemas 9.5 and 9.6",
        fields={
            "AirConditioner:VariableRefrigerantFlow": (
                (r"(minimum|maximum)_outdoor_temperature_in_(cooling|heating|heat_recovery)_mode",
                 r"\1_condenser_inlet_node_temperature_in_\2_mode"),
            ),
            "Construction:ComplexFenestrationState": ((r"layer_(\d+)_material", r"layer_\1_name"),),
            "Daylighting:Controls": (("zone_name", "zone_or_space_name"),),
            "Daylighting:ReferencePoint": (("zone_name", "zone_or_space_name"),),
            "ElectricEquipment": _SPACE_LISTS,
            "ElectricEquipment:ITE:AirCooled": (("zone_name", "zone_or_space_name"),),
            "GasEquipment": _SPACE_LISTS,
            "HotWaterEquipment": _SPACE_LISTS,
            "Lights": _SPACE_LISTS,
            "OtherEquipment": _SPACE_LISTS,
            "People": (
                *_SPACE_LISTS,
                ("people_per_zone_floor_area", "people_per_floor_area"),
                ("zone_floor_area_per_person", "floor_area_per_person"),
            ),
            "SteamEquipment": _SPACE_LISTS,
            "ZoneBaseboard:OutdoorTemperatureControlled": (
                ("zone_name", "zone_or_zonelist_or_space_or_spacelist_name"),
            ),
            "ZoneProperty:UserViewFactors:BySurfaceName": _SPACE_LISTS,
        },
        entries={
            "Daylighting:Controls": (
                "control_data",
                (("fraction_of_zone_controlled_by_reference_point",
                  "fraction_of_lights_controlled_by_reference_point"),),
            ),
        },
        dropped={"AirLoopHVAC:OutdoorAirSystem": ("availability_manager_list_name",)},
        defaults={"AirflowNetwork:MultiZone:ReferenceCrackConditions": {"reference_temperature": 20.0}},
        words=(("Controller:MechanicalVentilation|Sizing:System", "system_outdoor_air_method", _VENTILATION),),
    ),
    VersionStep(
        "9.6",
        "22.1",
        "Input Changes 9.6.0 to 22.1.0, Report Variables 9-6-0 to 22-1-0, schemas 9.6 and 22.1",
        variables=((r"ElectricEmissions:(.*)", r"ElectricityEmissions:\1"),),
    ),
)  # fmt: skip
"""The steps in order."""
