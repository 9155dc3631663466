"""Everything that EnergyPlus offers for a model, from the engine's own lists; seconds, then cached."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from models import energyplus
from models.building import Building, prepared, write
from models.period import Period
from models.store import digest, made
from topics.units import unit_name

_FORMAT = "1"


@dataclass(frozen=True, slots=True)
class Variable:
    """An output variable.

    `system`: updated each system timestep (else each zone timestep); `summed`: reported as a sum over the
    timestep (else as a mean).
    """

    name: str
    key: str
    unit: str
    system: bool
    summed: bool


@dataclass(frozen=True, slots=True)
class MeterPoint:
    """A meter and its place in EnergyPlus's list, which is its handle."""

    name: str
    unit: str
    index: int


@dataclass(frozen=True, slots=True)
class ActuatorPoint:
    """An actuator: component type, control type and key, as EnergyPlus calls them."""

    component_type: str
    control_type: str
    key: str
    unit: str


@dataclass(frozen=True, slots=True)
class Survey:
    """The points of one model."""

    variables: tuple[Variable, ...]
    meters: tuple[MeterPoint, ...]
    actuators: tuple[ActuatorPoint, ...]


def survey(building: Building, weather: Path) -> Survey:
    """The points of `building`. The weather only serves to start EnergyPlus."""

    def make(target: Path) -> None:
        folder = target.parent
        day = date(2017, 1, 1)
        model = write(prepared(building, Period(day, day, building.steps_per_hour), outputs=False) | _LISTS, folder)
        energyplus.call("survey", model, weather, target)

    name = f"points/{digest(building.content, energyplus.version(), _FORMAT)}.json"
    return _read(made(name, make))


_LISTS = {"OutputControl:Files": {"lists": {"output_rdd": "Yes", "output_eso": "No", "output_tabular": "No"}}}


def _read(path: Path) -> Survey:
    found = json.loads(path.read_bytes())
    kinds = {name.casefold(): kind for name, kind in found["kinds"].items()}
    variables: list[Variable] = []
    meters: list[MeterPoint] = []
    actuators: list[ActuatorPoint] = []
    for what, name, key, control, unit in found["points"]:
        if what == "OutputVariable":
            where, how = kinds.get(name.casefold(), ("hvac", "average"))
            variables.append(Variable(name, key, unit_name(unit), where == "hvac", how == "sum"))
        elif what == "OutputMeter":
            meters.append(MeterPoint(key, unit_name(unit), len(meters)))
        elif what == "Actuator":
            actuators.append(ActuatorPoint(name, control, key, unit_name(unit)))
    return Survey(tuple(variables), tuple(meters), tuple(actuators))
