"""Read a model file with its lines: each object and each field of an IDF or an epJSON, and the errors of its syntax.

The objects of an IDF are those that EnergyPlus's own converter makes of it, by the order of the fields in its input
data dictionary (a test compares all bundled models). The converter remains the one that makes the model; this reader
knows where each value is.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from zenostat.models.building import schema
from zenostat.models.building.dictionary import FieldOrder, field_order
from zenostat.topics.errors import did_you_mean

_JSON_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,\n]|[^\s{}\[\]:,"]+')
_TYPE_FIELD = re.compile("type|class|key|name|field|line")  # fields that may hold the name of an object type
_INTEGER = re.compile(r"[+-]?\d+")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_AUTO = {"autosize", "autocalculate"}


class SourceField(NamedTuple):
    """A field of an object in a file: its line, from 1, and its text."""

    line: int
    text: str


@dataclass(slots=True)
class SourceObject:
    """An object of a model file.

    Attributes:
        kind: its type, as EnergyPlus spells it if it has that type.
        name: the key of the object in an epJSON; types without names are numbered, `RunPeriod 1`.
        line: of its name or, without one, of its type.
        fields: by path, such as `schedule_name` or `vertices[2].vertex_x_coordinate`, in the file's order.
    """

    kind: str
    name: str
    line: int
    fields: dict[str, SourceField] = field(default_factory=dict)


class SyntaxIssue(NamedTuple):
    """An error of a file that the schema does not show: its line, and the type and name of the object."""

    line: int
    kind: str
    name: str
    text: str


@dataclass(frozen=True)
class SourceModel:
    """A model file with the lines of its objects.

    Attributes:
        entries: its objects in their order.
        objects: the same as an epJSON.
        issues: errors of its syntax.
    """

    entries: tuple[SourceObject, ...] = ()
    objects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    issues: tuple[SyntaxIssue, ...] = ()

    def line(self, kind: str, name: str = "", path: str = "") -> int | None:
        """Return the line of a field, else of its object, else of the first object of the type; None if not found."""
        index = self._index()
        entry = index.get((kind.casefold(), name.casefold())) or (None if name else index.get((kind.casefold(), None)))
        if entry is None:
            return None
        while path and path not in entry.fields:
            within = next((value.line for own, value in entry.fields.items() if own.startswith(f"{path}.")), None)
            if within is not None:
                return within
            path = path.rpartition(".")[0] if "." in path else path.partition("[")[0] if "[" in path else ""
        return entry.fields[path].line if path else entry.line

    @cache  # noqa: B019  # a source lives as long as the errors of one file are described
    def _index(self) -> dict[tuple[str, str | None], SourceObject]:
        index: dict[tuple[str, str | None], SourceObject] = {}
        for entry in self.entries:
            index.setdefault((entry.kind.casefold(), entry.name.casefold()), entry)
            index.setdefault((entry.kind.casefold(), None), entry)
        return index

    __hash__ = object.__hash__


def read_source(path: Path) -> SourceModel:
    """Read an IDF or an epJSON file with its lines; an unreadable file has no objects."""
    is_idf = path.suffix.lower() == ".idf"
    try:
        text = path.read_text(encoding="latin-1" if is_idf else "utf-8")
    except (OSError, UnicodeDecodeError):
        return SourceModel()
    return read_idf(text) if is_idf else read_epjson(text)


# IDF


class _IdfValue(NamedTuple):
    line: int
    text: str
    is_split: bool  # a line ends within it: a comma is missing


def read_idf(text: str) -> SourceModel:
    """Read the text of an IDF of the engine's version."""
    reader = _IdfReader()
    for values, is_ended in _idf_objects(text):
        reader.add(values, is_ended=is_ended)
    return SourceModel(tuple(reader.entries), reader.objects, tuple(reader.issues))


class _IdfReader:
    """The objects of an IDF while they are read."""

    def __init__(self) -> None:
        self.entries: list[SourceObject] = []
        self.objects: dict[str, dict[str, Any]] = {}
        self.issues: list[SyntaxIssue] = []
        self._counts: Counter[str] = Counter()
        self._lines: dict[tuple[str, str], int] = {}

    def add(self, values: list[_IdfValue], *, is_ended: bool) -> None:
        """Add an object; the first value is its type."""
        (line, word, _), *rest = values
        kind = schema.canonical_type(word)
        if kind is None:
            self.entries.append(SourceObject(word, rest[0].text if rest else "", line))
            self.issues.append(SyntaxIssue(line, word, "", _unknown_type(word)))
            return
        order = field_order(kind)
        self._counts[kind] += 1
        is_named = bool(rest) and order.is_named
        name, at = (rest[0].text, rest[0].line) if is_named else (f"{kind} {self._counts[kind]}", line)
        entry = SourceObject(kind, name, at)
        self.issues += _idf_issues(entry, order, rest, is_ended=is_ended)
        first = self._lines.setdefault((kind, name.casefold()), at) if is_named else at
        if first != at:
            self.issues.append(_twin(entry, first))
        fields = _idf_fields(entry, order, rest)
        self.entries.append(entry)
        self.objects.setdefault(kind, {}).setdefault(name, fields)


def _twin(entry: SourceObject, first: int) -> SyntaxIssue:
    text = f"{entry.kind} {entry.name!r} is in the file twice; first in line {first}"
    return SyntaxIssue(entry.line, entry.kind, entry.name, text)


def _unknown_type(word: str) -> str:
    shown = word if len(word) <= 60 else word[:57] + "..."
    return f"EnergyPlus has no object type {shown!r}; {did_you_mean(shown, schema.types())}"


def _idf_objects(text: str) -> Iterator[tuple[list[_IdfValue], bool]]:
    """Yield the values of each object, its type first, and whether it ends with a semicolon."""
    values: list[_IdfValue] = []
    value, begin, is_split = "", 0, False
    for number, line in enumerate(text.splitlines(), 1):
        for part in re.split(r"([,;])", line.partition("!")[0]):
            if part not in (",", ";"):
                if part.strip():
                    is_split = is_split or bool(value.strip())
                    begin = begin if value.strip() else number
                    value = f"{value} {part.strip()}"
                continue
            values.append(_IdfValue(begin if value.strip() else number, value.strip(), is_split))
            value, is_split = "", False
            if part == ";":
                if values[0].text:
                    yield values, True
                values = []
    if values or value.strip():
        yield [*values, _IdfValue(begin, value.strip(), is_split)] if value.strip() else values, False


def _idf_issues(
    entry: SourceObject, order: FieldOrder, values: list[_IdfValue], *, is_ended: bool
) -> Iterator[SyntaxIssue]:
    label = f"{entry.kind} {entry.name!r}"
    surplus = values[len(order.fields)] if len(values) > len(order.fields) and not order.extensibles else None
    split = next((v for v in values if v.is_split), None)
    swallowed = _swallowed(order, values)
    if split is not None:
        text = f"{label}: ',' or ';' is missing within {split.text!r}, which begins here and ends in a later line"
        yield SyntaxIssue(split.line, entry.kind, entry.name, text)
    elif swallowed is not None:
        text = f"{label} does not end: ';' is missing before {swallowed.text!r}"
        yield SyntaxIssue(swallowed.line, entry.kind, entry.name, text)
    elif not is_ended:
        text = f"{label} does not end: ';' is missing after its last field"
        yield SyntaxIssue(values[-1].line if values else entry.line, entry.kind, entry.name, text)
    elif surplus is not None:
        text = (
            f"{label} has {len(values)} fields, but the type has {len(order.fields)}; "
            "is there a ',' too many, or a ';' missing at the end?"
        )
        yield SyntaxIssue(surplus.line, entry.kind, entry.name, text)


def _swallowed(order: FieldOrder, values: list[_IdfValue]) -> _IdfValue | None:
    """Return the first value that is the type of another object, where the semicolon before it is missing."""
    for index, value in enumerate(values[1:], 1):
        member = order.path(index).rpartition(".")[2]
        if (not member or (":" in value.text and not _TYPE_FIELD.search(member))) and schema.canonical_type(value.text):
            return value
    return None


def _idf_fields(entry: SourceObject, order: FieldOrder, values: list[_IdfValue]) -> dict[str, Any]:
    """Return the fields of an object as in an epJSON, and add them to `entry` with their lines."""
    fields: dict[str, Any] = {}
    entries: list[dict[str, Any]] = []
    size = len(order.extensibles)
    for index, (line, text, _) in enumerate(values):
        path = order.path(index)
        if not path:
            break
        entry.fields[path] = SourceField(line, text)
        target, member = fields, path
        if index >= len(order.fields):
            position, offset = divmod(index - len(order.fields), size)
            if position == len(entries):
                entries.append({})
            target, member = entries[position], order.extensibles[offset]
        if text and path != "name":
            target[member] = _idf_value(entry.kind, member, order.extension if target is not fields else "", text)
    if entries:
        fields[order.extension] = entries
    return schema.canonical_fields(entry.kind, fields)


def _idf_value(kind: str, member: str, extension: str, text: str) -> Any:
    """Convert the text of a field as EnergyPlus's converter does: to a number where the field may be one."""
    choices = schema.choices(kind, member, extension)
    if any(choice["type"] in ("number", "integer") for choice in choices):
        if _INTEGER.fullmatch(text):
            return int(text)
        if _NUMBER.fullmatch(text):
            return float(text)
        if text.casefold() in _AUTO:  # EnergyPlus takes one for the other
            words = [word for choice in choices for word in choice.get("words", ())]
            return next((word for word in words if str(word).casefold() in _AUTO), text)
    return text


# epJSON


def read_epjson(text: str) -> SourceModel:
    """Read the text of an epJSON."""
    try:
        objects = json.loads(text)
    except (ValueError, RecursionError):
        return SourceModel()
    entries = list(_EpjsonScanner().scan(text))
    first: dict[tuple[str, str], int] = {}
    issues = []
    for entry in entries:
        line = first.setdefault((entry.kind.casefold(), entry.name.casefold()), entry.line)
        if line != entry.line:
            issues.append(_twin(entry, line))
    return SourceModel(tuple(entries), objects if isinstance(objects, dict) else {}, tuple(issues))


class _EpjsonScanner:
    """The state of a scan over the tokens of a JSON text.

    Attributes:
        keys: the key or the index within each open object or list, None before a key; types are keys at depth 1, names
            at depth 2.
    """

    def __init__(self) -> None:
        self.keys: list[str | int | None] = []
        self._kind, self._last, self._last_line = "", "", 0
        self._entry: SourceObject | None = None

    def scan(self, text: str) -> Iterator[SourceObject]:
        """Yield the objects of a valid epJSON text."""
        line = 1
        for part in _JSON_TOKEN.findall(text):
            if part == "\n":
                line += 1
            elif part in "{[":
                self.keys.append(0 if part == "[" else None)
            elif part in "}]":
                self.keys.pop()
                if len(self.keys) == 2 and self._entry is not None:
                    yield self._entry
                    self._entry = None
            elif part == ":":
                self._key()
            elif part == ",":
                index = self.keys[-1]
                self.keys[-1] = index + 1 if isinstance(index, int) else None
            else:
                self._value(part, line)

    def _key(self) -> None:
        self.keys[-1] = self._last
        if len(self.keys) == 1:
            self._kind = self._last
        elif len(self.keys) == 2:
            self._entry = SourceObject(self._kind, self._last, self._last_line)
        elif self._entry is not None:
            self._entry.fields[self._path()] = SourceField(self._last_line, "")

    def _value(self, part: str, line: int) -> None:
        self._last, self._last_line = str(json.loads(part)), line
        if self._entry is not None and len(self.keys) > 2 and self.keys[-1] is not None:
            self._entry.fields[self._path()] = SourceField(line, self._last)

    def _path(self) -> str:
        text = ""
        for key in self.keys[2:]:
            text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
        return text
