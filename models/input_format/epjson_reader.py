"""Read an epJSON with the line of each object and field."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

from zenostat.models.input_format.source_model import SourceField, SourceModel, SourceObject, repeated_objects

_JSON_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,\n]|[^\s{}\[\]:,"]+')


def read_epjson(text: str) -> SourceModel:
    """Read the text of an epJSON; one that is no JSON object has no objects."""
    try:
        objects = json.loads(text)
    except (ValueError, RecursionError):
        return SourceModel()
    entries = tuple(_EpjsonScanner().scan(text))
    return SourceModel(entries, objects if isinstance(objects, dict) else {}, tuple(repeated_objects(entries)))


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
