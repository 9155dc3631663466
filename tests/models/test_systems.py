"""Systems of models: air loops with their zones, plant loops, equipment of zones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import pytest

from zenostat.models.building.conflicts import thermostat_setpoints
from zenostat.models.building.description import describe_model, file_version
from zenostat.models.building.model import read_building
from zenostat.models.building.systems import System, air_loops, plant_loops, zone_equipment
from zenostat.models.catalog import bundled_buildings, find_building


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


def test_describe_model__names_programs_that_set_the_same_control() -> None:
    building = read_building(find_building("office-medium"))
    conflicts = [each for each in describe_model(building, "").actuators if each.conflicts]
    assert conflicts
    assert all("EMS program" in each.conflicts[0] for each in conflicts)
