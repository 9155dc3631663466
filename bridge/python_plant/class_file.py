"""Find the file of a plant's class without importing anything."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import PathFinder
from pathlib import Path

from bridge.python_plant.description import split_name
from topics.errors import InvalidConfig


def class_file(plant: str) -> Path:
    """Return the file of a plant's class; nothing is imported or run.

    Args:
        plant: `FILE.py:CLASS` or `MODULE:CLASS`; a module is looked for in the current folder first, as when it is
            imported.

    Raises:
        InvalidConfig: it is neither, or there is no such file or module.
    """
    place, _ = split_name(plant)
    path = Path(place).absolute() if place.endswith(".py") else _module_file(place)
    if path is None or not path.is_file():
        raise InvalidConfig(f"plant {plant!r}: no file {place}; name a Python file that exists, or a module")
    return path


def _module_file(module: str) -> Path | None:
    folders: Sequence[str] = [str(Path.cwd()), *sys.path]
    name, parts, spec = "", module.split("."), None
    for part in parts:
        name = f"{name}.{part}" if name else part
        spec = PathFinder.find_spec(name, folders)
        if spec is None:
            return None
        folders = spec.submodule_search_locations or ()
    return Path(spec.origin) if spec is not None and spec.origin and spec.origin.endswith(".py") else None
