"""Discover the points that EnergyPlus offers for a model."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from zenostat.models import energyplus
from zenostat.models.building.diagnostics import check_meters, suspects
from zenostat.models.building.model import Building, check_runnable, for_episode, write
from zenostat.models.building.run_needs import lacks_design_days
from zenostat.models.building.schedule_fields import DATED, missing_date
from zenostat.models.building.source_lines import locator
from zenostat.models.run_period import Period
from zenostat.models.weather import design_days
from zenostat.models.weather.header import Header, read_header
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.calendar import LEAP_YEAR
from zenostat.topics.energyplus_names import FUELS, HVAC_METERS
from zenostat.topics.errors import ModelError
from zenostat.topics.units import unit_name

_FORMAT = "3"


class Variable(NamedTuple):
    """An output variable.

    Attributes:
        system: whether it is updated each system timestep, rather than each zone timestep.
        summed: whether EnergyPlus reports its sum over the timestep, rather than its mean.
    """

    name: str
    key: str
    unit: str
    system: bool
    summed: bool


@dataclass(frozen=True, slots=True)
class MeterPoint:
    """A meter of EnergyPlus, or a sum of such meters.

    Attributes:
        index: its index in EnergyPlus's list, which is its handle; -1 for a sum.
        parts: the meters that a sum adds up, in this order; a sum of none is always 0.
    """

    name: str
    unit: str
    index: int
    parts: tuple[MeterPoint, ...] = ()

    @property
    def measured(self) -> tuple[MeterPoint, ...]:
        """EnergyPlus's own meters to add up: the parts of a sum, else this meter."""
        return (self,) if self.index >= 0 else self.parts


class ActuatorPoint(NamedTuple):
    """An actuator: component type, control type and key, in EnergyPlus's terms."""

    component_type: str
    control_type: str
    key: str
    unit: str


class InternalVariable(NamedTuple):
    """A constant of the model, read or sized: a floor area, a design flow."""

    name: str
    key: str
    unit: str


@dataclass(frozen=True)
class PointCatalog:
    """The points of one model. The keys of its dictionaries are case-folded, since EnergyPlus ignores case."""

    variables: tuple[Variable, ...]
    meters: tuple[MeterPoint, ...]
    actuators: tuple[ActuatorPoint, ...]
    internal: tuple[InternalVariable, ...] = ()

    @cached_property
    def by_variable(self) -> dict[tuple[str, str], Variable]:
        """Variables by name and key."""
        return {(v.name.casefold(), v.key.casefold()): v for v in reversed(self.variables)}

    @cached_property
    def by_actuator(self) -> dict[tuple[str, str, str], ActuatorPoint]:
        """Actuators by component type, control type and key."""
        return {
            (a.component_type.casefold(), a.control_type.casefold(), a.key.casefold()): a
            for a in reversed(self.actuators)
        }


def discover(building: Building, weather: Path) -> PointCatalog:
    """Return the points of `building`; cached. The weather file is needed only to start EnergyPlus.

    Raises:
        InvalidConfig: the model does not match the schema, runs other programs within the simulation, or has a
            transformer of a meter that it lacks.
        ModelError: EnergyPlus cannot start the model.
    """
    check_runnable(building)

    def make(target: Path) -> None:
        folder, file = target.parent, building.file or building.name
        header = read_header(weather)
        day = _any_day(building, header)
        objects = for_episode(building, day, outputs=False)
        objects["RunPeriod"]["zenostat"].pop("treat_weather_as_actual", None)
        # The year of a run period may have a fifth weekday of a month that this day's year lacks.
        for kind in (each for each in DATED if each in objects):
            named = objects[kind].items()
            objects[kind] = {name: fields for name, fields in named if not missing_date(fields, day.begin.year)}
        if lacks_design_days(objects):
            objects = design_days.apply(objects, design_days.site(weather, header))
        model = write(objects | _LISTS, folder)
        try:
            energyplus.call("survey", model, weather, target, file=file, locate=locator(file))
        except ModelError as error:
            raise ModelError("\n".join([str(error), *suspects(building)])) from None

    name = f"points/{digest(building.content, energyplus.version(), _FORMAT)}.json"
    catalog = _read(cached_bytes(name, make))
    check_meters(building, [meter.name for meter in catalog.meters if meter.index >= 0])
    return catalog


def _any_day(building: Building, header: Header) -> Period:
    """Return a day that a weather file covers, in timesteps with which EnergyPlus reads the file."""
    day = date(LEAP_YEAR if header.first == (2, 29) else LEAP_YEAR + 1, *header.first)
    steps = header.records_per_hour if header.records_per_hour > 1 else building.steps_per_hour
    return Period(day, day, 4 if 60 % steps else steps)


_LISTS = {
    "OutputControl:Files": {
        "lists": {"output_rdd": "Yes", "output_sqlite": "Yes", "output_eso": "No", "output_tabular": "No"}
    }
}


def _read(content: bytes) -> PointCatalog:
    lists = json.loads(content)
    kinds = {name.casefold(): kind for name, kind in lists["kinds"].items()}
    variables: list[Variable] = []
    meters: list[MeterPoint] = []
    actuators: list[ActuatorPoint] = []
    internal: list[InternalVariable] = []
    for point_type, name, key, control, unit in lists["points"]:
        if point_type == "OutputVariable":
            timestep_type, store_type = kinds.get(name.casefold(), ("hvac", "average"))
            variables.append(Variable(name, key, unit_name(unit), timestep_type == "hvac", store_type == "sum"))
        elif point_type == "OutputMeter":
            meters.append(MeterPoint(key, unit_name(unit), len(meters)))
        elif point_type == "Actuator":
            actuators.append(ActuatorPoint(name, control, key, unit_name(unit)))
        elif point_type == "InternalVariable":
            internal.append(InternalVariable(name, key, unit_name(unit)))
    meters += hvac_meters(meters)
    return PointCatalog(tuple(variables), tuple(meters), tuple(actuators), tuple(internal))


def hvac_meters(meters: Iterable[MeterPoint]) -> list[MeterPoint]:
    """Return the sums of `HVAC_METERS` for the fuels that a model uses; its own meters keep their names.

    The HVAC's part of a fuel that only other end uses have is a sum of no meters.
    """
    own = {meter.name.casefold(): meter for meter in meters}
    sums = []
    for fuel, (name, addends) in zip(FUELS, HVAC_METERS.items(), strict=True):
        parts = tuple(own[addend.casefold()] for addend in addends if addend.casefold() in own)
        total = own.get(f"{fuel}:Facility".casefold())
        if (parts or total) and name.casefold() not in own:
            sums.append(MeterPoint(name, (total or parts[0]).unit, -1, parts))
    return sums
