"""Convert an IDF to epJSON and check that no object was lost.

EnergyPlus's converter skips what it does not know and continues. So the file is read and checked here first, with the
line of each error, and the objects of the result are counted against those of the IDF.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zenostat.models import energyplus, schema
from zenostat.models.building.diagnostics import describe, diagnose, diagnose_format, verdict
from zenostat.models.building.source_lines import read_source
from zenostat.models.err_file import severe_messages
from zenostat.models.input_format.source_model import SourceModel
from zenostat.topics.errors import InvalidConfig, ModelError, list_errors


def convert(path: Path, target: Path) -> None:
    """Write the epJSON of the IDF `path` to `target`.

    Raises:
        InvalidConfig: the file contains no object that EnergyPlus knows, or an object is unknown or invalid; the text
            lists all of them, with their lines.
        ModelError: EnergyPlus cannot convert the file.
    """
    source = read_source(path)
    if not source.objects:
        raise InvalidConfig(f"{path} is not an IDF: it contains no object that EnergyPlus {energyplus.version()} knows")
    if diagnose_format(source.objects, source):
        raise InvalidConfig(describe(diagnose(source.objects, source), str(path), verdict()))
    energyplus.call("convert", path, target)
    messages = [line for message in severe_messages(target.parent) for line in message]
    errors = [line for line in messages if "Fatal" not in line]
    errors += _lost_objects(source, json.loads(target.read_bytes()) or {})
    if errors:
        raise ModelError(list_errors(f"{path} {verdict()}:", errors))


def convert_text(text: str, target: Path, file: Path) -> None:
    """Write the epJSON of an IDF that was translated from `file` to `target`; errors as of `convert`."""
    source = target.with_name("translated.idf")
    source.write_text(text, encoding="utf-8")
    try:
        convert(source, target)
    except (InvalidConfig, ModelError) as error:
        raise type(error)(str(error).replace(str(source), f"{file}, translated to IDF,")) from None


def _lost_objects(source: SourceModel, converted: dict[str, Any]) -> Iterator[str]:
    read = Counter(entry.kind for entry in source.entries)
    counts = {kind.casefold(): len(objects) for kind, objects in converted.items()}
    for kind in schema.types():
        kept = counts.get(kind.casefold(), 0)
        if kept < read[kind]:
            yield f"{kind}: {kept} of {read[kind]} objects could be read"
