"""The files in the folder of a training, as far as a trained model needs them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from zenostat.topics import VERSION, yaml12
from zenostat.topics.errors import InvalidConfig

TRAINING, SCENARIO, VERSIONS, WRAPPERS = "training.yaml", "scenario.yaml", "versions.json", "wrappers.yaml"
MODEL, BEST, CHECKPOINTS = "model.zip", "best.zip", "checkpoints"
CURVE, EVALUATIONS, REFERENCES, LOCK = "curve.csv", "evaluations.csv", "references.csv", ".lock"
FORMAT = 1
"""Version of the folder's format; it changes whenever an older version cannot read it, or a newer one not that."""


def is_training(path: str | Path) -> bool:
    """Return whether a path is the folder of a training."""
    return (Path(path).expanduser() / TRAINING).is_file()


def read_training_fields(folder: Path) -> dict[str, Any]:
    """Return the fields of a folder's `training.yaml`.

    Raises:
        InvalidConfig: it is not the folder of a training, or was written by a version with another format.
    """
    if not is_training(folder):
        raise InvalidConfig(f"{folder} is not the folder of a training: it has no {TRAINING}")
    saved = read_versions(folder)
    if saved.get("format") != FORMAT:
        raise InvalidConfig(
            f"{folder} was written by Zenostat {saved.get('zenostat', '(unknown)')} in format {saved.get('format')}; "
            f"this is Zenostat {VERSION}, which reads format {FORMAT}: train again, or use that version"
        )
    return yaml12.read_mapping(folder / TRAINING)


def read_versions(folder: Path) -> dict[str, Any]:
    """Return the versions with which a folder was written; empty if they cannot be read."""
    try:
        saved = json.loads((folder / VERSIONS).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return saved if isinstance(saved, dict) else {}


def model_file(folder: Path) -> Path:
    """Return the best model of a training; without evaluations the last one, and of a running one the latest.

    Raises:
        InvalidConfig: there is none yet.
    """
    saved = [folder / BEST, folder / MODEL, *(path / MODEL for path in reversed(_checkpoints(folder)))]
    for path in saved:
        if path.is_file():
            return path
    raise InvalidConfig(f"{folder} has no model yet: its training ended before the first checkpoint")


def normalization_path(model: Path) -> Path:
    """Return the file of a model's normalization: `best.vecnormalize.pkl` of `best.zip`."""
    return model.with_suffix(".vecnormalize.pkl")


def wrappers_path(model: Path) -> Path:
    """Return the file of the wrappers of a model, or of their states: `best.wrappers.yaml` of `best.zip`."""
    return model.with_suffix(".wrappers.yaml")


def policy_files(path: Path) -> list[Path]:
    """Return the files that determine the actions of a training, given its folder, or of a model's file.

    Raises:
        InvalidConfig: see `model_file`.
    """
    folder, model = (path, model_file(path)) if path.is_dir() else (path.parent, path)
    beside = [normalization_path(model), wrappers_path(model), *([folder / WRAPPERS] if is_training(folder) else [])]
    return [model, *filter(Path.is_file, beside)]


def _checkpoints(folder: Path) -> list[Path]:
    return sorted((folder / CHECKPOINTS).glob("step-*"))


def read_wrappers(folder: Path, model: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the wrappers of a training, innermost first, and the states that were saved beside a model.

    Args:
        folder: the folder of the training.
        model: the file of a model in it.

    Raises:
        InvalidConfig: a file is damaged.
    """
    state_file = wrappers_path(model)
    states = yaml12.read_mapping(state_file)["wrappers"] if state_file.is_file() else []
    # Those of the slots of a vector environment are around the vector: a single environment has the same.
    return yaml12.read_mapping(folder / WRAPPERS)["wrappers"], states
