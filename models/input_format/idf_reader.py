"""Read an IDF of any version into epJSON objects, with the line of each field.

The result equals that of EnergyPlus's own converter (`tests/models/test_idf_reader.py` compares all bundled models),
which reads only IDF files of its own version and keeps no lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from zenostat.models.input_format.layout import Layout, Rules, TypeLayout
from zenostat.topics.errors import InvalidConfig, did_you_mean

Objects = dict[str, dict[str, dict[str, Any]]]
"""epJSON: object type, object name, fields."""

_COMMENT = re.compile(r"!.*")
_VERSION = re.compile(r"(?:^|;)\s*version\s*,([^,;]*)[,;]", re.IGNORECASE)
_SEPARATOR = re.compile(r"([,;])")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")
_INTEGER = re.compile(r"[+-]?\d+")
_SIZES = frozenset(("autosize", "autocalculate"))
_LARGEST_INTEGER = 2**31 - 1
_MAX_ERRORS = 10


@dataclass(frozen=True, slots=True)
class IdfObject:
    """An object of an IDF: its type, its fields with their lines, and the line of the type."""

    kind: str
    fields: tuple[tuple[int, str], ...]
    line: int


@dataclass(frozen=True)
class ParsedModel:
    """A model file's objects as epJSON.

    Attributes:
        objects: object type, object name, fields.
        lines: line of each object (the field is empty then) and of each of its fields, by type, name and field.
    """

    objects: Objects
    lines: dict[tuple[str, str, str], int] = field(default_factory=dict)

    def line(self, kind: str, name: str, field_name: str = "") -> int | None:
        """Return the line of a field, else of its object; None if it is not in the file."""
        return self.lines.get((kind, name, field_name), self.lines.get((kind, name, "")))


def idf_objects(text: str) -> Iterator[IdfObject]:
    """Yield the objects of an IDF; text after the last semicolon is ignored, as in EnergyPlus."""
    parts: list[tuple[int, str]] = []
    value, begin = "", 0
    for number, line in enumerate(text.splitlines(), 1):
        for part in _SEPARATOR.split(line.partition("!")[0]):
            if part not in (",", ";"):
                if part.strip() and not value.strip():
                    begin = number
                value += part
                continue
            parts.append((begin if value.strip() else number, value.strip()))
            value = ""
            if part == ";":
                (first, kind), *fields = parts
                if kind:
                    yield IdfObject(kind, tuple(fields), first)
                parts = []


def idf_version(text: str) -> str | None:
    """Return the version identifier of an IDF; None if it has none."""
    match = _VERSION.search(_COMMENT.sub("", text))
    return match[1].strip() if match else None


def read_idf(text: str, layout: Layout, *, name: str) -> ParsedModel:
    """Read an IDF of the layout's version.

    Args:
        text: the file's content.
        layout: of the version.
        name: of the file, for error messages.

    Raises:
        InvalidConfig: an object has an unknown type, too many fields or a name that another one has; the text lists
            these with their lines.
    """
    reader = _Reader(layout)
    for each in idf_objects(text):
        reader.add(each)
    if reader.errors:
        more = [f"and {len(reader.errors) - _MAX_ERRORS} more"] if len(reader.errors) > _MAX_ERRORS else []
        head = f"{name} is not an IDF for EnergyPlus {layout.version}:"
        raise InvalidConfig("\n  ".join([head, *reader.errors[:_MAX_ERRORS], *more]))
    return ParsedModel(reader.objects, reader.lines)


class _Reader:
    """State of reading one IDF."""

    def __init__(self, layout: Layout) -> None:
        self.objects: Objects = {}
        self.lines: dict[tuple[str, str, str], int] = {}
        self.errors: list[str] = []
        self._layout = layout

    def add(self, each: IdfObject) -> None:
        """Add an object, or an error."""
        layout = self._layout.find(each.kind)
        if layout is None:
            hint = did_you_mean(each.kind, self._layout.kinds)
            self.errors.append(f"line {each.line}: no object type {each.kind[:60]!r}; {hint}")
            return
        capacity = len(layout.order) if not layout.list_name else len(each.fields)
        if len(each.fields) > capacity and any(value for _, value in each.fields[capacity:]):
            line = each.fields[capacity][0]
            self.errors.append(f"line {line}: {layout.kind} has {capacity} fields, got {len(each.fields)}")
            return
        fields, lines = _fields(layout, each.fields)
        items = self.objects.setdefault(layout.kind, {})
        named = fields.pop("name", "") if layout.named else ""
        key = str(named) or f"{layout.kind} {len(items) + 1}"
        if any(key.casefold() == other.casefold() for other in items) if named else key in items:
            self.errors.append(f"line {each.line}: a second {layout.kind} {key!r}")
            return
        items[key] = fields
        self.lines[layout.kind, key, ""] = each.line
        self.lines.update({(layout.kind, key, field_name): line for field_name, line in lines.items()})


def _fields(layout: TypeLayout, values: tuple[tuple[int, str], ...]) -> tuple[dict[str, Any], dict[str, int]]:
    """Return the fields of an object and their lines; entries of its list are `LIST[INDEX].FIELD` in the lines."""
    fields: dict[str, Any] = {}
    lines: dict[str, int] = {}
    for field_name, (line, value) in zip(layout.order, values, strict=False):
        lines[field_name] = line
        if value:
            fields[field_name] = _value(value, layout.rules.get(field_name, {}), numeric=field_name in layout.numeric)
    rest, size = values[len(layout.order) :], len(layout.entry_order)
    entries: list[dict[str, Any]] = []
    for start in range(0, len(rest), size or 1):
        entry: dict[str, Any] = {}
        for entry_field, (line, value) in zip(layout.entry_order, rest[start : start + size], strict=False):
            lines[f"{layout.list_name}[{len(entries)}].{entry_field}"] = line
            if value:
                entry[entry_field] = _value(
                    value, layout.entry_rules[entry_field], numeric=entry_field in layout.numeric
                )
        entries.append(entry)
    if layout.list_name and entries:
        fields[layout.list_name] = entries
    return fields, lines


def _value(text: str, rules: Rules, *, numeric: bool) -> Any:
    """Return a field's value: a number, a word as the schema spells it, or the text."""
    choices: list[Mapping[str, Any]] = [rules, *rules.get("anyOf", ())]
    if numeric or any(choice.get("type") in ("number", "integer") for choice in choices):
        number = _number(text)
        if number is not None:
            whole = isinstance(number, float) and number.is_integer() and rules.get("type") == "integer"
            return int(number) if whole else number
    words = [word for choice in choices for word in choice.get("enum", ()) if isinstance(word, str)]
    spelled = next((word for word in words if word.casefold() == text.casefold()), None)
    if spelled is None and text.casefold() in _SIZES:
        # EnergyPlus takes either word for the one that the field knows.
        spelled = next((word for word in words if word.casefold() in _SIZES), None)
    return text if spelled is None else spelled


def _number(text: str) -> int | float | None:
    if _INTEGER.fullmatch(text):
        number = int(text)
        return number if abs(number) <= _LARGEST_INTEGER else float(number)
    if _NUMBER.fullmatch(text):
        return float(text.replace("d", "e").replace("D", "e"))
    return None
