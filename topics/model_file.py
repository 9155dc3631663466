"""Files of users that are read into a pydantic model, with the line of each value for errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from zenostat.topics import yaml12
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, list_errors
from zenostat.topics.file_kinds import FileKind, check_file_kind
from zenostat.topics.user_file import user_file
from zenostat.topics.yaml12 import Lines

M = TypeVar("M", bound=BaseModel)


@dataclass
class FileErrors:
    """Errors of a user's file, each with its line, which are reported together.

    Attributes:
        path: the file.
        lines: of its values.
        texts: the errors so far.
    """

    path: Path
    lines: Lines
    texts: list[tuple[int, str]] = field(default_factory=list)

    def add(self, location: Sequence[str | int], text: str) -> None:
        """Add an error of the value at a path of names and indices."""
        self.texts.append((self.lines.at(location), text))

    def raise_if_any(self) -> None:
        """Raise `InvalidConfig` with all errors in the order of their lines, each in a line of its own."""
        if not self.texts:
            return
        ordered = [f"{self.path}:{line}: {text}" for line, text in sorted(set(self.texts))]
        raise InvalidConfig(ordered[0] if len(ordered) == 1 else list_errors(f"{self.path} has errors:", ordered))


def read_with_lines(path: Path, model: type[M], kind: FileKind | None = None) -> tuple[M, dict[str, Any], FileErrors]:
    """Read a YAML file into a model; return it, the file's mapping, and a list for further errors, which is empty.

    Args:
        path: the file.
        model: of its fields.
        kind: that the file is to have, if it may be taken for one of another kind.

    Raises:
        InvalidConfig: the file cannot be read, it is of another kind, or a field is unknown, missing or wrong; lists
            all errors with lines.
    """
    with user_file(path):
        path = path.expanduser()
    with user_file(path, expected="a YAML file"):
        text = yaml12.read_text(path)
    mapping, lines = yaml12.parse_with_lines(text, str(path))
    if kind is not None:
        check_file_kind(mapping, kind, str(path))
    errors = FileErrors(path, lines)
    try:
        return model.model_validate(mapping), mapping, errors
    except ValidationError as error:
        for location, text in located_errors(error, model):
            errors.add(_without_types(location, lines), text)
        errors.raise_if_any()
        raise


def located_errors(error: ValidationError, model: type[BaseModel]) -> Iterator[tuple[Sequence[str | int], str]]:
    """Yield the path and the text of each error of a validation."""
    for detail in error.errors(include_url=False):
        yield detail["loc"], describe_validation_errors(_single(error, detail), model.model_fields)


def _single(error: ValidationError, detail: Any) -> ValidationError:
    """Return a validation error with one of its details."""
    fields = InitErrorDetails(type=detail["type"], loc=detail["loc"], input=detail["input"], ctx=detail.get("ctx", {}))
    try:
        return ValidationError.from_exception_data(error.title, [fields])
    except KeyError:  # a type of a model's own
        fields["type"] = PydanticCustomError(detail["type"], "{text}", {"text": detail["msg"]})
        return ValidationError.from_exception_data(error.title, [fields])


def _without_types(location: Sequence[str | int], lines: Lines) -> tuple[str | int, ...]:
    """Return the parts of a path that the file has: pydantic adds the names of types to those of unions."""
    path: tuple[str | int, ...] = ()
    for part in location:
        path = (*path, part) if (*path, part) in lines else path
    return path
