"""The geometry of a building: its zones and the polygons of its surfaces."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from pydantic import Field

from zenostat.topics.messages.base import Count, Message, Raw


class SurfaceKind(IntEnum):
    """Kind of a surface. Windows include glass doors; photovoltaic surfaces are shading surfaces with a generator."""

    WALL = 0
    ROOF = 1
    FLOOR = 2
    CEILING = 3
    WINDOW = 4
    DOOR = 5
    SHADING = 6
    PHOTOVOLTAIC = 7


class ZoneGeometry(Message):
    """A thermal zone.

    `name`: EnergyPlus's. `storey`: an index into `Geometry.storeys`. `floor_area_m2`: without the multiplier.
    `multiplier`: number of identical zones that it stands for. `is_conditioned`: whether it has a thermostat or HVAC
    equipment, so false for a plenum.
    """

    name: str
    storey: Count
    floor_area_m2: Annotated[float, Field(ge=0)]
    multiplier: float = 1
    is_conditioned: bool


class Geometry(Message):
    """The zones and surfaces of a building; `zenostat.views.display.surfaces` decodes the surfaces.

    `storeys`: heights of the storeys' floors in m, ascending. `time_zone_h`: hours ahead of UTC.

    The surfaces are raw little-endian arrays with an entry each: `kinds`, uint8, a `SurfaceKind`; `zone_index`, int16,
    an index into `zones` or -1 for none; `exposed`, uint8, 1 if it borders on outdoors or ground; `corner_counts`,
    uint16. `corners` has all their corners in turn, float32 of shape (sum of `corner_counts`, 3), in m: x east, y
    north (true north; the building's north axis is applied), z up. The corners of a surface are counter-clockwise as
    seen from outside its zone. A wall includes the area of its windows and doors.
    """

    zones: tuple[ZoneGeometry, ...]
    storeys: tuple[float, ...]
    latitude_deg: float
    longitude_deg: float
    time_zone_h: float
    kinds: Raw
    zone_index: Raw
    exposed: Raw
    corner_counts: Raw
    corners: Raw
