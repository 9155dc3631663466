"""What is measured on: buildings by short names, each for more than seven years, so that no burst meets an end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eplus_node.config import Plan, plan, read_config
from models.points.discovery import discover
from models.scenario.episode import EpisodeFactory, EpisodeFiles, WeatherDraw
from topics.messages import Actuator

PERIOD = {"begin": "2096-07-01", "end": "2104-02-28"}  # a weather file has no 29 February; nor has 2100
DENVER = {"weather": "USA_CO_Denver", "steps_per_hour": 4}
SCENES: dict[str, dict[str, Any]] = {
    "five-zone": {"scenario": "zenostat/5zone-hot-continuous-v1"},
    "office-small": {"building": "office-small", **DENVER},
    "office-medium": {"building": "office-medium", **DENVER},
    "outpatient": {"building": "outpatient", **DENVER},
}


def settings(scene: str, sensors: int | None = None) -> dict[str, Any]:
    """The settings of a node or an environment; with `sensors`, that many of those that the model offers."""
    found = {**SCENES[scene], **PERIOD}
    return found if sensors is None else {**found, "sensors": _offered(found, sensors), "meters": {}, "reward": None}


def environment(scene: str) -> Any:
    """The scene as an environment."""
    import gymnasium as gym

    import agent_sdk  # noqa: F401  # registers the environments

    found = settings(scene)
    return gym.make(found.pop("scenario", "zenostat/Building-v1"), **found)


def _offered(found: dict[str, Any], count: int) -> dict[str, list[str]]:
    """Output variables of a model, evenly from its list."""
    checked = plan(read_config(found))
    offered = discover(checked.building, checked.sources[0].path).variables
    chosen = [offered[int(place)] for place in np.linspace(0, len(offered) - 1, count)]
    return {f"s{number}": [variable.name, variable.key] for number, variable in enumerate(chosen)}


def prepared(found: dict[str, Any], folder: Path) -> tuple[Plan, EpisodeFiles]:
    """The model and weather that EnergyPlus reads of these settings."""
    checked = plan(read_config(found))
    episodes = EpisodeFactory(checked.building, checked.period, checked.sources, {}, outputs=False)
    return checked, episodes.prepare(WeatherDraw(), folder, folder / "in.epw")


def setpoints(actuators: tuple[Actuator, ...]) -> NDArray[np.float64]:
    """20 °C for heating and 25 °C for cooling, in the actuators' order."""
    return np.tile([20.0, 25.0], len(actuators) // 2)
