"""An IDF converted to epJSON, and the proof that all of its objects came out.

EnergyPlus's converter leaves out what it does not know and goes on, so what was read is compared with what came out.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from models import energyplus
from models.building import schema
from models.building.transition import idf_objects
from models.err_file import severe_lines
from topics.errors import InvalidConfig, ModelError, did_you_mean

_MOST = 10
_UNKNOWN_TYPE = re.compile(r'"(.*)" is not a valid Object Type')


def convert(path: Path, target: Path) -> None:
    """Write the epJSON of the IDF `path` to `target`.

    Raises:
        InvalidConfig: it holds nothing that EnergyPlus knows.
        ModelError: an object of it is unknown, broken or was left out; all of them are named.
    """
    energyplus.call("convert", path, target)
    read = Counter(kind.casefold() for kind, _ in idf_objects(path.read_text(encoding="latin-1")))
    converted: dict[str, Any] = json.loads(target.read_bytes()) or {}
    if not read.keys() & {kind.casefold() for kind in schema.types()}:
        raise InvalidConfig(f"{path} is no IDF: it holds no object that EnergyPlus {energyplus.version()} knows")
    errors = [_spelled(line) for line in severe_lines(target.parent) if "Fatal" not in line]
    errors += _left_out(read, converted)
    if errors:
        more = [f"and {len(errors) - _MOST} more"] if len(errors) > _MOST else []
        raise ModelError("\n  ".join([f"{path} is not a valid model:", *errors[:_MOST], *more]))


def _spelled(line: str) -> str:
    """A line of the converter, with near names where it does not know an object type."""
    unknown = _UNKNOWN_TYPE.search(line)
    return f"{line} ({did_you_mean(unknown[1][:60], schema.types())})" if unknown else line


def _left_out(read: Counter[str], converted: dict[str, Any]) -> Iterator[str]:
    came = {kind.casefold(): len(objects) for kind, objects in converted.items()}
    for kind in schema.types():
        count, kept = read[kind.casefold()], came.get(kind.casefold(), 0)
        if kept < count:
            yield f"{kind}: {kept} of {count} objects could be read"
