"""Locations of a model's objects in the building: their zones, air loops and plant loops."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from zenostat.models.input_format.source_model import ModelObjects

LOOPS = ("AirLoopHVAC", "PlantLoop", "CondenserLoop")
"""Types of the objects that are loops."""

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
    zones = _zone_names(objects)
    loops = {name.upper() for kind in LOOPS for name in objects.get(kind, {})}
    parts: dict[str, list[str]] = defaultdict(list)
    for kind, items in objects.items():
        if kind not in LOOPS or kind == "AirLoopHVAC":
            for name, fields in items.items():
                parts[name.upper()] += [text.upper() for field, text in texts(fields) if _is_part(field)]
    location: dict[str, str] = {}
    for tier in _tiers(objects, zones):
        for name, place in _unshared(tier, parts, stop=zones.keys() | loops).items():
            location.setdefault(name, place)
    _add_neighbors(objects, location)
    location |= {name.upper(): name for kind in LOOPS for name in objects.get(kind, {})}
    return location | {name: members[0] for name, members in zones.items() if len(members) == 1}


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


def _zone_names(objects: ModelObjects) -> dict[str, tuple[str, ...]]:
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


def _own_zones(fields: Mapping[str, Any], zones: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the zones, from `_zone_names`, that an object names as its own."""
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


def zones_of(objects: ModelObjects, kinds: tuple[str, ...]) -> set[str]:
    """Return the case-folded names of the zones of all objects whose type starts with one of `kinds`."""
    zones = _zone_names(objects)
    return {
        zone.casefold()
        for kind, items in objects.items()
        if kind.startswith(kinds)
        for fields in items.values()
        for zone in _own_zones(fields, zones)
    }
