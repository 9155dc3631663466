"""Files that a model's objects name: found in the folder of the model, wherever EnergyPlus runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from zenostat.models.input_format.source_model import ObjectsOfType

FILE_FIELDS = {
    "Chiller:Electric:ASHRAE205": "representation_file_name",
    "Coil:DX:ASHRAE205:Performance": "representation_file_name",
    "Construction:WindowDataFile": "file_name",
    "Schedule:File": "file_name",
    "Schedule:File:Shading": "file_name",
    "Table:IndependentVariable": "external_file_name",
    "Table:Lookup": "external_file_name",
}
"""The fields that name a file, by object type."""

_ROLE = "file of "


def is_external(role: str) -> bool:
    """Return whether a role is one of `files_by_role`."""
    return role.startswith(_ROLE)


def with_absolute_paths(objects: dict[str, ObjectsOfType], folder: Path) -> dict[str, ObjectsOfType]:
    """Return a model whose files are named by absolute paths; it is the same object if it names no relative one.

    EnergyPlus looks in the folder of its input file, which is a copy in another folder. A file that does not exist
    keeps its name, except for that of a schedule, whose error then names the folder.
    """
    changed: dict[str, ObjectsOfType] = {}
    for kind, field in FILE_FIELDS.items():
        for name, fields in objects.get(kind, {}).items():
            path = fields.get(field)
            if not isinstance(path, str) or not path.strip() or Path(path).is_absolute():
                continue
            target = (folder / path.strip().replace("\\", "/")).absolute()
            if target.is_file() or kind == "Schedule:File":
                items = changed.setdefault(kind, dict(objects[kind]))
                items[name] = dict(fields) | {field: str(target)}
    return {**objects, **changed} if changed else objects


def versions_of_files(objects: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield a text for each file that a model names: its path, size and time of the last change."""
    for _, _, path in _named_files(objects):
        try:
            status = path.stat()
        except OSError:
            yield f"{path}: none"
        else:
            yield f"{path}: {status.st_size} bytes of {status.st_mtime_ns}"


def files_by_role(objects: Mapping[str, Mapping[str, Any]]) -> dict[str, Path]:
    """Return the files that a model reads, each once, by a text that names the first object which names it."""
    roles = {path: f"{_ROLE}{kind} {name!r}" for kind, name, path in reversed([*_named_files(objects)])}
    return {role: path for path, role in reversed(roles.items()) if path.is_absolute() and path.is_file()}


def _named_files(objects: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str, Path]]:
    """Yield type, name and file of each object that names one."""
    for kind, field in FILE_FIELDS.items():
        for name, fields in objects.get(kind, {}).items():
            path = fields.get(field) if isinstance(fields, Mapping) else None
            if isinstance(path, str) and path:
                yield kind, name, Path(path)
