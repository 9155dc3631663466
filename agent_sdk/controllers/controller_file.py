"""Controller files: a controller by name with parameters, as `zenostat tune` writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from zenostat.topics import yaml12
from zenostat.topics.codec import validated
from zenostat.topics.errors import UnknownName
from zenostat.topics.file_kinds import FileKind, check_file_kind


class ControllerFile(BaseModel):
    """Content of a controller file.

    Attributes:
        controller: short name of a bundled controller, or a class as for `load_controller`.
        parameters: its parameters by name; all others have their defaults.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    controller: str = Field(min_length=1, strict=True)
    parameters: dict[str, Any] = Field(default_factory=dict)


def read_controller_file(path: Path) -> ControllerFile:
    """Read a controller file.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: it is not YAML, a file of another kind, or has invalid fields.
    """
    fields = yaml12.read_mapping(path, UnknownName)
    check_file_kind(fields, FileKind.CONTROLLER, str(path))
    return validated(ControllerFile, fields, str(path))
