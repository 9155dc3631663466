"""EnergyPlus's own input schema: what each object type may hold, and what is wrong with given objects.

The engine's library carries the schema (JSON schema draft 7, as CBOR, RFC 8949) against which EnergyPlus
checks an epJSON. It is read from there, so what passes here passes there. The classes of
`pyenergyplus.model` are no substitute: they take seconds to import and have lost the limits of all fields
that may also be `Autosize`.

EnergyPlus refuses words in another case, numbers written as texts, `25.0` for a whole number and null. It
passes over unknown fields, which is how a misspelled one stays unseen; here that is a fault as well.
"""

from __future__ import annotations

import json
import mmap
import operator
import struct
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any

from models import energyplus
from models.cache import cached_bytes
from models.catalog import wheel
from topics.errors import InvalidConfig, did_you_mean

FORMAT = "1"
"""Version of the stored file."""

Fields = Mapping[str, Any]
Model = Mapping[str, Mapping[str, Fields]]
"""Object type, object name, fields: an epJSON or a part of one."""

_METADATA = frozenset(("idf_order", "idf_max_fields", "idf_max_extensible_fields"))
"""Keys that converters of IDF leave among the fields."""

_LIMITS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "minimum": ("at least", operator.ge),
    "exclusiveMinimum": ("above", operator.gt),
    "maximum": ("at most", operator.le),
    "exclusiveMaximum": ("below", operator.lt),
}
_NOUNS = {"number": "a number", "integer": "a whole number", "string": "a text", "array": "a list"}
_SHOWN_WORDS = 12


def types() -> tuple[str, ...]:
    """All object types, as EnergyPlus spells them."""
    return tuple(_schema()["types"])


def canonical_type(kind: str) -> str | None:
    """The object type `kind`, given in any case, as EnergyPlus spells it; None if there is no such type."""
    return _folded().get(kind.casefold())


def required(kind: str) -> tuple[str, ...]:
    """The fields that every object of type `kind` must have."""
    return tuple(_schema()["types"][kind]["required"])


def single(kind: str) -> bool:
    """Whether a model has at most one object of type `kind`."""
    return bool(_schema()["types"][kind].get("single"))


def has_field(kind: str, name: str) -> bool:
    """Whether objects of type `kind` have a field `name`."""
    return name in _schema()["types"][kind]["fields"]


def unknown_field(kind: str, name: str) -> str:
    """What to say of a field that objects of type `kind` do not have, after the object's name."""
    return f"has no field {name!r}; {did_you_mean(name, _schema()['types'][kind]['fields'])}"


def canonical_fields(kind: str, fields: Fields) -> dict[str, Any]:
    """`fields` with allowed words in EnergyPlus's own case and whole floats as integers where it wants those.

    What is wrong in another way, or unknown, stays as it is.
    """
    shape = _schema()["types"].get(kind)
    return _respell_fields(shape["fields"], fields) if shape else dict(fields)


def schema_errors(objects: Model, *, complete: bool) -> list[str]:
    """Each fault of `objects` against the schema, one line each.

    Args:
        objects: object type to object name to fields; any part of a model.
        complete: whether missing required fields are faults.
    """
    found: list[str] = []
    for kind, items in objects.items():
        shape = _schema()["types"].get(kind)
        if shape is None:
            found.append(unknown_type(kind))
        elif not isinstance(items, Mapping):
            found.append(f"{kind}: expected objects by name, got {_short(items)}")
        else:
            found.extend(_type_faults(kind, shape, items, complete=complete))
    return found


def unknown_type(kind: str) -> str:
    """What to say of an object type that EnergyPlus does not have."""
    right = canonical_type(kind)
    said = f"EnergyPlus spells it {right!r}" if right else did_you_mean(kind, types())
    return f"EnergyPlus has no object type {kind!r}; {said}"


def _type_faults(kind: str, shape: dict[str, Any], items: Model | Any, *, complete: bool) -> Iterator[str]:
    if shape.get("single") and len(items) > 1:
        yield f"{kind}: a model has one of it, got {len(items)}: {', '.join(map(repr, items))}"
    for name, fields in items.items():
        where = f"{kind} {name!r}"
        if shape.get("named") and not name.strip():
            yield f"{kind}: an object without a name"
        if not isinstance(fields, Mapping):
            yield f"{where}: expected fields by name, got {_short(fields)}"
            continue
        yield from _fields_faults(where, "", shape, fields, complete=complete)


def _fields_faults(where: str, path: str, shape: dict[str, Any], fields: Fields, *, complete: bool) -> Iterator[str]:
    rules = shape["fields"]
    for name, value in fields.items():
        rule = rules.get(name)
        if rule is not None:
            yield from _value_faults(where, path + name, _schema()["rules"][rule], value, complete=complete)
        elif name not in _METADATA:
            yield f"{where} has no field {path + name!r}; {did_you_mean(name, rules)}"
    missing = [name for name in shape["required"] if name not in fields] if complete else []
    if missing:
        inside = f" in {path.removesuffix('.')}" if path else ""
        yield f"{where} lacks {', '.join(map(repr, missing))}{inside}"


def _value_faults(where: str, path: str, rule: list[dict[str, Any]], value: object, *, complete: bool) -> Iterator[str]:
    if any(_fits(choice, value) for choice in rule):
        items = next((choice["items"] for choice in rule if "items" in choice), None)
        if items is not None and isinstance(value, list):
            for index, entry in enumerate(value):
                if isinstance(entry, Mapping):
                    yield from _fields_faults(where, f"{path}[{index}].", items, entry, complete=complete)
                else:
                    yield f"{where}: {path}[{index}] is {_short(entry)}; expected fields by name"
        return
    if value is None:
        yield f"{where}: {path} is null; expected {_expected(rule)}, or no such field"
        return
    right = _respell(rule, value)
    if right is not value:
        yield f"{where}: {path} is {_short(value)}; EnergyPlus wants it written {right!r}"
    else:
        yield f"{where}: {path} is {_short(value)}; expected {_expected(rule)}"


def _fits(choice: dict[str, Any], value: object) -> bool:
    """Whether `value` is of one of a field's possible kinds and within its limits; list entries are not looked at."""
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
    """A field's possible kinds as the end of an error text: `a number above 0, or 'Autosize'`."""
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
    every = _schema()["rules"]
    return {n: _respell(every[rules[n]], value) if n in rules else value for n, value in fields.items()}


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


@cache
def _schema() -> dict[str, Any]:
    """`types`: type to {fields: name to rule number, required, named, single}; `rules`: lists of choices."""
    found: dict[str, Any] = json.loads(cached_bytes(f"schema/{energyplus.version()}-{FORMAT}.json", _make))
    return found


@cache
def _folded() -> dict[str, str]:
    return {kind.casefold(): kind for kind in _schema()["types"]}


def _make(target: Path) -> None:
    library = wheel().parent / f"libenergyplusapi.so.{energyplus.version()}"
    if not library.exists():
        library = next(iter(sorted(wheel().parent.glob("libenergyplusapi.*"))), library)
    rules: dict[str, int] = {}
    kinds = {kind: _compact(entry, rules) for kind, entry in sorted(_embedded(library)["properties"].items())}
    target.write_text(json.dumps({"types": kinds, "rules": [json.loads(rule) for rule in rules]}))


def _compact(entry: dict[str, Any], rules: dict[str, int]) -> dict[str, Any]:
    """One object type of the schema; each distinct rule is kept once, in `rules`."""
    ((pattern, shape),) = entry["patternProperties"].items()
    found = _compact_fields(shape, rules)
    if pattern != ".*":
        found["named"] = True
    if entry.get("maxProperties") == 1:
        found["single"] = True
    return found


def _compact_fields(shape: dict[str, Any], rules: dict[str, int]) -> dict[str, Any]:
    fields = {}
    for name, said in shape["properties"].items():
        rule = json.dumps([_choice(choice, rules) for choice in said.get("anyOf", [said])])
        fields[name] = rules.setdefault(rule, len(rules))
    return {"fields": fields, "required": shape.get("required", [])}


def _choice(said: dict[str, Any], rules: dict[str, int]) -> dict[str, Any]:
    choice: dict[str, Any] = {"type": said["type"]}
    if "enum" in said:
        choice["words"] = said["enum"]
    limits = {name: said[name] for name in _LIMITS if name in said}
    limits |= {"minimum": said["minItems"]} if "minItems" in said else {}
    limits |= {"maximum": said["maxItems"]} if "maxItems" in said else {}
    if limits:
        choice["limits"] = limits
    if "items" in said:
        choice["items"] = _compact_fields(said["items"], rules)
    return choice


def _embedded(library: Path) -> dict[str, Any]:
    """The schema inside EnergyPlus's library: a CBOR map whose first key is `$schema`."""
    first_key = b"\x67$schema"
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
        place = raw.find(first_key)
        found = _cbor(raw, place - 1)[0] if place > 0 else None
    if not isinstance(found, dict) or "properties" not in found:
        raise InvalidConfig(f"{library} holds no input schema; EnergyPlus 23.2 to 25.2 do")
    return found


def _cbor(raw: mmap.mmap, at: int) -> tuple[Any, int]:
    """The item at `at` and the place behind it (RFC 8949, section 3; no tags, byte strings or open lengths)."""
    major, low = raw[at] >> 5, raw[at] & 31
    width = {24: 1, 25: 2, 26: 4, 27: 8}.get(low, 0)
    head = raw[at + 1 : at + 1 + width]
    at += 1 + width
    count = int.from_bytes(head, "big") if width else low
    if major in (0, 1):
        return (count if major == 0 else -1 - count), at
    if major == 3:
        return raw[at : at + count].decode(), at + count
    if major == 4:
        entries = []
        for _ in range(count):
            entry, at = _cbor(raw, at)
            entries.append(entry)
        return entries, at
    if major == 5:
        pairs = {}
        for _ in range(count):
            key, at = _cbor(raw, at)
            pairs[key], at = _cbor(raw, at)
        return pairs, at
    if major == 7 and low in (20, 21, 22):
        return {20: False, 21: True, 22: None}[low], at
    if major == 7 and width in (2, 4, 8):
        return struct.unpack({2: ">e", 4: ">f", 8: ">d"}[width], head)[0], at
    raise InvalidConfig(f"EnergyPlus's input schema has a CBOR item of kind {major}/{low}, which is not known here")
