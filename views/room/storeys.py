"""Floor plans of a building: the outlines of its zones, storey by storey, and a place for the label of each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.messages import Geometry, SurfaceKind
from zenostat.views.display.surfaces import Surface, area, surfaces

_GRID = 24
_PLANES = (SurfaceKind.FLOOR, SurfaceKind.CEILING, SurfaceKind.ROOF)
"""Surfaces that give a zone's outline: its floors, or what it has instead of one."""

Outline = NDArray[np.float64]


def storeys(geometry: Geometry, zones: dict[str, int]) -> list[dict[str, Any]]:
    """Return the storeys that have zones with a temperature, from the lowest one up.

    Args:
        geometry: of the building.
        zones: number of each zone with a temperature, by its name in lower case; others are drawn without a value.

    Returns:
        For each storey its `height_m` and its `zones`, each with the name, the number (None without a temperature), the
        `outlines` as lists of [x, y] in m, east and north, and the `label`: x, y and the distance to the nearest edge.
    """
    outlines = _outlines(geometry)
    result = []
    for storey, height_m in enumerate(geometry.storeys):
        drawn = [
            {
                "name": zone.name,
                "zone": zones.get(zone.name.casefold()),
                "outlines": [np.round(outline, 2).tolist() for outline in outlines[index]],
                "label": _label_place(max(outlines[index], key=_flat_area)),
            }
            for index, zone in enumerate(geometry.zones)
            if zone.storey == storey
            and outlines[index]
            and (zone.is_conditioned or zone.name.casefold() in zones)  # no attic or plenum, which would hide rooms
        ]
        if any(zone["zone"] is not None for zone in drawn):
            result.append({"height_m": round(height_m, 2), "zones": drawn})
    return result


def _outlines(geometry: Geometry) -> list[list[Outline]]:
    """Return the outlines of each zone, seen from above."""
    by_zone: list[dict[SurfaceKind, list[Surface]]] = [{} for _ in geometry.zones]
    for surface in surfaces(geometry):
        if surface.zone is not None and surface.kind in _PLANES:
            by_zone[surface.zone].setdefault(surface.kind, []).append(surface)
    outlines = []
    for planes in by_zone:
        kind = next((kind for kind in _PLANES if kind in planes), None)
        outlines.append([] if kind is None else [surface.corners[:, :2] for surface in planes[kind]])
    return [[outline for outline in each if _flat_area(outline) > 0.0] for each in outlines]


def _flat_area(outline: Outline) -> float:
    return area(np.column_stack([outline, np.zeros(len(outline))]))


def _label_place(outline: Outline) -> list[float]:
    """Return x, y and the distance to the nearest edge of the point of a grid that is farthest from all edges."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    steps = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(*(low[axis] + steps * (high[axis] - low[axis]) for axis in (0, 1)))
    points = np.vstack([np.column_stack([x.ravel(), y.ravel()]), outline.mean(axis=0), (low + high) / 2])
    begins, ends = outline, np.roll(outline, -1, axis=0)
    along = ends - begins
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    part = np.clip(((points[:, None] - begins) * along).sum(axis=2) / length, 0.0, 1.0)
    distance = np.linalg.norm(points[:, None] - (begins + part[..., None] * along), axis=2).min(axis=1)
    distance[~_is_inside(points, begins, ends)] = 0.0
    # Of several places that are as far from the edges, the one nearest to the middle reads best.
    middle = np.linalg.norm(points - (low + high) / 2, axis=1)
    best = np.lexsort((middle, -np.round(distance / max(distance.max(), 1e-9), 1)))[0]
    return [round(float(value), 2) for value in (*points[best], distance[best])]


def _is_inside(points: Outline, begins: Outline, ends: Outline) -> NDArray[np.bool_]:
    """Return for each point whether an odd number of edges is crossed on the way to the east."""
    x, y = points[:, :1], points[:, 1:]
    crosses = (begins[:, 1] > y) != (ends[:, 1] > y)
    rise = ends[:, 1] - begins[:, 1]
    at = begins[:, 0] + (y - begins[:, 1]) * (ends[:, 0] - begins[:, 0]) / np.where(rise == 0.0, 1.0, rise)
    inside: NDArray[np.bool_] = ((crosses & (at > x)).sum(axis=1) % 2).astype(bool)
    return inside
