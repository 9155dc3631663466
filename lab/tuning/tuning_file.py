"""Reading of tuning files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from zenostat.lab.config_file import read_file
from zenostat.lab.tuning.study_config import StudyConfig
from zenostat.topics import codec
from zenostat.topics.errors import InvalidConfig

C = TypeVar("C", bound=StudyConfig)


def read_tuning(fields: Mapping[str, Any], what: str = "the study", folder: Path = Path()) -> StudyConfig:
    """Validate the fields of a tuning file, as far as that is possible before anything starts.

    Args:
        fields: the fields.
        what: the file, for errors.
        folder: the folder to which the path of a training file is relative.

    Returns:
        A `TrainingStudy`, or a `ControllerStudy` if the file names a controller.

    Raises:
        InvalidConfig: lists all errors.
    """
    if "training" in fields and "controller" in fields:
        raise InvalidConfig(f"{what}: a study has either a training or a controller; remove one of the fields")
    if isinstance(fields.get("training"), str):
        fields = {**fields, "training": read_file(folder / fields["training"])}
    return validated(_kind(fields), fields, what)


def validated(kind: type[C], fields: Mapping[str, Any], what: str) -> C:
    """Validate the fields of a study of a kind.

    Raises:
        InvalidConfig: lists all errors.
    """
    checked: C = codec.validated(kind, fields, what).checked(what)
    return checked


def _kind(fields: Mapping[str, Any]) -> type[StudyConfig]:
    if "controller" in fields:
        from zenostat.lab.tuning.controller_study import ControllerStudy

        return ControllerStudy
    from zenostat.lab.tuning.training_study import TrainingStudy  # torch takes seconds to import

    return TrainingStudy
