"""Systems of models: air loops with their zones, plant loops, equipment of zones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from zenostat.models.building.conflicts import thermostat_setpoints
from zenostat.models.building.description import describe_model, file_version
from zenostat.models.building.model import read_building
from zenostat.models.building.schematic import systems
from zenostat.models.building.systems import System, air_loops, plant_loops, zone_equipment
from zenostat.models.catalog import bundled_buildings, find_building
from zenostat.topics import codec
from zenostat.topics.messages import Systems


def objects_of(name: str) -> dict[str, dict[str, object]]:
    """The objects of a bundled building."""
    return read_building(find_building(name)).objects


def every(system: System) -> Iterator[System]:
    """A system and all that is in it."""
    yield system
    for part in system.parts:
        yield from every(part)


def tree(system: System) -> tuple[object, ...]:
    """The names of a system and of its parts."""
    return (system.name, *[tree(part) for part in system.parts])


def test_air_loops__of_the_medium_office_are_one_for_each_storey() -> None:
    loops = air_loops(objects_of("ref-medium-office"))
    assert [loop.name for loop in loops] == ["VAV_1", "VAV_2", "VAV_3"]
    zones = [[part.name for part in loop.parts if part.kind == "Zone"] for loop in loops]
    floors = [("Core_bottom", "bot"), ("Core_mid", "mid"), ("Core_top", "top")]
    assert zones == [[core, *(f"Perimeter_{f}_ZN_{i}" for i in (1, 2, 3, 4))] for core, f in floors]


def test_air_loops__have_the_parts_of_unitary_systems_coils_and_terminals() -> None:
    loop = air_loops(objects_of("ref-medium-office"))[0]
    supply = [tree(part) for part in loop.parts if part.kind != "Zone"]
    assert supply == [
        ("VAV_1_OA", ("VAV_1_OAMixing Box",)),
        ("VAV_1_CoolC", ("VAV_1_CoolC DXCoil",)),
        ("VAV_1_HeatC",),
        ("VAV_1_Fan",),
    ]
    terminal = next(part for part in loop.parts if part.name == "Core_bottom")
    assert [each.kind for each in every(terminal)] == [
        "Zone",
        "ZoneHVAC:AirDistributionUnit",
        "AirTerminal:SingleDuct:VAV:Reheat",
        "Coil:Heating:Electric",
    ]


def test_plant_loops__have_supply_and_demand() -> None:
    loops = {loop.name: loop for loop in plant_loops(objects_of("ref-large-office"))}
    cooling = loops["CoolSys1"]
    supply, demand = cooling.parts
    assert (supply.name, demand.name) == ("supply", "demand")
    assert {part.kind.partition(":")[0] for part in supply.parts} == {"Chiller", "Pump"}
    assert {part.kind for part in demand.parts} == {"Coil:Cooling:Water"}
    assert len(demand.parts) == len(objects_of("ref-large-office")["Coil:Cooling:Water"])


@pytest.mark.slow
def test_systems__each_terminal_unit_of_the_bundled_models_is_on_one_air_loop() -> None:
    for entry in bundled_buildings():
        objects = read_building(entry).objects
        terminals = [n for kind, items in objects.items() if kind.startswith("AirTerminal:") for n in items]
        placed = Counter(
            each.name
            for loop in air_loops(objects)
            for part in loop.parts
            if part.kind == "Zone"
            for each in every(part)
            if each.kind.startswith("AirTerminal:")
        )
        assert placed == Counter(terminals), entry.name
        assert set(zone_equipment(objects)) <= set(objects["Zone"])


def test_systems__a_component_that_contains_itself_ends() -> None:
    own = {"part_object_type": "Fan:OnOff", "part_name": "f"}
    objects = {
        "Fan:OnOff": {"f": own},
        "AirLoopHVAC": {"a": {"branch_list_name": "l"}},
        "BranchList": {"L": {"branches": [{"branch_name": "b"}]}},
        "Branch": {"B": {"components": [{"component_object_type": "Fan:OnOff", "component_name": "F"}]}},
    }
    (loop,) = air_loops(objects)
    assert tree(loop) == ("a", ("f", ("f",)))
    assert air_loops({"AirLoopHVAC": {"a": {}}}) == [System("AirLoopHVAC", "a")]
    assert [tree(loop) for loop in plant_loops({"PlantLoop": {"p": {}}})] == [("p", ("supply",), ("demand",))]


def test_describe_model__has_zones_setpoints_and_what_can_be_set() -> None:
    entry = find_building("warehouse")
    building = read_building(entry)
    description = describe_model(building, file_version(entry.path))
    assert description.version == "25.2"
    assert [zone.name for zone in description.zones] == list(building.objects["Zone"])
    office = description.zones[0]
    assert (office.name, office.storey, office.air_loops) == ("Zone1 Office", 0, ("PSZ-Office",))
    assert office.area_m2 == pytest.approx(236.88, abs=0.01)  # 2,550 ft2, as in the prototype's description
    assert set(office.setpoints) == {"heating setpoint", "cooling setpoint"}
    set_by_zone = {
        (a.key.casefold(), a.control_type.casefold()) for a in description.actuators if "Zone" in a.component_type
    }
    assert set_by_zone == {(zone, control) for zone, control, _ in thermostat_setpoints(building.objects)}
    schedules = {each.name: each for each in description.schedules}
    lights = next(iter(building.objects["Lights"].values()))
    assert schedules[lights["schedule_name"]].uses["Lights"] >= 1
    assert description.diagnostics == ()
    assert description.geometry.geometry is not None


def test_describe_model__lists_setpoint_of_several_control_types_once() -> None:
    building = read_building(find_building("warehouse"))
    zone, *_ = building.objects["Zone"]
    (name, thermostat), *_ = building.objects["ZoneControl:Thermostat"].items()
    dual = building.objects["ThermostatSetpoint:DualSetpoint"][thermostat["control_1_name"]]
    heating, cooling = (dual[f"{kind}_setpoint_temperature_schedule_name"] for kind in ("heating", "cooling"))
    singles = {"SingleHeating": ("Winter", heating), "SingleCooling": ("Summer", "Always 26")}
    objects: dict[str, Any] = {**building.objects, "Schedule:Constant": {"Always 26": {"hourly_value": 26.0}}}
    for number, (kind, (own, schedule)) in enumerate(singles.items(), start=2):
        objects[f"ThermostatSetpoint:{kind}"] = {own: {"setpoint_temperature_schedule_name": schedule}}
        control = f"control_{number}"
        thermostat = {**thermostat, f"{control}_object_type": f"ThermostatSetpoint:{kind}", f"{control}_name": own}
    objects["ZoneControl:Thermostat"] = {name: thermostat}
    description = describe_model(replace(building, objects=objects, content="several control types"), "")
    assert [each.acts_on for each in description.actuators if "Zone" in each.component_type] == [
        f"heating setpoint of zone {zone} (schedule {heating})",
        f"cooling setpoint of zone {zone} (schedule {cooling} or Always 26)",
    ]
    setpoints = {"heating setpoint": heating, "cooling setpoint": f"{cooling} or Always 26"}
    assert description.zones[0].setpoints == setpoints


def test_describe_model__names_programs_that_set_the_same_control() -> None:
    building = read_building(find_building("office-medium"))
    conflicts = [each for each in describe_model(building, "").actuators if each.conflicts]
    assert conflicts
    assert all("EMS program" in each.conflicts[0] for each in conflicts)


def on_branches(objects: dict[str, dict[str, Any]], lists: Iterable[object]) -> set[tuple[str, str]]:
    """Kind and name, case-folded, of all components of the model's own branches that these lists name."""
    branches = {name.casefold(): fields for name, fields in objects.get("Branch", {}).items()}
    named = {name.casefold(): fields for name, fields in objects.get("BranchList", {}).items()}
    return {
        (part["component_object_type"].casefold(), part["component_name"].casefold())
        for each in lists
        for entry in named[str(each).casefold()]["branches"]
        for part in branches[entry["branch_name"].casefold()]["components"]
        if not part["component_object_type"].startswith(("Pipe:", "Duct"))
    }


@pytest.mark.parametrize("name", [entry.name for entry in bundled_buildings()])
def test_schematic__has_each_loop_and_each_component_of_the_model_once(name: str) -> None:
    objects = objects_of(name)
    described = systems(objects)
    kinds = ("AirLoopHVAC", "PlantLoop", "CondenserLoop")
    assert Counter(loop.kind for loop in described.loops) == Counter(
        {k: len(objects[k]) for k in kinds if k in objects}
    )
    names = Counter((each.kind.casefold(), each.name.casefold()) for each in described.components)
    assert set(names.values()) <= {1}
    for loop in described.loops:
        fields = objects[loop.kind][loop.name]
        lists = [value for field, value in fields.items() if field.endswith("branch_list_name")]
        placed = [number for side in loop.sides for stage in side.stages for branch in stage for number in branch]
        drawn = Counter(described.components[number] for number in placed)
        assert {(each.kind.casefold(), each.name.casefold()) for each in drawn} == on_branches(objects, lists)
        assert set(drawn.values()) <= {1}
    terminals = {
        (kind.casefold(), name.casefold())
        for kind, items in objects.items()
        if kind.startswith("AirTerminal:")
        for name in items
    }
    assert terminals <= set(names)
    assert codec.decode(Systems, codec.encode(described), "") == described


def test_schematic__parallel_chillers_stand_between_the_pump_and_the_outlet() -> None:
    described = systems(objects_of("ref-large-office"))
    loop = next(loop for loop in described.loops if loop.name == "CoolSys1")
    supply, demand = loop.sides
    kinds = [[[described.components[n].kind for n in branch] for branch in stage] for stage in supply.stages]
    assert kinds == [
        [["Pump:VariableSpeed"]],
        [["Chiller:Electric:ReformulatedEIR"], ["Chiller:Electric:ReformulatedEIR"], []],
    ]
    coils = {described.components[n].name for stage in demand.stages for branch in stage for n in branch}
    assert coils == set(objects_of("ref-large-office")["Coil:Cooling:Water"])
    on_air_loops = {
        described.components[n].name
        for loop in described.loops
        if loop.kind == "AirLoopHVAC"
        for stage in loop.sides[0].stages
        for branch in stage
        for n in branch
    }
    assert coils <= on_air_loops  # each is one component on two loops


def test_schematic__pieces_that_the_model_only_names_are_left_out() -> None:
    fields = {"branch_list_name": "none", "connector_list_name": "none", "demand_side_inlet_node_names": "none"}
    (loop,) = systems({"AirLoopHVAC": {"Air": fields}}).loops
    assert loop.sides[0].stages == ()
    assert loop.zones == ()
    assert systems({}) == Systems(components=(), loops=())
