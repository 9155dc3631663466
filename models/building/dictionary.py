"""EnergyPlus's input data dictionary: the order of the fields in an IDF, and which objects a field refers to.

Both are in the input schema of the engine's library (see `zenostat.models.building.schema`): `legacy_idd` has the order
of the fields of each object type, and `object_list` the lists of names from which a field takes its value. A name is
in a list if its object type, or the field that holds the name, has that list as its `reference`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from zenostat.models import energyplus
from zenostat.models.building import schema
from zenostat.models.cache import cached_bytes

FORMAT = "1"
"""Version of the stored file."""


class FieldOrder(NamedTuple):
    """The fields of an object type in an IDF.

    Attributes:
        fields: those before the list, in their order; the first one is `name` for named types.
        extension: the list that the remaining fields belong to; empty if there is none.
        extensibles: fields of one entry of the list.
        numeric: fields that hold numbers.
    """

    fields: tuple[str, ...]
    extension: str
    extensibles: tuple[str, ...]
    numeric: frozenset[str]

    @property
    def is_named(self) -> bool:
        """Whether the first field is the object's name."""
        return self.fields[:1] == ("name",)

    def path(self, index: int) -> str:
        """Return the path of the field at a position, from 0: `schedule_name`, `vertices[2].vertex_x_coordinate`.

        Empty beyond the last field.
        """
        if index < len(self.fields):
            return self.fields[index]
        if not self.extensibles:
            return ""
        entry, member = divmod(index - len(self.fields), len(self.extensibles))
        return f"{self.extension}[{entry}].{self.extensibles[member]}"


@cache
def field_order(kind: str) -> FieldOrder:
    """Return the fields of the object type `kind`, as EnergyPlus spells it."""
    fields, extension, extensibles, numeric = _dictionary()["orders"][kind]
    return FieldOrder(tuple(fields), extension, tuple(extensibles), frozenset(numeric))


def object_lists(kind: str) -> Mapping[str, list[str]]:
    """Return the object lists of the fields of a type: `schedule_name`, or `components.component_name` in a list."""
    return dict(_dictionary()["lists"].get(kind, {}))


def named_in() -> Mapping[str, Mapping[str, list[str]]]:
    """Return the object lists in which each type's names are: by type, and by the field that holds the name."""
    return dict(_dictionary()["references"])


def type_lists() -> Mapping[str, list[str]]:
    """Return the object types of each list of types, such as `validBranchEquipmentTypes`."""
    return dict(_dictionary()["types"])


@cache
def _dictionary() -> dict[str, Any]:
    return dict(json.loads(cached_bytes(f"dictionary/{energyplus.version()}-{FORMAT}.json", _make)))


def _make(target: Path) -> None:
    orders: dict[str, Any] = {}
    lists: dict[str, dict[str, list[str]]] = {}
    references: dict[str, dict[str, list[str]]] = {}
    types: dict[str, list[str]] = {}
    for kind, entry in schema.embedded()["properties"].items():
        order = entry["legacy_idd"]
        numerics = order["numerics"]
        numeric = [*numerics.get("fields", ()), *numerics.get("extensions", ())]
        orders[kind] = order["fields"], order.get("extension", ""), order.get("extensibles", []), numeric
        (shape,) = entry["patternProperties"].values()
        for path, spec in [("name", entry.get("name", {})), *_fields(shape["properties"])]:
            for part in [spec, *spec.get("anyOf", ())]:
                if "object_list" in part:
                    lists.setdefault(kind, {}).setdefault(path, []).extend(part["object_list"])
                if "reference" in part:
                    references.setdefault(kind, {}).setdefault(path, []).extend(part["reference"])
                for name in part.get("reference-class-name", ()):
                    types.setdefault(name, []).append(kind)
    target.write_text(json.dumps({"orders": orders, "lists": lists, "references": references, "types": types}))


def _fields(properties: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield path and description of each field, those of list entries as `list.field`."""
    for name, spec in properties.items():
        yield name, spec
        for member, entry in spec.get("items", {}).get("properties", {}).items():
            yield f"{name}.{member}", entry
