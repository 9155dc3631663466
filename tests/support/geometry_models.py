"""Models by hand for tests of geometry: a house of two zones, and one with every simple form of surface."""

from typing import Any

from zenostat.models.building.model import Building
from zenostat.models.input_format.source_model import ObjectsOfType
from zenostat.models.weather.header import Header

DENVER = Header("Denver", 39.72, -104.75, -7.0, 1726.0, (1, 1), (12, 31))


def vertices(*corners: tuple[float, float, float]) -> list[dict[str, float]]:
    """Corners as epJSON has them."""
    return [{f"vertex_{axis}_coordinate": value for axis, value in zip("xyz", c, strict=True)} for c in corners]


def model(**kinds: dict[str, dict[str, Any]]) -> Building:
    """A building of these objects, without its rules of geometry: counter-clockwise from the upper left, relative."""
    return Building("model", rules() | kinds, "digest")


def rules(**fields: str) -> dict[str, ObjectsOfType]:
    """The rules of geometry, with these fields in place of the usual ones."""
    usual = {
        "starting_vertex_position": "UpperLeftCorner",
        "vertex_entry_direction": "Counterclockwise",
        "coordinate_system": "Relative",
    }
    return {"GlobalGeometryRules": {"rules": usual | fields}}


def surface(
    kind: str, zone: str, boundary: str, *corners: tuple[float, float, float], other: str = ""
) -> dict[str, Any]:
    """A `BuildingSurface:Detailed`."""
    return {
        "surface_type": kind,
        "construction_name": "wall",
        "zone_name": zone,
        "outside_boundary_condition": boundary,
        "vertices": vertices(*corners),
    } | ({"outside_boundary_condition_object": other} if other else {})


def box(
    zone: str,
    x: float,
    y: float,
    z: float,
    size: tuple[float, float, float],
    *,
    below: str = "Ground",
    above: str = "Outdoors",
) -> ObjectsOfType:
    """The six surfaces of a zone; `below` and `above` are the boundary conditions of its floor and its ceiling."""
    a, b, c = x + size[0], y + size[1], z + size[2]
    return {
        f"{zone} south": surface("Wall", zone, "Outdoors", (x, y, c), (x, y, z), (a, y, z), (a, y, c)),
        f"{zone} east": surface("Wall", zone, "Outdoors", (a, y, c), (a, y, z), (a, b, z), (a, b, c)),
        f"{zone} north": surface("Wall", zone, "Outdoors", (a, b, c), (a, b, z), (x, b, z), (x, b, c)),
        f"{zone} west": surface("Wall", zone, "Outdoors", (x, b, c), (x, b, z), (x, y, z), (x, y, c)),
        f"{zone} floor": surface("Floor", zone, below, (x, b, z), (a, b, z), (a, y, z), (x, y, z)),
        f"{zone} roof": surface(
            "Roof" if above == "Outdoors" else "Ceiling", zone, above, (x, b, c), (x, y, c), (a, y, c), (a, b, c)
        ),
    }


CONSTRUCTIONS: dict[str, ObjectsOfType] = {
    "Version": {"v": {"version_identifier": "25.2"}},
    "Material": {
        "brick": {"roughness": "Rough", "thickness": 0.1, "conductivity": 1, "density": 1000, "specific_heat": 1000}
    },
    "WindowMaterial:SimpleGlazingSystem": {"glass": {"u_factor": 2, "solar_heat_gain_coefficient": 0.5}},
    "Construction": {"wall": {"outside_layer": "brick"}, "window": {"outside_layer": "glass"}},
}

_A = {"construction_name": "wall", "zone_name": "A"}
_B = {"construction_name": "wall", "zone_name": "B"}


def _at(x: float, y: float, z: float, **fields: Any) -> dict[str, Any]:
    return {"starting_x_coordinate": x, "starting_y_coordinate": y, "starting_z_coordinate": z, **fields}


def _on(base: str, x: float, z: float, length: float, height: float, construction: str = "window") -> dict[str, Any]:
    return {
        "construction_name": construction,
        "building_surface_name": base,
        "starting_x_coordinate": x,
        "starting_z_coordinate": z,
        "length": length,
        "height": height,
    }


_TRIANGLE = vertices((0, -1, 3), (0, 0, 3), (2, 0, 3.5))
_OVERHANG = {
    "height_above_window_or_door": 0.2,
    "left_extension_from_window_door_width": 0.3,
    "right_extension_from_window_door_width": 0.5,
}
_FIN = {
    "left_extension_from_window_door": 0.1,
    "left_distance_above_top_of_window": 0.2,
    "left_distance_below_bottom_of_window": 0.3,
    "right_extension_from_window_door": 0.15,
    "right_distance_above_top_of_window": 0.25,
    "right_distance_below_bottom_of_window": 0.35,
}
_QUADRANGLE = ((1.0, 1.0, 3.0), (5.0, 2.0, 3.0), (4.0, 6.0, 3.0), (0.0, 5.0, 3.0))

EVERY_FORM: dict[str, ObjectsOfType] = {
    **CONSTRUCTIONS,
    "Building": {"b": {"north_axis": 25.0}},
    "Zone": {
        "A": {"x_origin": 10, "y_origin": 5, "z_origin": 2, "direction_of_relative_north": 40},
        "B": {"x_origin": -10, "y_origin": 5, "z_origin": 2},
    },
    "BuildingSurface:Detailed": {
        "detailed roof": surface("Roof", "A", "Outdoors", *_QUADRANGLE),
        "upside down": surface("Floor", "A", "Outdoors", *_QUADRANGLE),
        "steep roof": surface("Roof", "A", "Outdoors", (0, 0, 0), (0, 1, 5), (3, 1, 5), (3, 0, 0)),
        "gable": surface("Wall", "A", "Zone", (0, 0, 0), (8, 1, 0), (8, 1, 4), (4, 0.5, 5), (0, 0, 4), other="B"),
        "ceiling": surface("Ceiling", "A", "Zone", *_QUADRANGLE, other="B"),
    },
    "Wall:Exterior": {
        "S": _A | _at(0, 0, 0, azimuth_angle=180, tilt_angle=90, length=8, height=3),
        "W": _A | _at(0, 6, 0, azimuth_angle=270, tilt_angle=80, length=6, height=3),
        "WB": _B | _at(0, 6, 0, azimuth_angle=270, length=6, height=3),
    },
    "Wall:Adiabatic": {"N": _A | _at(8, 6, 0, azimuth_angle=0, length=8, height=3)},
    "Wall:Underground": {"U": _B | _at(8, 6, 0, azimuth_angle=0, length=8, height=3)},
    "Wall:Interzone": {
        "E": _A | _at(8, 0, 0, azimuth_angle=90, length=6, height=3, outside_boundary_condition_object="B")
    },
    "Roof": {
        "R": _A | _at(0, 0, 3, azimuth_angle=180, length=8, width=6),
        "R2": _B | _at(0, 0, 3, azimuth_angle=120, tilt_angle=30, length=8, width=6),
    },
    "Ceiling:Adiabatic": {"CA": _B | _at(0, 0, 3, azimuth_angle=180, length=8, width=6)},
    "Floor:GroundContact": {"F": _A | _at(0, 0, 0, azimuth_angle=0, length=8, width=6)},
    "Floor:Adiabatic": {"FA": _B | _at(0, 0, 0, azimuth_angle=90, length=8, width=6)},
    "Window": {
        "SW": _on("S", 1, 1, 2, 1.5),
        "WW": _on("W", 1, 1, 2, 1.5),
        "RW": _on("R", 1, 1, 2, 1.5),
        "R2W": _on("R2", 1, 2, 2, 1.5),
        "DW": _on("detailed roof", 1, 0.5, 1, 0.5),
    },
    "Door": {"SD": _on("S", 4, 0, 1, 2, "wall"), "UD": _on("upside down", 1, 0.5, 1, 0.5, "wall")},
    "GlazedDoor": {"WD": _on("W", 4, 0, 1, 2)},
    "Shading:Site": {"SS": _at(20, -3, 1, azimuth_angle=70, tilt_angle=60, length=3, height=2)},
    "Shading:Building": {"SB": _at(20, -3, 1, azimuth_angle=70, length=3, height=2)},
    "Shading:Overhang": {
        "OV": {"window_or_door_name": "SW", "tilt_angle_from_window_door": 70, "depth": 0.8} | _OVERHANG
    },
    "Shading:Overhang:Projection": {
        "OP": {"window_or_door_name": "WW", "depth_as_fraction_of_window_door_height": 0.4} | _OVERHANG
    },
    "Shading:Fin": {
        "FI": {
            "window_or_door_name": "SW",
            "left_tilt_angle_from_window_door": 70,
            "left_depth": 0.5,
            "right_tilt_angle_from_window_door": 100,
            "right_depth": 0.6,
        }
        | _FIN
    },
    "Shading:Fin:Projection": {
        "FP": {
            "window_or_door_name": "WW",
            "left_depth_as_fraction_of_window_door_width": 0.5,
            "right_depth_as_fraction_of_window_door_width": 0.6,
        }
        | _FIN
    },
    "Shading:Zone:Detailed": {"SZ": {"base_surface_name": "S", "vertices": _TRIANGLE}},
    "Shading:Building:Detailed": {"SBD": {"vertices": _TRIANGLE}},
    "Shading:Site:Detailed": {"SSD": {"vertices": _TRIANGLE}},
}
"""Two zones that are turned and moved, in a building that is turned; not closed, which EnergyPlus only warns of."""
