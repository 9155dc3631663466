"""The systems of a building for the page: components with the points that belong to them, and the loops."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from zenostat.topics.messages import Actuator, Manifest, Sensor, ServedZone, SystemNode, Systems
from zenostat.views.room.district import district

_NODE_WORDS = "System Node "
_WORD = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_GROUPS = ("AirLoopHVAC", "ZoneHVAC", "HVACTemplate", "SingleDuct", "DualDuct")
"""Parts of the name of a type that say nothing on a schematic."""


def schematic(systems: Systems, manifest: Manifest, zones: Mapping[str, int]) -> dict[str, Any]:
    """Return the systems with their live points.

    Args:
        systems: of the building.
        manifest: of its node.
        zones: number of each zone with a temperature, by its name in lower case.

    Returns:
        `components`, each with its `type` in words, `kind`, `name`, `parts` and `values`: pairs of a point's index and
        a short label; `loops` with `sides` and `zones`; `zones`, those with equipment that is on no air loop; and what
        `zenostat.views.room.district.district` returns.
    """
    by_key = _points_by_key(manifest)
    by_component = _node_values(systems, by_key)
    components = []
    for number, component in enumerate(systems.components):
        own = [
            (index, _label(point, component.kind))
            for index, point in by_key.get(component.name.casefold(), ())
            if not _is_of_node(point)
        ]
        components.append(
            {
                "kind": component.kind,
                "type": type_words(component.kind),
                "name": component.name,
                "parts": list(component.parts),
                "values": [*by_component[number], *own],
            }
        )
    loops = [
        {
            "kind": loop.kind,
            "name": loop.name,
            "values": [(index, _label(point, loop.kind)) for index, point in by_key.get(loop.name.casefold(), ())],
            "sides": [
                {"name": side.name, "stages": [[list(branch) for branch in stage] for stage in side.stages]}
                for side in loop.sides
            ],
            "zones": _zones(loop.zones, zones),
        }
        for loop in systems.loops
    ]
    return {
        "components": components,
        "loops": loops,
        "zones": _zones(systems.zones, zones),
        **district(systems, manifest),
    }


def type_words(kind: str) -> str:
    """Return the type of an object in words: `Coil:Cooling:DX:TwoSpeed` as `Cooling coil, DX, two speed`."""
    first, *rest = [part for part in kind.split(":") if part not in _GROUPS] or [kind]
    if first == "Coil" and rest:
        first = f"{rest.pop(0)}Coil"
    elif first == "AirTerminal":
        first = f"{rest.pop(0)} Terminal" if rest else "Terminal"
    texts = [_words(part) for part in (first, *rest)]
    return ", ".join([texts[0][:1].upper() + texts[0][1:], *texts[1:]])


def _words(text: str) -> str:
    return " ".join(word if word.isupper() and len(word) > 1 else word.lower() for word in _WORD.sub(" ", text).split())


def _zones(served: Iterable[ServedZone], zones: Mapping[str, int]) -> list[dict[str, Any]]:
    return [
        {"name": each.zone, "zone": zones.get(each.zone.casefold()), "equipment": list(each.equipment)}
        for each in served
    ]


def _points_by_key(manifest: Manifest) -> dict[str, list[tuple[int, Sensor | Actuator]]]:
    """Return index and point of all sensors and actuators by what they measure or set, case-folded."""
    by_key: dict[str, list[tuple[int, Sensor | Actuator]]] = defaultdict(list)
    for index, point in enumerate((*manifest.points, *manifest.actuators)):
        if isinstance(point, Sensor | Actuator):
            by_key[point.key.casefold()].append((index, point))
    return by_key


def _is_of_node(point: Sensor | Actuator) -> bool:
    return _quantity(point).startswith(_NODE_WORDS)


def _node_values(
    systems: Systems, by_key: Mapping[str, Sequence[tuple[int, Sensor | Actuator]]]
) -> dict[int, list[tuple[int, str]]]:
    """Return the values of nodes by component: where the node is an outlet, or an inlet if it is nobody's outlet.

    Of a component and its parts with the same node, the component has the value.
    """
    parts = {part for component in systems.components for part in component.parts}
    places: dict[str, tuple[int, str]] = {}
    for side in ("outlets", "inlets"):
        for is_part in (False, True):
            for number, component in enumerate(systems.components):
                if (number in parts) == is_part:
                    nodes: tuple[SystemNode, ...] = getattr(component, side)
                    for node in nodes:
                        is_clear = side == "outlets" and len(nodes) == 1
                        places.setdefault(node.name.casefold(), (number, "" if is_clear else _port(node)))
    values: dict[int, list[tuple[int, str]]] = defaultdict(list)
    for name, (number, port) in places.items():
        for index, point in by_key.get(name, ()):
            if _is_of_node(point):
                text = _quantity(point).removeprefix(_NODE_WORDS)
                values[number].append((index, _sentence(f"{port} {_short(text)}".strip())))
    return values


def _label(point: Sensor | Actuator, kind: str) -> str:
    """Return what a point measures or sets, without the words that its component's type has already."""
    known = {word.lower() for word in _WORD.sub(" ", kind.replace(":", " ")).split()}
    words = _quantity(point).split()
    while len(words) > 1 and words[0].lower() in known:
        known.remove(words[0].lower())
        words = words[1:]
    return _sentence(_short(" ".join(words)))


def _port(node: SystemNode) -> str:
    return node.port.removesuffix(" outlet").removesuffix(" stream")


def _short(text: str) -> str:
    return (
        text.removesuffix(" Rate")
        .replace("Setpoint Temperature", "Setpoint")
        .replace("Temperature Setpoint", "Setpoint")
    )


def _quantity(point: Sensor | Actuator) -> str:
    return point.variable if isinstance(point, Sensor) else f"{point.component_type} {point.control_type}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].lower()
