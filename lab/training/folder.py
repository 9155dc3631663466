"""The folder of a training: its files, and what they were made with."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers.training_folder import (
    FORMAT,
    SCENARIO,
    TRAINING,
    VERSIONS,
    WRAPPERS,
    read_training_fields,
    read_versions,
)
from zenostat.lab.training.config import TrainingConfig, read_training
from zenostat.topics import VERSION, yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig

_LIBRARIES = ("gymnasium", "numpy", "pyenergyplus-lbnl", "sb3-contrib", "stable-baselines3", "torch")
_FREE = ("steps", "output", "log", "wandb", "checkpoint_steps", "device")
"""Fields that may differ when a training is resumed."""


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
    return read_training(read_training_fields(folder), str(folder / TRAINING))


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
    names = [name for name in {**before, **now} if name.partition(".")[0] not in _FREE]
    if differences := _differences(before, now, names):
        raise InvalidConfig(f"{folder} is another training and cannot be resumed: {differences}")


def check_same_scenario(folder: Path, wrappers: list[dict[str, Any]], scenario: str) -> None:
    """Check that the environment of a training is the one with which its folder was written.

    Building and weather may be in other folders; the checkpoint tells whether they simulate the same. Fields that only
    another version of Zenostat writes are not compared.

    Args:
        folder: of a training that is resumed.
        wrappers: all wrappers of the environment.
        scenario: its text; "" without one.

    Raises:
        InvalidConfig: they differ; the text names the fields.
    """
    saved, present = _environment_fields(folder), yaml12.parse(scenario, "the node's scenario") if scenario else {}
    before, now = _comparable(saved), _comparable({**present, "wrappers": wrappers})
    is_same_version = read_versions(folder).get("zenostat") == VERSION
    if differences := _differences(before, now, {**before, **now} if is_same_version else before):
        raise InvalidConfig(f"{folder} was trained with another scenario, and cannot be resumed: {differences}")


def _differences(before: Mapping[str, Any], now: Mapping[str, Any], names: Iterable[str]) -> str:
    """Return the first of the fields with these names that differ, with both values; empty if none do."""
    differing = [
        f"{name} was {before.get(name, 'not set')}, now {now.get(name, 'not set')}"
        for name in names
        if before.get(name) != now.get(name)
    ]
    return "; ".join(differing[:5])


def _environment_fields(folder: Path) -> dict[str, Any]:
    scenario = folder / SCENARIO
    fields = yaml12.read_mapping(scenario) if scenario.exists() else {}
    return fields | yaml12.read_mapping(folder / WRAPPERS)


def _comparable(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a scenario by their paths, without the folders of its files."""
    names = {name: fields[name] for name in ("building", "weather") if name in fields}
    for name, value in names.items():
        files = [value] if isinstance(value, str) else value
        names[name] = [file.replace("\\", "/").rpartition("/")[2] for file in files]
    return _flat({**fields, **names})


def _flat(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping) and value:
            flat |= _flat(value, f"{prefix}{name}.")
        elif value not in ({}, None):
            flat[prefix + name] = value
    return flat
