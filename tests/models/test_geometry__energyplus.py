"""Surfaces against EnergyPlus's own EIO file: every form of surface in every coordinate system, and whole buildings."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support import data_packs, eio
from support.geometry_models import DENVER, EVERY_FORM, rules

from zenostat.models import catalog
from zenostat.models.building.geometry import building_geometry
from zenostat.models.building.model import Building, read_building
from zenostat.models.building.polygons import PolygonReader
from zenostat.models.input_format.source_model import ModelObjects, ObjectsOfType
from zenostat.topics.messages import SurfaceKind
from zenostat.views.display.surfaces import Surface, sun_direction, surfaces

_PRINTED_M = 0.0051
"""EnergyPlus prints coordinates and areas with two digits."""

_APPENDIX_G = {"Compliance:Building": {"c": {"building_rotation_for_appendix_g": 33}}}

# Counter-clockwise from the upper left in relative coordinates stands first; the others are read from the same numbers.
SYSTEMS: dict[str, dict[str, ObjectsOfType]] = {
    "relative": rules(),
    "clockwise from the lower left": rules(
        vertex_entry_direction="Clockwise", starting_vertex_position="LowerLeftCorner"
    ),
    "from the upper right": rules(starting_vertex_position="UpperRightCorner"),
    "clockwise from the lower right": rules(
        vertex_entry_direction="Clockwise", starting_vertex_position="LowerRightCorner"
    ),
    "world": rules(coordinate_system="World", rectangular_surface_coordinate_system="World"),
    "world, rectangles relative": rules(coordinate_system="World"),
    "relative, rectangles in the world": rules(rectangular_surface_coordinate_system="World"),
    "rotated for Appendix G": rules() | _APPENDIX_G,
    "world, rotated for Appendix G": _APPENDIX_G
    | rules(coordinate_system="World", rectangular_surface_coordinate_system="World"),
}


def named_surfaces(objects: ModelObjects) -> dict[str, Surface]:
    """The surfaces of a geometry by the names that EnergyPlus gives them."""
    building = Building("model", dict(objects), "digest")
    geometry, note = building_geometry(building, DENVER)
    assert geometry is not None
    assert note == ""
    surfaces_by_label: dict[str, list[Surface]] = {}
    for polygon, surface in zip(PolygonReader(objects).polygons, surfaces(geometry), strict=True):
        assert polygon.kind is surface.kind
        if surface.kind is not SurfaceKind.PHOTOVOLTAIC:
            surfaces_by_label.setdefault(polygon.label, []).append(surface)
    named = {}
    for label, parts in surfaces_by_label.items():
        kind, name = label[:-1].split(" '", 1)
        suffixes = ("{} Left", "{} Right") if kind.startswith("Shading:Fin") else ("{}", "iz-{}")
        named |= {suffix.format(name.upper()): part for suffix, part in zip(suffixes, parts, strict=False)}
    return named


def check(objects: ModelObjects, folder: Path, extra: ModelObjects | None = None) -> int:
    """Compare all surfaces of a model; return their number."""
    own, expected = named_surfaces(objects), eio.surfaces(eio.simulate(objects, folder, extra))
    assert {surface.name for surface in expected} == own.keys()
    for surface in expected:
        mine = own[surface.name]
        assert mine.area_m2 == pytest.approx(surface.area_m2, rel=0.005, abs=_PRINTED_M), surface.name
        assert mine.tilt_deg == pytest.approx(surface.tilt_deg, abs=0.01), surface.name
        if 0.05 < surface.tilt_deg < 179.95:
            turned = (mine.azimuth_deg - surface.azimuth_deg + 180) % 360 - 180
            assert turned == pytest.approx(0, abs=0.01), surface.name
        if len(mine.corners) == len(surface.corners):  # EnergyPlus leaves out corners on a straight edge
            shifted = [np.roll(mine.corners, k, axis=0) for k in range(len(mine.corners))]
            assert min(np.abs(corners - surface.corners).max() for corners in shifted) < _PRINTED_M, surface.name
    return len(expected)


@pytest.mark.variants
@pytest.mark.parametrize("system", SYSTEMS)
def test_geometry__every_form_of_surface_is_where_energyplus_places_it(system: str, scratch: Path) -> None:
    assert check(EVERY_FORM | SYSTEMS[system], scratch / "run") == 38


@pytest.mark.variants
@pytest.mark.parametrize(
    "name", sorted((e.name for e in catalog.bundled_buildings()), key=lambda name: name != "warehouse")
)
def test_geometry__bundled_building_has_energypluss_areas_and_directions(name: str, scratch: Path) -> None:
    check(read_building(catalog.find_building(name)).objects, scratch / "run")


@pytest.mark.slow
def test_geometry__packs_buildings_have_energypluss_areas_and_directions(scratch: Path) -> None:
    data_packs.sinergym()
    names = [entry.name for entry in catalog.buildings() if entry.name.startswith("sinergym/")]
    assert len(names) == 9
    for name in names:
        check(read_building(catalog.find_building(name)).objects, scratch / name.replace("/", "-"))


def test_geometry__sun_is_where_energyplus_has_it(scratch: Path) -> None:
    variables = ("Site Solar Azimuth Angle", "Site Solar Altitude Angle")
    days = {
        str(month): {
            "begin_month": month,
            "begin_day_of_month": 21,
            "begin_year": 2017,
            "end_month": month,
            "end_day_of_month": 21,
            "end_year": 2017,
        }
        for month in (3, 6, 9, 12)
    }
    extra = {
        "RunPeriod": days,
        "Output:Variable": {
            name: {"key_value": "*", "variable_name": name, "reporting_frequency": "Timestep"} for name in variables
        },
    }
    positions = _positions(eio.simulate(EVERY_FORM | rules(), scratch / "run", extra) / "eplusout.eso")
    assert len(positions) == 4 * 96
    by_day = [(time, position) for time, position in positions if position[1] > 0]
    assert len(by_day) > 4 * 36
    for time, position in by_day:
        own = sun_direction(DENVER.latitude_deg, DENVER.longitude_deg, DENVER.time_zone_h, time)
        apart = np.degrees(np.arccos(np.clip(_direction(*own) @ _direction(*position), -1, 1)))
        assert apart < 0.5, (time, own, position)


def _direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])


def _positions(file: Path) -> list[tuple[datetime, tuple[float, float]]]:
    """The end of each timestep, azimuth and altitude."""
    head, _, body = file.read_text().partition("End of Data Dictionary\n")
    azimuth, altitude = (
        next(line.split(",")[0] for line in head.splitlines() if name in line) for name in ("Azimuth", "Altitude")
    )
    positions, time, values = [], datetime(2017, 1, 1), {}
    for line in body.splitlines():
        identity, *fields = line.split(",")
        if identity == "2":
            time = datetime(2017, int(fields[1]), int(fields[2])) + timedelta(
                hours=int(fields[4]) - 1, minutes=float(fields[6])
            )
        elif identity in (azimuth, altitude):
            values[identity] = float(fields[0])
            if len(values) == 2:
                positions.append((time, (values[azimuth], values[altitude])))
                values = {}
    return positions
