"""What a user gives an environment, as the settings of a node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agent_sdk.bus.local_node import LocalNode
from agent_sdk.rewards import AnyReward, read_reward
from bridge.runtime.affinity import Affinity
from topics import yaml12
from topics.errors import InvalidConfig, UnknownArgument, UsageError, did_you_mean

FROM_SCENARIO = "scenario"
"""The reward that the node's scenario names."""

NODE_ARGUMENTS = (
    "building", "weather", "scenario", "file", "config", "variant", "sensors", "meters", "actuators", "begin", "end",
    "steps_per_hour", "weather_order", "weather_noise", "sizing", "edits", "time", "aggregation", "actions", "control",
    "discrete", "terminate", "output_dir", "keep_last", "baseline", "branches", "faults",
    "unresponsive_s",
)  # fmt: skip
"""The arguments that a node decides by."""


def check_arguments(given: Mapping[str, Any], known: Sequence[str]) -> None:
    """Refuses keyword arguments that are not known, in Python's own words.

    Raises:
        UnknownArgument: names all of them, with near ones.
    """
    if unknown := [name for name in given if name not in known]:
        faults = [f"got an unexpected keyword argument {name!r}; {did_you_mean(name, known)}" for name in unknown]
        raise UnknownArgument("\n".join(faults))


def of_scenario(scenario: str | Path | Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of an environment: a scenario's id or file, or those themselves."""
    if isinstance(scenario, Mapping):
        return dict(scenario)
    if Path(scenario).suffix in (".yaml", ".yml"):
        return {"file": scenario}
    return {"scenario": str(scenario).removeprefix("zenostat/")}


def for_node(given: Mapping[str, Any], name: str, slots: int = 1) -> dict[str, Any]:
    """What the user gave (None left out), as the settings of a node of that many slots.

    Raises:
        InvalidConfig: nothing to simulate, or several things; a point that is no list of names.
    """
    settings = {key: _plain(value) for key, value in given.items()}
    sources = [key for key in ("scenario", "file", "config") if key in settings]
    if len(sources) > 1:
        raise InvalidConfig(f"{' and '.join(sources)} both say what to simulate; name one of them")
    if not sources and not {"building", "weather"} <= set(settings):
        raise InvalidConfig(
            "name a building and a weather, a scenario, a file (file=), or the bus (connect=) and node of a running one"
        )
    for key in ("sensors", "actuators"):
        if not isinstance(settings.get(key, {}), dict):
            raise InvalidConfig(f"{key}: points by the names that they get expected, got {given[key]!r}")
        for point, spec in settings.get(key, {}).items():
            if isinstance(spec, str) or not isinstance(spec, list | dict):
                raise InvalidConfig(f"{key} {point!r}: a tuple of EnergyPlus's names expected, got {spec!r}")
    if "file" in settings:
        settings["scenario"] = settings.pop("file")
    # A relative path is the caller's, who may be elsewhere than the node.
    for key in ("building", "config", "faults", "output_dir", "scenario", "weather"):
        if key in settings:
            settings[key] = _absolute(settings[key], always=key in ("config", "faults", "output_dir"))
    return settings | {"name": name} | ({"slots": slots} if slots > 1 else {})


def _plain(value: Any) -> Any:
    """As JSON has it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def _absolute(value: Any, *, always: bool) -> Any:
    if isinstance(value, list):
        return [_absolute(part, always=always) for part in value]
    path = Path(str(value))
    if not always and not path.suffix:
        return value
    try:
        path = path.expanduser()
    except RuntimeError:  # ~name of nobody: the node says so
        return value
    return str(path.absolute()) if always or path.exists() else value


def check_reward(reward: AnyReward | None, settings: Mapping[str, Any], placement: Affinity) -> None:
    """Checks the reward before anything starts; with a fault in it, all else as well, so that all are said at once.

    Raises:
        InvalidConfig: a kind or parameters that cannot be.
    """
    said = _of_file(settings.get("scenario", "")) if reward == FROM_SCENARIO else reward
    if said is None:
        return
    try:
        read_reward(said)
    except InvalidConfig as fault:
        faults = [str(fault)]
        try:
            LocalNode({**settings, "check": True}, placement).close()
        except UsageError as others:
            faults.append(str(others))
        raise InvalidConfig("\n".join(faults)) from None


def _of_file(scenario: str) -> Any:
    """The reward in a scenario's file; None where there is none to be read (the node says why)."""
    if Path(scenario).suffix not in (".yaml", ".yml"):
        return None
    try:
        found = yaml12.parse(yaml12.read_text(Path(scenario)), scenario)
    except (OSError, ValueError, InvalidConfig):
        return None
    return found.get("reward")
