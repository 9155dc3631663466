"""Fields of configuration files of studies, and the files themselves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.file_kinds import FileKind, check_file_kind
from zenostat.topics.seed_validation import MAX_SEED

Count = Annotated[int, Field(strict=True, ge=1)]
Number = Annotated[float, Field(strict=True, gt=0)]
Seed = Annotated[int, Field(strict=True, ge=0, le=MAX_SEED)]


class ConfigPart(BaseModel):
    """Base of the parts of a configuration file: unknown fields are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _switch(value: Any) -> str:
    return "@false" if value is False else "@fields"


No = Annotated[Literal[False], Tag("@false")]
FIELDS, FIELDS_OR_FALSE = Tag("@fields"), Discriminator(_switch)
"""Marks of a field that is false or has fields of its own; errors are those of the form that was used."""


def read_file(path: str | Path, kind: FileKind = FileKind.TRAINING) -> dict[str, Any]:
    """Return the fields of a training or tuning file; paths in it are relative to the working directory.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: it is not YAML, or a file of another kind.
    """
    path = Path(path)
    fields = yaml12.read_mapping(path, UnknownName)
    check_file_kind(fields, kind, str(path))
    return fields


def with_field(fields: Mapping[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return a copy of nested fields with one set: `parameters.learning_rate`.

    Raises:
        InvalidConfig: a part of the path is a field that has no fields of its own.
    """
    first, dot, rest = path.partition(".")
    if not dot:
        return {**fields, first: value}
    inner = fields.get(first) or {}
    if not isinstance(inner, Mapping):
        raise InvalidConfig(f"{path}: {first} is {inner!r} and has no fields")
    return {**fields, first: with_field(inner, rest, value)}
