"""Rules of the steps from 22.1 to 25.2.

Sources: EnergyPlus's "Input Changes" pages and transition rules (`src/Transition` of its repository), its table of
renamed report variables, and a comparison of the input schemas of both versions, because some renamed fields are on
none of those pages. The step says which; a rule with another source has it beside it.
"""

from __future__ import annotations

from zenostat.models.upgrade import equipment_rules
from zenostat.models.upgrade.step import FUEL_FIELD, Renames, VersionStep

_SPACES: Renames = (("zone_name", "zone_or_space_name"),)
_PER_FLOOR_AREA: Renames = ((r"(watts|power)_per_zone_floor_area", r"\1_per_floor_area"),)
_MIXING: Renames = (
    *_SPACES,
    ("flow_rate_per_zone_floor_area", "flow_rate_per_floor_area"),
    ("source_zone_name", "source_zone_or_space_name"),
    (r"(minimum|maximum)_zone_temperature_schedule_name", r"\1_receiving_temperature_schedule_name"),
    (r"(minimum|maximum)_source_zone_temperature_schedule_name", r"\1_source_temperature_schedule_name"),
)
_RATED_2017: Renames = (
    (r"((speed_\d+_)?rated_(evaporator|supply_air|supply)_fan_power_per_volume_flow_rate)", r"2017_\1"),
)
_CYCLING = (
    "maximum_cycling_rate",
    "heat_pump_time_constant",
    "fraction_of_on_cycle_power_use",
    "heat_pump_fan_delay_time",
)
_CYCLING_REASON = (
    "its part-load losses came from a cycling rate and a time constant; since 23.2 they come from a curve "
    "(part_load_fraction_correlation_curve_name), which has no equivalent in the file"
)
_DISTRICT = {"DistrictHeating": "DistrictHeatingWater", "Steam": "DistrictHeatingSteam"}
_ONE_CELL = {"cell_control": "MinimalCell"}

STEPS = (
    VersionStep(
        "22.1",
        "22.2",
        "Input Changes 22.1.0 to 22.2.0, schemas 22.1 and 22.2",
        fields={
            "Coil:Cooling:DX:CurveFit:Speed": _RATED_2017,
            "Coil:Cooling:DX:MultiSpeed": _RATED_2017,
            "Coil:Cooling:DX:SingleSpeed": _RATED_2017,
            "Coil:Heating:DX:MultiSpeed": _RATED_2017,
            "Coil:Heating:DX:SingleSpeed": _RATED_2017,
            "ZoneCrossMixing": _MIXING,
            "ZoneInfiltration:DesignFlowRate": (
                ("zone_or_zonelist_name", "zone_or_zonelist_or_space_or_spacelist_name"),
                ("flow_per_zone_floor_area", "flow_rate_per_floor_area"),
                ("flow_per_exterior_surface_area", "flow_rate_per_exterior_surface_area"),
            ),
            "ZoneInfiltration:EffectiveLeakageArea": _SPACES,
            "ZoneInfiltration:FlowCoefficient": _SPACES,
            "ZoneMixing": _MIXING,
            "ZoneVentilation:DesignFlowRate": (
                ("zone_or_zonelist_name", "zone_or_zonelist_or_space_or_spacelist_name"),
                ("flow_rate_per_zone_floor_area", "flow_rate_per_floor_area"),
            ),
            "ZoneVentilation:WindandStackOpenArea": _SPACES,
        },
        dropped={"FuelFactors": ("units_of_measure", "energy_per_unit_factor")},
        defaults={
            "CoolingTower:SingleSpeed": _ONE_CELL,
            "CoolingTower:TwoSpeed": _ONE_CELL,
            "CoolingTower:VariableSpeed": _ONE_CELL,
            "CoolingTower:VariableSpeed:Merkel": _ONE_CELL,
        },
    ),
    VersionStep("22.2", "23.1", "Input Changes 22.2.0 to 23.1.0, schemas 22.2 and 23.1"),
    VersionStep(
        "23.1",
        "23.2",
        "Input Changes 23.1.0 to 23.2.0, Report Variables 23-1-0 to 23-2-0, schemas 23.1 and 23.2",
        types={"DistrictHeating": "DistrictHeating:Water"},
        fields={
            "Boiler:HotWater": (("parasitic_electric_load", "on_cycle_parasitic_electric_load"),),
            "Coil:Heating:Desuperheater": (("parasitic_electric_load", "on_cycle_parasitic_electric_load"),),
            "Coil:Heating:Fuel": (
                ("parasitic_electric_load", "on_cycle_parasitic_electric_load"),
                ("parasitic_fuel_load", "off_cycle_parasitic_fuel_load"),
            ),
            "Coil:Heating:Gas:MultiStage": (
                ("parasitic_gas_load", "off_cycle_parasitic_gas_load"),
                (r"(stage_\d+)_parasitic_electric_load", r"\1_on_cycle_parasitic_electric_load"),
            ),
            "Construction:ComplexFenestrationState": ((r"(.*)_absoptance_(.*)", r"\1_absorptance_\2"),),
            "EnvironmentalImpactFactors": (
                ("district_heating_efficiency", "district_heating_water_efficiency"),
                ("steam_conversion_efficiency", "district_heating_steam_conversion_efficiency"),
            ),
            "Site:GroundTemperature:Undisturbed:Xing": (
                ("average_soil_surface_tempeature", "average_soil_surface_temperature"),
            ),
            "SurfaceProperty:LocalEnvironment": (
                ("external_shading_fraction_schedule_name", "sunlit_fraction_schedule_name"),
            ),
        },
        # These belonged to water-to-air heat pumps alone, which are refused below.
        dropped={
            "AirLoopHVAC:UnitaryHeatPump:WaterToAir": _CYCLING,
            "AirLoopHVAC:UnitarySystem": _CYCLING,
            "ZoneHVAC:WaterToAirHeatPump": _CYCLING,
        },
        defaults={
            "HeatPump:PlantLoop:EIR:Cooling": {"reference_coefficient_of_performance": 7.5},
            "HeatPump:PlantLoop:EIR:Heating": {"reference_coefficient_of_performance": 7.5},
        },
        words=((r".*", FUEL_FIELD, _DISTRICT),),
        variables=(
            (r"(.+:)?DistrictHeating(:.+)?", r"\1DistrictHeatingWater\2"),
            (r"(.+:)?Steam(:.+)?", r"\1DistrictHeatingSteam\2"),
            (r"(.* Equipment )DistrictHeating( Energy| Rate)", r"\1DistrictHeatingWater\2"),
            (r"(.* Equipment )Steam( Energy| Rate)", r"\1DistrictHeatingSteam\2"),
            (r"District Cooling (?:Chilled Water )?(Energy|Rate)", r"District Cooling Water \1"),
            (r"District Cooling (Inlet Temperature|Outlet Temperature|Mass Flow Rate)", r"District Cooling Water \1"),
            (r"District Heating (?:Hot Water )?(Energy|Rate)", r"District Heating Water \1"),
            (r"District Heating (Inlet Temperature|Outlet Temperature|Mass Flow Rate)", r"District Heating Water \1"),
        ),
        refused={
            "Coil:Cooling:WaterToAirHeatPump:EquationFit": _CYCLING_REASON,
            "Coil:Cooling:WaterToAirHeatPump:ParameterEstimation": _CYCLING_REASON,
            "Coil:Cooling:WaterToAirHeatPump:VariableSpeedEquationFit": (
                "the cycling rate and the time constant of its latent capacity were its parent's; since 23.2 they "
                "are its own, with other defaults"
            ),
            "Coil:Heating:WaterToAirHeatPump:EquationFit": _CYCLING_REASON,
            "Coil:Heating:WaterToAirHeatPump:ParameterEstimation": _CYCLING_REASON,
            "HVACTemplate:Zone:WaterToAirHeatPump": _CYCLING_REASON,
        },
    ),
    VersionStep(
        "23.2",
        "24.1",
        "Input Changes 23.2.0 to 24.1.0, transition rules V24_1_0, schemas 23.2 and 24.1",
        fields={
            "ElectricEquipment": _PER_FLOOR_AREA,
            "ElectricEquipment:ITE:AirCooled": _PER_FLOOR_AREA,
            "GasEquipment": _PER_FLOOR_AREA,
            "HotWaterEquipment": _PER_FLOOR_AREA,
            "Lights": _PER_FLOOR_AREA,
            "OtherEquipment": _PER_FLOOR_AREA,
            "SteamEquipment": _PER_FLOOR_AREA,
        },
        dropped={"ComfortViewFactorAngles": ("zone_name",)},
        words=(("People", "mean_radiant_temperature_calculation_type", {"ZoneAveraged": "EnclosureAveraged"}),),
        functions=(equipment_rules.heat_exchanger_effectiveness, equipment_rules.no_load_flow_rate),
    ),
    VersionStep(
        "24.1",
        "24.2",
        "Input Changes 24.1.0 to 24.2.0, schemas 24.1 and 24.2",
        fields={
            "IndoorLivingWall": ((r"(led_intensity_schedule_name|led_nominal_intensity)_", r"\1"),),
            "Output:IlluminanceMap": _SPACES,
            "ZoneCoolTower:Shower": _SPACES,
            "ZoneRefrigerationDoorMixing": ((r"zone_([12])_name", r"zone_or_space_name_\1"),),
            "ZoneThermalChimney": (
                (r"zone_(\d+)_name", r"zone_or_space_name_\1"),
                (r"(relative_ratios_of_air_flow_rates_passing_through)_zone_(\d+)", r"\1_inlet_\2"),
            ),
        },
        listed={
            "MaterialProperty:PhaseChange": (
                "values",
                ((r"temperature_(\d+)", "temperature"), (r"enthalpy_(\d+)", "enthalpy")),
            ),
            "MaterialProperty:VariableThermalConductivity": (
                "values",
                ((r"temperature_(\d+)", "temperature"), (r"thermal_conductivity_(\d+)", "thermal_conductivity")),
            ),
        },
    ),
    VersionStep("24.2", "25.1", "Input Changes 24.2.0 to 25.1.0, schemas 24.2 and 25.1"),
    VersionStep(
        "25.1",
        "25.2",
        "Input Changes 25.1.0 to 25.2.0, schemas 25.1 and 25.2",
        fields={
            "Coil:Cooling:DX:VariableSpeed": (
                (r"speed_(\d+)_reference_unit_condenser_(air_)?flow_rate",
                 r"speed_\1_reference_unit_rated_condenser_air_flow_rate"),
            ),
            "Coil:Heating:DX:VariableSpeed": (
                (r"speed_(\d+)_(heating_capacity_function_of_air_flow_fraction_curve_name)", r"speed_\1_total_\2"),
            ),
            "Coil:Heating:WaterToAirHeatPump:VariableSpeedEquationFit": (
                ("speed_1_reference_unit_rated_air_flow", "speed_1_reference_unit_rated_air_flow_rate"),
            ),
            "Coil:WaterHeating:AirToWaterHeatPump:VariableSpeed": (
                (r"(rated_sensible_heat_ratio|rated_water_heating_capacity|rated_water_heating_cop)_at_speed_(\d+)",
                 r"speed_\2_\1"),
            ),
            "Output:Table:ReportPeriod": (("report_name_", "report_name"),),
        },
        listed={
            "ComfortViewFactorAngles": (
                "angles",
                ((r"surface_(\d+)_name", "surface_name"), (r"angle_factor_(\d+)", "angle_factor")),
            ),
        },
        named={"Output:Table:ReportPeriod": "name_"},
        dropped={
            "AirLoopHVAC:UnitaryHeatPump:AirToAir:MultiSpeed": (
                "minimum_outdoor_dry_bulb_temperature_for_compressor_operation",
            ),
        },
        defaults={"HeatExchanger:Desiccant:BalancedFlow": {"economizer_lockout": "No"}},
    ),
)  # fmt: skip
"""The steps in order."""
