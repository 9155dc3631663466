"""Apply a scenario's edits to a building model, checked against EnergyPlus's schema before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zenostat.models import schema
from zenostat.topics.errors import InvalidConfig, did_you_mean

Edits = dict[str, dict[str, dict[str, Any] | None]]
"""Object type, object name, fields.

A field or an object set to None is removed, a name that the model does not have adds an object, and the name `*`
means every object of that type. A list (vertices, schedule data, program lines) is replaced as a whole.
"""

EVERY = "*"
"""Object name that means every object of a type."""


def apply_edits(objects: Mapping[str, Mapping[str, Any]], edits: Edits) -> dict[str, dict[str, Any]]:
    """Return `objects` with `edits` applied; the input is not modified, and unchanged parts are shared with it.

    Object types, object names and allowed words may be written in any case; field names are those of epJSON.

    Raises:
        InvalidConfig: lists all errors of the edits.
    """
    result: dict[str, Any] = dict(objects)
    errors: list[str] = []
    for type_name, by_name in edits.items():
        kind = schema.canonical_type(type_name)
        if kind is None:
            errors.append(schema.unknown_type(type_name))
        elif not isinstance(by_name, Mapping):
            errors.append(f"{kind}: expected objects by name, got {by_name!r}")
        else:
            editor = _TypeEditor(kind, dict(result.get(kind, {})), errors)
            for name, fields in by_name.items():
                editor.apply(name, fields)
            result[kind] = editor.items
            if not editor.items:
                del result[kind]
    if errors:
        raise InvalidConfig("\n".join(dict.fromkeys(errors)))
    return result


class _TypeEditor:
    """The objects of one type while they are edited; errors are added to `errors`."""

    def __init__(self, kind: str, items: dict[str, Any], errors: list[str]) -> None:
        self.kind, self.items, self.errors = kind, items, errors

    def apply(self, name: str, fields: object) -> None:
        """Change, add or remove the objects that `name` refers to."""
        matches = self._matching(name)
        if matches is None:
            return
        if fields is not None and not isinstance(fields, Mapping):
            self._add_error(name, f": expected fields by name, or null to remove it; got {fields!r}")
        elif not matches and (fields is None or name == EVERY):
            noun = "object of this type" if name == EVERY else "such object"
            self._add_error(name, f": the model has no {noun}; {did_you_mean(name, self.items)}")
        elif fields is None:
            for member in matches:
                del self.items[member]
        elif matches:
            self._merge(name, matches, fields)
        else:
            self._add(name, fields)

    def _matching(self, name: str) -> list[str] | None:
        """Return the model's objects that `name` refers to; None, with an error added, if that is ambiguous."""
        if name == EVERY:
            return list(self.items)
        if name in self.items:
            return [name]
        same = [own for own in self.items if own.casefold() == name.casefold()]
        if len(same) > 1:
            self._add_error(name, f" matches several objects: {', '.join(map(repr, same))}")
            return None
        return same

    def _merge(self, name: str, matches: list[str], fields: Mapping[str, Any]) -> None:
        new_fields = schema.canonical_fields(self.kind, {f: value for f, value in fields.items() if value is not None})
        removed = [f for f, value in fields.items() if value is None]
        label = matches[0] if name != EVERY else name
        self.errors.extend(schema.schema_errors({self.kind: {label: new_fields}}, complete=False))
        for field in removed:
            if not schema.has_field(self.kind, field):
                self._add_error(label, f" {schema.unknown_field(self.kind, field)}")
            elif field in schema.required(self.kind):
                self._add_error(label, f": {field!r} is required and cannot be removed")
        for member in matches:
            self.items[member] = {f: v for f, v in self.items[member].items() if f not in removed} | new_fields

    def _add(self, name: str, fields: Mapping[str, Any]) -> None:
        new_fields = schema.canonical_fields(self.kind, {f: value for f, value in fields.items() if value is not None})
        missing = [f for f in schema.required(self.kind) if f not in new_fields]
        if schema.single(self.kind) and self.items:
            (only,) = list(self.items)[:1]
            self._add_error(
                name, f": a model has only one object of this type, here {only!r}; '*' refers to it as well"
            )
        elif missing:
            self.errors.extend(schema.schema_errors({self.kind: {name: new_fields}}, complete=False))
            names = ", ".join(map(repr, missing))
            self._add_error(
                name, f": the model has no such object ({did_you_mean(name, self.items)}); a new one needs {names}"
            )
        else:
            self.errors.extend(schema.schema_errors({self.kind: {name: new_fields}}, complete=True))
        self.items[name] = new_fields

    def _add_error(self, name: str, text: str) -> None:
        self.errors.append(f"{self.kind} {name!r}{text}")
