"""Everything that EnergyPlus offers for a model, from the engine's own lists, and where it belongs."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from models import energyplus
from models.building.model import Building, Objects, check_runnable, for_episode, write
from models.cache import cached_bytes, digest
from models.scenario.run_period import Period
from topics.units import unit_name

Kinds = Mapping[str, Objects]

_FORMAT = "2"


@dataclass(frozen=True, slots=True)
class Variable:
    """An output variable.

    `system`: updated each system timestep (else each zone timestep); `summed`: reported as a sum over the
    timestep (else as a mean).
    """

    name: str
    key: str
    unit: str
    system: bool
    summed: bool


@dataclass(frozen=True, slots=True)
class MeterPoint:
    """A meter and its place in EnergyPlus's list, which is its handle."""

    name: str
    unit: str
    index: int


@dataclass(frozen=True, slots=True)
class ActuatorPoint:
    """An actuator: component type, control type and key, as EnergyPlus calls them."""

    component_type: str
    control_type: str
    key: str
    unit: str


@dataclass(frozen=True, slots=True)
class InternalVariable:
    """A fixed number of the model, as it was read or sized: a floor area, a design flow."""

    name: str
    key: str
    unit: str


@dataclass(frozen=True)
class PointCatalog:
    """The points of one model. Its dictionaries have casefolded names: EnergyPlus takes any case."""

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
    """The points of `building`. The weather only serves to start EnergyPlus.

    Raises:
        InvalidConfig: it has other programs run within the simulation.
        ModelError: EnergyPlus cannot start it.
    """
    check_runnable(building)

    def make(target: Path) -> None:
        folder = target.parent
        day = date(2017, 1, 1)
        model = write(for_episode(building, Period(day, day, building.steps_per_hour), outputs=False) | _LISTS, folder)
        energyplus.call("survey", model, weather, target, file=building.file or building.name)

    name = f"points/{digest(building.content, energyplus.version(), _FORMAT)}.json"
    return _read(cached_bytes(name, make))


_LISTS = {
    "OutputControl:Files": {
        "lists": {"output_rdd": "Yes", "output_sqlite": "Yes", "output_eso": "No", "output_tabular": "No"}
    }
}


def _read(content: bytes) -> PointCatalog:
    found = json.loads(content)
    kinds = {name.casefold(): kind for name, kind in found["kinds"].items()}
    variables: list[Variable] = []
    meters: list[MeterPoint] = []
    actuators: list[ActuatorPoint] = []
    internal: list[InternalVariable] = []
    for what, name, key, control, unit in found["points"]:
        if what == "OutputVariable":
            where, how = kinds.get(name.casefold(), ("hvac", "average"))
            variables.append(Variable(name, key, unit_name(unit), where == "hvac", how == "sum"))
        elif what == "OutputMeter":
            meters.append(MeterPoint(key, unit_name(unit), len(meters)))
        elif what == "Actuator":
            actuators.append(ActuatorPoint(name, control, key, unit_name(unit)))
        elif what == "InternalVariable":
            internal.append(InternalVariable(name, key, unit_name(unit)))
    return PointCatalog(tuple(variables), tuple(meters), tuple(actuators), tuple(internal))


_OWN_ZONE = re.compile(r"(zone|space)(_or_\w+)?_name")
_ANY_ZONE = re.compile(r"\w+_zone_name")
_PART = re.compile(r"\w*_names?")
_USED = re.compile(r"schedule|curve|construction|material")  # what others use too is no part
_SURFACE = re.compile(r"(\w+_)?surface_name")
_NODE = re.compile(r"\w*node\w*_name")


def locations(objects: Kinds) -> dict[str, str]:
    """Name of a thing, in upper case as in EnergyPlus's lists, to the zone or loop that it belongs to.

    It follows the names that objects have of each other. What names a zone as its own, with all its parts
    and nodes, is in that zone; else what hangs on an air loop is of that loop; else the plant loop that it
    supplies; else the one that supplies it; else any zone that it names. What two of the same rank share
    is of neither. At last, what has only its surface or its nodes in one place is there.
    """
    zones = zone_names(objects)
    loops = {name.upper() for kind in _LOOPS for name in objects.get(kind, {})}
    parts: dict[str, list[str]] = defaultdict(list)
    for kind, items in objects.items():
        if kind not in _LOOPS or kind == "AirLoopHVAC":
            for name, fields in items.items():
                parts[name.upper()] += [text.upper() for field, text in texts(fields) if _is_part(field)]
    where: dict[str, str] = {}
    for tier in _tiers(objects, zones):
        for name, place in _unshared(tier, parts, stop=zones.keys() | loops).items():
            where.setdefault(name, place)
    _follow(objects, where)
    where |= {name.upper(): name for kind in _LOOPS for name in objects.get(kind, {})}
    return where | {name: found[0] for name, found in zones.items() if len(found) == 1}


_LOOPS = ("AirLoopHVAC", "PlantLoop", "CondenserLoop")


def _tiers(objects: Kinds, zones: Mapping[str, Sequence[str]]) -> list[dict[str, list[str]]]:
    """Place to what stands there directly: zones, air loops, supply and demand sides, zones named otherwise."""
    own: dict[str, list[str]] = defaultdict(list)
    named: dict[str, list[str]] = defaultdict(list)
    for kind, items in objects.items():
        # An air loop's parts may name a zone (a plenum) and are the loop's all the same.
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
            found = [(field, text.upper()) for field, text in texts(fields) if _is_part(field)]
            supply[name] = [text for field, text in found if "demand" not in field]
            demand[name] = [text for field, text in found if "demand" in field]
    air = {name: [name.upper()] for name in objects.get("AirLoopHVAC", {})}
    return [own, air, supply, demand, named]


@cache
def _is_part(field: str) -> bool:
    return bool(_PART.fullmatch(field)) and not _USED.search(field)


@cache
def _is_beside(field: str) -> bool:
    return bool(_SURFACE.fullmatch(field) or _NODE.fullmatch(field))


def _aliases(name: str, fields: Mapping[str, Any], zones: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str]]:
    """(zone, name there) of an object: one that names a list of zones is one in each, `ZONE NAME`.

    A surface whose other side is a zone has a twin there, `IZ-NAME`.
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
    """Name to place, for all that is reached from one place only."""
    found: dict[str, set[str]] = defaultdict(set)
    ends = set(stop)
    for place, starts in tier.items():
        todo, seen = list(starts), set(starts)
        while todo:
            name = todo.pop()
            found[name].add(place)
            new = [part for part in parts.get(name, ()) if part not in seen and part not in ends]
            seen.update(new)
            todo += new
    return {name: next(iter(reached)) for name, reached in found.items() if len(reached) == 1}


def _follow(objects: Kinds, where: dict[str, str]) -> None:
    """Puts what has no place yet where its surfaces or nodes are, if that is one place."""
    for _ in range(2):  # a window's blind follows the window, which follows the wall
        for items in objects.values():
            for name in [n for n in items if n.upper() not in where]:
                beside = [t.upper() for f, t in texts(items[name]) if _is_beside(f)]
                near = {where[text] for text in beside if text in where}
                if len(near) == 1:
                    where[name.upper()] = near.pop()


def zone_names(objects: Kinds) -> dict[str, tuple[str, ...]]:
    """Names, in upper case, of zones, spaces and lists of them, to the zones that they mean."""
    zones = {zone.upper(): (zone,) for zone in objects.get("Zone", {})}
    found: dict[str, tuple[str, ...]] = dict(zones)
    for space, fields in objects.get("Space", {}).items():
        found.setdefault(space.upper(), zones.get(str(fields["zone_name"]).upper(), ()))
    for kind in ("ZoneList", "SpaceList"):
        for name, fields in objects.get(kind, {}).items():
            members = [zone for _, text in texts(fields) for zone in found.get(text.upper(), ())]
            found.setdefault(name.upper(), tuple(dict.fromkeys(members)))
    return found


def own_zones(fields: Mapping[str, Any], zones: Mapping[str, Sequence[str]]) -> list[str]:
    """The zones that an object names as its own, of `zone_names`."""
    return [zone for f, t in texts(fields) if _OWN_ZONE.fullmatch(f) for zone in zones.get(t.upper(), ())]


def texts(fields: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """(field, text) of all text fields, those of lists too."""
    for field, value in fields.items():
        if isinstance(value, str):
            yield field, value
        elif isinstance(value, list):
            for entry in value:
                if isinstance(entry, Mapping):
                    yield from texts(entry)
