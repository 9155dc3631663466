"""Meshes of a building for the 3D view: storeys cut open and drawn apart, a mesh for each zone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Geometry, SurfaceKind
from zenostat.views.display.surfaces import Surface, surfaces, triangulate

Points = NDArray[np.float64]

CUT_M = 1.3
"""Smallest height above a storey's floor at which its walls are cut."""

MAX_STACKED = 4
"""Largest number of storeys drawn above each other; more hide each other and are drawn side by side."""

_ROWS_ASPECT = 2.6
"""Width by depth of storeys side by side, which a view from above at a slant shortens."""

_CUT_SHARE = 0.035
"""Height of the cut as a share of the building's horizontal extent, so that walls of large buildings are seen."""

_INSET_M = 0.05
"""Distance by which walls are moved into their zone, so that both sides of an interior wall are seen."""

_PLENUM_M = 1.0
"""Height above a storey's floor from which a zone without a temperature counts as a plenum."""

_BELOW_GROUND_M = -1.0
"""Height of a floor below which its storey is a basement."""

_OPENINGS = (SurfaceKind.WINDOW, SurfaceKind.DOOR)
_SHADES = {SurfaceKind.SHADING: "shading", SurfaceKind.PHOTOVOLTAIC: "photovoltaics"}


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: positions of shape (n, 3) in m, their normals, and brightnesses from 0 to 1 of shape (n,)."""

    positions: Points
    normals: Points
    brightness: Floats
    triangles: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class BuildingModel:
    """The building as it is drawn.

    Attributes:
        zones: mesh of each drawn zone by its name in EnergyPlus.
        others: meshes of `windows`, `doors`, `shading`, `photovoltaics`, where there are any.
        storey_labels: text and position of the labels of storeys that are drawn side by side.
        zone_places: where each drawn zone's name stands, above its floor.
        low, high: corners of the box around all zones, as drawn.
    """

    zones: dict[str, Mesh]
    others: dict[str, Mesh]
    storey_labels: list[tuple[str, Points]]
    zone_places: dict[str, Points]
    low: Points
    high: Points

    @property
    def center(self) -> Points:
        """Center of the box."""
        return (self.low + self.high) / 2

    @property
    def radius_m(self) -> float:
        """Half of the box's diagonal."""
        return float(np.linalg.norm(self.high - self.low)) / 2


def clip_above(corners: Points, height: float) -> Points:
    """Return the part of a polygon at or below a height, shape (n, 3); n may be 0 (Sutherland and Hodgman, 1974)."""
    kept = []
    for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        is_first_below, is_second_below = first[2] <= height, second[2] <= height
        if is_first_below:
            kept.append(first)
        if is_first_below != is_second_below:
            share = (height - first[2]) / (second[2] - first[2])
            kept.append(first + share * (second - first))
    return np.array(kept).reshape(-1, 3)


def storey_offsets(extents: Points, floors: Sequence[float]) -> Points:
    """Return the shift of each storey in m, shape (storeys, 3): apart vertically, or side by side in rows.

    Args:
        extents: width (east) and depth (north) of the building in m.
        floors: height of each storey's floor in m, ascending.
    """
    count = len(floors)
    offsets = np.zeros((count, 3))
    if count <= MAX_STACKED:
        offsets[:, 2] = np.arange(count) * 0.24 * math.hypot(*extents)
        return offsets
    width, depth = extents * (1.12, 1.3)
    columns = min(count, max(1, round(math.sqrt(_ROWS_ASPECT * count * depth / width))))
    columns = -(-count // -(-count // columns))  # rows of equal length
    places = np.arange(count)
    offsets[:, 0] = places % columns * width
    offsets[:, 1] = -(places // columns) * depth
    offsets[:, 2] = floors[0] - np.asarray(floors)
    return offsets


def building_model(geometry: Geometry, measured: Iterable[str]) -> BuildingModel | None:
    """Return the meshes of a building; None if no zone can be drawn.

    Zones that are neither conditioned nor measured are drawn only if they begin at the floor of a storey with other
    zones: plena and attics would hide the rooms below them.

    Args:
        geometry: of the node.
        measured: names of the zones with a temperature.
    """
    polygons = surfaces(geometry)
    names = {name.casefold() for name in measured}
    is_main = [zone.is_conditioned or zone.name.casefold() in names for zone in geometry.zones]
    bases: dict[int, float] = {}
    for polygon in polygons:
        if polygon.zone is not None:
            bases[polygon.zone] = min(bases.get(polygon.zone, math.inf), float(polygon.corners[:, 2].min()))
    storeys = sorted({zone.storey for zone, main in zip(geometry.zones, is_main, strict=True) if main})
    drawn = [
        index
        for index, zone in enumerate(geometry.zones)
        if is_main[index]
        or (zone.storey in storeys and bases.get(index, math.inf) < geometry.storeys[zone.storey] + _PLENUM_M)
    ]
    if not drawn or not storeys:
        return None
    corners = np.concatenate([polygon.corners for polygon in polygons if polygon.zone in drawn])
    extents = np.ptp(corners[:, :2], axis=0)
    floors = [geometry.storeys[storey] for storey in storeys]
    offsets = storey_offsets(extents, floors)
    cut_m = max(CUT_M, _CUT_SHARE * math.hypot(*extents))
    place = {storey: number for number, storey in enumerate(storeys)}
    zones: dict[str, Mesh] = {}
    places: dict[str, Points] = {}
    openings: dict[str, list[Points]] = {"windows": [], "doors": []}
    for index in drawn:
        zone = geometry.zones[index]
        offset, top = offsets[place[zone.storey]], geometry.storeys[zone.storey] + cut_m
        own = [polygon for polygon in polygons if polygon.zone == index]
        parts = [(cut + offset, brightness) for cut, brightness in _zone_parts(own, top)]
        if parts:
            zones[zone.name] = mesh([part for part, _ in parts], [brightness for _, brightness in parts])
            places[zone.name] = _center(zones[zone.name], top + offset[2])
        for polygon in own:
            if polygon.kind in _OPENINGS:
                cut = clip_above(polygon.corners + polygon.normal * _INSET_M, top)
                openings["windows" if polygon.kind == SurfaceKind.WINDOW else "doors"].append(cut + offset)
    if not zones:
        return None
    shades = _shades(polygons, floors, offsets)
    others = {name: mesh(parts) for name, parts in (openings | shades).items() if any(len(part) > 2 for part in parts)}
    positions = np.concatenate([part.positions for part in zones.values()])
    labels = _storey_labels(geometry, storeys, offsets, corners) if len(storeys) > MAX_STACKED else []
    return BuildingModel(zones, others, labels, places, positions.min(axis=0), positions.max(axis=0))


def _zone_parts(own: Sequence[Surface], top: float) -> list[tuple[Points, float]]:
    """Return the polygons of a zone below a height, with their brightness: floors, and walls moved inwards."""
    parts = []
    for polygon in own:
        if polygon.kind == SurfaceKind.FLOOR:
            parts.append((polygon.corners, 1.0))
        elif polygon.kind == SurfaceKind.WALL:
            cut = clip_above(polygon.corners - polygon.normal * _INSET_M, top)
            if len(cut) > 2:
                parts.append((cut, 0.78))
    return parts


def _shades(polygons: Sequence[Surface], floors: Sequence[float], offsets: Points) -> dict[str, list[Points]]:
    """Return the shading and photovoltaic surfaces, each moved with the storey in whose height it begins."""
    parts: dict[str, list[Points]] = {name: [] for name in _SHADES.values()}
    if len(floors) > MAX_STACKED:
        return parts
    for polygon in polygons:
        if polygon.kind in _SHADES:
            below = np.searchsorted(floors, polygon.corners[:, 2].min() + 1e-6, side="right") - 1
            parts[_SHADES[polygon.kind]].append(polygon.corners + offsets[max(int(below), 0)])
    return parts


def _storey_labels(
    geometry: Geometry, storeys: Sequence[int], offsets: Points, corners: Points
) -> list[tuple[str, Points]]:
    low, high = corners.min(axis=0), corners.max(axis=0)
    names = storey_names(geometry)
    labels = []
    for storey, offset in zip(storeys, offsets, strict=True):
        text = names[storey]
        front = np.array([(low[0] + high[0]) / 2, low[1] - 0.04 * (high[1] - low[1]), geometry.storeys[storey]])
        labels.append((text, front + offset))
    return labels


def storey_names(geometry: Geometry) -> list[str]:
    """Return the name of each storey: `Basement`, `Storey 1` for the lowest above ground, `Storeys 2 to 11`."""
    multipliers = dict.fromkeys(range(len(geometry.storeys)), math.inf)
    for zone in geometry.zones:
        multipliers[zone.storey] = min(multipliers[zone.storey], zone.multiplier)
    below = sum(height < _BELOW_GROUND_M for height in geometry.storeys)
    names = ["Basement"] if below == 1 else [f"Basement {below - number}" for number in range(below)]
    first = 1
    for storey in range(below, len(geometry.storeys)):
        times = round(multipliers[storey]) if math.isfinite(multipliers[storey]) else 1
        names.append(f"Storey {first}" if times == 1 else f"Storeys {first} to {first + times - 1}")
        first += times
    return names


def _center(part: Mesh, height: float) -> Points:
    """Return the center of the area of a zone's floor, seen from above, at a height."""
    corners = part.positions[part.triangles]
    areas = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2])
    if not areas.any():
        areas = np.ones(len(areas))
    east, north, _ = np.average(corners.mean(axis=1), axis=0, weights=areas)
    return np.array([east, north, height])


def mesh(polygons: Sequence[Points], brightness: Sequence[float] | None = None) -> Mesh:
    """Return the triangles of polygons; those with less than 3 corners or without an area are left out."""
    positions, normals, shades, triangles, first = [], [], [], [], 0
    for polygon, shade in zip(polygons, brightness or [1.0] * len(polygons), strict=True):
        if len(polygon) < 3:
            continue
        normal = np.cross(polygon - polygon[0], np.roll(polygon - polygon[0], -1, axis=0)).sum(axis=0)
        length = np.linalg.norm(normal)
        if length < 1e-9:
            continue
        positions.append(polygon)
        normals.append(np.broadcast_to(normal / length, polygon.shape))
        shades.append(np.full(len(polygon), shade))
        triangles.append(triangulate(polygon) + first)
        first += len(polygon)
    if not positions:
        empty = np.empty((0, 3))
        return Mesh(empty, empty, np.empty(0), np.empty((0, 3), np.intp))
    return Mesh(*map(np.concatenate, (positions, normals, shades, triangles)))
