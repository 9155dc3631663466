"""Models that hardly mean what they have: a warning with object, field and line, or an error where EnergyPlus ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.box_model import box_model, exit_code

from zenostat.models.building.diagnostics import Severity, check_meters, diagnose
from zenostat.models.building.model import Building, read_building
from zenostat.models.building.nodes import unconnected_nodes
from zenostat.models.catalog import find_building
from zenostat.models.input_format.epjson_reader import read_epjson
from zenostat.models.input_format.idf_reader import parse_idf
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.topics.errors import InvalidConfig

Objects = dict[str, dict[str, Any]]


def setpoints(heating: Any, cooling: Any, by_night: float | None = None) -> Objects:
    """A thermostat's setpoints, each of a Schedule:Constant; heating has a Schedule:Compact if it differs by night."""
    field = "setpoint_temperature_schedule_name"
    constants = {"Always": {"hourly_value": 1.0}, "Cooling": {"hourly_value": cooling}}
    lines = ("Through: 12/31", "For: AllDays", "Until: 06:00", by_night, "Until: 24:00", heating)
    compact: Objects = {"Schedule:Compact": {"Heating": {"data": [{"field": line} for line in lines]}}}
    return {
        "Schedule:Constant": constants if by_night else constants | {"Heating": {"hourly_value": heating}},
        **(compact if by_night else {}),
        "ThermostatSetpoint:DualSetpoint": {
            "Setpoints": {f"heating_{field}": "Heating", f"cooling_{field}": "Cooling"}
        },
    }


def programs(**lines: str) -> Objects:
    """EMS programs of one line each, of which the first is called."""
    first = next(iter(lines))
    return {
        "EnergyManagementSystem:Program": {name: {"lines": [{"program_line": line}]} for name, line in lines.items()},
        "EnergyManagementSystem:ProgramCallingManager": {
            "m": {
                "energyplus_model_calling_point": "BeginTimestepBeforePredictor",
                "programs": [{"program_name": first}],
            }
        },
    }


TRANSFORMER = {
    "rated_capacity": 15000.0,
    "performance_input_method": "NominalEfficiency",
    "nameplate_efficiency": 0.98,
    "per_unit_load_for_nameplate_efficiency": 0.5,
}


def transformer(*meters: str, **fields: Any) -> Objects:
    """A transformer between the grid and these meters."""
    entries = [{"meter_name": meter} for meter in meters]
    return {"ElectricLoadCenter:Transformer": {"Grid": TRANSFORMER | {"meters": entries} | fields}}


def generator(meter: str) -> Objects:
    """PV whose load center follows a meter."""
    outputs = {"generator_name": "Roof", "generator_object_type": "Generator:PVWatts"}
    return {
        "Generator:PVWatts": {
            "Roof": {"dc_system_capacity": 5000.0, "module_type": "Standard", "array_type": "FixedRoofMounted"}
        },
        "ElectricLoadCenter:Generators": {"Generators": {"generator_outputs": [outputs]}},
        "ElectricLoadCenter:Inverter:PVWatts": {"Inverter": {}},
        "ElectricLoadCenter:Distribution": {
            "Center": {
                "generator_list_name": "Generators",
                "inverter_name": "Inverter",
                "electrical_buss_type": "DirectCurrentWithInverter",
                "generator_operation_scheme_type": "TrackMeter",
                "generator_track_meter_scheme_meter_name": meter,
            }
        },
    }


CONNECTIONS: Objects = {
    "ZoneHVAC:EquipmentList": {"Equipment": {}},
    "NodeList": {"Inlets": {"nodes": [{"node_name": "Inlet"}]}},
    "ZoneHVAC:EquipmentConnections": {
        "ZoneHVAC:EquipmentConnections 1": {
            "zone_name": "Box",
            "zone_conditioning_equipment_list_name": "Equipment",
            "zone_air_inlet_node_or_nodelist_name": "Inlets",
            "zone_air_node_name": "Air",
        }
    },
}
COMPACT = {"data": [{"field": field} for field in ("Through: 12/31", "For: AllDays", "Until: 24:00", 1.0)]}
LIMITS = {"lower_limit_value": 0, "upper_limit_value": 1, "numeric_type": "Continuous"}
WARNING, ERROR = Severity.WARNING, Severity.ERROR

CASES: dict[str, tuple[Callable[[Objects], object], Severity, str, str, str]] = {
    "zone without surfaces": (
        lambda model: model["Zone"].update({"Attic": {}}), ERROR, "Zone", "", "'Attic': no surface belongs to it"),
    "no surfaces": (
        lambda model: model.pop("BuildingSurface:Detailed"), ERROR, "Zone", "", "'Box': no surface belongs to it"),
    "no version": (lambda model: model.pop("Version"), WARNING, "Version", "", "has no Version object"),
    "empty version": (
        lambda model: model["Version"].update({"Version 1": {}}), ERROR, "Version", "", "lacks 'version_identifier'"),
    "odd timestep": (
        lambda model: model["Timestep"]["Timestep 1"].update(number_of_timesteps_per_hour=7),
        WARNING, "Timestep", "number_of_timesteps_per_hour", "is 7, which does not divide the hour"),
    "no such day": (
        lambda model: model["RunPeriod"]["Day"].update(begin_day_of_month=30, begin_month=2, end_month=3),
        WARNING, "RunPeriod", "begin_day_of_month", "begins on 02-30, which is no day of the year"),
    "swapped setpoints": (
        lambda model: model.update(setpoints(24.0, 20.0)), WARNING, "ThermostatSetpoint:DualSetpoint",
        "heating_setpoint_temperature_schedule_name", "24 °C, is above the highest of the cooling schedule 'Cooling'"),
    "setpoints in °F": (
        lambda model: model.update(setpoints(70.0, 75.0)), WARNING, "ThermostatSetpoint:DualSetpoint",
        "heating_setpoint_temperature_schedule_name", "is up to 70 °C; are its values in °F?"),
    "heating above cooling by day": (
        lambda model: model.update(setpoints(29.0, 27.0, by_night=15.0)), WARNING, "ThermostatSetpoint:DualSetpoint",
        "heating_setpoint_temperature_schedule_name", "highest value, 29 °C, is above the highest of the cooling"),
    "no thermostat": (
        lambda model: model.update(CONNECTIONS), WARNING, "ZoneHVAC:EquipmentConnections", "zone_name",
        "zone 'Box' has HVAC equipment, but no ZoneControl:Thermostat"),
    "swapped conductivity and density": (
        lambda model: model["Material"]["Concrete"].update(conductivity=2300.0, density=1.7),
        WARNING, "Material", "conductivity", "density is 1.7 kg/m3: are they swapped?"),
    "value beyond limits": (
        lambda model: (model["ScheduleTypeLimits"]["Any number"].update(LIMITS),
                       model["Schedule:Constant"]["Always"].update(hourly_value=3.0)),
        ERROR, "Schedule:Constant", "hourly_value", "is 3, but its type 'Any number' has the limits 0 and 1"),
    "swapped limits": (
        lambda model: model["ScheduleTypeLimits"]["Any number"].update(LIMITS | {"lower_limit_value": 2}),
        ERROR, "ScheduleTypeLimits", "lower_limit_value", "is 2, which is above upper_limit_value, 1"),
    "schedules of one name": (
        lambda model: model.update({"Schedule:Compact": {"ALWAYS": COMPACT}}),
        ERROR, "Schedule:Compact", "", "'ALWAYS': a Schedule:Constant has this name, too"),
    "program that runs itself": (
        lambda model: model.update(programs(p="RUN p")),
        ERROR, "EnergyManagementSystem:Program", "lines[0].program_line", "runs the program itself"),
    "list without a zone": (
        lambda model: model.update({"ZoneHVAC:EquipmentList": {"Equipment": {}}}),
        ERROR, "ZoneHVAC:EquipmentList", "", "'Equipment': no ZoneHVAC:EquipmentConnections names this list"),
    "meter of a transformer": (
        lambda model: model.update(transformer("Electricity:Facility", "InteriorLight:Electricity")),
        ERROR, "ElectricLoadCenter:Transformer", "meters[1].meter_name",
        "is 'InteriorLight:Electricity', but the model has no meter of electricity of that name; did you mean "),
    "meter of a load center": (
        lambda model: model.update(generator("Electricity:Facilty")),
        WARNING, "ElectricLoadCenter:Distribution", "generator_track_meter_scheme_meter_name",
        "of electricity of that name; did you mean 'Electricity:Facility'"),
    "thickness in mm": (
        lambda model: model["Material"]["Concrete"].update(thickness=200.0),
        WARNING, "Material", "thickness", "thickness is 200 m; is it in mm?"),
    "limits without a type": (
        lambda model: model["ScheduleTypeLimits"]["Any number"].update(lower_limit_value=0, upper_limit_value=1),
        ERROR, "ScheduleTypeLimits", "", "lacks 'numeric_type'"),
}  # fmt: skip


UNDECIDED = ("no such day", "no thermostat", "thickness in mm")
"""The day is replaced by a scenario's, the equipment is incomplete, and thickness matters with other properties."""


@pytest.mark.parametrize("case", CASES)
def test_diagnose__implausible_model_has_one_finding_with_its_line(case: str) -> None:
    change, severity, kind, field, words = CASES[case]
    model = box_model()
    change(model)
    source = parse_idf(write_idf(model, engine_layout()), engine_layout())
    (diagnostic,) = [each for each in diagnose(source.objects, source) if each.kind == kind]
    assert (diagnostic.severity, diagnostic.field) == (severity, field)
    assert words in diagnostic.text
    assert diagnostic.line == source.line(kind, diagnostic.name, field)
    assert (diagnostic.line is None) == (case == "no version")


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("case", [case for case in CASES if case not in UNDECIDED])
def test_diagnose__energyplus_ends_at_what_is_an_error(case: str, tmp_path: Path) -> None:
    change, severity, *_ = CASES[case]
    model = box_model()
    change(model)
    assert (exit_code(model, tmp_path / "run") != 0) == (severity is ERROR)


CUSTOM = {"resource_type": "Electricity", "variable_details": [{"output_variable_or_meter_name": "Fans:Electricity"}]}
METERS = (
    "electricity:facility",
    "InteriorLights:Electricity",
    "Electricity:Zone:Box",
    "General:InteriorLights:Electricity:SpaceType:General",
    "Own",
)
SOUND: list[Callable[[Objects], object]] = [
    lambda model: model,
    lambda model: model.update(setpoints(20.0, 24.0)),
    lambda model: model.update(transformer(*METERS), **{"Meter:Custom": {"Own": CUSTOM}}),
    lambda model: model.update(transformer("None", transformer_usage="PowerOutToGrid")),
    lambda model: model.update(generator("Electricity:Building")),
]


@pytest.mark.parametrize("change", SOUND)
def test_diagnose__sound_model_has_no_finding(change: Callable[[Objects], object]) -> None:
    model = box_model()
    change(model)
    assert diagnose(model) == []


OTHER_PROGRAMS: Objects = {
    "ExternalInterface": {"E": {"name_of_external_interface": "PtolemyServer"}},
    "ExternalInterface:Variable": {"V": {"initial_value": 1.0}},
    "ExternalInterface:FunctionalMockupUnitImport": {"F": {"fmu_file_name": "x.fmu"}},
    "PythonPlugin:Instance": {"P": {"python_module_name": "mine", "plugin_class_name": "Ruler"}},
}


@pytest.mark.parametrize("kind", OTHER_PROGRAMS)
def test_diagnose__object_that_runs_another_program_is_an_error_with_its_line(kind: str) -> None:
    source = parse_idf(write_idf(box_model() | {kind: OTHER_PROGRAMS[kind]}, engine_layout()), engine_layout())
    (diagnostic,) = diagnose(source.objects, source)
    (name,) = source.objects[kind]
    assert (diagnostic.severity, diagnostic.kind, diagnostic.line) == (ERROR, kind, source.line(kind, name, ""))
    assert "are not supported; remove this object" in diagnostic.text


def test_diagnose__parametric_object_is_an_error_with_its_line() -> None:
    text = write_idf(box_model(), engine_layout())
    source = parse_idf(f"{text}\nParametric:SetValueForRun,\n  $angle, 0, 45;\n", engine_layout())
    (diagnostic,) = diagnose(source.objects, source)
    assert diagnostic.line == text.count("\n") + 2
    assert diagnostic.text.startswith("Parametric:SetValueForRun '$angle' is for EnergyPlus's ParametricPreprocessor")


@pytest.mark.parametrize("kind", ["PlantLoop", "Zone", None])
def test_diagnose__model_with_neither_zone_nor_plant_has_a_warning(kind: str | None) -> None:
    model: Objects = {"Building": {"b": {}}, "GlobalGeometryRules": {"g": {}}} | ({kind: {"x": {}}} if kind else {})
    texts = [each.text for each in diagnose(model) if "nothing to simulate" in each.text]
    assert len(texts) == (kind is None)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ({"p": "RUN q", "q": "RUN p"}, ["runs 'q', which runs 'p'", "runs 'p', which runs 'q'"]),
        ({"p": "RUN q", "q": "SET x = 1"}, []),
        ({"p": "SET x = 1", "q": "RUN q"}, []),  # which nothing calls
    ],
)
def test_diagnose__programs_in_a_ring_are_errors_if_they_are_called(lines: dict[str, str], expected: list[str]) -> None:
    diagnostics = diagnose(box_model() | programs(**lines))
    assert [each.text.partition("program_line ")[2].partition(":")[0] for each in diagnostics] == expected


SHARED_BRANCHES: dict[str, tuple[Callable[[Objects], object], tuple[str, str, str], str]] = {
    "list of another loop": (
        lambda model: model["PlantLoop"]["HeatSys1"].update(plant_side_branch_list_name="CoolSys1 Supply Branches"),
        ("PlantLoop", "HeatSys1", "plant_side_branch_list_name"), "of PlantLoop 'CoolSys1' is"),
    "list of the other side": (
        lambda model: model["PlantLoop"]["SWHSys1"].update(demand_side_branch_list_name="SWHSys1 Supply Branches"),
        ("PlantLoop", "SWHSys1", "plant_side_branch_list_name"), "as demand_side_branch_list_name of PlantLoop 'SWHS"),
    "list of another air loop": (
        lambda model: model["AirLoopHVAC"]["VAV_2"].update(branch_list_name="vav_1 air loop branches"),
        ("AirLoopHVAC", "VAV_2", "branch_list_name"), "as branch_list_name of AirLoopHVAC 'VAV_1' is"),
    "branch of another list": (
        lambda model: model["BranchList"]["VAV_2 Air Loop Branches"]["branches"].append(
            model["BranchList"]["VAV_1 Air Loop Branches"]["branches"][0]),
        ("BranchList", "VAV_2 Air Loop Branches", "branches[1].branch_name"), "of BranchList 'VAV_1 Air Loop"),
}  # fmt: skip


def large_office(change: Callable[[Objects], object]) -> Objects:
    """The large office with a change."""
    model: Objects = json.loads(json.dumps(read_building(find_building("ref-large-office")).objects))
    change(model)
    return model


@pytest.mark.variants
@pytest.mark.parametrize("case", SHARED_BRANCHES)
def test_diagnose__branches_of_two_loops_are_one_error(case: str) -> None:
    change, (kind, name, field), words = SHARED_BRANCHES[case]
    errors = [each for each in diagnose(large_office(change)) if each.severity is ERROR]
    assert [(each.kind, each.name, each.field) for each in errors] == [(kind, name, field)]
    assert words in errors[0].text


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("case", SHARED_BRANCHES)
def test_diagnose__energyplus_ends_at_branches_of_two_loops(case: str, tmp_path: Path) -> None:
    assert exit_code(large_office(SHARED_BRANCHES[case][0]), tmp_path / "run") != 0


def test_check_meters__transformer_of_an_end_use_that_the_model_lacks_is_an_error_with_its_line(tmp_path: Path) -> None:
    model = box_model() | transformer("InteriorLights:Electricity", "ExteriorLights:Electricity")
    path = tmp_path / "box.epJSON"
    path.write_text(json.dumps(model, indent=1))
    meters = ["Electricity:Facility", "InteriorLights:Electricity"]
    line = 1 + next(i for i, text in enumerate(path.read_text().splitlines()) if "ExteriorLights" in text)
    building = Building("box", model, "", file=str(path))
    with pytest.raises(InvalidConfig, match=rf"line {line}: .*\[1\].meter_name is 'ExteriorLights:Electricity', but"):
        check_meters(building, meters)
    check_meters(building, [*meters, "EXTERIORLIGHTS:ELECTRICITY"])


NODE_FIELDS = [
    ("Coil:Cooling:DX:VariableRefrigerantFlow", {"coil_air_inlet_node": "Mixed"}),
    ("Fan:ConstantVolume", {"air_inlet_node_name": "Mixed"}),
    ("PipingSystem:Underground:PipeCircuit", {"circuit_inlet_node": "Mixed"}),
    ("PlantComponent:TemperatureSource", {"inlet_node": "Mixed"}),
    ("SolarCollector:UnglazedTranspired:Multisystem", {"systems": [{"outdoor_air_system_mixed_air_node": "Mixed"}]}),
    ("SwimmingPool:Indoor", {"pool_water_inlet_node": "Mixed"}),
    ("ZoneHVAC:VentilatedSlab:SlabGroup", {"data": [{"slab_inlet_node_name_for_surface": "Mixed"}]}),
]


@pytest.mark.parametrize(("kind", "fields"), NODE_FIELDS)
def test_unconnected_nodes__all_fields_that_name_a_node_count(kind: str, fields: dict[str, Any]) -> None:
    mixer = {"OutdoorAir:Mixer": {"Mixer": {"mixed_air_node_name": "mixed"}}}
    assert [(each.kind, each.node) for each in unconnected_nodes({kind: {"it": fields}})] == [(kind, "Mixed")]
    assert not list(unconnected_nodes({kind: {"it": fields}} | mixer))


OBJECTS_OF_FIELDS = [
    ("AirflowNetwork:MultiZone:Surface", "external_node_name", "AirflowNetwork:MultiZone:ExternalNode"),
    ("AirflowNetwork:IntraZone:Linkage", "node_1_name", "AirflowNetwork:IntraZone:Node"),
    ("ElectricEquipment:ITE:AirCooled", "air_inlet_room_air_model_node_name", "RoomAir:Node"),
    ("ZoneHVAC:EquipmentConnections", "zone_return_air_node_1_flow_rate_fraction_schedule_name", "Schedule:Constant"),
]
"""Fields with names like those of nodes that name an object, and its type."""


@pytest.mark.parametrize(("kind", "field", "named"), OBJECTS_OF_FIELDS)
def test_unconnected_nodes__name_of_an_object_is_none(kind: str, field: str, named: str) -> None:
    assert list(unconnected_nodes({kind: {"it": {field: "A"}}, named: {"A": {}}})) == []


def test_diagnose__loop_that_is_sized_without_an_object_for_it_is_a_warning() -> None:
    loop = {
        "AirLoopHVAC": {"A": {"design_supply_air_flow_rate": "Autosize"}, "B": {"design_supply_air_flow_rate": 1.0}}
    }
    texts = [each.text for each in diagnose(box_model() | loop) if "Sizing:System" in each.text]
    assert texts == [
        "AirLoopHVAC 'A': design_supply_air_flow_rate is 'Autosize', but no Sizing:System is for this loop"
    ]
    sizing = {"Sizing:System": {"s": {"airloop_name": "a"}}}
    assert not [each for each in diagnose(box_model() | loop | sizing) if "no Sizing" in each.text]


def test_period__own_timestep_that_energyplus_would_change_is_refused_with_its_line(tmp_path: Path) -> None:
    model = box_model()
    model["Timestep"]["Timestep 1"]["number_of_timesteps_per_hour"] = 7
    path = tmp_path / "box.idf"
    path.write_text(write_idf(model, engine_layout()))
    building = Building("box", model, "", file=str(path))
    line = 1 + path.read_text().splitlines().index("Timestep,") + 1
    with pytest.raises(InvalidConfig, match=rf"box\.idf, line {line}, has number_of_timesteps_per_hour 7"):
        building.period(None, None, None)
    assert building.period(None, None, 4).steps_per_hour == 4


SHIFTED = {
    "decimal comma": ("  0.2,  !", "  0,2,  !", "thickness has '0,2' in a line, which are two values; if that is a"),
    "doubled comma": ("  0.2,  !", "  0.2,,  !", "thickness has ',,' in a line after '0.2'"),
    "semicolon": ("  0.2,  !", "  0.2;  !", "ends with ';' after thickness, but line {next} goes on with '1.7'"),
    "semicolon of the type": ("Material,", "Material;", "ends with ';' after its type, but line {next} goes on"),
}


@pytest.mark.parametrize("case", SHIFTED)
def test_diagnose__shifted_fields_are_one_error_at_the_line_of_their_cause(case: str) -> None:
    before, after, words = SHIFTED[case]
    text = write_idf(box_model(), engine_layout())
    changed = text.replace(before, after, 1)
    line = 1 + next(i for i, (a, b) in enumerate(zip(text.splitlines(), changed.splitlines(), strict=True)) if a != b)
    source = parse_idf(changed, engine_layout())
    (diagnostic,) = diagnose(source.objects, source)
    assert (diagnostic.severity, diagnostic.kind, diagnostic.line) == (ERROR, "Material", line)
    assert words.format(next=line + 1) in diagnostic.text


def test_parse_idf__two_values_in_a_line_are_no_error() -> None:
    text = write_idf(box_model(), engine_layout()).replace("  0.2,  !- Thickness\n", "  0.2,", 1)
    source = parse_idf(text, engine_layout())
    assert diagnose(source.objects, source) == []


def test_read_epjson__keys_that_are_in_the_file_twice_are_errors() -> None:
    text = '{"Zone": {"A": {}},\n"Building": {"B": {"north_axis": 1.0,\n"north_axis": 2.0}},\n"Zone": {"C": {}}}'
    assert [(issue.line, issue.text) for issue in read_epjson(text).issues] == [
        (3, "Building 'B': north_axis is in it twice; first in line 2, whose value JSON leaves out"),
        (4, "type 'Zone' is in the file twice; first in line 1, whose objects JSON leaves out"),
    ]
