"""Surfaces of a building: polygons from a `Geometry`, their triangles, areas and directions; the sun's position.

from zenostat.views.display.surfaces import surfaces, triangulate

for surface in surfaces(bus.geometry("office")):
    print(surface.kind.name, surface.area_m2, surface.corners[triangulate(surface.corners)].shape)
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from math import acos, asin, atan2, cos, degrees, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import Geometry, SurfaceKind

Corners = NDArray[np.float64]
"""Corners of a polygon in m, shape (n, 3): x east, y north, z up; counter-clockwise as seen from outside."""

_FIELDS = {"kinds": "u1", "zone_index": "<i2", "exposed": "u1", "corner_counts": "<u2"}
_HORIZONTAL = 1e-6
"""Length of a unit normal's horizontal part below which a surface has no azimuth."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A plane polygon.

    Attributes:
        kind: wall, window, etc.
        zone: index into `Geometry.zones`; None for a shading surface.
        is_exposed: whether it borders on outdoors or ground.
        corners: shape (n, 3), in m.
    """

    kind: SurfaceKind
    zone: int | None
    is_exposed: bool
    corners: Corners

    @cached_property
    def normal(self) -> Floats:
        """Unit vector that points outwards."""
        return unit_normal(self.corners)

    @property
    def area_m2(self) -> float:
        """Area, including that of windows and doors in it."""
        return area(self.corners)

    @property
    def azimuth_deg(self) -> float:
        """Direction that it faces; see `azimuth_deg`."""
        return azimuth_deg(self.corners)

    @property
    def tilt_deg(self) -> float:
        """Tilt; see `tilt_deg`."""
        return tilt_deg(self.corners)


def surfaces(geometry: Geometry) -> list[Surface]:
    """Return the surfaces of a geometry, in its order.

    Raises:
        BadMessage: the arrays do not fit together, or contain an unknown kind, an index out of range or NaN.
    """
    count = len(geometry.kinds)
    kinds, zones, exposed, corner_counts = (_array(geometry, name, kind, count) for name, kind in _FIELDS.items())
    ends = np.cumsum(corner_counts)
    corners = _array(geometry, "corners", "<f4", 3 * int(corner_counts.sum())).reshape(-1, 3).astype(float)
    storeys = [zone.storey for zone in geometry.zones]
    _check(
        max(storeys, default=-1) < len(geometry.storeys), f"its zones are in storeys up to {max(storeys, default=0)}"
    )
    _check(kinds.max(initial=0) <= max(SurfaceKind), f"its kinds contain {kinds.max(initial=0)}")
    lowest, highest = zones.min(initial=0), zones.max(initial=-1)
    _check(
        lowest >= -1 and highest < len(geometry.zones),
        f"zone_index has values from {lowest} to {highest}; there are {len(geometry.zones)} zones",
    )
    _check(corner_counts.min(initial=3) >= 3, "a surface has fewer than 3 corners")
    _check(bool(np.isfinite(corners).all()), "corners contains NaN or infinity")
    return [
        Surface(SurfaceKind(kind), int(zone) if zone >= 0 else None, bool(is_exposed), corners[end - size : end])
        for kind, zone, is_exposed, size, end in zip(kinds, zones, exposed, corner_counts, ends, strict=True)
    ]


def _array(geometry: Geometry, name: str, kind: str, length: int) -> NDArray[np.generic]:
    raw = getattr(geometry, name)
    expected = length * np.dtype(kind).itemsize
    _check(len(raw) == expected, f"{name} has {len(raw)} bytes; {expected} expected")
    return np.frombuffer(raw, kind)


def _check(is_valid: bool, text: str) -> None:  # noqa: FBT001
    if not is_valid:
        raise BadMessage(f"Geometry: {text}")


def area_vector(corners: Corners) -> Floats:
    """Return the polygon's normal with its area in m2 as length (Newell's method: half the sum of cross products)."""
    relative = corners - corners[0]  # far from the origin the products would cancel
    vector: Floats = np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0) / 2
    return vector


def area(corners: Corners) -> float:
    """Return the area of a polygon in m2."""
    return float(np.linalg.norm(area_vector(corners)))


def unit_normal(corners: Corners) -> Floats:
    """Return the polygon's unit normal; zeros if its area is 0."""
    vector = area_vector(corners)
    length = np.linalg.norm(vector)
    return vector / length if length else vector


def azimuth_deg(corners: Corners) -> float:
    """Return the direction that a polygon faces, 0 to 360: 0 is north, 90 east; 0 for a horizontal one."""
    x, y, _ = unit_normal(corners)
    return degrees(atan2(x, y)) % 360 if x * x + y * y > _HORIZONTAL**2 else 0.0


def tilt_deg(corners: Corners) -> float:
    """Return the angle between a polygon's normal and the zenith, 0 to 180: 0 faces up, 90 is vertical."""
    return degrees(acos(min(1.0, max(-1.0, unit_normal(corners)[2]))))


def triangulate(corners: Corners) -> NDArray[np.intp]:
    """Divide a simple polygon, convex or concave, into triangles by ear clipping.

    Args:
        corners: shape (n, 3), n at least 3. Repeated corners and edges that touch are permitted.

    Returns:
        Indices of the triangles' corners, shape (n - 2, 3), with the polygon's orientation.
    """
    if len(corners) < 3:
        raise ValueError(f"a polygon has at least 3 corners, not {len(corners)}")
    points = _flat(corners)
    left = list(range(len(points)))
    triangles = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(points, left, i)), None)
        if ear is None:
            ear = _flattest(points, left)
        triangles.append(_triple(left, ear))
        del left[ear]
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles, np.intp)


def _flat(corners: Corners) -> list[tuple[float, float]]:
    """Project a polygon along the axis that is nearest to its normal, so that it is counter-clockwise in (x, y)."""
    vector = area_vector(corners)
    axis = int(np.abs(vector).argmax())
    flat = np.delete(corners - corners[0], axis, axis=1)
    if (vector[axis] < 0) != (axis == 1):  # deleting y leaves (x, z), which is mirrored
        flat = flat[:, ::-1]
    return [(float(x), float(y)) for x, y in flat]


def _triple(left: list[int], i: int) -> tuple[int, int, int]:
    return left[i - 1], left[i], left[(i + 1) % len(left)]


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return twice the signed area of a triangle; positive if it is counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _is_ear(points: list[tuple[float, float]], left: list[int], i: int) -> bool:
    a, b, c = (points[k] for k in _triple(left, i))
    if _turn(a, b, c) < 0:
        return False
    return not any(
        point not in (a, b, c) and _turn(a, b, point) >= 0 and _turn(b, c, point) >= 0 and _turn(c, a, point) >= 0
        for point in (points[k] for k in left)
    )


def _flattest(points: list[tuple[float, float]], left: list[int]) -> int:
    """Return the corner whose triangle is smallest, for a polygon that crosses itself and has no ear."""
    return min(range(len(left)), key=lambda i: abs(_turn(*(points[k] for k in _triple(left, i)))))


def sun_direction(latitude_deg: float, longitude_deg: float, time_zone_h: float, time: datetime) -> tuple[float, float]:
    """Return the sun's azimuth (0 is north, 90 east) and elevation above the horizon in degrees.

    Without refraction, and accurate to about half a degree, like EnergyPlus's: declination and equation of time are
    J. W. Spencer's Fourier series ("Fourier series representation of the position of the sun", Search 2 (5), 1971).

    Args:
        latitude_deg: north positive.
        longitude_deg: east positive.
        time_zone_h: hours ahead of UTC.
        time: local standard time, without a time zone.
    """
    hour = time.hour + time.minute / 60 + (time.second + time.microsecond / 1e6) / 3600
    day = 2 * pi * (time.timetuple().tm_yday - 1 + (hour - time_zone_h - 12) / 24) / 365
    declination = (
        0.006918
        - 0.399912 * cos(day)
        + 0.070257 * sin(day)
        - 0.006758 * cos(2 * day)
        + 0.000907 * sin(2 * day)
        - 0.002697 * cos(3 * day)
        + 0.00148 * sin(3 * day)
    )
    equation_of_time_min = 229.18 * (
        0.000075 + 0.001868 * cos(day) - 0.032077 * sin(day) - 0.014615 * cos(2 * day) - 0.040849 * sin(2 * day)
    )
    solar_hour = hour + longitude_deg / 15 - time_zone_h + equation_of_time_min / 60
    hour_angle, latitude = radians(15 * (solar_hour - 12)), radians(latitude_deg)
    east = -cos(declination) * sin(hour_angle)
    north = sin(declination) * cos(latitude) - cos(declination) * sin(latitude) * cos(hour_angle)
    up = sin(declination) * sin(latitude) + cos(declination) * cos(latitude) * cos(hour_angle)
    return degrees(atan2(east, north)) % 360, degrees(asin(min(1.0, max(-1.0, up))))
