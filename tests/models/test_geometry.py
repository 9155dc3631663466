"""The geometry of models: zones by storey, kinds, boundaries, and what cannot be drawn; by hand calculation."""

from typing import Any

import numpy as np
import pytest
from support import data_packs
from support.geometry_models import DENVER, EVERY_FORM, box, model, rules, surface, vertices

from zenostat.models import catalog
from zenostat.models.building.geometry import building_geometry
from zenostat.models.building.model import Building, read_building
from zenostat.models.building.summary import building_summary, zone_areas
from zenostat.models.input_format.source_model import ObjectsOfType
from zenostat.topics import codec
from zenostat.topics.messages import Geometry, SurfaceKind
from zenostat.views.display.surfaces import Surface, area, surfaces, triangulate

NEED: dict[str, ObjectsOfType] = {"Building": {"b": {}}, "Zone": {"A": {}}}


def decoded(building: Building) -> tuple[Geometry, list[Surface]]:
    geometry, note = building_geometry(building, DENVER)
    assert note == ""
    assert geometry is not None
    return geometry, surfaces(geometry)


def check_whole(building: Building) -> None:
    """Check the invariants of any building: triangles, zones, storeys, floor areas."""
    geometry, parts = decoded(building)
    for part in parts:
        triangles = [area(part.corners[triangle]) for triangle in triangulate(part.corners)]
        assert sum(triangles) == pytest.approx(part.area_m2, rel=1e-9)
    summary = building_summary(building)
    assert len(geometry.zones) == summary.zones
    assert sum(zone.is_conditioned for zone in geometry.zones) == summary.conditioned_zones
    counted = {
        name
        for name, fields in building.objects["Zone"].items()
        if fields.get("part_of_total_floor_area", "Yes").casefold() != "no"
    }
    total = sum(zone.floor_area_m2 * zone.multiplier for zone in geometry.zones if zone.name in counted)
    assert total == pytest.approx(summary.floor_area_m2)
    assert list(geometry.storeys) == sorted(geometry.storeys)
    assert {zone.storey for zone in geometry.zones} == set(range(len(geometry.storeys)))
    drawn = {part.zone for part in parts if part.zone is not None}
    assert drawn == set(range(len(geometry.zones))), "each zone has surfaces"
    assert (geometry.latitude_deg, geometry.longitude_deg, geometry.time_zone_h) == (39.72, -104.75, -7.0)
    assert len(codec.encode(geometry)) < 100_000


@pytest.mark.variants
@pytest.mark.parametrize("name", [entry.name for entry in catalog.bundled_buildings()])
def test_geometry__every_bundled_building_has_a_geometry(name: str) -> None:
    building = read_building(catalog.find_building(name))
    check_whole(building)
    floors: dict[int, float] = {}
    geometry, parts = decoded(building)
    for part in parts:
        if part.kind is SurfaceKind.FLOOR and part.zone is not None:
            floors[part.zone] = floors.get(part.zone, 0.0) + part.area_m2
    for index, zone in enumerate(geometry.zones):
        stated = building.objects["Zone"][zone.name].get("floor_area")
        if not isinstance(stated, (int, float)):
            assert floors.get(index, 0.0) == pytest.approx(zone.floor_area_m2, rel=1e-4), zone.name


@pytest.mark.slow
def test_geometry__packs_buildings_have_a_geometry() -> None:
    data_packs.sinergym()
    for entry in catalog.buildings():
        if entry.pack:
            check_whole(read_building(entry))


def test_geometry__storeys_of_the_medium_office_hold_their_plena() -> None:
    geometry, _ = decoded(read_building(catalog.find_building("office-medium")))
    assert geometry.storeys == pytest.approx((0.0, 3.96, 7.92), abs=0.01)
    storeys = {zone.name: (zone.storey, zone.is_conditioned) for zone in geometry.zones}
    assert storeys["Core_bottom"] == (0, True)
    assert storeys["FirstFloor_Plenum"] == (0, False)
    assert storeys["MidFloor_Plenum"] == (1, False)
    assert storeys["Perimeter_top_ZN_3"] == (2, True)


def test_geometry__kinds_boundaries_and_zones_of_a_house() -> None:
    house = box("A", 0, 0, 0, (8, 6, 3), above="Adiabatic")
    house["inner"] = surface("Wall", "A", "Surface", (4, 0, 3), (4, 0, 0), (4, 6, 0), (4, 6, 3), other="inner")
    window = {
        "surface_type": "Window",
        "building_surface_name": "a SOUTH",
        **{
            f"vertex_{i}_{axis}_coordinate": value
            for i, corner in enumerate([(1, 0, 2), (1, 0, 1), (3, 0, 1), (3, 0, 2)], 1)
            for axis, value in zip("xyz", corner, strict=True)
        },
    }
    _, parts = decoded(
        model(**NEED, **{"BuildingSurface:Detailed": house, "FenestrationSurface:Detailed": {"w": window}})
    )
    south, _, _, _, floor, ceiling, inner, glass = parts
    assert (south.kind, south.is_exposed, south.azimuth_deg, south.tilt_deg, south.area_m2) == (0, True, 180, 90, 24)
    assert (floor.kind, floor.is_exposed, floor.tilt_deg, floor.area_m2) == (SurfaceKind.FLOOR, True, 180, 48)
    assert (ceiling.kind, ceiling.is_exposed, ceiling.tilt_deg) == (SurfaceKind.CEILING, False, 0)
    assert (inner.kind, inner.is_exposed) == (SurfaceKind.WALL, False)
    assert (glass.kind, glass.is_exposed, glass.area_m2, glass.zone) == (SurfaceKind.WINDOW, True, 2, 0)


def test_geometry__north_axis_turns_the_building_clockwise_as_seen_from_above() -> None:
    objects = NEED | {"Building": {"b": {"north_axis": 90}}}
    _, parts = decoded(model(**objects, **{"BuildingSurface:Detailed": box("A", 10, 0, 0, (8, 6, 3))}))
    assert parts[0].azimuth_deg == pytest.approx(270)  # the south wall faces west
    assert parts[0].corners[1] == pytest.approx((0, -10, 0), abs=1e-5)


def zones_of(
    *levels: tuple[str, float, float], people: tuple[str, ...] = (), hvac: tuple[str, ...] = ()
) -> tuple[tuple[float, ...], dict[str, int]]:
    """Storeys of boxes with a name, the height of the floor and of the room."""
    walls: ObjectsOfType = {}
    for name, z, height in levels:
        walls |= box(name, 0, 0, z, (8, 6, height))
    geometry, _ = decoded(
        model(
            **{
                "Zone": {name: {} for name, _, _ in levels},
                "BuildingSurface:Detailed": walls,
                "People": {name: {"zone_or_zonelist_or_space_or_spacelist_name": name} for name in people},
                "ZoneHVAC:EquipmentConnections": {name: {"zone_name": name} for name in hvac},
            }
        )
    )
    return geometry.storeys, {zone.name: zone.storey for zone in geometry.zones}


def test_geometry__plena_attics_and_crawl_spaces_have_no_storey_of_their_own() -> None:
    levels = (("crawl", -1.5, 1.5), ("low", 0, 2.7), ("plenum", 2.7, 1.3), ("high", 4, 2.7), ("attic", 6.7, 3))
    storeys, storey_of = zones_of(*levels, hvac=("low", "high"))
    assert storeys == (0.0, 4.0)
    assert storey_of == {"crawl": 0, "low": 0, "plenum": 0, "high": 1, "attic": 1}


def test_geometry__storey_without_hvac_but_with_people_is_one() -> None:
    storeys, storey_of = zones_of(
        ("garage", -3, 3), ("shop", 0, 3), ("flat", 3, 3), people=("garage",), hvac=("shop", "flat")
    )
    assert storeys == (-3.0, 0.0, 3.0)
    assert storey_of == {"garage": 0, "shop": 1, "flat": 2}


def test_geometry__floors_that_differ_by_a_step_are_one_storey() -> None:
    storeys, storey_of = zones_of(("a", 0, 3), ("b", 0.4, 3), ("c", 0.9, 3), ("d", 3.2, 3))
    assert storeys == (0.0, pytest.approx(3.2))
    assert storey_of == {"a": 0, "b": 0, "c": 0, "d": 1}


def test_geometry__multipliers_are_those_of_the_zone_and_of_its_group() -> None:
    objects: dict[str, Any] = {
        "Zone": {"A": {"multiplier": 2}},
        "ZoneList": {"list": {"zones": [{"zone_name": "a"}]}},
        "ZoneGroup": {"group": {"zone_list_name": "LIST", "zone_list_multiplier": 3}},
        "BuildingSurface:Detailed": box("A", 0, 0, 0, (8, 6, 3)),
    }
    geometry, _ = decoded(model(**objects))
    assert (geometry.zones[0].multiplier, geometry.zones[0].floor_area_m2) == (6, 48)


def test_geometry__photovoltaics_replace_a_shading_surface_and_lie_on_a_roof() -> None:
    objects = {
        "BuildingSurface:Detailed": box("A", 0, 0, 0, (8, 6, 3)),
        "Shading:Building:Detailed": {"panel": {"vertices": vertices((0, 0, 4), (4, 0, 4), (4, 2, 5))}},
        "Generator:Photovoltaic": {"1": {"surface_name": "PANEL"}, "2": {"surface_name": "a roof"}},
    }
    _, parts = decoded(model(**NEED, **objects))
    kinds = [part.kind for part in parts]
    assert kinds.count(SurfaceKind.PHOTOVOLTAIC) == 2
    assert kinds.count(SurfaceKind.SHADING) == 0
    roof, panels = (next(p for p in parts if p.kind is kind) for kind in (SurfaceKind.ROOF, SurfaceKind.PHOTOVOLTAIC))
    assert np.array_equal(roof.corners, panels.corners)
    assert (roof.zone, panels.zone) == (0, None)


BROKEN = {
    "line": (surface("Wall", "A", "Outdoors", (0, 0, 0), (1, 1, 1), (2, 2, 2)), "its area is 0"),
    "two": (surface("Wall", "A", "Outdoors", (0, 0, 0), (1, 1, 1)), "it has 2 corners"),
    "nan": (
        surface("Wall", "A", "Outdoors", (0, 0, float("nan")), (1, 1, 1), (2, 0, 0)),
        "a coordinate of a corner is missing, not a number, or above 10,000 km",
    ),
    "word": (
        surface("Wall", "A", "Outdoors", (0, 0, "x"), (1, 1, 1), (2, 0, 0)),  # type: ignore[arg-type]
        "a coordinate of a corner is missing, not a number, or above 10,000 km",
    ),
    "far": (
        surface("Wall", "A", "Outdoors", (0, 0, 1e39), (1, 1, 1), (2, 0, 0)),
        "a coordinate of a corner is missing, not a number, or above 10,000 km",
    ),
    "floor": (
        surface("Floor", "A", "Ground", (0, 0, "x"), (1, 1, 1), (2, 0, 0)),  # type: ignore[arg-type]
        "a coordinate of a corner is missing, not a number, or above 10,000 km",
    ),
    "lost": (surface("Wall", "C", "Outdoors", (0, 0, 0), (1, 1, 1), (2, 0, 0)), "there is no zone 'C'"),
    "odd": (surface("Lid", "A", "Outdoors", (0, 0, 0), (1, 1, 1), (2, 0, 0)), "its surface type is 'Lid'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_geometry__broken_surface_is_left_out_and_named(name: str) -> None:
    fields, reason = BROKEN[name]
    walls = box("A", 0, 0, 0, (8, 6, 3)) | {name: fields}
    geometry, note = building_geometry(model(**NEED, **{"BuildingSurface:Detailed": walls}), DENVER)
    assert geometry is not None
    assert len(surfaces(geometry)) == 6
    assert note == (
        f"1 of 7 surfaces are not in the geometry; the first is BuildingSurface:Detailed {name!r}: {reason}"
    )


def test_geometry__window_without_its_wall_is_left_out_and_named() -> None:
    objects = {
        "BuildingSurface:Detailed": box("A", 0, 0, 0, (8, 6, 3)),
        "Window": {"w": {"building_surface_name": "gone", "length": 1, "height": 1}},
    }
    geometry, note = building_geometry(model(**NEED, **objects), DENVER)
    assert geometry is not None
    assert note.endswith("the first is Window 'w': there is no surface 'gone' that can be drawn")


@pytest.mark.parametrize("objects", [{}, {"BuildingSurface:Detailed": {"line": BROKEN["line"][0]}}])
def test_geometry__model_without_a_usable_surface_has_no_geometry(objects: dict[str, ObjectsOfType]) -> None:
    geometry, note = building_geometry(model(**NEED, **objects), DENVER)
    assert geometry is None
    assert note.startswith("model has no surface that can be drawn")


def test_geometry__model_of_shading_only_has_one_storey() -> None:
    shade = {"azimuth_angle": 180, "length": 3, "height": 2}
    geometry, parts = decoded(model(**NEED, **{"Shading:Site": {"tree": shade}}))
    assert [part.area_m2 for part in parts] == [pytest.approx(6)]
    assert (geometry.zones[0].storey, geometry.storeys) == (0, (0.0,))


def test_geometry__floor_areas_are_those_of_the_summary() -> None:
    building = Building("every form", EVERY_FORM | rules(), "digest")
    geometry, _ = decoded(building)
    assert {zone.name: zone.floor_area_m2 for zone in geometry.zones} == zone_areas(building.objects)
