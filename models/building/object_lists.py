"""Object lists of EnergyPlus's input schema: which objects a field may refer to.

`object_list` has the lists of names from which a field takes its value. A name is in a list if its object type, or the
field that holds the name, has that list as its `reference`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from zenostat.models import energyplus, schema
from zenostat.topics.cache import cached_bytes

FORMAT = "3"
"""Version of the stored file."""

_OMITTED = {"ZoneHVAC:Baseboard:RadiantConvective:Steam:Design": "RadiantDesignObject"}
"""Object lists that the schema omits for the names of a type."""


def object_lists(kind: str) -> Mapping[str, list[str]]:
    """Return the object lists of the fields of a type: `schedule_name`, or `components.component_name` in a list."""
    return dict(_stored()["lists"].get(kind, {}))


def named_in() -> Mapping[str, Mapping[str, list[str]]]:
    """Return the object lists in which each type's names are: by type, and by the field that holds the name."""
    return dict(_stored()["references"])


def type_lists() -> Mapping[str, list[str]]:
    """Return the object types of each list of types, such as `validBranchEquipmentTypes`."""
    return dict(_stored()["types"])


@cache
def _stored() -> dict[str, Any]:
    return dict(json.loads(cached_bytes(f"object-lists/{energyplus.version()}-{FORMAT}.json", _make)))


def _make(target: Path) -> None:
    lists: dict[str, dict[str, list[str]]] = {}
    references: dict[str, dict[str, list[str]]] = {}
    types: dict[str, list[str]] = {}
    for kind, name in _OMITTED.items():
        references[kind] = {"name": [name]}
    for kind, entry in schema.document()["properties"].items():
        (shape,) = entry["patternProperties"].values()
        for path, spec in [("name", entry.get("name", {})), *_fields(shape["properties"])]:
            for part in [spec, *spec.get("anyOf", ())]:
                if "object_list" in part:
                    lists.setdefault(kind, {}).setdefault(path, []).extend(part["object_list"])
                if "reference" in part:
                    references.setdefault(kind, {}).setdefault(path, []).extend(part["reference"])
                for name in part.get("reference-class-name", ()):
                    types.setdefault(name, []).append(kind)
    target.write_text(json.dumps({"lists": lists, "references": references, "types": types}))


def _fields(properties: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield path and description of each field, those of list entries as `list.field`."""
    for name, spec in properties.items():
        yield name, spec
        for member, entry in spec.get("items", {}).get("properties", {}).items():
            yield f"{name}.{member}", entry
