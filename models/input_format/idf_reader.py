"""Read an IDF of any version into epJSON objects, with the line of each field and the errors of its syntax.

The result equals that of EnergyPlus's own converter (`tests/models/test_idf_reader.py` compares all bundled models),
which reads only IDF files of its own version and keeps no lines.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple

from zenostat.models.input_format.layout import Layout, Rules, TypeLayout
from zenostat.models.input_format.shifted_fields import shift_hint
from zenostat.models.input_format.source_model import (
    ObjectsOfType,
    ShiftHint,
    SourceField,
    SourceModel,
    SourceObject,
    SyntaxIssue,
    repeated_objects,
)
from zenostat.topics.errors import InvalidConfig, did_you_mean, list_errors

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
"""A number as EnergyPlus writes it; the exponent may be a `d`, as in Fortran."""

_COMMENT = re.compile(r"!.*")
_VERSION = re.compile(r"(?:^|;)\s*version\s*,([^,;]*)[,;]", re.IGNORECASE)
_SEPARATOR = re.compile(r"([,;])")
_MERGE_CONFLICT = re.compile(r"^<{7} .*", re.MULTILINE)
_CONFLICT_MARK = re.compile(r"^(<{7} .*|={7}|>{7} .*)$", re.MULTILINE)
_INTEGER = re.compile(r"[+-]?\d+", re.ASCII)
_TYPE_FIELD = re.compile("type|class|key|name|field|line")  # fields that may hold the name of an object type
_SIZES = frozenset(("autosize", "autocalculate"))
_LARGEST_INTEGER = 2**31 - 1
_BLANKS = " \t\r"  # no others, as in EnergyPlus: a no-break space or a form feed belongs to a name


class _Value(NamedTuple):
    line: int
    text: str
    is_split: bool  # a line ends within it: a comma is missing


def idf_version(text: str) -> str | None:
    """Return the version identifier of an IDF; None if it has none."""
    match = _VERSION.search(_COMMENT.sub("", text))
    return match[1].strip() if match else None


def version_line(text: str) -> int:
    """Return the line, from 1, of an IDF's version identifier; 0 if it has none."""
    code = _COMMENT.sub("", text)
    match = _VERSION.search(code)
    return code[: match.end(1) - len(match[1].lstrip())].count("\n") + 1 if match else 0


def parse_idf(text: str, layout: Layout) -> SourceModel:
    """Read an IDF of the layout's version; the result has the errors of its syntax."""
    conflict = _MERGE_CONFLICT.search(text)
    text = _CONFLICT_MARK.sub("", text) if conflict else text
    reader = _Reader(layout, text.split("\n"))
    for values, is_ended in _objects(text):
        reader.add(values, is_ended=is_ended)
    issues = sorted([*reader.issues, *repeated_objects(reader.known)])
    if conflict:  # what the two versions have in common is in the file twice
        line = conflict.string.count("\n", 0, conflict.start()) + 1
        what = f"{conflict[0]!r} begins two versions of the lines after it, which git could not merge; keep one of them"
        issues = [SyntaxIssue(line, "", "", what)]
    return SourceModel(tuple(reader.entries), reader.objects, tuple(issues), reader.hint)


def read_idf(text: str, layout: Layout, *, name: str) -> SourceModel:
    """Read an IDF of the layout's version without errors of syntax.

    Args:
        text: the file's content.
        layout: of the version.
        name: of the file, for error messages.

    Raises:
        InvalidConfig: a type is unknown, an object has too many fields, does not end or is in the file twice; the text
            lists these with their lines.
    """
    model = parse_idf(text, layout)
    if model.issues:
        errors = [_described(issue, model.hint(issue.kind, issue.name)) for issue in model.issues]
        raise InvalidConfig(list_errors(f"{name} is not an IDF for EnergyPlus {layout.version}:", errors))
    return model


def _described(issue: SyntaxIssue, hint: ShiftHint | None) -> str:
    text = f"line {issue.line}: {issue.text}"
    return f"{text} Line {hint.line}: {hint.field} {hint.text}" if hint else text


def _objects(text: str) -> Iterator[tuple[list[_Value], bool]]:
    """Yield the values of each object, its type first, and whether it ends with a semicolon."""
    values: list[_Value] = []
    value, begin, is_split = "", 0, False
    for number, line in enumerate(text.split("\n"), 1):
        for part in _SEPARATOR.split(line.partition("!")[0]):
            if part not in (",", ";"):
                if part := part.strip(_BLANKS):
                    is_split = is_split or bool(value)
                    begin = begin if value else number
                    value = f"{value} {part}" if value else part
                continue
            values.append(_Value(begin if value else number, value, is_split))
            value, is_split = "", False
            if part == ";":
                if values[0].text:
                    yield values, True
                values = []
    if values or value:
        yield [*values, _Value(begin, value, is_split)] if value else values, False


class _Reader:
    """The objects of an IDF while they are read; `known` are those whose type the version has."""

    def __init__(self, layout: Layout, lines: Sequence[str]) -> None:
        self.entries: list[SourceObject] = []
        self.known: list[SourceObject] = []
        self.objects: dict[str, ObjectsOfType] = {}
        self.issues: list[SyntaxIssue] = []
        self._sources: dict[tuple[str, str], tuple[TypeLayout, list[_Value]]] = {}
        self._layout = layout
        self._lines = lines
        self._counts: Counter[str] = Counter()
        self._last: tuple[SourceObject, TypeLayout, list[_Value]] | None = None

    def add(self, values: list[_Value], *, is_ended: bool) -> None:
        """Add an object; the first value is its type."""
        (line, word, _), *rest = values
        layout = self._layout.find(word)
        if layout is None:
            if self._continues(word, line):
                return
            self._last = None
            shown = word if len(word) <= 60 else word[:57] + "..."
            text = f"EnergyPlus has no object type {shown!r}; {did_you_mean(shown, self._layout.kinds)}"
            self.entries.append(SourceObject(word, rest[0].text if rest else "", line))
            self.issues.append(SyntaxIssue(line, word, "", text))
            return
        self._counts[layout.kind] += 1
        own_name = rest[0].text if rest else ""
        is_named = layout.named and bool(own_name or not layout.numbered)
        name = own_name if is_named else f"{layout.kind} {self._counts[layout.kind]}"
        entry = SourceObject(layout.kind, name, line)
        text, at = self._error(entry, layout, rest, is_ended=is_ended)
        self._sources[entry.kind, entry.name] = layout, rest
        if text:
            self.issues.append(SyntaxIssue(at, entry.kind, entry.name, text))
        self._last = (entry, layout, rest) if is_ended and not text else None
        fields = _fields(entry, layout, rest)
        self.entries.append(entry)
        self.known.append(entry)
        self.objects.setdefault(layout.kind, {}).setdefault(name, fields)

    def hint(self, kind: str, name: str) -> ShiftHint | None:
        """Return where the fields of an object seem to be shifted; asked only for objects with errors."""
        layout, values = self._sources.get((kind, name), (None, []))
        if layout is None or any(value.is_split for value in values):
            return None
        return shift_hint(layout, [(value.line, value.text) for value in values], self._lines)

    def _continues(self, word: str, line: int) -> bool:
        """Whether a word that is no type goes on with the last object; if so, report the semicolon that ended it."""
        if self._last is None:
            return word == ""
        entry, layout, values = self._last
        is_complete = len(values) >= len(layout.order) and not layout.list_name
        kinds = [kind.casefold() for kind in self._layout.kinds]
        if is_complete or ":" in word or get_close_matches(word.casefold(), kinds, 1, 0.75):
            return False
        last = values[-1] if values else _Value(entry.line, "", is_split=False)
        path = layout.path(len(values) - 1) if values else "its type"
        text = (
            f"{entry.kind} {entry.name!r} ends with ';' after {path}, but line {line} goes on with {word!r}; "
            f"put ',' there if it is a field of the object, which is {layout.path(len(values))}"
        )
        self.issues.append(SyntaxIssue(last.line, entry.kind, entry.name, text))
        self._last = None
        return True

    def _error(
        self, entry: SourceObject, layout: TypeLayout, values: list[_Value], *, is_ended: bool
    ) -> tuple[str, int]:
        """Return what is wrong with the syntax of an object, and its line; empty if nothing is."""
        label = f"{entry.kind} {entry.name!r}"
        surplus = values[len(layout.order)] if len(values) > len(layout.order) and not layout.list_name else None
        split = next((value for value in values if value.is_split), None)
        if split is not None:
            problem = f"',' or ';' is missing within {split.text!r}, which begins here and ends in a later line"
            return f"{label}: {problem}", split.line
        swallowed = self._swallowed(layout, values)
        if swallowed is not None:
            return f"{label} does not end: ';' is missing before {swallowed.text!r}", swallowed.line
        if not is_ended:
            line = values[-1].line if values else entry.line
            return f"{label} does not end: ';' is missing after its last field", line
        if surplus is not None:
            has = f"{label} has {len(values)} fields, but the type has {len(layout.order)}"
            return f"{has}; is there a ',' too many, or a ';' missing at the end?", surplus.line
        return "", 0

    def _swallowed(self, layout: TypeLayout, values: list[_Value]) -> _Value | None:
        """Return the first value that is the type of another object, where the semicolon before it is missing."""
        for index, value in enumerate(values[1:], 1):
            if self._layout.find(value.text) is not None:
                member = layout.path(index).rpartition(".")[2]
                may_be_text = _TYPE_FIELD.search(member) or ":" not in value.text
                if not member or member in layout.numeric or not may_be_text:
                    return value
        return None


def _fields(entry: SourceObject, layout: TypeLayout, values: list[_Value]) -> dict[str, Any]:
    """Return the fields of an object as in an epJSON, and add them to `entry` with their lines."""
    fields: dict[str, Any] = {}
    entries: list[dict[str, Any]] = []
    size = len(layout.entry_order)
    for index, (line, text, _) in enumerate(values):
        path = layout.path(index)
        if not path:
            break
        entry.fields[path] = SourceField(line, text)
        target, member, rules = fields, path, layout.rules
        if index >= len(layout.order):
            position, offset = divmod(index - len(layout.order), size)
            if position == len(entries):
                entries.append({})
            target, member, rules = entries[position], layout.entry_order[offset], layout.entry_rules
        if text and not (layout.named and path == "name"):
            target[member] = _value(text, rules.get(member, {}), numeric=member in layout.numeric)
    if entries:
        fields[layout.list_name] = entries
    return fields


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
    if NUMBER.fullmatch(text):
        return float(text.replace("d", "e").replace("D", "e"))
    return None
