"""Reading of fault plan files."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from topics.codec import describe_validation_errors
from topics.errors import InvalidConfig
from topics.fault_plan import FaultPlan


def read_plan(path: Path) -> FaultPlan:
    """Read a fault plan from a YAML file.

    Raises:
        InvalidConfig: the file cannot be read, or is not a valid plan; the text lists all errors.
    """
    from topics import yaml12  # slow to import, and only files need it

    try:
        text = yaml12.read_text(path.expanduser())
    except (OSError, RuntimeError, UnicodeDecodeError) as error:
        raise InvalidConfig(f"{path} cannot be read: {error}") from None
    try:
        return FaultPlan.model_validate(yaml12.parse(text, str(path)))
    except ValidationError as error:
        raise InvalidConfig(f"{path}: {describe_validation_errors(error, FaultPlan.model_fields)}") from None
