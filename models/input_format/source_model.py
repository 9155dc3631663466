"""A model file with its lines: each object and each field of an IDF or an epJSON, and the errors of its syntax."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

ObjectsOfType = dict[str, dict[str, Any]]
"""Objects of one type by name, each with its fields."""
ModelObjects = Mapping[str, ObjectsOfType]
"""Objects of a model by type, as in epJSON."""


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
        line: where it begins: of the type in an IDF, of the name in an epJSON.
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


class ShiftHint(NamedTuple):
    """A line of an object that has one value more than it should have, it seems, so that all after it are shifted.

    Attributes:
        line: of the file, from 1.
        field: path of the first field that the value may belong to.
        text: what the line has, and what may be meant.
    """

    line: int
    field: str
    text: str


def _no_hint(kind: str, name: str) -> ShiftHint | None:  # noqa: ARG001
    return None


@dataclass(frozen=True)
class SourceModel:
    """A model file with the lines of its objects.

    Attributes:
        entries: its objects in their order.
        objects: the same as an epJSON; of objects with the same name, the first.
        issues: errors of its syntax.
        hint: returns where the fields of an object seem to be shifted, by its type and name; None if they do not.
    """

    entries: tuple[SourceObject, ...] = ()
    objects: dict[str, ObjectsOfType] = field(default_factory=dict)
    issues: tuple[SyntaxIssue, ...] = ()
    hint: Callable[[str, str], ShiftHint | None] = field(default=_no_hint, compare=False)

    def line(self, kind: str, name: str = "", path: str = "") -> int | None:
        """Return the line of a field, else of its object, else of the first object of the type; None if not found."""
        index = self._index
        entry = index.get((kind.casefold(), name.casefold())) or (None if name else index.get((kind.casefold(), None)))
        if entry is None:
            return None
        while path and path not in entry.fields:
            within = next((value.line for own, value in entry.fields.items() if own.startswith(f"{path}.")), None)
            if within is not None:
                return within
            path = path.rpartition(".")[0] if "." in path else path.partition("[")[0] if "[" in path else ""
        return entry.fields[path].line if path else entry.line

    @cached_property
    def _index(self) -> dict[tuple[str, str | None], SourceObject]:
        index: dict[tuple[str, str | None], SourceObject] = {}
        for entry in self.entries:
            index.setdefault((entry.kind.casefold(), entry.name.casefold()), entry)
            index.setdefault((entry.kind.casefold(), None), entry)
        return index


def repeated_objects(entries: Iterable[SourceObject]) -> list[SyntaxIssue]:
    """Return an error for each object whose type and name an earlier one has."""
    first: dict[tuple[str, str], SourceObject] = {}
    issues = []
    for entry in entries:
        earlier = first.setdefault((entry.kind.casefold(), entry.name.casefold()), entry)
        if earlier is not entry:
            text = f"{entry.kind} {entry.name!r} is in the file twice; first in line {earlier.line}"
            issues.append(SyntaxIssue(entry.line, entry.kind, entry.name, text))
    return issues
