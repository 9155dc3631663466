"""Positions of the fields of each object type in an IDF, and the schema's rule for each field.

EnergyPlus's input schema has, beside the JSON Schema of an epJSON, the order of each type's fields in an IDF
(`legacy_idd`). Both formats of one version are therefore described by one document, and so is the data dictionary.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

from zenostat.models import energyplus, schema

Rules = Mapping[str, Any]
"""A field's part of the schema: type, alternatives, words, limits, default."""


@dataclass(frozen=True)
class TypeLayout:
    """Layout of one object type.

    Attributes:
        kind: the type, as EnergyPlus spells it.
        order: fields in the order of an IDF; `name` is among them if objects have names.
        rules: the schema's rules by field.
        list_name: field of the list to which an IDF's last fields belong; empty if the type has none.
        entry_order: fields of an entry of that list, in the order of an IDF.
        entry_rules: the schema's rules of an entry's fields.
        titles: names of the fields in the data dictionary.
        numeric: fields that hold numbers.
        named: whether objects have names.
        numbered: whether an object without a name gets its number as one, as in `RunPeriod 1`.
        required: fields that each object has.
        minimum_fields: number of fields up to which defaults apply.
        group: heading in the data dictionary.
    """

    kind: str
    order: tuple[str, ...]
    rules: Rules
    list_name: str = ""
    entry_order: tuple[str, ...] = ()
    entry_rules: Rules = field(default_factory=dict)
    titles: Mapping[str, str] = field(default_factory=dict)
    numeric: frozenset[str] = frozenset()
    named: bool = False
    numbered: bool = True
    required: tuple[str, ...] = ()
    minimum_fields: int = 0
    group: str = ""

    def path(self, index: int) -> str:
        """Return the path of the field at a position, from 0: `schedule_name`, `vertices[2].vertex_x_coordinate`.

        Empty beyond the last field.
        """
        if index < len(self.order):
            return self.order[index]
        if not self.entry_order:
            return ""
        entry, member = divmod(index - len(self.order), len(self.entry_order))
        return f"{self.list_name}[{entry}].{self.entry_order[member]}"


class Layout:
    """Layout of all object types of one version, from its schema."""

    def __init__(self, document: Mapping[str, Any], version: str) -> None:
        self.version = version
        self._entries: Mapping[str, Any] = document["properties"]
        self._types: dict[str, TypeLayout] = {}

    def find(self, kind: str) -> TypeLayout | None:
        """Return the layout of a type, in any case; None if the version has no such type."""
        spelling = self._spelling.get(kind.casefold())
        if spelling is None:
            return None
        if spelling not in self._types:
            self._types[spelling] = _type_layout(spelling, self._entries[spelling])
        return self._types[spelling]

    @property
    def kinds(self) -> tuple[str, ...]:
        """All object types, as EnergyPlus spells them."""
        return tuple(self._entries)

    @cached_property
    def _spelling(self) -> dict[str, str]:
        return {kind.casefold(): kind for kind in self._entries}


@cache
def engine_layout() -> Layout:
    """Return the layout of the installed engine's version."""
    return Layout(schema.document(), energyplus.version())


def _type_layout(kind: str, entry: Mapping[str, Any]) -> TypeLayout:
    legacy = entry["legacy_idd"]
    (shape,) = entry["patternProperties"].values()
    rules: Rules = shape["properties"]
    list_name = legacy.get("extension", "")
    entry_rules = rules[list_name]["items"]["properties"] if list_name else {}
    numerics = legacy["numerics"]
    return TypeLayout(
        kind,
        tuple(legacy["fields"]),
        rules,
        list_name,
        tuple(legacy.get("extensibles", ())),
        entry_rules,
        {name: str(info["field_name"]) for name, info in legacy["field_info"].items() if "field_name" in info},
        frozenset([*numerics["fields"], *numerics.get("extensions", ())]),
        "name" in entry,
        "name" not in entry or (kind == "RunPeriod" and not entry["name"].get("is_required")),  # 9.0 and 9.1
        tuple(shape.get("required", ())),
        int(entry.get("min_fields", 0)),
        entry.get("group", ""),
    )
