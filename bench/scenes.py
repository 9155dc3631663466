"""The measured scenes: buildings by short names, with run periods of over seven years, which no benchmark reaches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import Plan, plan
from zenostat.models.points.discovery import discover
from zenostat.models.scenario.episode_weather import EpisodeFactory, EpisodeFiles, WeatherDraw
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Actuator

# Without a 29 February, which weather files lack; 2100 is not a leap year.
PERIOD = {"begin": "2097-01-01", "end": "2104-02-28"}
DENVER = {"weather": "USA_CO_Denver", "steps_per_hour": 4}
SCENES: dict[str, dict[str, Any]] = {
    "five-zone": {"scenario": "zenostat/5zone-hot-continuous-v1"},
    "office-small": {"building": "office-small", **DENVER},
    "office-medium": {"building": "office-medium", **DENVER},
    "outpatient": {"building": "outpatient", **DENVER},
}


def settings(scene: str, sensors: int | None = None) -> dict[str, Any]:
    """Return the settings of a node or an environment; with `sensors`, that many output variables of the model."""
    base = {**SCENES[scene], **PERIOD}
    return (
        base if sensors is None else {**base, "sensors": _select_sensors(base, sensors), "meters": {}, "reward": None}
    )


def environment(scene: str) -> Any:
    """Create the environment of a scene."""
    import gymnasium as gym

    import zenostat  # noqa: F401  # registers the environments

    arguments = settings(scene)
    return gym.make(arguments.pop("scenario", "zenostat/Building-v1"), **arguments)


def _select_sensors(node_settings: dict[str, Any], count: int) -> dict[str, list[str]]:
    """Select output variables of a model, evenly spaced in its list."""
    checked = plan(read_config(node_settings))
    offered = discover(checked.building, checked.sources[0].path).variables
    chosen = [offered[int(index)] for index in np.linspace(0, len(offered) - 1, count)]
    return {f"s{number}": [variable.name, variable.key] for number, variable in enumerate(chosen)}


def prepared(node_settings: dict[str, Any], folder: Path) -> tuple[Plan, EpisodeFiles]:
    """Write the model and weather that EnergyPlus reads with these settings."""
    checked = plan(read_config(node_settings))
    episodes = EpisodeFactory(checked.building, checked.period, checked.sources, {}, outputs=False)
    return checked, episodes.prepare(WeatherDraw(), folder, folder / "in.epw")


def setpoints(actuators: tuple[Actuator, ...]) -> Floats:
    """Return 20 °C for heating and 25 °C for cooling, in the order of the actuators."""
    return np.tile([20.0, 25.0], len(actuators) // 2)
