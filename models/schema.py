"""EnergyPlus's own input schema: the fields of each object type, and the check of objects against them.

The engine's library contains the schema (JSON Schema draft 7, encoded as CBOR, RFC 8949) against which EnergyPlus
checks an epJSON. It is read from the library, so objects that pass here pass in EnergyPlus. The classes of
`pyenergyplus.model` are no substitute: they take seconds to import and lack the limits of all fields that may also
be `Autosize`. A general JSON Schema validator is not used either: its messages neither suggest similar names nor
describe a field's alternatives in words.

EnergyPlus rejects words in another case, numbers written as strings, `25.0` for an integer, and null. It ignores
unknown fields, so a misspelled one goes unnoticed; here an unknown field is an error, too.
"""

from __future__ import annotations

import json
import mmap
import operator
from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from cbor2 import CBORDecodeError, CBORDecoder

from zenostat.models import energyplus
from zenostat.topics.cache import cached_bytes
from zenostat.topics.errors import InvalidConfig, did_you_mean

FORMAT = "1"
"""Version of the stored file."""

Fields = Mapping[str, Any]
Model = Mapping[str, Mapping[str, Fields]]
"""Object type, object name, fields: an epJSON or a part of one."""


class SchemaError(NamedTuple):
    """An error of an object against the schema.

    Attributes:
        kind: object type.
        name: of the object; empty if the error is about the type.
        field: path of the field, such as `vertices[2].vertex_x_coordinate`; empty if the error is about the object.
        text: the whole error, with type, name and field.
    """

    kind: str
    name: str
    field: str
    text: str


_METADATA = frozenset(("idf_order", "idf_max_fields", "idf_max_extensible_fields"))
"""Keys that IDF converters leave among the fields."""

_LIMITS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "minimum": ("at least", operator.ge),
    "exclusiveMinimum": ("above", operator.gt),
    "maximum": ("at most", operator.le),
    "exclusiveMaximum": ("below", operator.lt),
}
_NOUNS = {"number": "a number", "integer": "an integer", "string": "a string", "array": "a list"}
_SHOWN_WORDS = 12


def types() -> tuple[str, ...]:
    """Return all object types, as EnergyPlus spells them."""
    return tuple(_schema()["types"])


def canonical_type(kind: str) -> str | None:
    """Return the object type `kind`, in any case, as EnergyPlus spells it; None if there is no such type."""
    return _folded().get(kind.casefold())


def required(kind: str) -> tuple[str, ...]:
    """Return the fields that every object of type `kind` must have."""
    return tuple(_schema()["types"][kind]["required"])


def is_required(kind: str, path: str) -> bool:
    """Whether a field must have a value; `path`: `schedule_name`, or `zones[3].zone_name` in the entry of a list."""
    shape = _schema()["types"][kind]
    first, _, member = path.partition("[")
    if not member:
        return first in shape["required"]
    choices = _schema()["rules"][shape["fields"][first]]
    items: dict[str, Any] = next((c["items"] for c in choices if "items" in c), {"required": []})
    return member.rpartition(".")[2] in items["required"]


def single(kind: str) -> bool:
    """Whether a model may have at most one object of type `kind`."""
    return bool(_schema()["types"][kind].get("single"))


def has_field(kind: str, name: str) -> bool:
    """Whether objects of type `kind` have a field `name`."""
    return name in _schema()["types"][kind]["fields"]


def unknown_field(kind: str, name: str) -> str:
    """Return the error text for a field that objects of type `kind` do not have, to follow the object's name."""
    return f"has no field {name!r}; {did_you_mean(name, _schema()['types'][kind]['fields'])}"


def canonical_fields(kind: str, fields: Fields) -> dict[str, Any]:
    """Return `fields` with words in EnergyPlus's own case, and whole floats as integers where it requires those.

    Unknown fields and values with other errors are unchanged.
    """
    shape = _schema()["types"].get(kind)
    return _respell_fields(shape["fields"], fields) if shape else dict(fields)


def schema_errors(objects: Model, *, complete: bool) -> list[str]:
    """Return the errors of `objects` against the schema, one line each; see `find_errors`."""
    return [error.text for error in find_errors(objects, complete=complete)]


def find_errors(objects: Model, *, complete: bool) -> list[SchemaError]:
    """Return the errors of `objects` against the schema.

    Args:
        objects: object type to object name to fields; any part of a model.
        complete: whether missing required fields are errors.
    """
    errors: list[SchemaError] = []
    for kind, items in objects.items():
        shape = _schema()["types"].get(kind)
        if shape is None:
            errors.append(SchemaError(kind, "", "", unknown_type(kind)))
        elif not isinstance(items, Mapping):
            errors.append(SchemaError(kind, "", "", f"{kind}: expected objects by name, got {_short(items)}"))
        else:
            errors.extend(_type_errors(kind, shape, items, complete=complete))
    return errors


def matching_part(objects: Model) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the objects without what the schema does not allow: values of fields, and what is no object."""
    errors = find_errors(objects, complete=False)
    wrong = {(each.kind, each.name, each.field.partition(".")[0].partition("[")[0]) for each in errors}
    return {
        kind: {
            name: {field: value for field, value in fields.items() if (kind, name, field) not in wrong}
            for name, fields in items.items()
            if isinstance(fields, Mapping)
        }
        for kind, items in objects.items()
        if isinstance(items, Mapping)
    }


def unknown_type(kind: str) -> str:
    """Return the error text for an object type that EnergyPlus does not have."""
    spelling = canonical_type(kind)
    hint = f"EnergyPlus spells it {spelling!r}" if spelling else did_you_mean(kind, types())
    return f"EnergyPlus has no object type {kind!r}; {hint}"


def _type_errors(kind: str, shape: dict[str, Any], items: Model | Any, *, complete: bool) -> Iterator[SchemaError]:
    if shape.get("single") and len(items) > 1:
        names = ", ".join(map(repr, items))
        yield SchemaError(kind, list(items)[1], "", f"{kind}: a model has only one, got {len(items)}: {names}")
    for name, fields in items.items():
        label = f"{kind} {name!r}"
        if shape.get("named") and not name.strip():
            yield SchemaError(kind, name, "", f"{kind}: an object without a name")
        if not isinstance(fields, Mapping):
            yield SchemaError(kind, name, "", f"{label}: expected fields by name, got {_short(fields)}")
            continue
        for path, text in _fields_errors("", shape, fields, complete=complete):
            yield SchemaError(kind, name, path, f"{label}{text}")


def _fields_errors(path: str, shape: dict[str, Any], fields: Fields, *, complete: bool) -> Iterator[tuple[str, str]]:
    """Yield the path of a field and what is wrong with it, to follow the object's type and name."""
    rules = shape["fields"]
    for name, value in fields.items():
        rule = rules.get(name)
        if rule is not None:
            yield from _value_errors(path + name, _schema()["rules"][rule], value, complete=complete)
        elif name not in _METADATA:
            yield path + name, f" has no field {path + name!r}; {did_you_mean(name, rules)}"
    missing = [name for name in shape["required"] if name not in fields] if complete else []
    if missing:
        inside = f" in {path.removesuffix('.')}" if path else ""
        yield path.removesuffix("."), f" lacks {', '.join(map(repr, missing))}{inside}"


def _value_errors(path: str, rule: list[dict[str, Any]], value: object, *, complete: bool) -> Iterator[tuple[str, str]]:
    if any(_fits(choice, value) for choice in rule):
        items = next((choice["items"] for choice in rule if "items" in choice), None)
        if items is not None and isinstance(value, list):
            for index, entry in enumerate(value):
                if isinstance(entry, Mapping):
                    yield from _fields_errors(f"{path}[{index}].", items, entry, complete=complete)
                else:
                    yield f"{path}[{index}]", f": {path}[{index}] is {_short(entry)}; expected fields by name"
        return
    if value is None:
        yield path, f": {path} is null; expected {_expected(rule)}, or no such field"
        return
    canonical = _respell(rule, value)
    if canonical is not value:
        yield path, f": {path} is {_short(value)}; EnergyPlus requires {canonical!r}"
    else:
        yield path, f": {path} is {_short(value)}; expected {_expected(rule)}{_similar(rule, value)}"


def _similar(rule: list[dict[str, Any]], value: object) -> str:
    """Suggest a word for the end of an error text, where a similar one is allowed."""
    words = [word for choice in rule for word in choice.get("words", ()) if isinstance(word, str) and word]
    folded = {word.casefold(): word for word in words}
    close = get_close_matches(value.casefold(), folded, 1) if isinstance(value, str) else []
    return f"; did you mean {folded[close[0]]!r}?" if close else ""


def _fits(choice: dict[str, Any], value: object) -> bool:
    """Whether `value` has the type of `choice` and is within its limits; list entries are not checked."""
    kind = choice["type"]
    if kind in ("number", "integer"):
        if isinstance(value, bool) or not isinstance(value, int if kind == "integer" else (int, float)):
            return False
        if not isfinite(value):
            return False
    elif not isinstance(value, str if kind == "string" else list):
        return False
    if "words" in choice:
        return value in choice["words"]
    size = len(value) if isinstance(value, (list, str)) else value
    return all(_LIMITS[name][1](size, limit) for name, limit in choice.get("limits", {}).items())


def _expected(rule: list[dict[str, Any]]) -> str:
    """Describe a field's alternatives for the end of an error text: `a number above 0, or 'Autosize'`."""
    parts = []
    for choice in rule:
        words = [word for word in choice.get("words", ()) if word != ""]
        if words:
            shown = ", ".join(map(repr, words[:_SHOWN_WORDS]))
            more = f" and {len(words) - _SHOWN_WORDS} more" if len(words) > _SHOWN_WORDS else ""
            parts.append(f"one of {shown}{more}" if len(words) > 1 else shown)
        elif "words" not in choice:
            limits = " and ".join(f"{_LIMITS[n][0]} {v:.10g}" for n, v in choice.get("limits", {}).items())
            unit = " entries" if choice["type"] == "array" else ""
            parts.append(f"{_NOUNS[choice['type']]} {'of ' if unit else ''}{limits}{unit}" if limits
                         else _NOUNS[choice["type"]])  # fmt: skip
    return ", or ".join(parts)


def _respell_fields(rules: dict[str, int], fields: Fields) -> dict[str, Any]:
    all_rules = _schema()["rules"]
    return {n: _respell(all_rules[rules[n]], value) if n in rules else value for n, value in fields.items()}


def _respell(rule: list[dict[str, Any]], value: Any) -> Any:
    if any(_fits(choice, value) for choice in rule):
        items = next((choice["items"] for choice in rule if "items" in choice), None)
        if items is None or not isinstance(value, list):
            return value
        return [_respell_fields(items["fields"], e) if isinstance(e, Mapping) else e for e in value]
    for choice in rule:
        if choice["type"] == "integer" and isinstance(value, float) and value.is_integer():
            return int(value) if _fits(choice, int(value)) else value
        if isinstance(value, str):
            for word in choice.get("words", ()):
                if isinstance(word, str) and word.casefold() == value.casefold():
                    return word
    return value


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def document() -> dict[str, Any]:
    """Return the whole schema of the installed engine, as in its library; it has 28 MB as Python objects.

    Raises:
        InvalidConfig: the library has no schema.
    """
    return dict(json.loads(cached_bytes(f"schema/{energyplus.version()}-whole.json", _make_document)))


@cache
def _schema() -> dict[str, Any]:
    """`types`: type to {fields: name to rule number, required, named, single}; `rules`: lists of choices."""
    content = cached_bytes(f"schema/{energyplus.version()}-{FORMAT}.json", _make)
    return dict(json.loads(content))


@cache
def _folded() -> dict[str, str]:
    return {kind.casefold(): kind for kind in _schema()["types"]}


def _make_document(target: Path) -> None:
    target.write_text(json.dumps(_embedded()))


def _make(target: Path) -> None:
    rules: dict[str, int] = {}
    kinds = {kind: _compact(entry, rules) for kind, entry in sorted(_embedded()["properties"].items())}
    target.write_text(json.dumps({"types": kinds, "rules": [json.loads(rule) for rule in rules]}))


def _compact(entry: dict[str, Any], rules: dict[str, int]) -> dict[str, Any]:
    """Return one object type of the schema; each distinct rule is stored once, in `rules`."""
    ((pattern, shape),) = entry["patternProperties"].items()
    compact = _compact_fields(shape, rules)
    if pattern != ".*":
        compact["named"] = True
    if entry.get("maxProperties") == 1:
        compact["single"] = True
    return compact


def _compact_fields(shape: dict[str, Any], rules: dict[str, int]) -> dict[str, Any]:
    fields = {}
    for name, spec in shape["properties"].items():
        rule = json.dumps([_choice(choice, rules) for choice in spec.get("anyOf", [spec])])
        fields[name] = rules.setdefault(rule, len(rules))
    return {"fields": fields, "required": shape.get("required", [])}


def _choice(spec: dict[str, Any], rules: dict[str, int]) -> dict[str, Any]:
    choice: dict[str, Any] = {"type": spec["type"]}
    if "enum" in spec:
        choice["words"] = spec["enum"]
    limits = {name: spec[name] for name in _LIMITS if name in spec}
    limits |= {"minimum": spec["minItems"]} if "minItems" in spec else {}
    limits |= {"maximum": spec["maxItems"]} if "maxItems" in spec else {}
    if limits:
        choice["limits"] = limits
    if "items" in spec:
        choice["items"] = _compact_fields(spec["items"], rules)
    return choice


def _embedded() -> dict[str, Any]:
    """Return the schema inside EnergyPlus's library: a CBOR map whose first key is `$schema`."""
    library = energyplus.library()
    first_key = b"\x67$schema"
    schema = None
    with library.open("rb") as file:
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
            key_at = raw.find(first_key)
        if key_at > 0:
            file.seek(key_at - 1)
            try:
                schema = CBORDecoder(file).decode()
            except CBORDecodeError as error:
                raise InvalidConfig(f"cannot read the input schema in {library}: {error}") from None
    if not isinstance(schema, dict) or "properties" not in schema:
        raise InvalidConfig(f"{library} contains no input schema; EnergyPlus 23.2 to 25.2 do")
    return schema
