"""Find nodes of a model that only one object names: the connection is missing, mostly because of a typing error."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from zenostat.topics.errors import did_you_mean

_NODE = re.compile(r"(\w*_)?node(_or_nodelist)?(_\w*)?name|\w*_node_or_nodelist_name")
_MAY_BE_ALONE = re.compile(r"outlet|relief|exhaust|return|zone_air_node|zone_node|^node_name$|^node_or_nodelist_name$")
"""Fields whose node nothing else needs to name: air that leaves the building, the air of a zone, lists of nodes."""

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


def unconnected_nodes(objects: Mapping[str, Mapping[str, Any]]) -> Iterator[UnconnectedNode]:
    """Yield the nodes that only one field names, except for those that may be the end of an air stream."""
    uses: dict[str, list[tuple[str, str, str, str]]] = defaultdict(list)
    for kind, items in objects.items():
        if not kind.startswith(_IGNORED):
            for name, fields in items.items():
                for field, member, node in _node_fields(fields):
                    uses[node.casefold()].append((kind, name, field, node if not _MAY_BE_ALONE.search(member) else ""))
    named = {name.casefold() for kind in ("NodeList", "OutdoorAir:Node") for name in objects.get(kind, {})}
    known = tuple(dict.fromkeys(use[3] for each in uses.values() if len(each) > 1 for use in each if use[3]))
    for node, users in uses.items():
        kind, name, field, spelling = users[0]
        if len(users) == 1 and spelling and node not in named and kind not in _LISTS:
            yield UnconnectedNode(kind, name, field, spelling, known)


def _node_fields(fields: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield path, name and value of each field that names a node."""
    for member, value in fields.items():
        if isinstance(value, str):
            if value and _NODE.fullmatch(member):
                yield path + member, member, value
        elif isinstance(value, list):
            for index, entry in enumerate(value):
                if isinstance(entry, Mapping):
                    yield from _node_fields(entry, f"{path}{member}[{index}].")
