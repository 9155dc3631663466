"""Rules of one version step, and a model while it is upgraded.

A step is data: what was renamed, moved into a list, removed or given another default, by object type. What cannot be
said in these terms is a function of the model. Whatever two versions have in common needs no rule.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from zenostat.models.input_format.source_model import ObjectsOfType

Renames = tuple[tuple[str, str], ...]
"""Patterns of whole field names, and their replacements."""

_TYPE_FIELD = re.compile(r".*(object_type|component_type|terminal_object_type)(_\d+)?")
"""Fields that name an object's type."""

FUEL_FIELD = r"(.*_)?fuel_type|fuel_use_type|resource(_type)?|existing_fuel_resource_name"
"""Pattern of the fields that name a fuel or another resource."""


@dataclass(frozen=True, slots=True)
class Change:
    """A change of an object by a step, for the report."""

    before: str
    after: str
    kind: str
    name: str
    text: str

    def __str__(self) -> str:
        return f"from {self.before} to {self.after}: {self.kind} {self.name!r}: {self.text}"


@dataclass(frozen=True, slots=True)
class Refusal:
    """An object that no rule covers: its type and name in the user's file, a field if it is about one, the reason."""

    kind: str
    name: str
    field: str
    text: str


class UpgradingModel:
    """A model between two versions; rules change it and note what they changed.

    Attributes:
        objects: object type, object name, fields.
        changes: what was changed.
        refusals: what cannot be upgraded.
        origins: type and name of an object in the user's file, where the upgrade renamed or created it.
    """

    def __init__(self, objects: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
        self.objects: dict[str, ObjectsOfType] = {
            kind: {name: dict(fields) for name, fields in items.items()} for kind, items in objects.items()
        }
        self.changes: list[Change] = []
        self.refusals: list[Refusal] = []
        self.origins: dict[tuple[str, str], tuple[str, str]] = {}
        self.renamed_fields: dict[tuple[str, str, str], str] = {}
        self._step = ("", "")

    def begin(self, before: str, after: str) -> None:
        """Begin the step that the next changes belong to."""
        self._step = (before, after)

    def find(self, kind: str) -> str | None:
        """Return the model's spelling of a type; None if it has no such objects."""
        if kind in self.objects:
            return kind
        return next((own for own in self.objects if own.casefold() == kind.casefold()), None)

    def items(self, kind: str) -> list[tuple[str, dict[str, Any]]]:
        """Return the objects of a type by name; their fields may be changed."""
        own = self.find(kind)
        return list(self.objects[own].items()) if own else []

    def note(self, kind: str, name: str, text: str) -> None:
        """Note a change of an object."""
        self.changes.append(Change(*self._step, kind, name, text))

    def refuse(self, kind: str, name: str, text: str, field_name: str = "") -> None:
        """Note that an object cannot be upgraded."""
        self.refusals.append(Refusal(*self.origin(kind, name), field_name, text))

    def origin(self, kind: str, name: str) -> tuple[str, str]:
        """Return the type and the name that an object has in the user's file."""
        return self.origins.get((kind, name), (kind, name))

    def add(self, kind: str, name: str, fields: dict[str, Any], *, source: tuple[str, str]) -> str:
        """Add an object that follows from another one, and return its name, with a number if it is taken."""
        items = self.objects.setdefault(self.find(kind) or kind, {})
        taken = {own.casefold() for own in items}
        unique, number = name, 1
        while unique.casefold() in taken:
            number += 1
            unique = f"{name} {number}"
        items[unique] = fields
        self.origins[kind, unique] = self.origin(*source)
        self.note(kind, unique, f"added for {source[0]} {source[1]!r}")
        return unique

    def remove(self, kind: str, name: str, text: str) -> None:
        """Remove an object; `text` says why."""
        own = self.find(kind) or kind
        del self.objects[own][name]
        if not self.objects[own]:
            del self.objects[own]
        self.note(kind, name, text)

    def rename_type(self, old: str, new: str) -> None:
        """Rename a type, and the type in fields that name it."""
        own = self.find(old)
        for name, fields in self.objects.pop(own, {}).items() if own else ():
            self.objects.setdefault(new, {})[name] = fields
            self.origins[new, name] = self.origin(old, name)
            self.note(old, name, f"is now a {new}")
        for kind, items in self.objects.items():
            for name, fields in items.items():
                for text in _replace_type(fields, old, new):
                    self.note(kind, name, text)

    def rename_field(self, kind: str, name: str, old: str, new: str) -> None:
        """Rename a field of an object; one without that field is unchanged."""
        fields = self.objects[kind][name]
        if old in fields:
            self.objects[kind][name] = {new if key == old else key: value for key, value in fields.items()}
            self.renamed_fields[kind, name, new] = self.renamed_fields.get((kind, name, old), old)
            self.note(kind, name, f"{old} is now {new}")


def _replace_type(fields: dict[str, Any], old: str, new: str) -> Iterator[str]:
    """Replace a type in the fields that name one, also in `Plant Component TYPE` of an actuator; yield their texts."""
    pattern = re.compile(rf"(Plant Component )?{re.escape(old)}", re.IGNORECASE)
    for key, value in fields.items():
        if isinstance(value, str):
            if _TYPE_FIELD.fullmatch(key) and (match := pattern.fullmatch(value)):
                fields[key] = f"{match[1] or ''}{new}"
                yield f"{key} is now {fields[key]}"
        elif isinstance(value, list):
            for entry in value:
                if isinstance(entry, dict):
                    yield from _replace_type(entry, old, new)


Rule = Callable[[UpgradingModel], None]
"""A change that the tables of a step cannot express."""


@dataclass(frozen=True, slots=True)
class VersionStep:
    """Changes of the input format from one version to the next, by object type.

    Attributes:
        before, after: the two versions.
        source: where the rules are from.
        types: renamed types.
        fields: renamed fields.
        entries: renamed fields of a list's entries: the list, and the renames.
        listed: numbered fields that became the entries of a list: the list's name and the entries' fields.
        named: fields that became the object's name.
        dropped: removed fields that had no effect, or none that is left.
        defaults: defaults that changed, with the old ones, which are written where the field is empty.
        words: choices that were renamed: pattern of the type, pattern of the field, and old to new ones.
        variables: renamed output variables and meters; patterns.
        refused: types that no rule can upgrade, with the reason.
        functions: what these tables cannot express; applied after them.
    """

    before: str
    after: str
    source: str
    types: Mapping[str, str] = field(default_factory=dict)
    fields: Mapping[str, Renames] = field(default_factory=dict)
    entries: Mapping[str, tuple[str, Renames]] = field(default_factory=dict)
    listed: Mapping[str, tuple[str, Renames]] = field(default_factory=dict)
    named: Mapping[str, str] = field(default_factory=dict)
    dropped: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    defaults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    words: tuple[tuple[str, str, Mapping[str, str]], ...] = ()
    variables: Renames = ()
    refused: Mapping[str, str] = field(default_factory=dict)
    functions: tuple[Rule, ...] = ()
