"""Find the file of a plant's class without importing anything."""

from __future__ import annotations

import importlib.util
from importlib.machinery import PathFinder
from pathlib import Path

from zenostat.bridge.python_plant.description import split_name
from zenostat.topics.errors import InvalidConfig


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
    top, *parts = module.split(".")
    # `importlib.util.find_spec` of a name without dots imports nothing, and knows editable installations.
    spec = PathFinder.find_spec(top, [str(Path.cwd())]) or importlib.util.find_spec(top)
    name = top
    for part in parts:
        folders = spec.submodule_search_locations if spec is not None else None
        name = f"{name}.{part}"
        spec = PathFinder.find_spec(name, folders) if folders else None
    return Path(spec.origin) if spec is not None and spec.origin and spec.origin.endswith(".py") else None
