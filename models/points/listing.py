"""The points of a model as rows of a list: all that EnergyPlus offers, or those of a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from zenostat.models.building.locations import locations
from zenostat.models.building.model import Building
from zenostat.models.points.discovery import PointCatalog
from zenostat.models.points.selection import Points, actuator_bounds, meter_low, sensor_bounds


@dataclass(frozen=True, slots=True)
class PointListing:
    """A point of a model, for lists.

    Attributes:
        kind: `sensor`, `meter`, `actuator`, or `internal` (a constant of the model).
        name: the variable, the meter, the component type and control type, or the internal variable.
        key: EnergyPlus's name of the object that has it; empty for a meter.
        low, high: bounds of its values, or of the values that an actuator accepts; None if there is none.
        where: the zone, air loop or plant loop that it belongs to, `Environment`, `facility` for the whole
            building; empty if the model does not show it.
        bus_name: its name on the bus; empty in a list of all points of a model, where it has none yet.
    """

    kind: str
    name: str
    key: str
    unit: str
    low: float | None
    high: float | None
    where: str
    bus_name: str = ""


def listing(available: PointCatalog, building: Building) -> Iterator[PointListing]:
    """Yield all points of a model with bounds and location; takes a tenth of a second for 20,000."""
    places = _Places(building)
    for v in available.variables:
        yield PointListing("sensor", v.name, v.key, v.unit, *sensor_bounds(v), places.of_key(v.key))
    for m in available.meters:
        yield PointListing("meter", m.name, "", m.unit, meter_low(m), None, places.of_meter(m.name))
    for a in available.actuators:
        name = f"{a.component_type} / {a.control_type}"
        yield PointListing("actuator", name, a.key, a.unit, *actuator_bounds(building, a), places.of_key(a.key))
    for i in available.internal:
        yield PointListing("internal", i.name, i.key, i.unit, None, None, places.of_key(i.key))


def run_listing(points: Points, building: Building) -> Iterator[PointListing]:
    """Yield the points of a run in the order of its manifest, with their names on the bus."""
    places = _Places(building)
    for s in points.sensors:
        yield PointListing("sensor", s.variable, s.key, s.unit, s.low, s.high, places.of_key(s.key), s.name)
    for m in points.meters:
        yield PointListing("meter", m.meter, "", m.unit, m.low, m.high, places.of_meter(m.meter), m.name)
    for a in points.actuators:
        name = f"{a.component_type} / {a.control_type}"
        yield PointListing("actuator", name, a.key, a.unit, a.low, a.high, places.of_key(a.key), a.name)


# EnergyPlus's keys of points that belong to no zone and no loop.
_SITE_KEYS = {
    "ENVIRONMENT": "Environment",
    "WHOLE BUILDING": "facility",
    "FACILITY": "facility",
    "SITE": "facility",
    "SIMHVAC": "facility",
}


class _Places:
    """The zone or loop of each object of a model."""

    def __init__(self, building: Building) -> None:
        self._location = locations(building.objects)
        meters = (items for kind, items in building.objects.items() if kind.startswith("Meter:"))
        self._own_meters = {name.upper() for items in meters for name in items}

    def of_key(self, key: str) -> str:
        """Return the place of an object or node; "" if it is unknown."""
        return self._location.get(key.upper()) or _SITE_KEYS.get(key.upper(), "")

    def of_meter(self, meter: str) -> str:
        """Return the zone for `…:Zone:NAME`, "" for a space type or the model's own meter, else `facility`."""
        name = meter.upper()
        if ":ZONE:" in name:
            return self._location.get(name.rpartition(":ZONE:")[2], "")
        return "" if ":SPACETYPE:" in name or name in self._own_meters else "facility"
