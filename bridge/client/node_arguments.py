"""Convert a user's arguments to the settings of a node."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.bridge.python_plant.shipped import PLANT_SETTINGS, SHIPPED, absolute_source
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.user_file import absolute


def for_node(arguments: Mapping[str, Any], name: str, slots: int = 1) -> dict[str, Any]:
    """Return the settings of a node for a user's arguments, of which none is None.

    Raises:
        InvalidConfig: No simulation or several are named; a point is not a tuple of names; a path is empty; or a value
            cannot be sent to the node's process.
    """
    settings = {key: to_json(value) for key, value in arguments.items()}
    for key in ("scenario", "file"):
        if not isinstance(settings.get(key, ""), str):
            raise InvalidConfig(f"{key} = {arguments[key]!r}; the name of a scenario or the path of its file expected")
    _check_sources(settings)
    _check_points(settings, arguments)
    _check_serializable(settings)
    if "file" in settings:
        settings["scenario"] = settings.pop("file")
    # Relative paths refer to the caller's working directory, which may differ from the node's.
    files = ("alarms", "config", "district", "faults", "output_dir", "record")
    for key in (*files, "building", "scenario", "weather"):
        if settings.get(key) == "":
            raise InvalidConfig(
                f"{key} is empty; leave it out, or name a {'file' if key != 'output_dir' else 'folder'}"
            )
        if key in settings:
            settings[key] = _absolute(settings[key], always=key in files)
    if "plant_arguments" in settings and not PLANT_SETTINGS & settings.keys():
        raise InvalidConfig("plant_arguments needs a plant: plant='FILE.py:CLASS', fmu='FILE.fmu' or grid='FILE.yaml'")
    if "plant" in settings:
        settings["plant"] = _absolute_class(str(settings["plant"]))
    settings |= {option: absolute_source(str(settings[option])) for option in SHIPPED if option in settings}
    return settings | {"name": name} | ({"slots": slots} if slots > 1 else {})


def _check_sources(settings: Mapping[str, Any]) -> None:
    sources = [key for key in ("scenario", "file", "config", "plant", "district", *SHIPPED) if key in settings]
    if len(sources) > 1:
        raise InvalidConfig(f"{' and '.join(sources)} both define the simulation; use only one of them")
    if not sources and not {"building", "weather"} <= set(settings):
        raise InvalidConfig(
            "name a building and a weather, a scenario, a file (file=), a class of your own (plant=), an FMU (fmu=), a "
            "grid (grid=), or the bus (connect=) and node of a running one"
        )


def _check_points(settings: Mapping[str, Any], arguments: Mapping[str, Any]) -> None:
    for key in ("sensors", "actuators"):
        if not isinstance(settings.get(key, {}), dict):
            raise InvalidConfig(f"{key}: a mapping from names to points expected, got {arguments[key]!r}")
        for point, spec in settings.get(key, {}).items():
            if isinstance(spec, str) or not isinstance(spec, list | dict):
                raise InvalidConfig(f"{key} {point!r}: a tuple of EnergyPlus's names expected, got {spec!r}")


def _check_serializable(settings: Mapping[str, Any]) -> None:
    plant = settings.get("plant_arguments")
    values = {f"plant_arguments: {name}": value for name, value in plant.items()} if isinstance(plant, dict) else {}
    for name, value in {**values, **settings}.items():
        try:
            json.dumps(value)
        except (TypeError, ValueError):
            process = "plant" if name in values else "node"
            raise InvalidConfig(
                f"{name} = {value!r} cannot be sent to the {process}'s process; only numbers, texts, lists and "
                "mappings can"
            ) from None


def _absolute_class(plant: str) -> str:
    """Return `FILE.py:CLASS` with an absolute path; `MODULE:CLASS` as it is."""
    place, _, class_name = plant.rpartition(":")
    return f"{_absolute(place, always=place.endswith('.py'))}:{class_name}" if place else plant


def to_json(value: Any) -> Any:
    """Convert an argument of an environment to JSON built-ins; a value of another class stays as it is."""
    if isinstance(value, Mapping):
        return {str(key): to_json(part) for key, part in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_json(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, datetime) and value.time() == time(0):  # as pandas has dates
        value = value.date()
    if isinstance(value, date):
        return value.isoformat()
    return str(value) if isinstance(value, Path) else value


def _absolute(value: Any, *, always: bool) -> Any:
    if isinstance(value, list):
        return [_absolute(part, always=always) for part in value]
    if not isinstance(value, str):
        return value
    path = Path(value)
    if not always and not path.suffix:
        return value
    try:
        path = path.expanduser()
        return str(absolute(path)) if always or path.exists() else value
    except (OSError, RuntimeError):  # no path at all, or ~name of an unknown user: the node reports it
        return value
