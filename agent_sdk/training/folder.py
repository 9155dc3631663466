"""The folder of a training: its files, and what they were made with."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.training.config import TrainingConfig, read_file, read_training
from zenostat.topics import VERSION, yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig

TRAINING, SCENARIO, VERSIONS, WRAPPERS = "training.yaml", "scenario.yaml", "versions.json", "wrappers.yaml"
MODEL, BEST, CHECKPOINTS = "model.zip", "best.zip", "checkpoints"
FORMAT = 1
"""Version of the folder's format; it changes whenever an older version cannot read it, or a newer one not that."""
_LIBRARIES = ("gymnasium", "numpy", "pyenergyplus-lbnl", "sb3-contrib", "stable-baselines3", "torch")
_FREE = ("steps", "output", "log", "wandb", "checkpoint_steps", "device")
"""Fields that may differ when a training is resumed."""


def is_training(path: str | Path) -> bool:
    """Return whether a path is the folder of a training."""
    return (Path(path).expanduser() / TRAINING).is_file()


def versions() -> dict[str, Any]:
    """Return the versions of what determines the results of a training."""
    found_versions: dict[str, Any] = {"format": FORMAT, "zenostat": VERSION, "python": platform.python_version()}
    for library in _LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found_versions[library] = importlib.metadata.version(library)
    return found_versions


def create(folder: Path, config: TrainingConfig, wrappers: list[dict[str, Any]], scenario: str) -> None:
    """Write the files that describe a training.

    Args:
        folder: the folder; created if necessary.
        config: the training.
        wrappers: all wrappers of its environment, those of the scenario included.
        scenario: text of the scenario file; "" without one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / VERSIONS, json.dumps(versions(), indent=1) + "\n")
    _write(folder / WRAPPERS, yaml12.dump({"wrappers": wrappers}))
    if scenario:
        _write(folder / SCENARIO, scenario)
    _write(folder / TRAINING, yaml12.dump(config.plain()))  # last: it marks the folder as that of a training


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_folder(folder: Path) -> TrainingConfig:
    """Return the training of a folder.

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
    return read_training(read_file(folder / TRAINING), str(folder / TRAINING))


def read_versions(folder: Path) -> dict[str, Any]:
    """Return the versions with which a folder was written; empty if they cannot be read."""
    try:
        saved = json.loads((folder / VERSIONS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return saved if isinstance(saved, dict) else {}


def changed_versions(folder: Path) -> list[str]:
    """Return what has another version than when the folder was written: `torch 2.12.0, now 2.13.0`."""
    saved, now = read_versions(folder), versions()
    return [f"{name} {saved[name]}, now {now.get(name, 'missing')}" for name in saved if saved[name] != now.get(name)]


def check_same(saved: TrainingConfig, config: TrainingConfig, folder: Path) -> None:
    """Check that a training can be resumed with this configuration.

    Raises:
        InvalidConfig: fields differ that determine the results; the text names them.
    """
    before, now = _flat(saved.plain()), _flat(config.plain())
    differing = [
        f"{name} was {before.get(name, 'not set')}, now {now.get(name, 'not set')}"
        for name in {**before, **now}
        if name.partition(".")[0] not in _FREE and before.get(name) != now.get(name)
    ]
    if differing:
        raise InvalidConfig(f"{folder} is another training and cannot be resumed: {'; '.join(differing[:5])}")


def _flat(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping) and value:
            flat |= _flat(value, f"{prefix}{name}.")
        elif value not in ({}, None):
            flat[prefix + name] = value
    return flat


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
    state_file = model.with_suffix(".wrappers.yaml")
    states = read_file(state_file)["wrappers"] if state_file.is_file() else []
    # Those of the slots of a vector environment are around the vector: a single environment has the same.
    return read_file(folder / WRAPPERS)["wrappers"], states
