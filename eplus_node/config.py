"""What a node is asked to simulate and how, and the checking of it before anything starts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bridge.affinity import Affinity
from bridge.session import DEFAULT_ENDPOINT
from models import building, catalog, points, survey, weather
from models.building import Building
from models.catalog import Entry
from models.period import Period
from models.points import Points
from models.weather import Header
from topics.codec import explain
from topics.errors import InvalidConfig, UnknownName
from topics.keys import check_name
from topics.messages import Mode


class NodeConfig(BaseModel):
    """The settings of a node. Points left out (None) are found in the model."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    building: str
    weather: str
    name: str = "building"
    begin: str | None = None
    end: str | None = None
    steps_per_hour: int | None = None
    sensors: dict[str, list[str]] | None = None
    meters: dict[str, str] | None = None
    actuators: dict[str, list[str | float | None]] | None = None
    mode: Mode = Mode.LOCKSTEP
    listen: list[str] = Field(default_factory=lambda: [DEFAULT_ENDPOINT])
    connect: list[str] = Field(default_factory=list)
    expose: bool = False
    keep: Path | None = None
    folder: Path | None = None
    affinity: Affinity = Affinity.APART
    cpu: int | None = None
    engine_cpu: int | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked configuration: everything that can be known before EnergyPlus runs."""

    config: NodeConfig
    building: Building
    weather: Path
    weather_name: str
    header: Header
    period: Period
    points: Points


def read_config(settings: dict[str, Any]) -> NodeConfig:
    """The settings as a `NodeConfig`; `InvalidConfig` names all faults at once."""
    try:
        return NodeConfig.model_validate(settings)
    except ValidationError as error:
        raise InvalidConfig(explain(error)) from None


def _find(config: NodeConfig) -> tuple[Entry, Entry]:
    """The building's and the weather's file; `UnknownName` names both if both are unknown."""
    found, missing = [], []
    for find, text in ((catalog.find_building, config.building), (catalog.find_weather, config.weather)):
        try:
            found.append(find(text))
        except UnknownName as error:
            missing.append(str(error))
    if missing:
        raise UnknownName("\n".join(missing))
    return found[0], found[1]


def plan(config: NodeConfig) -> Plan:
    """Finds and checks the building, the weather, the run period and the points.

    Raises:
        UnknownName: a building, weather or point that is not there.
        InvalidConfig: settings that cannot be.
        ModelRefused: a model that EnergyPlus cannot read.
    """
    check_name(config.name, "the node's name")
    model_entry, weather_entry = _find(config)
    header = weather.read_header(weather_entry.path)
    model = building.read_building(model_entry)
    period = model.period(config.begin, config.end, config.steps_per_hour)
    weather.check_covers(header, period, weather_entry.name)
    if config.keep is not None and config.keep.exists() and not config.keep.is_dir():
        raise InvalidConfig(f"keep={config.keep} is a file; name a folder")
    chosen = points.choose(
        model, survey.survey(model, weather_entry.path), config.sensors, config.meters, config.actuators
    )
    return Plan(config, model, weather_entry.path, weather_entry.name, header, period, chosen)
