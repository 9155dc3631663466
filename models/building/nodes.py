"""Find nodes that only one object names, nodes without the setpoint that equipment needs, and branches in two loops.

All are mostly typing errors: with the first a connection is missing. EnergyPlus reports the second, in plant loops,
only when a run has ended; a coil without a setpoint is off.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from zenostat.models.building.findings import FieldFinding, RuleFinding, finding
from zenostat.models.building.object_lists import object_lists
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.errors import did_you_mean

_NODE = re.compile(r"(\w*_)?node(_\w*)?_names?(_for_surface)?|\w*_node")
_MAY_BE_ALONE = re.compile(r"outlet|relief|exhaust|return|zone_air_node|zone_node|^node_name$|^node_or_nodelist_name$")
"""Fields whose node nothing else needs to name: air that leaves the building, the air of a zone, lists of nodes."""

_ANY_NODE = re.compile(r"\w*node\w*")
_OUTLET_NODE = re.compile(r"\w*outlet\w*node\w*")
_OUTDOOR_AIR = "outdoor_air_stream_node_name"
_SETPOINT_NODE = re.compile(r"\w*(setpoint|sensor)_node_name")
_NEED_SETPOINT = ("PlantLoop", "CondenserLoop", "Controller:WaterCoil", "CoilSystem:", "Coil:Heating:")

_BRANCH_LIST = re.compile(r"(\w*_)?branch_list_name")
_BRANCH = re.compile(r"branch_name")
_LISTS = ("NodeList", "OutdoorAir:NodeList")
_IGNORED = ("Output", "EnergyManagementSystem")


class UnconnectedNode(NamedTuple):
    """A node that only one object names.

    Attributes:
        kind, name, field: the object and its field.
        node: the node's name.
        known: names of the other nodes.
    """

    kind: str
    name: str
    field: str
    node: str
    known: tuple[str, ...]

    def describe(self) -> str:
        """Return the text of a warning."""
        text = f"{self.kind} {self.name!r}: {self.field} is {self.node!r}, a node that nothing else in the model names"
        return f"{text}; {did_you_mean(self.node, self.known)}"


def unconnected_nodes(objects: ModelObjects) -> Iterator[UnconnectedNode]:
    """Yield the nodes that only one field names, except for those that may be the end of an air stream.

    Fields that the schema has as references to objects, such as `AirflowNetwork:MultiZone:ExternalNode`, are left to
    `dangling_references`.
    """
    uses: dict[str, list[tuple[str, str, str, str]]] = defaultdict(list)
    for kind, items in objects.items():
        if not kind.startswith(_IGNORED):
            references = {path.rpartition(".")[2] for path in object_lists(kind)}
            for name, fields in items.items():
                for field, member, node in _node_fields(fields):
                    may_be_alone = member in references or _MAY_BE_ALONE.search(member)
                    uses[node.casefold()].append((kind, name, field, "" if may_be_alone else node))
    named = {name.casefold() for kind in ("NodeList", "OutdoorAir:Node") for name in objects.get(kind, {})}
    known = tuple(dict.fromkeys(use[3] for each in uses.values() if len(each) > 1 for use in each if use[3]))
    for node, users in uses.items():
        kind, name, field, spelling = users[0]
        if len(users) == 1 and spelling and node not in named and kind not in _LISTS:
            yield UnconnectedNode(kind, name, field, spelling, known)


def nodes_without_setpoint(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield a warning for each node whose setpoint an object needs, and that no setpoint manager or EMS actuator sets.

    A plug-in or an external interface may set any node, so a model with one of these has no such warnings.
    """
    if any(kind.startswith(("PythonPlugin:", "ExternalInterface")) for kind in objects):
        return
    managed = managed_nodes(objects)
    for kind, items in objects.items():
        if kind.startswith(_NEED_SETPOINT):
            for name, fields in items.items():
                for path, _, node in _node_fields(fields, pattern=_SETPOINT_NODE):
                    if node.casefold() not in managed:
                        text = f": {path} is {node!r}, but no setpoint manager or EMS actuator sets that node"
                        yield finding(kind, name, FieldFinding(path, text, is_fatal=False))


def managed_nodes(objects: ModelObjects) -> set[str]:
    """Return the nodes, case-folded, that a setpoint manager or an EMS actuator may set."""
    managed = {
        node.casefold()
        for kind, items in objects.items()
        if kind.startswith("SetpointManager:")
        for fields in items.values()
        for _, _, node in _node_fields(fields, pattern=_ANY_NODE)
    }
    for fields in objects.get("EnergyManagementSystem:Actuator", {}).values():
        if str(fields.get("actuated_component_type", "")).casefold() == "system node setpoint":
            managed.add(str(fields.get("actuated_component_unique_name", "")).casefold())
    return _with_list_members(objects, managed)


def _with_list_members(objects: ModelObjects, names: set[str]) -> set[str]:
    """Return names of nodes and node lists, case-folded, with the nodes in these lists."""
    lists = [fields for name, fields in objects.get("NodeList", {}).items() if name.casefold() in names]
    return names | {str(node.get("node_name", "")).casefold() for each in lists for node in each.get("nodes", ())}


def outdoor_nodes_without_air(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield a warning for each mixer whose outdoor air comes neither from outdoors nor from other equipment.

    EnergyPlus reports it as a severe error, and simulates the mixer nevertheless.
    """
    sources = {name.casefold() for name in objects.get("OutdoorAir:Node", {})}
    for kind, items in objects.items():
        pattern = _OUTLET_NODE if kind != "OutdoorAir:NodeList" else _ANY_NODE
        sources |= {node.casefold() for f in items.values() for _, _, node in _node_fields(f, pattern=pattern)}
    sources = _with_list_members(objects, sources)
    for name, fields in objects.get("OutdoorAir:Mixer", {}).items():
        node = str(fields.get(_OUTDOOR_AIR, ""))
        if node and node.casefold() not in sources:
            text = (
                f": {_OUTDOOR_AIR} is {node!r}, which no OutdoorAir:Node or OutdoorAir:NodeList names, and where no "
                "other equipment has its outlet"
            )
            yield finding("OutdoorAir:Mixer", name, FieldFinding(_OUTDOOR_AIR, text, is_fatal=False))


def shared_branches(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield an error for each branch list that two sides of loops name, and each branch that is in two lists."""
    loops = {kind: items for kind, items in objects.items() if kind.endswith("Loop") or kind == "AirLoopHVAC"}
    lists = {kind: items for kind, items in objects.items() if kind == "BranchList"}
    for users, pattern in ((loops, _BRANCH_LIST), (lists, _BRANCH)):
        first: dict[str, str] = {}
        for kind, items in users.items():
            for name, fields in items.items():
                for path, _, branch in _node_fields(fields, pattern=pattern):
                    user = first.setdefault(branch.casefold(), f"{path} of {kind} {name!r}")
                    if user != f"{path} of {kind} {name!r}":
                        text = f": {path} is {branch!r}, as {user} is; each needs branches of its own"
                        yield finding(kind, name, FieldFinding(path, text))


def _node_fields(
    fields: Mapping[str, Any], path: str = "", pattern: re.Pattern[str] = _NODE
) -> Iterator[tuple[str, str, str]]:
    """Yield path, name and value of each field whose name matches a pattern, by default that of names of nodes."""
    for member, value in fields.items():
        if isinstance(value, str):
            if value and pattern.fullmatch(member):
                yield path + member, member, value
        elif isinstance(value, list):
            for index, entry in enumerate(value):
                if isinstance(entry, Mapping):
                    yield from _node_fields(entry, f"{path}{member}[{index}].", pattern)
