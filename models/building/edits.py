"""A scenario's changes to a building model, checked against EnergyPlus's schema before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from models.building import schema
from topics.errors import InvalidConfig, did_you_mean

Changes = dict[str, dict[str, dict[str, Any] | None]]
"""Object type, object name, fields.

A field that is None is removed, an object that is None is removed, a name that the model does not have adds
an object, and the name `*` means every object of that type. A list (vertices, schedule data, program lines)
is replaced as a whole.
"""

EVERY = "*"


def apply_edits(objects: Mapping[str, Mapping[str, Any]], edits: Changes) -> dict[str, dict[str, Any]]:
    """`objects` with `edits`; the input is not touched, and what did not change is shared with it.

    Object types, object names and allowed words may be written in any case; field names are those of epJSON.

    Raises:
        InvalidConfig: with every fault of the changes.
    """
    result: dict[str, Any] = dict(objects)
    found: list[str] = []
    for said, wanted in edits.items():
        kind = schema.canonical_type(said)
        if kind is None:
            found.append(schema.unknown_type(said))
        elif not isinstance(wanted, Mapping):
            found.append(f"{kind}: expected objects by name, got {wanted!r}")
        else:
            change = _Change(kind, dict(result.get(kind, {})), found)
            for name, fields in wanted.items():
                change.apply(name, fields)
            result[kind] = change.items
            if not change.items:
                del result[kind]
    if found:
        raise InvalidConfig("\n".join(dict.fromkeys(found)))
    return result


class _Change:
    """The objects of one type while they are changed; what is wrong is added to `found`."""

    def __init__(self, kind: str, items: dict[str, Any], found: list[str]) -> None:
        self.kind, self.items, self.found = kind, items, found

    def apply(self, name: str, fields: object) -> None:
        """Changes, adds or removes what `name` means."""
        own = self._names(name)
        if own is None:
            return
        if fields is not None and not isinstance(fields, Mapping):
            self._fault(name, f": expected fields by name, or null to remove it; got {fields!r}")
        elif not own and (fields is None or name == EVERY):
            what = "object of this type" if name == EVERY else "such object"
            self._fault(name, f": the model has no {what}; {did_you_mean(name, self.items)}")
        elif fields is None:
            for each in own:
                del self.items[each]
        elif own:
            self._merge(name, own, fields)
        else:
            self._add(name, fields)

    def _names(self, name: str) -> list[str] | None:
        """The model's objects that `name` means; None (and a fault) if that is not clear."""
        if name == EVERY:
            return list(self.items)
        if name in self.items:
            return [name]
        same = [own for own in self.items if own.casefold() == name.casefold()]
        if len(same) > 1:
            self._fault(name, f" fits several: {', '.join(map(repr, same))}")
            return None
        return same

    def _merge(self, name: str, own: list[str], fields: Mapping[str, Any]) -> None:
        given = schema.canonical_fields(self.kind, {f: value for f, value in fields.items() if value is not None})
        removed = [f for f, value in fields.items() if value is None]
        said = own[0] if name != EVERY else name
        self.found.extend(schema.schema_errors({self.kind: {said: given}}, complete=False))
        for each in removed:
            if not schema.has_field(self.kind, each):
                self._fault(said, f" {schema.unknown_field(self.kind, each)}")
            elif each in schema.required(self.kind):
                self._fault(said, f": {each!r} is required and cannot be removed")
        for each in own:
            self.items[each] = {f: v for f, v in self.items[each].items() if f not in removed} | given

    def _add(self, name: str, fields: Mapping[str, Any]) -> None:
        given = schema.canonical_fields(self.kind, {f: value for f, value in fields.items() if value is not None})
        lacking = [f for f in schema.required(self.kind) if f not in given]
        if schema.single(self.kind) and self.items:
            (only,) = list(self.items)[:1]
            self._fault(name, f": a model has one object of this type, and this one has {only!r}; '*' names it too")
        elif lacking:
            self.found.extend(schema.schema_errors({self.kind: {name: given}}, complete=False))
            lacks = ", ".join(map(repr, lacking))
            self._fault(
                name, f": the model has no such object; {did_you_mean(name, self.items)}; a new one would lack {lacks}"
            )
        else:
            self.found.extend(schema.schema_errors({self.kind: {name: given}}, complete=True))
        self.items[name] = given

    def _fault(self, name: str, text: str) -> None:
        self.found.append(f"{self.kind} {name!r}{text}")
