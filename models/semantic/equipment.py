"""The zones, loops and equipment of a model in Brick's terms, and what feeds what; no RDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import NamedTuple

from zenostat.models.building import systems
from zenostat.models.building.summary import conditioned_zones, zone_areas
from zenostat.models.building.systems import System
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.models.semantic.brick_classes import EQUIPMENT, LOOP_OF_TYPE, PUMP_OF_LOOP

_TRANSPARENT = ("AirLoopHVAC:OutdoorAirSystem", "CoilSystem:", "ZoneHVAC:AirDistributionUnit", "OutdoorAir:Mixer")
"""Types that only hold others: their parts belong to what holds them."""

_DISTRIBUTION = ("Pump:", "HeaderedPumps:", "TemperingValve")
"""Types on the supply side that move the water and do not heat or cool it."""


class Relation(StrEnum):
    """Relations of Brick between two entities, and `includes` of RealEstateCore."""

    FEEDS = "feeds"
    HAS_PART = "hasPart"
    HAS_LOCATION = "hasLocation"
    INCLUDES = "includes"


class Key(NamedTuple):
    """Identity of an entity: the type and the name of the object that it stands for."""

    kind: str
    name: str


class Link(NamedTuple):
    """A relation between two entities."""

    subject: Key
    relation: Relation
    object: Key


@dataclass
class Structure:
    """Entities and relations of one building.

    Attributes:
        building: key of the building.
        classes: Brick class of each entity.
        areas: floor area of each zone in m2, without its multiplier; 0 if unknown.
        links: relations, without repetitions, in the order of the model.
    """

    building: Key
    classes: dict[Key, str] = field(default_factory=dict)
    areas: dict[Key, float] = field(default_factory=dict)
    links: dict[Link, None] = field(default_factory=dict)

    def add(self, kind: str, name: str, brick_class: str) -> Key:
        """Add an entity, unless it exists, and return its key."""
        key = Key(kind, name)
        self.classes.setdefault(key, brick_class)
        return key

    def link(self, subject: Key, relation: Relation, target: Key) -> None:
        """Add a relation; nothing is related to itself, and no two entities in both directions."""
        if subject != target and Link(target, relation, subject) not in self.links:
            self.links[Link(subject, relation, target)] = None

    @property
    def equipment(self) -> Iterator[Key]:
        """Keys of the entities that are no locations and no loops."""
        for key, brick_class in self.classes.items():
            if key != self.building and key.kind not in ("Zone", "Space") and not brick_class.endswith("Loop"):
                yield key


def read_structure(name: str, objects: ModelObjects) -> Structure:
    """Return the zones, spaces, air loops, plant loops and zone equipment of a model.

    Each air loop is a `brick:AHU` with its components as parts, and a `brick:Air_Loop`, which includes it and its
    terminal units. Plant equipment feeds what the loop serves. Equipment that belongs to no loop and no zone, such as
    lights, refrigeration and generators, is left out.

    Args:
        name: name of the building.
        objects: a whole model as epJSON, in the format of the installed EnergyPlus.
    """
    structure = Structure(Key("Building", name))
    structure.classes[structure.building] = "Building"
    _add_zones(structure, objects)
    economizers = systems.economizers(objects)
    for loop in systems.air_loops(objects):
        _add_air_loop(structure, loop, economizers.get(loop.name))
    for zone, equipment in systems.zone_equipment(objects).items():
        for each in equipment:
            _add_zone_equipment(structure, Key("Zone", zone), each)
    for loop in systems.plant_loops(objects):
        _add_plant_loop(structure, objects, loop)
    return structure


@cache
def equipment_class(kind: str) -> str:
    """Return the Brick class of a type of equipment: that of its longest beginning in the table."""
    matching = [start for start in EQUIPMENT if kind.casefold().startswith(start.casefold())]
    return EQUIPMENT[max(matching, key=len)] if matching else "HVAC_Equipment"


def _add_zones(structure: Structure, objects: ModelObjects) -> None:
    conditioned, areas = conditioned_zones(objects), _areas(objects)
    zones: dict[str, Key] = {}
    for name in objects.get("Zone", {}):
        zone = structure.add("Zone", name, "HVAC_Zone" if name.casefold() in conditioned else "Zone")
        structure.link(structure.building, Relation.HAS_PART, zone)
        structure.areas[zone] = areas.get(name, 0.0)
        zones[name.casefold()] = zone
    for name, fields in objects.get("Space", {}).items():
        place = zones.get(str(fields.get("zone_name", "")).casefold())
        if place is not None:
            structure.link(place, Relation.HAS_PART, structure.add("Space", name, "Space"))


def _areas(objects: ModelObjects) -> Mapping[str, float]:
    """Return each zone's floor area in m2; none at all if a surface lacks what EnergyPlus needs of it as well."""
    try:
        return zone_areas(objects)
    except (KeyError, TypeError, ValueError):
        return {}


def _add_air_loop(structure: Structure, loop: System, economizer: System | None) -> None:
    handler = structure.add(loop.kind, loop.name, "AHU")
    air_loop = structure.add("AirLoop", loop.name, "Air_Loop")
    structure.link(air_loop, Relation.INCLUDES, handler)
    components = [each for part in loop.parts if part.kind != "Zone" for each in _opened(part)]
    fans = [each for each in components if each.kind.startswith("Fan:")]
    for each in components:
        _add_component(structure, handler, each, "Supply_Fan" if fans == [each] else "")
    if economizer is not None:
        _add_component(structure, handler, economizer)
    for part in loop.parts:
        for each in part.parts if part.kind == "Zone" else ():
            for unit in _opened(each):
                terminal = _add_zone_equipment(structure, Key("Zone", part.name), unit)
                structure.link(handler, Relation.FEEDS, terminal)
                structure.link(air_loop, Relation.INCLUDES, terminal)


def _opened(system: System) -> Iterator[System]:
    """Yield a component, or the components in one that only holds others."""
    if system.kind.startswith(_TRANSPARENT):
        for part in system.parts:
            yield from _opened(part)
    else:
        yield system


def _add_component(structure: Structure, parent: Key | None, system: System, brick_class: str = "") -> Key:
    """Add a component with all its parts."""
    key = structure.add(system.kind, system.name, brick_class or equipment_class(system.kind))
    if parent is not None:
        structure.link(parent, Relation.HAS_PART, key)
    for part in system.parts:
        for each in _opened(part):
            _add_component(structure, key, each)
    return key


def _add_zone_equipment(structure: Structure, zone: Key, system: System) -> Key:
    """Add the equipment of a zone; return the last piece. It feeds the zone, except for a fan that exhausts air."""
    added = zone
    for unit in _opened(system):
        added = _add_component(structure, None, unit)
        relation = Relation.HAS_LOCATION if structure.classes[added] == "Exhaust_Fan" else Relation.FEEDS
        structure.link(added, relation, zone)
    return added


def _add_plant_loop(structure: Structure, objects: ModelObjects, loop: System) -> None:
    sides = {side.name: [each for part in side.parts for each in _opened(part)] for side in loop.parts}
    brick_class = _loop_class(objects, loop, sides)
    water_loop = structure.add(loop.kind, loop.name, brick_class)
    keys: dict[str, list[Key]] = {}
    for side, components in sides.items():
        keys[side] = []
        for each in components:
            is_pump = equipment_class(each.kind) == "Pump"
            key = _add_component(structure, None, each, PUMP_OF_LOOP.get(brick_class, "") if is_pump else "")
            structure.link(water_loop, Relation.INCLUDES, key)
            if not each.kind.startswith(_DISTRIBUTION):
                keys[side].append(key)
    for source in keys.get("supply", ()):
        for served in keys.get("demand", ()):
            structure.link(source, Relation.FEEDS, served)


def _loop_class(objects: ModelObjects, loop: System, sides: Mapping[str, list[System]]) -> str:
    """Return the class of a plant loop: by its sizing object, or else by what supplies it."""
    kinds = [each.kind for each in sides.get("supply", ())]
    if loop.kind == "CondenserLoop":
        return "Condenser_Water_Loop"
    if any(each.kind.startswith("WaterUse:") for each in sides.get("demand", ())):
        return "Domestic_Water_Loop"
    for name, fields in objects.get("Sizing:Plant", {}).items():
        sized = str(fields.get("plant_or_condenser_loop_name", name)).casefold()
        if sized == loop.name.casefold():
            return LOOP_OF_TYPE.get(str(fields.get("loop_type", "")).casefold(), "Loop")
    is_cooled = any(kind.startswith(("Chiller", "DistrictCooling", "ThermalStorage:Ice")) for kind in kinds)
    is_heated = any(kind.startswith(("Boiler", "DistrictHeating", "WaterHeater", "SolarCollector")) for kind in kinds)
    if is_cooled == is_heated:
        return "Water_Loop"
    return "Chilled_Water_Loop" if is_cooled else "Hot_Water_Loop"
