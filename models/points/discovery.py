"""Discover the points that EnergyPlus offers for a model, and their locations in the building."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

from zenostat.models import energyplus
from zenostat.models.building.diagnostics import cached_diagnostics, describe
from zenostat.models.building.model import Building, check_runnable, for_episode, write
from zenostat.models.building.run_needs import lacks_design_days
from zenostat.models.building.source_lines import locator
from zenostat.models.cache import cached_bytes, digest
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.models.scenario.run_period import Period
from zenostat.models.weather import design_days
from zenostat.models.weather.header import Header, read_header
from zenostat.topics.calendar import LEAP_YEAR
from zenostat.topics.energyplus_names import HVAC_METERS
from zenostat.topics.errors import ModelError
from zenostat.topics.units import unit_name

_FORMAT = "3"


class Variable(NamedTuple):
    """An output variable.

    Attributes:
        system: whether it is updated each system timestep, rather than each zone timestep.
        summed: whether EnergyPlus reports its sum over the timestep, rather than its mean.
    """

    name: str
    key: str
    unit: str
    system: bool
    summed: bool


@dataclass(frozen=True, slots=True)
class MeterPoint:
    """A meter of EnergyPlus, or a sum of such meters.

    Attributes:
        index: its index in EnergyPlus's list, which is its handle; -1 for a sum.
        parts: the meters that a sum adds up, in this order.
    """

    name: str
    unit: str
    index: int
    parts: tuple[MeterPoint, ...] = ()


class ActuatorPoint(NamedTuple):
    """An actuator: component type, control type and key, in EnergyPlus's terms."""

    component_type: str
    control_type: str
    key: str
    unit: str


class InternalVariable(NamedTuple):
    """A constant of the model, read or sized: a floor area, a design flow."""

    name: str
    key: str
    unit: str


@dataclass(frozen=True)
class PointCatalog:
    """The points of one model. The keys of its dictionaries are case-folded, since EnergyPlus ignores case."""

    variables: tuple[Variable, ...]
    meters: tuple[MeterPoint, ...]
    actuators: tuple[ActuatorPoint, ...]
    internal: tuple[InternalVariable, ...] = ()

    @cached_property
    def by_variable(self) -> dict[tuple[str, str], Variable]:
        """Variables by name and key."""
        return {(v.name.casefold(), v.key.casefold()): v for v in reversed(self.variables)}

    @cached_property
    def by_actuator(self) -> dict[tuple[str, str, str], ActuatorPoint]:
        """Actuators by component type, control type and key."""
        return {
            (a.component_type.casefold(), a.control_type.casefold(), a.key.casefold()): a
            for a in reversed(self.actuators)
        }


def discover(building: Building, weather: Path) -> PointCatalog:
    """Return the points of `building`; cached. The weather file is needed only to start EnergyPlus.

    Raises:
        InvalidConfig: the model does not match the schema, or runs other programs within the simulation.
        ModelError: EnergyPlus cannot start the model.
    """
    check_runnable(building)

    def make(target: Path) -> None:
        folder, file = target.parent, building.file or building.name
        header = read_header(weather)
        objects = for_episode(building, _any_day(building, header), outputs=False)
        objects["RunPeriod"]["zenostat"].pop("treat_weather_as_actual", None)
        if lacks_design_days(objects):
            objects = design_days.apply(objects, design_days.site(weather, header))
        model = write(objects | _LISTS, folder)
        try:
            energyplus.call("survey", model, weather, target, file=file, locate=locator(file))
        except ModelError as error:
            raise ModelError("\n".join([str(error), *_suspects(building)])) from None

    name = f"points/{digest(building.content, energyplus.version(), _FORMAT)}.json"
    return _read(cached_bytes(name, make))


def _any_day(building: Building, header: Header) -> Period:
    """Return a day that a weather file covers, in timesteps with which EnergyPlus reads the file."""
    day = date(LEAP_YEAR if header.first == (2, 29) else LEAP_YEAR + 1, *header.first)
    steps = header.records_per_hour if header.records_per_hour > 1 else building.steps_per_hour
    return Period(day, day, 4 if 60 % steps else steps)


def _suspects(building: Building) -> Iterator[str]:
    """Yield a line with the warnings on a model that EnergyPlus cannot start, which may be the reason."""
    warnings = cached_diagnostics(building)
    if warnings:
        yield describe(warnings, building.file or building.name, "also has")


_LISTS = {
    "OutputControl:Files": {
        "lists": {"output_rdd": "Yes", "output_sqlite": "Yes", "output_eso": "No", "output_tabular": "No"}
    }
}


def _read(content: bytes) -> PointCatalog:
    lists = json.loads(content)
    kinds = {name.casefold(): kind for name, kind in lists["kinds"].items()}
    variables: list[Variable] = []
    meters: list[MeterPoint] = []
    actuators: list[ActuatorPoint] = []
    internal: list[InternalVariable] = []
    for point_type, name, key, control, unit in lists["points"]:
        if point_type == "OutputVariable":
            timestep_type, store_type = kinds.get(name.casefold(), ("hvac", "average"))
            variables.append(Variable(name, key, unit_name(unit), timestep_type == "hvac", store_type == "sum"))
        elif point_type == "OutputMeter":
            meters.append(MeterPoint(key, unit_name(unit), len(meters)))
        elif point_type == "Actuator":
            actuators.append(ActuatorPoint(name, control, key, unit_name(unit)))
        elif point_type == "InternalVariable":
            internal.append(InternalVariable(name, key, unit_name(unit)))
    meters += hvac_meters(meters)
    return PointCatalog(tuple(variables), tuple(meters), tuple(actuators), tuple(internal))


def hvac_meters(meters: Iterable[MeterPoint]) -> list[MeterPoint]:
    """Return the sums of `HVAC_METERS` for the fuels that the HVAC of a model uses; its own meters keep their names."""
    own = {meter.name.casefold(): meter for meter in meters}
    sums = []
    for name, addends in HVAC_METERS.items():
        parts = tuple(own[addend.casefold()] for addend in addends if addend.casefold() in own)
        if parts and name.casefold() not in own:
            sums.append(MeterPoint(name, parts[0].unit, -1, parts))
    return sums


_OWN_ZONE = re.compile(r"(zone|space)(_or_\w+)?_name")
_ANY_ZONE = re.compile(r"\w+_zone_name")
_PART = re.compile(r"\w*_names?")
_SHARED = re.compile(r"schedule|curve|construction|material")  # objects that several others use are no parts
_SURFACE = re.compile(r"(\w+_)?surface_name")
_NODE = re.compile(r"\w*node\w*_name")


def locations(objects: ModelObjects) -> dict[str, str]:
    """Return the zone or loop of each object and node, whose names are in upper case, as in EnergyPlus's lists.

    The references between objects are followed, in this order of precedence: the zone that an object names as its
    own, for the object with all its parts and nodes; the air loop that it is part of; the plant loop that it supplies;
    the plant loop that supplies it; any zone that it names. What two places of the same rank share belongs to neither.
    Finally, an object that has only its surface or its nodes in one place is in that place.
    """
    zones = zone_names(objects)
    loops = {name.upper() for kind in _LOOPS for name in objects.get(kind, {})}
    parts: dict[str, list[str]] = defaultdict(list)
    for kind, items in objects.items():
        if kind not in _LOOPS or kind == "AirLoopHVAC":
            for name, fields in items.items():
                parts[name.upper()] += [text.upper() for field, text in texts(fields) if _is_part(field)]
    location: dict[str, str] = {}
    for tier in _tiers(objects, zones):
        for name, place in _unshared(tier, parts, stop=zones.keys() | loops).items():
            location.setdefault(name, place)
    _add_neighbors(objects, location)
    location |= {name.upper(): name for kind in _LOOPS for name in objects.get(kind, {})}
    return location | {name: members[0] for name, members in zones.items() if len(members) == 1}


_LOOPS = ("AirLoopHVAC", "PlantLoop", "CondenserLoop")


def _tiers(objects: ModelObjects, zones: Mapping[str, Sequence[str]]) -> list[dict[str, list[str]]]:
    """Return the objects directly in each place, by rank: zone, air loop, supply side, demand side, other zones."""
    own: dict[str, list[str]] = defaultdict(list)
    named: dict[str, list[str]] = defaultdict(list)
    for kind, items in objects.items():
        # An air loop's part may name a zone (a plenum) and still belongs to the loop.
        if kind.startswith(("AirLoopHVAC", "Space", "Zone:")) or kind in ("ZoneList", "ZoneGroup"):
            continue
        for name, fields in items.items():
            for zone, alias in _aliases(name, fields, zones):
                own[zone].append(alias)
            for field, text in texts(fields):
                if _ANY_ZONE.fullmatch(field):
                    for zone in zones.get(text.upper(), ()):
                        named[zone].append(name.upper())
    supply: dict[str, list[str]] = {}
    demand: dict[str, list[str]] = {}
    for kind in ("PlantLoop", "CondenserLoop"):
        for name, fields in objects.get(kind, {}).items():
            branches = [(field, text.upper()) for field, text in texts(fields) if _is_part(field)]
            supply[name] = [text for field, text in branches if "demand" not in field]
            demand[name] = [text for field, text in branches if "demand" in field]
    air = {name: [name.upper()] for name in objects.get("AirLoopHVAC", {})}
    return [own, air, supply, demand, named]


@cache
def _is_part(field: str) -> bool:
    return bool(_PART.fullmatch(field)) and not _SHARED.search(field)


@cache
def _is_neighbor(field: str) -> bool:
    return bool(_SURFACE.fullmatch(field) or _NODE.fullmatch(field))


def _aliases(name: str, fields: Mapping[str, Any], zones: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str]]:
    """Yield (zone, name) for an object: one that names a list of zones exists in each of them as `ZONE NAME`.

    A surface whose outside boundary is a zone has a twin in that zone, `IZ-NAME`.
    """
    for field, text in texts(fields):
        if _OWN_ZONE.fullmatch(field):
            for zone in zones.get(text.upper(), ()):
                yield zone, name.upper()
                yield zone, f"{zone} {name}".upper()
            if len(zones.get(text.upper(), ())) == 1:
                yield zones[text.upper()][0], f"{text} {name}".upper()
        elif field == "outside_boundary_condition_object" and text.upper() in zones:
            yield zones[text.upper()][0], f"IZ-{name}".upper()


def _unshared(
    tier: Mapping[str, Iterable[str]], parts: Mapping[str, Sequence[str]], stop: Iterable[str]
) -> dict[str, str]:
    """Return the place of each name that is reachable from only one place."""
    reached_from: dict[str, set[str]] = defaultdict(set)
    ends = set(stop)
    for place, starts in tier.items():
        pending, seen = list(starts), set(starts)
        while pending:
            name = pending.pop()
            reached_from[name].add(place)
            new = [part for part in parts.get(name, ()) if part not in seen and part not in ends]
            seen.update(new)
            pending += new
    return {name: next(iter(places)) for name, places in reached_from.items() if len(places) == 1}


def _add_neighbors(objects: ModelObjects, location: dict[str, str]) -> None:
    """Add to `location` the objects without a place whose surfaces or nodes are all in one place."""
    for _ in range(2):  # a window's blind follows the window, which follows the wall
        for items in objects.values():
            for name in [n for n in items if n.upper() not in location]:
                neighbors = [t.upper() for f, t in texts(items[name]) if _is_neighbor(f)]
                places = {location[text] for text in neighbors if text in location}
                if len(places) == 1:
                    location[name.upper()] = places.pop()


def zone_names(objects: ModelObjects) -> dict[str, tuple[str, ...]]:
    """Return the zones that each zone, space, zone list and space list contains; their names are in upper case."""
    zones = {zone.upper(): (zone,) for zone in objects.get("Zone", {})}
    zones_of: dict[str, tuple[str, ...]] = dict(zones)
    for space, fields in objects.get("Space", {}).items():
        zones_of.setdefault(space.upper(), zones.get(str(fields.get("zone_name", "")).upper(), ()))
    for kind in ("ZoneList", "SpaceList"):
        for name, fields in objects.get(kind, {}).items():
            members = [zone for _, text in texts(fields) for zone in zones_of.get(text.upper(), ())]
            zones_of.setdefault(name.upper(), tuple(dict.fromkeys(members)))
    return zones_of


def own_zones(fields: Mapping[str, Any], zones: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the zones, from `zone_names`, that an object names as its own."""
    return [zone for f, t in texts(fields) if _OWN_ZONE.fullmatch(f) for zone in zones.get(t.upper(), ())]


def texts(fields: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (field, text) for all string fields, including those in lists."""
    for field, value in fields.items():
        if isinstance(value, str):
            yield field, value
        elif isinstance(value, list):
            for entry in value:
                if isinstance(entry, Mapping):
                    yield from texts(entry)
