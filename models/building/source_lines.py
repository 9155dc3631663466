"""Read a model file with its lines, and find the line that a message of EnergyPlus is about."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from zenostat.models.input_format.encoding import check_encoding, decode_epjson, decode_idf
from zenostat.models.input_format.epjson_reader import read_epjson
from zenostat.models.input_format.idf_reader import idf_version, parse_idf
from zenostat.models.input_format.layout import Layout, engine_layout
from zenostat.models.input_format.source_model import SourceModel, SourceObject
from zenostat.models.upgrade.versions import STEPS, layout_of, short
from zenostat.topics.errors import InvalidConfig, did_you_mean

_WHOLE_WORD = r"(?<![\w:.-]){}(?![\w:.-])"
_NOT_FOUND = re.compile(r"(\w+) ?= ?([^=]+?), item not found")


def read_source(path: Path) -> SourceModel:
    """Read an IDF, in the format of its own version, or an epJSON; an unreadable file has no objects."""
    try:
        raw = path.read_bytes()
        if path.suffix.lower() != ".idf":
            return read_epjson(decode_epjson(raw, path))
        check_encoding(raw, path)
        text = decode_idf(raw)
        return parse_idf(text, _layout(text, path))
    except (OSError, InvalidConfig):
        return SourceModel()


def _layout(text: str, path: Path) -> Layout:
    """Return the input format of an IDF's version; the engine's if it names none that is known."""
    version = idf_version(text)
    if not version or short(version) not in {step.before for step in STEPS}:
        return engine_layout()
    return layout_of(short(version), name=path.name)


def locator(path: str | Path) -> Callable[[str], str | None]:
    """Return a function that finds the place in a model file that a message names; it reads the file when called."""

    @cache
    def entries() -> Sequence[SourceObject]:
        return read_source(Path(path)).entries

    def find(message: str) -> str | None:
        place = locate(message, entries())
        return f"{path}, {place}" if place else None

    return find


def locate(message: str, objects: Sequence[SourceObject]) -> str | None:
    """Return the line and the object that a message names by type and name; None if it names none of them.

    The line is that of a field whose value the message contains, else that of the object's name.
    """
    text = message.casefold()
    named = [each for each in objects if _contains(text, _name(each)) and _contains(text, each.kind)]
    if not named:
        return None
    subject = max(named, key=lambda each: (len(_name(each)), len(each.kind)))
    rest = text.replace(_name(subject).casefold(), "")
    fields = [
        (len(value), line, path)
        for path, (line, value) in subject.fields.items()
        if path != "name" and not _is_number(value) and _contains(rest, value)
    ]
    _, line, path = max(fields) if fields else (0, subject.fields.get("name", subject).line, "")
    where = f": {path}" if path else ""
    return f"line {line}: {subject.kind} {_name(subject)!r}{where}{_suggestion(message, objects)}"


def _name(entry: SourceObject) -> str:
    """Return the name of an object; in an IDF, the first field of an object without a name."""
    first = next(iter(entry.fields.values()), None)
    return first.text if first and re.fullmatch(rf"{re.escape(entry.kind)} \d+", entry.name) else entry.name


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
