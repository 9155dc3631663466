"""Read an epJSON with the line of each object and field."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

from zenostat.models.input_format.source_model import (
    SourceField,
    SourceModel,
    SourceObject,
    SyntaxIssue,
    repeated_objects,
)

_JSON_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,\n]|[^\s{}\[\]:,"]+')


def read_epjson(text: str) -> SourceModel:
    """Read the text of an epJSON; one that is no JSON object has no objects."""
    try:
        objects = json.loads(text)
    except (ValueError, RecursionError):
        return SourceModel()
    scanner = _EpjsonScanner()
    entries = tuple(scanner.scan(text))
    issues = sorted([*scanner.issues, *repeated_objects(entries)])
    return SourceModel(entries, objects if isinstance(objects, dict) else {}, tuple(issues))


class _EpjsonScanner:
    """The state of a scan over the tokens of a JSON text.

    Attributes:
        keys: the key or the index within each open object or list, None before a key; types are keys at depth 1, names
            at depth 2.
        issues: types and fields that are in the file twice, of which JSON keeps only the last.
    """

    def __init__(self) -> None:
        self.keys: list[str | int | None] = []
        self.issues: list[SyntaxIssue] = []
        self._lines: list[dict[str, int]] = []
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
                self._lines.append({})
            elif part in "}]":
                self.keys.pop()
                self._lines.pop()
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
        self._check_repeated()
        if len(self.keys) == 1:
            self._kind = self._last
        elif len(self.keys) == 2:
            self._entry = SourceObject(self._kind, self._last, self._last_line)
        elif self._entry is not None:
            self._entry.fields[self._path()] = SourceField(self._last_line, "")

    def _check_repeated(self) -> None:
        first = self._lines[-1].setdefault(self._last, self._last_line)
        if first == self._last_line or len(self.keys) == 2:
            return
        if len(self.keys) == 1:
            text = f"type {self._last!r} is in the file twice; first in line {first}, whose objects JSON leaves out"
            self.issues.append(SyntaxIssue(self._last_line, self._last, "", text))
        elif self._entry is not None:
            label = f"{self._entry.kind} {self._entry.name!r}"
            text = f"{label}: {self._path()} is in it twice; first in line {first}, whose value JSON leaves out"
            self.issues.append(SyntaxIssue(self._last_line, self._entry.kind, self._entry.name, text))

    def _value(self, part: str, line: int) -> None:
        self._last, self._last_line = str(json.loads(part)), line
        if self._entry is not None and len(self.keys) > 2 and self.keys[-1] is not None:
            self._entry.fields[self._path()] = SourceField(line, self._last)

    def _path(self) -> str:
        text = ""
        for key in self.keys[2:]:
            text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
        return text
