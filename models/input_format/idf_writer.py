"""Write epJSON objects as an IDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from zenostat.models.input_format.layout import Layout, TypeLayout
from zenostat.topics.errors import InvalidConfig

_SYNTAX = (",", ";", "!", "\n", "\r")


def write_idf(
    objects: Mapping[str, Mapping[str, Mapping[str, Any]]], layout: Layout, *, all_fields: bool = False
) -> str:
    """Return the objects as an IDF of the layout's version.

    Args:
        objects: object type, object name, fields.
        layout: of the version.
        all_fields: whether to write the empty fields after an object's last one, too.

    Raises:
        InvalidConfig: a type or a field is unknown, or a text has a character that separates fields in an IDF, or half
            of a surrogate pair, which is no character.
    """
    lines: list[str] = []
    for kind, items in objects.items():
        entry = layout.find(kind)
        if entry is None:
            raise InvalidConfig(f"EnergyPlus {layout.version} has no object type {kind!r}")
        for name, fields in items.items():
            lines.append(f"{kind},")
            values = list(_values(entry, name, fields, all_fields=all_fields)) or [("", "")]
            lines += [f"  {value}{',' if i < len(values) else ';'}  !- {t}" for i, (t, value) in enumerate(values, 1)]
            lines.append("")
    return "\n".join([*lines, ""])


def _values(entry: TypeLayout, name: str, fields: Mapping[str, Any], *, all_fields: bool) -> Iterator[tuple[str, str]]:
    """Yield title and value of the fields up to the last one that the object has, or of all."""
    label = f"{entry.kind} {name!r}"
    known = {*entry.order, entry.list_name}
    unknown = [field for field in fields if field not in known and not field.startswith("idf_")]
    if unknown:
        raise InvalidConfig(f"{label} has no field {unknown[0]!r} in EnergyPlus")
    entries = list(fields.get(entry.list_name, ())) if entry.list_name else []
    present = {"name": name, **fields} if entry.named else fields
    positions = [position for position, field in enumerate(entry.order, 1) if field in present]
    last = len(entry.order) if entries or all_fields else max(positions, default=0)
    for field in entry.order[:last]:
        yield entry.titles.get(field, field), _text(label, field, present.get(field, ""))
    for number, values in enumerate(entries, 1):
        for field in entry.entry_order:
            yield f"{entry.titles.get(field, field)} {number}", _text(label, field, values.get(field, ""))


def _text(label: str, field: str, value: Any) -> str:
    text = str(value) if isinstance(value, (str, int)) else repr(float(value))
    if any(mark in text for mark in _SYNTAX):
        raise InvalidConfig(
            f"{label}: {field} is {text!r}, which an IDF cannot have: it contains a separator of fields"
        )
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InvalidConfig(f"{label}: {field} is {text!r}, which a file cannot have: it has half of a surrogate pair")
    return text
