"""Find the line of a model file that a message of EnergyPlus is about."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from zenostat.topics.errors import did_you_mean

_WHOLE_WORD = r"(?<![\w:.-]){}(?![\w:.-])"
_NOT_FOUND = re.compile(r"(\w+) ?= ?([^=]+?), item not found")
_JSON_TEXT = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:\n]')


@dataclass(frozen=True, slots=True)
class SourceObject:
    """An object of a model file.

    Attributes:
        kind: its type.
        values: its fields with their lines; the first one is its name.
    """

    kind: str
    values: tuple[tuple[int, str], ...]

    @property
    def name(self) -> str:
        """Its name; in an IDF, the first field of an object without a name."""
        return self.values[0][1]


def locate(message: str, objects: Sequence[SourceObject]) -> str | None:
    """Return the line and the object that a message names by type and name; None if it names none of them.

    The line is that of a field whose value the message contains, else that of the object's name.
    """
    text = message.casefold()
    named = [each for each in objects if _contains(text, each.name) and _contains(text, each.kind)]
    if not named:
        return None
    subject = max(named, key=lambda each: (len(each.name), len(each.kind)))
    rest = text.replace(subject.name.casefold(), "")
    fields = [
        (len(value), line) for line, value in subject.values[1:] if not _is_number(value) and _contains(rest, value)
    ]
    line = max(fields)[1] if fields else subject.values[0][0]
    return f"line {line}: {subject.kind} {subject.name!r}{_suggestion(message, objects)}"


def _suggestion(message: str, objects: Sequence[SourceObject]) -> str:
    """Suggest objects of similar names where EnergyPlus did not find one that a field refers to."""
    missing = _NOT_FOUND.search(message)
    if missing is None:
        return ""
    field, name = missing.groups()
    kinds = "schedule:" if "schedule" in field.casefold() else ""
    return f"; {did_you_mean(name, (each.name for each in objects if each.kind.casefold().startswith(kinds)))}"


def _contains(text: str, words: str) -> bool:
    folded = words.casefold()
    return bool(folded) and folded in text and bool(re.search(_WHOLE_WORD.format(re.escape(folded)), text))


def _is_number(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def read_objects(path: Path) -> list[SourceObject]:
    """Return the objects of an IDF or epJSON file with their lines; an unreadable file has none."""
    try:
        text = path.read_text(encoding="latin-1" if path.suffix.lower() == ".idf" else "utf-8")
    except (OSError, UnicodeDecodeError):
        return []
    return list(_idf_objects(text) if path.suffix.lower() == ".idf" else _epjson_objects(text))


def _idf_objects(text: str) -> Iterator[SourceObject]:
    fields: list[tuple[int, str]] = []
    value = ""
    for number, line in enumerate(text.splitlines(), 1):
        for part in re.split(r"([,;])", line.partition("!")[0]):
            if part not in (",", ";"):
                value += part
                continue
            fields.append((number, value.strip()))
            value = ""
            if part == ";":
                if len(fields) > 1:
                    yield SourceObject(fields[0][1], tuple(fields[1:]))
                fields = []


def _epjson_objects(text: str) -> Iterator[SourceObject]:
    """Yield the objects of an epJSON text, whose types are at depth 1 and names at depth 2.

    The names of an object's fields count as values of it.
    """
    line, depth, kind, last = 1, 0, "", ""
    values: list[tuple[int, str]] = []
    for part in _JSON_TEXT.findall(text):
        if part == "\n":
            line += 1
        elif part in "{[":
            depth += 1
        elif part in "}]":
            if depth == 3 and values:
                yield SourceObject(kind, tuple(values))
                values = []
            depth -= 1
        elif part == ":":
            if depth == 1:
                kind = last
            elif depth == 2:
                values = [(line, last)]
        else:
            last = str(json.loads(part))
            if depth >= 3:
                values.append((line, last))
