"""Summaries of buildings and weather files: against EnergyPlus's own words, hand calculation, and small models."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from support.energyplus_alone import run_energyplus

from zenostat.models import catalog
from zenostat.models.building import summary
from zenostat.models.building.locations import locations
from zenostat.models.building.model import Building, for_episode, read_building, write
from zenostat.models.building.summary import BuildingSummary, building_summary, listed_summaries, zone_areas
from zenostat.models.points.discovery import discover
from zenostat.models.run_period import Period

# Multipliers of zones and of a list of zones, plenums, attics, no heating in some zones, condenser loops.
MODELS = ("restaurant-fast-food", "hotel-small", "office-large", "ref-midrise-apartment", "ref-outpatient", "warehouse")


@dataclass(frozen=True)
class EngineReport:
    """Report of EnergyPlus on a model at the start of a run: rows of `eplusout.eio` and `eplusout.bnd`."""

    building: Building
    rows: list[list[str]]

    def of(self, kind: str) -> list[list[str]]:
        return [row for row in self.rows if row[0] == kind]


def start(name: str, folder: Path) -> EngineReport:
    building = read_building(catalog.find_building(name))
    day = date(2017, 1, 1)
    objects = for_episode(building, Period(day, day, building.steps_per_hour))
    objects["OutputControl:Files"] = {"files": {"output_eio": "Yes", "output_bnd": "Yes", "output_tabular": "No"}}
    folder.mkdir()
    model, weather = write(objects, folder), catalog.find_weather("USA_CO_Denver").path
    stop = "runtime.callback_begin_new_environment(state, runtime.stop_simulation)"
    run_energyplus(model, weather, folder, before=stop)
    text = (folder / "eplusout.eio").read_text() + (folder / "eplusout.bnd").read_text()
    return EngineReport(building, [[cell.strip() for cell in line.split(",")] for line in text.splitlines()])


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, EngineReport]:
    folder = tmp_path_factory.mktemp("eio")
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(MODELS, pool.map(lambda name: start(name, folder / name), MODELS), strict=True))


# Areas, as in `Zone Information`: … zone multiplier [10], list multiplier [11], … floor area [-8], … counted [-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_building_summary__floor_area_of_each_zone_is_energyplus_own(
    reports: dict[str, EngineReport], name: str
) -> None:
    rows = reports[name].of("Zone Information")
    areas = {zone.upper(): area for zone, area in zone_areas(reports[name].building.objects).items()}
    assert areas == pytest.approx({row[1]: float(row[-8]) for row in rows}, rel=0.005, abs=0.006)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_building_summary__buildings_areas_and_zones_are_energyplus_own(
    reports: dict[str, EngineReport], name: str
) -> None:
    rows = reports[name].of("Zone Information")
    controlled = {row[1] for row in reports[name].of("Controlled Zone")}
    counted = {row[1]: float(row[-8]) * int(row[10]) * int(row[11]) for row in rows if row[-1] == "Yes"}
    summary = building_summary(reports[name].building)
    assert summary.floor_area_m2 == pytest.approx(sum(counted.values()), rel=0.005)
    assert summary.conditioned_area_m2 == pytest.approx(
        sum(area for zone, area in counted.items() if zone in controlled), rel=0.005
    )
    assert (summary.zones, summary.conditioned_zones) == (len(rows), len(controlled))


@pytest.mark.slow
def test_models__have_multipliers_and_zones_that_do_not_count(reports: dict[str, EngineReport]) -> None:
    rows = [row for name in MODELS for row in reports[name].of("Zone Information")]
    assert max(int(row[10]) * int(row[11]) for row in rows) > 1
    assert {row[-1] for row in rows} == {"Yes", "No"}


@pytest.mark.parametrize("entry", catalog.bundled_buildings(), ids=lambda e: e.name)
def test_building_summary__facts_of_all_buildings_hold_together(entry: catalog.Entry) -> None:
    summary = listed_summaries(entry)
    assert 0 < summary.conditioned_area_m2 <= summary.floor_area_m2 * (1 + 1e-9)
    assert 0 < summary.conditioned_zones <= summary.zones
    assert summary.hvac != "none"
    assert summary.fuels[0] == "electricity"
    assert (summary.ems_programs > 0) != entry.name.startswith("ref-")  # the older models have none


# The same building in both generations: its form did not change.
@pytest.mark.parametrize(
    ("new", "old"),
    [("office-medium", "ref-medium-office"), ("school-primary", "ref-primary-school"), ("warehouse", "ref-warehouse")],
)
def test_building_summary__building_has_one_area_in_both_generations(new: str, old: str) -> None:
    areas = [listed_summaries(catalog.find_building(name)).floor_area_m2 for name in (new, old)]
    assert areas[0] == pytest.approx(areas[1], rel=0.001)


# Fuels and systems, by what EnergyPlus meters and offers


@pytest.mark.parametrize("name", ["ref-small-office", "office-medium", "ref-super-market", "hotel-small"])
def test_building_summary__fuels_are_those_that_energyplus_meters(name: str) -> None:
    building = read_building(catalog.find_building(name))
    meters = {m.name.upper() for m in discover(building, catalog.bundled_weathers()[0].path).meters}
    all_fuels = ("electricity", "natural gas", "propane", "district cooling", "district heating water", "coal")
    metered = {fuel for fuel in all_fuels if f"{fuel.replace(' ', '')}:facility".upper() in meters}
    assert set(building_summary(building).fuels) == metered


def model(**kinds: dict[str, dict[str, Any]]) -> Building:
    return Building(
        "b", {"Building": {"b": {}}} | {kind.replace("__", ":"): items for kind, items in kinds.items()}, "0"
    )


@pytest.mark.parametrize(
    ("kinds", "hvac", "fuels"),
    [
        ({}, "none", ()),
        ({"ZoneHVAC__IdealLoadsAirSystem": {"i": {}}}, "ideal loads", ("district cooling", "district heating water")),
        (
            {"ZoneHVAC__IdealLoadsAirSystem": {"i": {"cooling_fuel_type": "Electricity"}}, "Lights": {"l": {}}},
            "ideal loads",
            ("electricity", "district heating water"),
        ),
        (
            {
                "AirLoopHVAC": {"l": {}},
                "Coil__Cooling__DX__SingleSpeed": {"c": {}},
                "Coil__Heating__Fuel": {"h": {"fuel_type": "Propane"}},
            },
            "1 air loop, DX cooling, propane furnace",
            ("electricity", "propane"),
        ),
        (
            {
                "Generator__FuelSupply": {"f": {"fuel_type": "GaseousConstituents"}},
                "Exterior__WaterEquipment": {"w": {"fuel_use_type": "Water"}},
                "GroundHeatExchanger__Vertical__Array": {"a": {}},
                "ThermalStorage__Ice__Simple": {"i": {}},
            },
            "ground heat exchanger, ice storage",
            ("natural gas",),  # a fuel cell and a micro-CHP have no other meter
        ),
        (
            {
                "ZoneHVAC__PackagedTerminalAirConditioner": {
                    "p": {"cooling_coil_name": "System", "heating_coil_name": "HEAT"}
                },
                "CoilSystem__Cooling__DX__HeatExchangerAssisted": {"system": {"cooling_coil_name": "cool"}},
                "Coil__Cooling__DX__SingleSpeed": {"Cool": {}},
                "Coil__Heating__Electric": {"Heat": {}},
            },
            "PTAC",
            ("electricity",),
        ),
        (
            {
                "ZoneHVAC__LowTemperatureRadiant__VariableFlow": {
                    "r": {"surface_name_or_radiant_surface_group_name": "slab"}
                },
                "BuildingSurface__Detailed": {"Slab": {"surface_type": "Floor", "vertices": []}},
                "Boiler__HotWater": {"b": {"fuel_type": "NaturalGas"}},
            },
            "radiant floor, boiler",
            ("natural gas",),
        ),
    ],
)  # fmt: skip
def test_building_summary__systems_and_fuels_are_read_from_the_objects(
    kinds: dict[str, Any], hvac: str, fuels: tuple[str, ...]
) -> None:
    summary = building_summary(model(**kinds))
    assert (summary.hvac, summary.fuels) == (hvac, fuels)


# Geometry by hand


def polygon(*corners: tuple[float, float, float]) -> list[dict[str, float]]:
    return [{f"vertex_{axis}_coordinate": value for axis, value in zip("xyz", c, strict=True)} for c in corners]


SQUARE = polygon((0, 0, 0), (0, 2, 0), (2, 2, 0), (2, 0, 0))
L_SHAPE = polygon((0, 0, 0), (4, 0, 0), (4, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0))
TILTED = polygon((0, 0, 0), (3, 0, 4), (3, 2, 4), (0, 2, 0))  # 5 m along the slope, 2 m across


@pytest.mark.parametrize(("vertices", "area"), [(SQUARE, 4.0), (L_SHAPE, 6.0), (TILTED, 10.0)])
def test_building_summary__floors_area_is_its_polygons(vertices: list[dict[str, float]], area: float) -> None:
    surface = {"surface_type": "Floor", "zone_name": "A", "vertices": vertices}
    objects = model(Zone={"a": {}}, BuildingSurface__Detailed={"f": surface}).objects
    assert zone_areas(objects) == {"a": pytest.approx(area)}


def test_building_summary__walls_and_roofs_are_no_floor_and_a_zone_without_one_has_no_area() -> None:
    walls = {n: {"surface_type": n, "zone_name": "a", "vertices": SQUARE} for n in ("Wall", "Roof", "Ceiling")}
    assert zone_areas(model(Zone={"a": {}}, BuildingSurface__Detailed=walls).objects) == {"a": 0.0}


def test_building_summary__zones_own_field_comes_before_its_floors_and_autocalculate_is_none() -> None:
    floors = {n: {"surface_type": "floor", "zone_name": n, "vertices": SQUARE} for n in ("a", "b")}
    zones = {"a": {"floor_area": 7.5}, "b": {"floor_area": "Autocalculate"}}
    objects = model(Zone=zones, BuildingSurface__Detailed=floors).objects
    assert zone_areas(objects) == {"a": 7.5, "b": pytest.approx(4.0)}


def test_building_summary__rectangular_floor_and_the_floor_that_a_ceiling_implies_count() -> None:
    objects = model(
        Zone={"below": {}, "above": {}},
        Floor__GroundContact={"g": {"zone_name": "below", "length": 3.0, "width": 2.5}},
        BuildingSurface__Detailed={
            "c": {
                "surface_type": "Ceiling",
                "zone_name": "below",
                "outside_boundary_condition": "Zone",
                "outside_boundary_condition_object": "ABOVE",
                "vertices": SQUARE,
            }
        },
    ).objects
    assert zone_areas(objects) == {"below": 7.5, "above": pytest.approx(4.0)}


def test_building_summary__spaces_add_up_to_their_zone() -> None:
    floor = {"surface_type": "Floor", "zone_name": "a", "vertices": SQUARE}
    objects = model(
        Zone={"a": {}},
        Space={"s1": {"zone_name": "A"}, "s2": {"zone_name": "a", "floor_area": 10.0}},
        BuildingSurface__Detailed={"f1": floor | {"space_name": "S1"}, "f2": floor | {"space_name": "s2"}, "f3": floor},
    ).objects
    assert zone_areas(objects) == {"a": pytest.approx(4.0 + 10.0 + 4.0)}


def test_building_summary__multipliers_of_zones_and_lists_count_and_an_attic_does_not() -> None:
    summary = building_summary(
        model(
            Zone={
                "a": {"floor_area": 10.0, "multiplier": 2},
                "b": {"floor_area": 5.0},
                "attic": {"floor_area": 100.0, "part_of_total_floor_area": "No"},
            },
            ZoneList={"middle": {"zones": [{"zone_name": "A"}]}},
            ZoneGroup={"g": {"zone_list_name": "Middle", "zone_list_multiplier": 3}},
            ZoneHVAC__EquipmentConnections={"e": {"zone_name": "A"}},
        )
    )
    assert (summary.floor_area_m2, summary.conditioned_area_m2) == (65.0, 60.0)
    assert (summary.zones, summary.conditioned_zones) == (3, 1)


def test_building_summary__thermostat_on_a_list_of_zones_conditions_each() -> None:
    summary = building_summary(
        model(
            Zone={"a": {}, "b": {}, "c": {}},
            ZoneList={"both": {"zones": [{"zone_name": "a"}, {"zone_name": "b"}]}},
            ZoneControl__Thermostat={"t": {"zone_or_zonelist_name": "Both"}},
        )
    )
    assert summary.conditioned_zones == 2


def test_building_summary__facts_are_made_once_for_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "b.epJSON"
    path.write_text('{"Building": {"b": {}}, "Zone": {"a": {"floor_area": 5.0}}, "Timestep": {}}')
    entry = catalog.find_building(str(path))
    first = listed_summaries(entry)
    assert isinstance(first, BuildingSummary)
    assert first.floor_area_m2 == 5.0
    monkeypatch.setattr(summary, "building_summary", lambda _: pytest.fail("made again"))
    assert listed_summaries(entry) == first


# Places, as in EnergyPlus's list of what is connected (`eplusout.bnd`)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_building_summary__nodes_equipment_and_branches_are_where_energyplus_has_them(
    reports: dict[str, EngineReport], name: str
) -> None:
    where = {key: place.upper() for key, place in locations(reports[name].building.objects).items()}
    expected = {}
    for row in reports[name].of("Branch"):  # branch, loop, kind of loop, inlet node, outlet node
        expected[row[2]] = row[3]
        if row[4] == "Air":
            expected |= {row[5]: row[3], row[6]: row[3]}
    for kind in ("Controlled Zone Inlet", "Controlled Zone Return"):  # zone, node
        expected |= {row[3]: row[2] for row in reports[name].of(kind)}
    expected |= {row[3]: row[4] for row in reports[name].of("Zone Equipment Component")}
    assert len(expected) > 10
    assert {key: where.get(key) for key in expected} == expected


def test_building_summary__names_lead_to_the_zone_or_the_loop() -> None:
    places = locations(
        model(
            Zone={"Hall": {}, "Attic": {}},
            ZoneList={"All": {"zones": [{"zone_name": "Hall"}, {"zone_name": "Attic"}]}},
            Space={"Corner": {"zone_name": "hall"}},
            BuildingSurface__Detailed={
                "Wall": {"zone_name": "HALL", "construction_name": "Brick"},
                "Lid": {"zone_name": "Hall", "outside_boundary_condition_object": "Attic"},
            },
            FenestrationSurface__Detailed={"Pane": {"building_surface_name": "WALL"}},
            Lights={
                "Lamp": {"zone_or_zonelist_or_space_or_spacelist_name": "corner", "schedule_name": "Day"},
                "Bulbs": {"zone_or_zonelist_or_space_or_spacelist_name": "All"},
            },
            ZoneHVAC__EquipmentConnections={
                "x": {"zone_name": "Hall", "zone_conditioning_equipment_list_name": "List", "zone_air_node_name": "Air"}
            },
            ZoneHVAC__EquipmentList={"List": {"equipment": [{"zone_equipment_name": "Box"}]}},
            ZoneHVAC__AirDistributionUnit={"Box": {"air_terminal_name": "Damper"}},
            AirTerminal__SingleDuct__VAV__Reheat={
                "Damper": {"reheat_coil_name": "Reheat", "air_inlet_node_name": "In"}
            },
            Coil__Heating__Water={"Reheat": {"water_inlet_node_name": "Hot"}},
            AirLoopHVAC={"Duct": {"branch_list_name": "Air Branches"}},
            PlantLoop={"Loop": {"plant_side_branch_list_name": "Made", "demand_side_branch_list_name": "Used"}},
            BranchList={
                "Air Branches": {"branches": [{"branch_name": "Main"}]},
                "Made": {"branches": [{"branch_name": "Source"}]},
                "Used": {"branches": [{"branch_name": "Sink"}]},
            },
            Branch={
                "Main": {"components": [{"component_name": "Fan", "component_inlet_node_name": "Return"}]},
                "Source": {"components": [{"component_name": "Boiler"}]},
                "Sink": {"components": [{"component_name": "Reheat"}]},
            },
            SetpointManager__Scheduled={"Manager": {"setpoint_node_or_nodelist_name": "Return"}},
            Schedule__Compact={"Day": {}},
        ).objects
    )
    expected = {
        "HALL": "Hall", "CORNER": "Hall", "WALL": "Hall", "PANE": "Hall", "LAMP": "Hall", "CORNER LAMP": "Hall",
        "HALL BULBS": "Hall", "ATTIC BULBS": "Attic", "IZ-LID": "Attic", "BOX": "Hall", "DAMPER": "Hall",
        "REHEAT": "Hall", "HOT": "Hall", "AIR": "Hall", "IN": "Hall", "DUCT": "Duct", "MAIN": "Duct", "FAN": "Duct",
        "RETURN": "Duct", "MANAGER": "Duct", "LOOP": "Loop", "BOILER": "Loop", "SOURCE": "Loop", "SINK": "Loop",
    }  # fmt: skip
    assert {name: places.get(name) for name in expected} == expected
    assert not {"BULBS", "ALL", "DAY", "BRICK"} & places.keys()
