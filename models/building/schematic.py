"""The HVAC systems of a model as a schematic: each component once, and the loops with their branches in order of flow.

The order follows from the splitters and mixers of a side: the branches before the splitter, the parallel ones, and
those behind the mixer.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from zenostat.models.building.systems import PASSIVE, SIDES, System, SystemObjects
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.messages import LoopSide, ServedZone, SystemComponent, SystemLoop, SystemNode, Systems

_INLET = re.compile(r"(?=.*(inlet|outdoor_air_stream|return_air_stream)).*node.*name")
_OUTLET = re.compile(r"(?=.*(outlet|mixed_air|relief_air_stream)).*node.*name")
_PORT = re.compile(r"_node.*")


def systems(objects: ModelObjects) -> Systems:
    """Return the systems of a model; a loop, branch or component that the model only names has no parts."""
    return _Schematic(objects).systems()


class _Schematic:
    """The components of a model, numbered as they are met."""

    def __init__(self, objects: ModelObjects) -> None:
        self._objects = objects
        self._model = SystemObjects(objects)
        self._components: list[SystemComponent] = []
        self._numbers: dict[tuple[str, str], int] = {}

    def systems(self) -> Systems:
        """Return loops, the equipment of zones that is on no air loop, and their components."""
        equipment = [*self._model.zone_equipment()]
        inlets = [self._model.inlets(system) for _, system in equipment]
        on_loops: set[tuple[str, System]] = set()
        loops = []
        for name, fields in self._objects.get("AirLoopHVAC", {}).items():
            nodes = self._model.supply_nodes(fields)
            served = [each for each, own in zip(equipment, inlets, strict=True) if own & nodes]
            on_loops.update(served)
            supply = self._side(fields, "supply", "branch_list_name", "connector_list_name")
            loops.append(SystemLoop(kind="AirLoopHVAC", name=name, sides=(supply,), zones=self._zones(served)))
        for kind, sides in SIDES.items():
            for name, fields in self._objects.get(kind, {}).items():
                drawn = tuple(
                    self._side(fields, side, branches, branches.replace("branch_list", "connector_list"))
                    for side, branches in sides
                )
                loops.append(SystemLoop(kind=kind, name=name, sides=drawn))
        others = self._zones([each for each in equipment if each not in on_loops])
        return Systems(components=tuple(self._components), loops=tuple(loops), zones=others)

    def _zones(self, equipment: Sequence[tuple[str, System]]) -> tuple[ServedZone, ...]:
        zones: dict[str, list[int]] = defaultdict(list)
        for zone, system in equipment:
            zones[zone].append(self._number(system))
        return tuple(ServedZone(zone=zone, equipment=tuple(numbers)) for zone, numbers in zones.items())

    def _number(self, system: System) -> int:
        """Return the index of a component, which is added with its parts if it is new."""
        key = (system.kind.casefold(), system.name.casefold())
        if key not in self._numbers:
            parts = tuple(dict.fromkeys(self._number(part) for part in system.parts))
            known = self._model.find(system.kind, system.name)
            fields = known[2] if known is not None else {}
            self._numbers[key] = len(self._components)
            self._components.append(
                SystemComponent(
                    kind=system.kind,
                    name=system.name,
                    inlets=tuple(_nodes(fields, _INLET)),
                    outlets=tuple(_nodes(fields, _OUTLET)),
                    parts=parts,
                )
            )
        return self._numbers[key]

    def _side(self, fields: Mapping[str, Any], name: str, branch_list: str, connector_list: str) -> LoopSide:
        listed = self._model.find("BranchList", fields.get(branch_list))
        entries = listed[2].get("branches", ()) if listed else ()
        branches = [str(entry.get("branch_name", "")) for entry in entries]
        stages = self._stages(branches, fields.get(connector_list))
        drawn = [tuple(self._branch(branch) for branch in stage) for stage in stages]
        # A single branch without components is a pipe; so is a stage of bypasses alone.
        return LoopSide(name=name, stages=tuple(stage for stage in drawn if any(stage)))

    def _branch(self, name: str) -> tuple[int, ...]:
        branch = self._model.find("Branch", name)
        parts = branch[2].get("components", ()) if branch else ()
        named = [(str(p.get("component_object_type", "")), str(p.get("component_name", ""))) for p in parts]
        return tuple(self._number(self._model.component(*part)) for part in named if not part[0].startswith(PASSIVE))

    def _stages(self, branches: Sequence[str], connector_list: object) -> list[list[str]]:
        """Return the branches of a side by stages: those without a connector first, one after another."""
        splits = [branch for kind, fields in self._connectors(connector_list) for branch in _parallel(kind, fields)]
        parallel = {branch.casefold() for branch in splits}
        ends = {
            str(fields.get("outlet_branch_name", "")).casefold()
            for kind, fields in self._connectors(connector_list)
            if kind == "Connector:Mixer"
        }
        before = [branch for branch in branches if branch.casefold() not in parallel | ends]
        between = [branch for branch in branches if branch.casefold() in parallel]
        after = [branch for branch in branches if branch.casefold() in ends - parallel]
        return [*([branch] for branch in before), *([between] if between else []), *([branch] for branch in after)]

    def _connectors(self, connector_list: object) -> Iterator[tuple[str, Mapping[str, Any]]]:
        listed = self._model.find("ConnectorList", connector_list) if connector_list else None
        fields = listed[2] if listed is not None else {}
        for number in (1, 2):
            kind, name = fields.get(f"connector_{number}_object_type"), fields.get(f"connector_{number}_name")
            connector = self._model.find(str(kind), name) if kind and name else None
            if connector is not None:
                yield connector[0], connector[2]


def _parallel(kind: str, fields: Mapping[str, Any]) -> Iterator[str]:
    """Yield the parallel branches of a splitter or a mixer."""
    field = "outlet_branch_name" if kind == "Connector:Splitter" else "inlet_branch_name"
    for entry in fields.get("branches", ()):
        yield str(entry.get(field, ""))


def _nodes(fields: Mapping[str, Any], side: re.Pattern[str]) -> Iterator[SystemNode]:
    """Yield an object's nodes whose fields match a pattern."""
    for field, value in fields.items():
        if isinstance(value, str) and value and side.fullmatch(field):
            yield SystemNode(name=value, port=_PORT.sub("", field).replace("_", " "))
