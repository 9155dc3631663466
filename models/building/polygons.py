"""Read the polygons of a model's surfaces, in the coordinates in which the model gives them.

Semantics of the objects: EnergyPlus's Input Output Reference, "Thermal Zone Description/Geometry" and "Surface(s)".
Polygons leave here counter-clockwise as seen from outside their zone, beginning with the upper left corner, whatever
the model's `GlobalGeometryRules` are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import acos, atan2, cos, degrees, hypot, isfinite, radians, sin
from typing import Any

from zenostat.models.building.frames import SITE, frames
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.messages import SurfaceKind

Corner = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Polygon:
    """A surface.

    Attributes:
        kind: wall, window, etc.
        label: type and name of its object.
        zone: case-folded name of its zone; empty for a shading surface.
        frame: of its corners; a zone, the building or the site; see `zenostat.models.building.frames`.
        is_exposed: whether it borders on outdoors or ground.
        corners: counter-clockwise as seen from outside, from the upper left one.
    """

    kind: SurfaceKind
    label: str
    zone: str
    frame: str | None
    is_exposed: bool
    corners: tuple[Corner, ...]


class BrokenSurface(Exception):
    """A surface that cannot be drawn; the text says why."""


# Outside boundary conditions inside the building; all others are outdoors, ground, or a model of one of them.
_INSIDE = frozenset(("adiabatic", "surface", "zone", "space"))

_DETAILED = {
    "BuildingSurface:Detailed": "",
    "Wall:Detailed": "wall",
    "RoofCeiling:Detailed": "roof",
    "Floor:Detailed": "floor",
}
_DETAILED_KINDS = {
    "wall": SurfaceKind.WALL,
    "roof": SurfaceKind.ROOF,
    "ceiling": SurfaceKind.ROOF,  # if exposed
    "floor": SurfaceKind.FLOOR,
}
_MAX_M = 1e7
_X, _Y, _Z = (f"vertex_{axis}_coordinate" for axis in "xyz")
# Object type: kind, whether it is exposed, default of the tilt.
_RECTANGULAR = {
    "Wall:Exterior": (SurfaceKind.WALL, True, 90.0),
    "Wall:Underground": (SurfaceKind.WALL, True, 90.0),
    "Wall:Adiabatic": (SurfaceKind.WALL, False, 90.0),
    "Wall:Interzone": (SurfaceKind.WALL, False, 90.0),
    "Roof": (SurfaceKind.ROOF, True, 0.0),
    "Ceiling:Adiabatic": (SurfaceKind.CEILING, False, 0.0),
    "Ceiling:Interzone": (SurfaceKind.CEILING, False, 0.0),
    "Floor:GroundContact": (SurfaceKind.FLOOR, True, 180.0),
    "Floor:Adiabatic": (SurfaceKind.FLOOR, False, 180.0),
    "Floor:Interzone": (SurfaceKind.FLOOR, False, 180.0),
}
_OPENINGS = {
    "Window": SurfaceKind.WINDOW,
    "GlazedDoor": SurfaceKind.WINDOW,
    "Door": SurfaceKind.DOOR,
    "Window:Interzone": SurfaceKind.WINDOW,
    "GlazedDoor:Interzone": SurfaceKind.WINDOW,
    "Door:Interzone": SurfaceKind.DOOR,
}
_TWIN_KINDS = {
    SurfaceKind.WALL: SurfaceKind.WALL,
    SurfaceKind.CEILING: SurfaceKind.FLOOR,
    SurfaceKind.FLOOR: SurfaceKind.CEILING,
}
# As in EnergyPlus, which reverses such floors and roofs with a warning.
_FLOOR_TILT_DEG = 90.0
_ROOF_TILT_DEG = 90.0
# Number of corners between the starting corner and the upper left one, counter-clockwise.
_STARTS = {"upperleftcorner": 0, "upperrightcorner": 1, "lowerrightcorner": 2, "lowerleftcorner": 3}


class PolygonReader:
    """The polygons of a model.

    Args:
        objects: object type, object name, fields.

    Attributes:
        polygons: in the model's order: building surfaces, windows and doors, shading, photovoltaics.
        broken: label and reason of each surface that cannot be drawn.
    """

    def __init__(self, objects: ModelObjects) -> None:
        self._objects = objects
        rules = next(iter(objects.get("GlobalGeometryRules", {}).values()), {})
        self._is_clockwise = str(rules.get("vertex_entry_direction")).casefold() == "clockwise"
        self._start = _STARTS.get(str(rules.get("starting_vertex_position")).casefold(), 0)
        is_rectangular_world = str(rules.get("rectangular_surface_coordinate_system")).casefold() == "world"
        self.frames = frames(objects, is_world=str(rules.get("coordinate_system")).casefold() == "world")
        self._rectangular_frames = frames(objects, is_world=is_rectangular_world)
        self._zones = {name.casefold() for name in objects.get("Zone", {})}
        self._zone_of_space = {
            name.casefold(): str(fields.get("zone_name", "")).casefold()
            for name, fields in objects.get("Space", {}).items()
        }
        self._by_name: dict[str, Polygon] = {}
        self.broken: list[tuple[str, str]] = []
        self.polygons: list[Polygon] = []
        for read, kinds in (
            (self._detailed, _DETAILED),
            (self._rectangle, _RECTANGULAR),
            (self._detailed_opening, ("FenestrationSurface:Detailed",)),
            (self._opening, _OPENINGS),
            (self._detailed_shading, ("Shading:Site:Detailed", "Shading:Building:Detailed", "Shading:Zone:Detailed")),
            (self._shading, ("Shading:Site", "Shading:Building")),
            (self._overhang, ("Shading:Overhang", "Shading:Overhang:Projection")),
            (self._fins, ("Shading:Fin", "Shading:Fin:Projection")),
        ):
            for kind in kinds:
                self._read_all(kind, read)
        self._add_photovoltaics()

    def _read_all(self, kind: str, read: Callable[[str, str, Mapping[str, Any]], list[Polygon]]) -> None:
        for name, fields in self._objects.get(kind, {}).items():
            try:
                polygons = read(kind, f"{kind} {name!r}", fields)
            except BrokenSurface as error:
                self.broken.append((f"{kind} {name!r}", str(error)))
            else:
                self.polygons += polygons
                self._by_name.setdefault(name.casefold(), polygons[0])

    # Surfaces of zones

    def _detailed(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        zone = self._zone(fields)
        is_exposed = _folded(fields, "outside_boundary_condition") not in _INSIDE
        surface_type = _DETAILED[kind] or _folded(fields, "surface_type")
        surface_kind = _DETAILED_KINDS.get(surface_type)
        if surface_kind is None:
            raise BrokenSurface(f"its surface type is {fields.get('surface_type')!r}")
        if surface_kind is SurfaceKind.ROOF and not is_exposed:
            surface_kind = SurfaceKind.CEILING
        corners = self._ordered(_corners(fields.get("vertices", ())))
        polygon = Polygon(surface_kind, label, zone, zone, is_exposed, _turned_upright(surface_kind, corners))
        return [polygon, *self._twin(polygon, fields)]

    def _rectangle(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        zone = self._zone(fields)
        surface_kind, is_exposed, tilt = _RECTANGULAR[kind]
        polygon = Polygon(surface_kind, label, zone, zone, is_exposed, self._rectangle_of(zone, fields, tilt))
        return [polygon, *self._twin(polygon, fields)]

    def _rectangle_of(self, frame: str | None, fields: Mapping[str, Any], default_tilt: float) -> tuple[Corner, ...]:
        """Return the rectangle of an object with a lower left corner, an azimuth, a tilt, a length and a height.

        As in EnergyPlus, the corner is in the coordinate system of rectangular surfaces, the azimuth in the other one.
        """
        x, y, z = (_number(fields, f"starting_{axis}_coordinate") for axis in "xyz")
        start = self.frames[frame].relative(*self._rectangular_frames[frame].placed(x, y, z))
        height = _number(fields, "height" if "height" in fields else "width")
        azimuth, tilt = _number(fields, "azimuth_angle"), _number(fields, "tilt_angle", default_tilt)
        return _rectangle(start, azimuth, tilt, _number(fields, "length"), height)

    def _zone(self, fields: Mapping[str, Any]) -> str:
        zone = _folded(fields, "zone_name") or self._zone_of_space.get(_folded(fields, "space_name"), "")
        if zone not in self._zones:
            raise BrokenSurface(f"there is no zone {fields.get('zone_name', '')!r}")
        return zone

    def _twin(self, polygon: Polygon, fields: Mapping[str, Any]) -> list[Polygon]:
        """Return the surface that EnergyPlus adds to the other zone if the outside boundary is a zone or a space."""
        other = _folded(fields, "outside_boundary_condition_object")
        other = self._zone_of_space.get(other, other)
        condition = _folded(fields, "outside_boundary_condition") or "zone"
        if polygon.is_exposed or condition not in ("zone", "space") or other not in self._zones - {polygon.zone}:
            return []
        return [replace(polygon, kind=_TWIN_KINDS[polygon.kind], zone=other, corners=polygon.corners[::-1])]

    # Windows and doors

    def _detailed_opening(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:  # noqa: ARG002
        base = self._base(fields, "building_surface_name")
        kind_of = SurfaceKind.DOOR if _folded(fields, "surface_type") == "door" else SurfaceKind.WINDOW
        number = fields.get("number_of_vertices")
        count = int(number) if isinstance(number, (int, float)) else 4 if "vertex_4_x_coordinate" in fields else 3
        vertices = [
            {name: fields.get(name.replace("_", f"_{i}_", 1)) for name in (_X, _Y, _Z)} for i in range(1, count + 1)
        ]
        corners = self._ordered(_corners(vertices))
        return [Polygon(kind_of, label, base.zone, base.zone, _is_outside(base, fields), corners)]

    def _opening(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        base = self._base(fields, "building_surface_name")
        if len(base.corners) < 3:
            raise BrokenSurface(f"its surface {base.label} has {len(base.corners)} corners")
        azimuth, tilt = _direction(base.corners)
        x, z = _number(fields, "starting_x_coordinate"), _number(fields, "starting_z_coordinate")
        across, up = _axes(azimuth, tilt)
        start = _moved(base.corners[1], (across, x), (up, z))
        corners = _rectangle(start, azimuth, tilt, _number(fields, "length"), _number(fields, "height"))
        return [Polygon(_OPENINGS[kind], label, base.zone, base.zone, _is_outside(base, fields), corners)]

    def _base(self, fields: Mapping[str, Any], field: str) -> Polygon:
        base = self._by_name.get(_folded(fields, field))
        if base is None:
            raise BrokenSurface(f"there is no surface {fields.get(field, '')!r} that can be drawn")
        return base

    # Shading

    def _detailed_shading(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        frame = SITE
        if kind == "Shading:Zone:Detailed":
            frame = self._base(fields, "base_surface_name").zone
        elif kind == "Shading:Building:Detailed":
            frame = ""
        return [self._shade(label, frame, self._ordered(_corners(fields.get("vertices", ()))))]

    def _shading(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        frame = SITE if kind == "Shading:Site" else ""
        return [self._shade(label, frame, self._rectangle_of(frame, fields, 90.0))]

    def _overhang(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        window, width, height = self._window(fields)
        depth = _number(fields, "depth")
        if kind.endswith("Projection"):
            depth = _number(fields, "depth_as_fraction_of_window_door_height") * height
        left = _number(fields, "left_extension_from_window_door_width")
        right = _number(fields, "right_extension_from_window_door_width")
        azimuth, tilt = _direction(window.corners)
        across, up = _axes(azimuth, tilt)
        start = _moved(window.corners[0], (up, _number(fields, "height_above_window_or_door")), (across, -left))
        angle = _number(fields, "tilt_angle_from_window_door", 90.0)
        return [self._shade(label, window.frame, _rectangle(start, azimuth, tilt + angle, left + width + right, depth))]

    def _fins(self, kind: str, label: str, fields: Mapping[str, Any]) -> list[Polygon]:
        window, width, height = self._window(fields)
        azimuth, tilt = _direction(window.corners)
        across, up = _axes(azimuth, tilt)
        fins = []
        for side, corner, sign in (("left", 1, -1.0), ("right", 2, 1.0)):
            depth = _number(fields, f"{side}_depth")
            if kind.endswith("Projection"):
                depth = _number(fields, f"{side}_depth_as_fraction_of_window_door_width") * width
            above = _number(fields, f"{side}_distance_above_top_of_window")
            below = _number(fields, f"{side}_distance_below_bottom_of_window")
            aside = _number(fields, f"{side}_extension_from_window_door")
            angle = _number(fields, f"{side}_tilt_angle_from_window_door", 90.0)
            bottom = _moved(window.corners[corner], (across, sign * aside), (up, -below))
            if depth:  # 0: there is no fin on this side
                corners = _rectangle(bottom, azimuth + angle, 180.0 - tilt, depth, below + height + above)
                fins.append(self._shade(label, window.frame, corners))
        if not fins:
            raise BrokenSurface("its depths are 0")
        return fins

    def _window(self, fields: Mapping[str, Any]) -> tuple[Polygon, float, float]:
        """Return the window or door of a shading device, its width and its height."""
        window = self._base(fields, "window_or_door_name")
        if len(window.corners) != 4:
            raise BrokenSurface(f"its window {window.label} has {len(window.corners)} corners")
        upper_left, lower_left, lower_right, _ = window.corners
        return window, _distance(lower_left, lower_right), _distance(upper_left, lower_left)

    @staticmethod
    def _shade(label: str, frame: str | None, corners: tuple[Corner, ...]) -> Polygon:
        return Polygon(SurfaceKind.SHADING, label, "", frame, True, corners)  # noqa: FBT003

    def _add_photovoltaics(self) -> None:
        """Mark shading surfaces that carry photovoltaics, and repeat building surfaces that do."""
        carriers = {
            _folded(fields, "surface_name")
            for kind in ("Generator:Photovoltaic", "Generator:PVWatts")
            for fields in self._objects.get(kind, {}).values()
        }
        for name in sorted(carriers & self._by_name.keys()):
            polygon = self._by_name[name]
            if polygon.kind is SurfaceKind.SHADING:
                self.polygons.remove(polygon)
            self.polygons.append(replace(polygon, kind=SurfaceKind.PHOTOVOLTAIC, zone="", is_exposed=True))

    def _ordered(self, corners: tuple[Corner, ...]) -> tuple[Corner, ...]:
        """Return the corners counter-clockwise, from the upper left one."""
        if self._is_clockwise:
            corners = (*corners[:1], *corners[:0:-1])
        start = self._start % len(corners) if self._start < 3 else len(corners) - 1
        return (*corners[start:], *corners[:start])


# Fields


def _folded(fields: Mapping[str, Any], field: str) -> str:
    return str(fields.get(field) or "").casefold()


def _number(fields: Mapping[str, Any], field: str, default: float = 0.0) -> float:
    value = fields.get(field, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
        raise BrokenSurface(f"its {field} is {value!r}")
    return float(value)


def _corners(vertices: Sequence[Mapping[str, Any]]) -> tuple[Corner, ...]:
    if len(vertices) < 3:
        raise BrokenSurface(f"it has {len(vertices)} corners")
    try:
        corners = [(vertex[_X], vertex[_Y], vertex[_Z]) for vertex in vertices]
        is_valid = all(abs(value) < _MAX_M for corner in corners for value in corner)
    except (KeyError, TypeError):
        is_valid = False
    if not is_valid:
        raise BrokenSurface("a coordinate of a corner is missing, not a number, or above 10,000 km")
    return tuple(corners)


def _is_outside(base: Polygon, fields: Mapping[str, Any]) -> bool:
    return base.is_exposed and not _folded(fields, "outside_boundary_condition_object")


# Rectangles


def _rectangle(start: Corner, azimuth_deg: float, tilt_deg: float, length: float, height: float) -> tuple[Corner, ...]:
    across, up = _axes(azimuth_deg, tilt_deg)
    right = _moved(start, (across, length))
    return _moved(start, (up, height)), start, right, _moved(right, (up, height))


def _axes(azimuth_deg: float, tilt_deg: float) -> tuple[Corner, Corner]:
    """Return the unit vectors to the right and upwards within a surface, as seen from outside."""
    azimuth, tilt = radians(azimuth_deg), radians(tilt_deg)
    across = (-cos(azimuth), sin(azimuth), 0.0)
    return across, (-cos(tilt) * sin(azimuth), -cos(tilt) * cos(azimuth), sin(tilt))


def _direction(corners: tuple[Corner, ...]) -> tuple[float, float]:
    """Return azimuth and tilt in degrees; the azimuth of a horizontal polygon is such that its first edge goes down."""
    x, y, z = doubled_area(corners)
    horizontal = hypot(x, y)
    if horizontal < 1e-9 * abs(z) or horizontal == z == 0:
        (ax, ay, _), (bx, by, _) = corners[:2]
        sign = 1.0 if z > 0 else -1.0
        return degrees(atan2(sign * (bx - ax), sign * (by - ay))), 0.0 if z > 0 else 180.0
    return degrees(atan2(x, y)), degrees(acos(z / hypot(horizontal, z)))


def _turned_upright(kind: SurfaceKind, corners: tuple[Corner, ...]) -> tuple[Corner, ...]:
    """Return the corners of a floor so that it faces down, of a roof or a ceiling so that it faces up."""
    if kind is SurfaceKind.WALL:
        return corners
    tilt = _direction(corners)[1]
    is_upside_down = tilt < _FLOOR_TILT_DEG if kind is SurfaceKind.FLOOR else tilt > _ROOF_TILT_DEG
    return corners[::-1] if is_upside_down else corners


def doubled_area(corners: Sequence[Corner]) -> Corner:
    """Return a polygon's normal with twice its area as length (Newell's sum of cross products)."""
    x = y = z = 0.0
    for (ax, ay, az), (bx, by, bz) in zip(corners, (*corners[1:], *corners[:1]), strict=True):
        x, y, z = x + (ay * bz - az * by), y + (az * bx - ax * bz), z + (ax * by - ay * bx)
    return x, y, z


def _moved(corner: Corner, *steps: tuple[Corner, float]) -> Corner:
    x, y, z = corner
    for (dx, dy, dz), length in steps:
        x, y, z = x + dx * length, y + dy * length, z + dz * length
    return x, y, z


def _distance(a: Corner, b: Corner) -> float:
    return hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2])
