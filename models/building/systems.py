"""The HVAC systems of a model as trees: air loops with their zones, plant loops with what they supply and serve.

Components are found by the pairs of fields `..._object_type` and `..._name` that equipment has for its parts, by the
branches of the loops, and along the nodes from an air loop's demand inlet to the terminal units.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from zenostat.models.input_format.source_model import ModelObjects

SIDES = {
    "PlantLoop": (("supply", "plant_side_branch_list_name"), ("demand", "demand_side_branch_list_name")),
    "CondenserLoop": (
        ("supply", "condenser_side_branch_list_name"),
        ("demand", "condenser_demand_side_branch_list_name"),
    ),
}
_TYPE, _NAME = "object_type", "name"
_OUTDOOR_AIR = "AirLoopHVAC:OutdoorAirSystem"
PASSIVE = ("Pipe:", "Duct", "Connector")
"""Types that only connect others."""


@dataclass(frozen=True, slots=True)
class System:
    """A component of a system, with its parts.

    Attributes:
        kind, name: type and name of the object; a group of components has no type.
        parts: its own components.
    """

    kind: str
    name: str
    parts: tuple[System, ...] = ()


class SystemObjects:
    """Lookup of a model's objects and nodes; names are case-folded."""

    def __init__(self, objects: ModelObjects) -> None:
        self.objects = objects
        self._named = {
            (kind.casefold(), name.casefold()): (kind, name, fields)
            for kind, items in objects.items()
            for name, fields in items.items()
        }

    def find(self, kind: str, name: object) -> tuple[str, str, Mapping[str, Any]] | None:
        """Return type, name and fields of an object, as the model spells them."""
        return self._named.get((kind.casefold(), str(name).casefold()))

    def component(self, kind: str, name: str, above: frozenset[tuple[str, str]] = frozenset()) -> System:
        """Return a component with its parts; one that contains itself ends there."""
        known = self.find(kind, name)
        if known is None:
            return System(kind, name)
        kind, name, fields = known
        if (kind, name) in above:
            return System(kind, name)
        inside = above | {(kind, name)}
        parts = [self.component(*part, inside) for part in _parts(fields) if not part[0].startswith(PASSIVE)]
        equipment = fields.get("outdoor_air_equipment_list_name")
        listed = self.find("AirLoopHVAC:OutdoorAirSystem:EquipmentList", equipment) if equipment else None
        if listed is not None:
            parts += [self.component(*part, inside) for part in _numbered_parts(listed[2])]
        return System(kind, name, tuple(parts))

    def branches(self, branch_list: object) -> tuple[System, ...]:
        """Return the components on the branches of a list, in their order."""
        listed = self.find("BranchList", branch_list)
        components = []
        for entry in listed[2].get("branches", ()) if listed else ():
            branch = self.find("Branch", entry.get("branch_name"))
            for part in branch[2].get("components", ()) if branch else ():
                kind, name = part.get("component_object_type", ""), part.get("component_name", "")
                if not kind.startswith(PASSIVE):
                    components.append(self.component(kind, name))
        return tuple(components)

    def zone_equipment(self) -> Iterator[tuple[str, System]]:
        """Yield each zone with each of its pieces of equipment."""
        for fields in self.objects.get("ZoneHVAC:EquipmentConnections", {}).values():
            listed = self.find("ZoneHVAC:EquipmentList", fields.get("zone_conditioning_equipment_list_name"))
            for entry in listed[2].get("equipment", ()) if listed else ():
                kind, name = entry.get("zone_equipment_object_type", ""), entry.get("zone_equipment_name", "")
                zone = self.find("Zone", fields.get("zone_name"))
                yield zone[1] if zone else str(fields.get("zone_name", "")), self.component(kind, name)

    def economizer(self, part: System) -> System | None:
        """Return the controller of an outdoor air system that has an economizer; None of any other component."""
        system = self.find(_OUTDOOR_AIR, part.name) if part.kind == _OUTDOOR_AIR else None
        listed = self.find("AirLoopHVAC:ControllerList", system[2].get("controller_list_name")) if system else None
        fields = listed[2] if listed else {}
        for number in range(1, 9):
            known = self.find(*(str(fields.get(f"controller_{number}_{field}", "")) for field in (_TYPE, _NAME)))
            if known and known[0] == "Controller:OutdoorAir":
                control = str(known[2].get("economizer_control_type", "NoEconomizer"))
                if control.casefold() != "noeconomizer":
                    return System(known[0], known[1])
        return None

    def supply_nodes(self, loop: Mapping[str, Any]) -> set[str]:
        """Return the nodes from an air loop's demand inlets to its terminal units, case-folded."""
        outlets: dict[str, list[str]] = defaultdict(list)
        for kind in ("AirLoopHVAC:ZoneSplitter", "AirLoopHVAC:SupplyPlenum"):
            for fields in self.objects.get(kind, {}).values():
                nodes = [str(entry.get("outlet_node_name", "")).casefold() for entry in fields.get("nodes", ())]
                outlets[str(fields.get("inlet_node_name", "")).casefold()] += nodes
        pending = [str(loop.get("demand_side_inlet_node_names")).casefold()]
        reached = set(pending)
        while pending:
            node = pending.pop()
            listed = self.find("NodeList", node)  # wherever a node may stand, a list of nodes may
            members = [str(e.get("node_name")).casefold() for e in listed[2].get("nodes", ())] if listed else []
            new = [each for each in (*outlets.get(node, ()), *members) if each not in reached]
            reached.update(new)
            pending += new
        return reached

    def inlets(self, equipment: System) -> set[str]:
        """Return the inlet nodes of a piece of equipment and of its parts, case-folded."""
        own = self.find(equipment.kind, equipment.name)
        nodes = (
            {str(value).casefold() for field, value in own[2].items() if "inlet_node" in field} if own else set[str]()
        )
        return nodes.union(*map(self.inlets, equipment.parts))


def _parts(fields: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield type and name of the parts of an object, also of those in a list."""
    for field, value in fields.items():
        if field.endswith(_TYPE) and isinstance(value, str):
            name = fields.get(f"{field.removesuffix(_TYPE)}{_NAME}")
            if isinstance(name, str) and name:
                yield value, name
        elif isinstance(value, list):
            for entry in value:
                if isinstance(entry, Mapping):
                    yield from _parts(entry)


def _numbered_parts(fields: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for number in range(1, 10):
        kind, name = fields.get(f"component_{number}_object_type"), fields.get(f"component_{number}_name")
        if kind and name:
            yield kind, name


def air_loops(objects: ModelObjects) -> list[System]:
    """Return the air loops: the components of their supply side, then a part for each zone with its terminal units."""
    model = SystemObjects(objects)
    terminals = list(model.zone_equipment())
    loops = []
    for name, fields in objects.get("AirLoopHVAC", {}).items():
        nodes, zones = model.supply_nodes(fields), defaultdict[str, list[System]](list)
        for zone, equipment in terminals:
            if model.inlets(equipment) & nodes:
                zones[zone].append(equipment)
        served = [System("Zone", zone, tuple(equipment)) for zone, equipment in zones.items()]
        loops.append(System("AirLoopHVAC", name, (*model.branches(fields.get("branch_list_name")), *served)))
    return loops


def plant_loops(objects: ModelObjects) -> list[System]:
    """Return the plant and condenser loops, each with the parts `supply` and `demand`."""
    model = SystemObjects(objects)
    return [
        System(kind, name, tuple(System("", side, model.branches(fields.get(field))) for side, field in sides))
        for kind, sides in SIDES.items()
        for name, fields in objects.get(kind, {}).items()
    ]


def economizers(objects: ModelObjects) -> dict[str, System]:
    """Return the outdoor air controller of each air loop that has an economizer, by the loop's name."""
    model = SystemObjects(objects)
    controllers = {}
    for name, fields in objects.get("AirLoopHVAC", {}).items():
        for part in model.branches(fields.get("branch_list_name")):
            controller = model.economizer(part)
            if controller is not None:
                controllers[name] = controller
    return controllers


def zone_equipment(objects: ModelObjects) -> dict[str, list[System]]:
    """Return the equipment of each zone, terminal units included, by the zone's name."""
    equipment: dict[str, list[System]] = defaultdict(list)
    for zone, system in SystemObjects(objects).zone_equipment():
        equipment[zone].append(system)
    return dict(equipment)
