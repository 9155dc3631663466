"""The coordinate systems of a model: the site, the building, and each zone."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, isfinite, radians, sin
from typing import Any, NamedTuple

from zenostat.models.input_format.source_model import ModelObjects

SITE = None
"""Frame of what does not turn with the building; other frames are a zone, case-folded, or `""`: the building."""

_ROTATION = "building_rotation_for_appendix_g"
_ZONE_FIELDS = ("direction_of_relative_north", "x_origin", "y_origin", "z_origin")


class Frame(NamedTuple):
    """A coordinate system: its counter-clockwise angle in rad and its origin in m, in world coordinates."""

    angle: float
    x: float
    y: float
    z: float

    def placed(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Convert coordinates in this system to world coordinates."""
        c, s = cos(self.angle), sin(self.angle)
        return self.x + x * c - y * s, self.y + x * s + y * c, self.z + z

    def relative(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Convert world coordinates to coordinates in this system."""
        c, s, dx, dy = cos(self.angle), sin(self.angle), x - self.x, y - self.y
        return dx * c + dy * s, dy * c - dx * s, z - self.z


def frames(objects: ModelObjects, *, is_world: bool) -> dict[str | None, Frame]:
    """Return the coordinate systems of a model.

    A zone is turned by its direction of relative north and moved to its origin; then the building is turned by its
    north axis. Where the model has world coordinates, only the rotation of Appendix G applies, to the whole building.
    """
    rotation = _number(_first(objects, "Compliance:Building"), _ROTATION)
    north = rotation + (0.0 if is_world else _number(_first(objects, "Building"), "north_axis"))
    building = Frame(-radians(north), 0.0, 0.0, 0.0)
    result: dict[str | None, Frame] = {SITE: Frame(0.0, 0.0, 0.0, 0.0), "": building}
    for name, fields in objects.get("Zone", {}).items():
        turn, *origin = (0.0 if is_world else _number(fields, field) for field in _ZONE_FIELDS)
        result[name.casefold()] = Frame(building.angle - radians(turn), *building.placed(*origin))
    return result


def _first(objects: ModelObjects, kind: str) -> Mapping[str, Any]:
    return next(iter(objects.get(kind, {}).values()), {})


def _number(fields: Mapping[str, Any], field: str) -> float:
    value = fields.get(field)
    return float(value) if isinstance(value, (int, float)) and isfinite(value) else 0.0
