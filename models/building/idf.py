"""Convert an IDF to epJSON and check that no object was lost.

EnergyPlus's converter skips what it does not know and continues, so the objects of the result are counted against
those of the IDF.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zenostat.models import energyplus
from zenostat.models.building import schema
from zenostat.models.building.transition import idf_objects
from zenostat.models.err_file import severe_messages
from zenostat.topics.errors import InvalidConfig, ModelError, did_you_mean

_MAX_ERRORS = 10
_UNKNOWN_TYPE = re.compile(r'"(.*)" is not a valid Object Type')


def convert(path: Path, target: Path) -> None:
    """Write the epJSON of the IDF `path` to `target`.

    Raises:
        InvalidConfig: the file contains no object that EnergyPlus knows.
        ModelError: an object is unknown, invalid or missing from the result; the text lists all of them.
    """
    energyplus.call("convert", path, target)
    read = Counter(kind.casefold() for kind, _ in idf_objects(path.read_text(encoding="latin-1")))
    converted: dict[str, Any] = json.loads(target.read_bytes()) or {}
    if not read.keys() & {kind.casefold() for kind in schema.types()}:
        raise InvalidConfig(f"{path} is not an IDF: it contains no object that EnergyPlus {energyplus.version()} knows")
    messages = [line for message in severe_messages(target.parent) for line in message]
    errors = [_with_suggestions(line) for line in messages if "Fatal" not in line]
    errors += _lost_objects(read, converted)
    if errors:
        more = [f"and {len(errors) - _MAX_ERRORS} more"] if len(errors) > _MAX_ERRORS else []
        raise ModelError("\n  ".join([f"{path} is not a valid model:", *errors[:_MAX_ERRORS], *more]))


def _with_suggestions(line: str) -> str:
    """Append similar object types to a converter message about an unknown one."""
    unknown = _UNKNOWN_TYPE.search(line)
    return f"{line} ({did_you_mean(unknown[1][:60], schema.types())})" if unknown else line


def _lost_objects(read: Counter[str], converted: dict[str, Any]) -> Iterator[str]:
    counts = {kind.casefold(): len(objects) for kind, objects in converted.items()}
    for kind in schema.types():
        count, kept = read[kind.casefold()], counts.get(kind.casefold(), 0)
        if kept < count:
            yield f"{kind}: {kept} of {count} objects could be read"
