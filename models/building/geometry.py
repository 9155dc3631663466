"""The geometry of a building: its zones by storey, and the polygons of its surfaces in world coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zenostat.models.building.frames import Frame
from zenostat.models.building.model import Building
from zenostat.models.building.polygons import Polygon, PolygonReader
from zenostat.models.building.summary import conditioned_zones, used_zones, zone_areas, zone_multipliers
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.models.weather.header import Header
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Geometry, SurfaceKind, ZoneGeometry

STOREY_M = 1.0
"""Floors whose heights differ by at most this much belong to one storey."""

_MAX_CORNERS = 65_535
_MIN_AREA_M2 = 1e-6


class BuildingGeometry(NamedTuple):
    """The geometry of a model.

    Attributes:
        geometry: None if the model has no surface that can be drawn.
        note: why there is none, or how many surfaces are left out; empty if all are in it.
    """

    geometry: Geometry | None
    note: str


class _Corners(NamedTuple):
    """Corners of all polygons in turn, in m, shape (corners, 3), and the index of each polygon's first one."""

    corners: Floats
    counts: NDArray[np.intp]
    first: NDArray[np.intp]


def building_geometry(building: Building, place: Header) -> BuildingGeometry:
    """Return the geometry of a model at the place of a weather file.

    Surfaces with fewer than 3 corners, without an area, or of a zone or a window that does not exist are left out.
    """
    reader = PolygonReader(building.objects)
    polygons, broken = reader.polygons, reader.broken
    placed = _placed(polygons, reader.frames)
    areas = _areas(placed)
    is_valid = (areas > _MIN_AREA_M2) & (placed.counts <= _MAX_CORNERS)
    broken += [(p.label, "its area is 0") for p, valid in zip(polygons, is_valid, strict=True) if not valid]
    if not is_valid.any():
        return BuildingGeometry(None, f"{building.name} has no surface that can be drawn{_first(broken)}")
    corners = placed.corners[np.repeat(is_valid, placed.counts)]
    kept = [polygon for polygon, valid in zip(polygons, is_valid, strict=True) if valid]
    zones, storeys = _zones(building.objects, polygons, placed)
    index = {name.casefold(): i for i, name in enumerate(building.objects.get("Zone", {}))} | {"": -1}
    geometry = Geometry(
        zones=tuple(zones),
        storeys=tuple(storeys),
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        time_zone_h=place.time_zone_h,
        kinds=bytes(polygon.kind for polygon in kept),
        zone_index=np.array([index[polygon.zone] for polygon in kept], "<i2").tobytes(),
        exposed=bytes(polygon.is_exposed for polygon in kept),
        corner_counts=placed.counts[is_valid].astype("<u2").tobytes(),
        corners=corners.astype("<f4").tobytes(),
    )
    note = f"{len(broken)} of {len(kept) + len(broken)} surfaces are not in the geometry{_first(broken)}"
    return BuildingGeometry(geometry, note if broken else "")


def _first(broken: Sequence[tuple[str, str]]) -> str:
    return f"; the first is {broken[0][0]}: {broken[0][1]}" if broken else ""


# Coordinates


def _placed(polygons: Sequence[Polygon], frames: Mapping[str | None, Frame]) -> _Corners:
    """Return the corners of all polygons in world coordinates."""
    counts = np.array([len(polygon.corners) for polygon in polygons], np.intp)
    flat = [corner for polygon in polygons for corner in polygon.corners]
    corners = np.array(flat, float).reshape(-1, 3)
    names = list(frames)
    index = {name: i for i, name in enumerate(names)}
    angle, *origin = np.array([frames[name] for name in names]).T
    of_corner = np.repeat(np.array([index[polygon.frame] for polygon in polygons], np.intp), counts)
    cosine, sine = np.cos(angle)[of_corner], np.sin(angle)[of_corner]
    x, y, z = corners.T
    placed = np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=1) + np.stack(origin, axis=1)[of_corner]
    return _Corners(placed, counts, np.cumsum(counts) - counts)


def _areas(placed: _Corners) -> Floats:
    """Return the area of each polygon in m2 (Newell's method)."""
    corners, counts, first = placed
    if not len(counts):
        return np.empty(0)
    relative = corners - np.repeat(corners[first], counts, axis=0)
    following = np.roll(relative, -1, axis=0)
    following[first + counts - 1] = 0.0  # the first corner
    areas: Floats = np.linalg.norm(np.add.reduceat(np.cross(relative, following), first), axis=1) / 2
    return areas


# Zones and storeys


def _zones(
    objects: ModelObjects, polygons: Sequence[Polygon], placed: _Corners
) -> tuple[list[ZoneGeometry], list[float]]:
    """Return the zones, and the heights of the storeys' floors in m.

    Zones that nobody uses (plena, attics, crawl spaces) have no storey of their own: they belong to the one below, or
    to the lowest one.
    """
    floors = _floor_heights(polygons, placed)
    used = used_zones(objects) & floors.keys() or floors.keys()
    storeys: list[float] = []
    for height in sorted(floors[zone] for zone in used):
        if not storeys or height > storeys[-1] + STOREY_M:
            storeys.append(height)
    storeys = storeys or [0.0]
    conditioned, areas, multipliers = conditioned_zones(objects), _floor_areas(objects), zone_multipliers(objects)
    # A zone without surfaces is on the lowest storey.
    below = {zone: sum(storey <= height + STOREY_M for storey in storeys) - 1 for zone, height in floors.items()}
    zones = [
        ZoneGeometry(
            name=name,
            storey=max(0, below.get(name.casefold(), 0)),
            floor_area_m2=areas.get(name, 0.0),
            multiplier=multipliers[name],
            is_conditioned=name.casefold() in conditioned,
        )
        for name in objects.get("Zone", {})
    ]
    return zones, storeys


def _floor_areas(objects: ModelObjects) -> dict[str, float]:
    try:
        return {zone: max(0.0, area) for zone, area in zone_areas(objects).items()}
    except (KeyError, TypeError, ValueError):  # a floor whose corners are no numbers
        return {}


def _floor_heights(polygons: Sequence[Polygon], placed: _Corners) -> dict[str, float]:
    """Return the height of the lowest floor of each zone, or of its lowest surface if it has no floor, in m."""
    lowest = np.minimum.reduceat(placed.corners[:, 2], placed.first)
    heights: dict[tuple[str, bool], float] = {}
    for polygon, height in zip(polygons, lowest.tolist(), strict=True):
        key = polygon.zone, polygon.kind is SurfaceKind.FLOOR
        heights[key] = min(height, heights.get(key, height))
    zones = {zone for zone, _ in heights if zone}
    return {zone: heights.get((zone, True), heights.get((zone, False), 0.0)) for zone in zones}
