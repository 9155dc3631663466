"""Describe a model for an engineer: version, zones, systems, controls, schedules, and diagnostics, without a run."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from zenostat.models import schema
from zenostat.models.building import systems
from zenostat.models.building.conflicts import ProgramOverrides, thermostat_setpoints
from zenostat.models.building.diagnostics import Diagnostic, Severity, cached_diagnostics
from zenostat.models.building.geometry import BuildingGeometry, building_geometry
from zenostat.models.building.locations import texts
from zenostat.models.building.model import Building
from zenostat.models.building.run_needs import assumptions
from zenostat.models.building.source_lines import read_source
from zenostat.models.building.summary import BuildingSummary, building_summary, zone_areas, zone_multipliers
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.models.weather.header import Header
from zenostat.topics.energyplus_names import SCHEDULE_VALUE, THERMOSTAT

_SCHEDULE_PARTS = ("Schedule:Day", "Schedule:Week")


@dataclass(frozen=True, slots=True)
class ZoneDescription:
    """A zone, its thermostat, and its equipment.

    Attributes:
        storey: index of its storey, from 0 at the bottom.
        area_m2: floor area, without the multiplier.
        multiplier: number of identical zones that it stands for.
        setpoints: schedules of its thermostat, by `heating setpoint` and `cooling setpoint`; `A or B` if the
            schedule depends on the control type.
        air_loops: air loops that supply it.
        equipment: its equipment, terminal units included.
    """

    name: str
    storey: int
    area_m2: float
    multiplier: float
    is_conditioned: bool
    setpoints: Mapping[str, str]
    air_loops: tuple[str, ...]
    equipment: tuple[systems.System, ...]


@dataclass(frozen=True, slots=True)
class ScheduleDescription:
    """A schedule, and the types of the objects that use it with their numbers."""

    name: str
    kind: str
    uses: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Actuatable:
    """A control that a controller can set.

    Attributes:
        component_type, control_type, key: EnergyPlus's names of the actuator.
        acts_on: the zone, or the objects that follow the schedule.
        conflicts: what in the model may set it as well.
    """

    component_type: str
    control_type: str
    key: str
    acts_on: str
    conflicts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ModelDescription:
    """Contents of a model.

    Attributes:
        name, file: of the catalog entry; the file is empty if there is none.
        version: EnergyPlus version of the file; empty if it has none.
        notes: what was converted.
        storeys: heights of the storeys' floors in m.
        setpoint_managers, programs: objects that control the building, as `TYPE NAME`.
        actuators: thermostats and schedules that a controller can set; `zenostat points` lists all.
        assumptions: what a run of the model assumes.
        geometry: the surfaces, or the reason why there are none.
    """

    name: str
    file: str
    version: str
    notes: tuple[str, ...]
    summary: BuildingSummary
    storeys: tuple[float, ...]
    zones: tuple[ZoneDescription, ...]
    air_loops: tuple[systems.System, ...]
    plant_loops: tuple[systems.System, ...]
    setpoint_managers: tuple[str, ...]
    programs: tuple[str, ...]
    schedules: tuple[ScheduleDescription, ...]
    actuators: tuple[Actuatable, ...]
    assumptions: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...]
    geometry: BuildingGeometry


def file_version(path: Path) -> str:
    """Return the EnergyPlus version that a model file names; empty if it names none."""
    versions = schema.matching_part({"Version": read_source(path).objects.get("Version", {})}).get("Version", {})
    return next((str(fields.get("version_identifier", "")) for fields in versions.values()), "")


def describe_model(building: Building, version: str) -> ModelDescription:
    """Describe a model; takes a fraction of a second.

    Args:
        building: the model, in the format of the installed engine.
        version: EnergyPlus version of the user's file.
    """
    diagnostics = tuple(cached_diagnostics(building))
    if any(each.severity is Severity.ERROR for each in diagnostics):
        building = replace(building, objects=schema.matching_part(building.objects))
    objects = building.objects
    geometry = building_geometry(building, _place(objects))
    schedules = tuple(_schedules(objects))
    return ModelDescription(
        name=building.name,
        file=building.file,
        version=version,
        notes=building.notes,
        summary=building_summary(building),
        storeys=tuple(geometry.geometry.storeys) if geometry.geometry is not None else (),
        zones=tuple(_zones(objects, geometry)),
        air_loops=tuple(systems.air_loops(objects)),
        plant_loops=tuple(systems.plant_loops(objects)),
        setpoint_managers=tuple(_named(objects, "SetpointManager:")),
        programs=(*_named(objects, "EnergyManagementSystem:Program"), *_named(objects, "PythonPlugin:Instance")),
        schedules=schedules,
        actuators=tuple(_actuators(objects, schedules)),
        assumptions=tuple(assumptions(objects, has_dates=False)),
        diagnostics=diagnostics,
        geometry=geometry,
    )


def _place(objects: ModelObjects) -> Header:
    """Return the location of the model itself; a weather file of a scenario replaces it."""
    fields: Mapping[str, Any] = next(iter(objects.get("Site:Location", {}).values()), {})
    latitude, longitude, zone, elevation = (
        float(fields.get(name, 0.0)) for name in ("latitude", "longitude", "time_zone", "elevation")
    )
    return Header("", latitude, longitude, zone, elevation, (1, 1), (12, 31))


def _zones(objects: ModelObjects, geometry: BuildingGeometry) -> Iterator[ZoneDescription]:
    places = {zone.name: zone for zone in geometry.geometry.zones} if geometry.geometry is not None else {}
    areas, multipliers = zone_areas(objects), zone_multipliers(objects)
    setpoints: dict[str, dict[str, str]] = defaultdict(dict)
    for (zone, control), schedule in _setpoints(objects).items():
        setpoints[zone][control] = schedule
    equipment = {zone.casefold(): parts for zone, parts in systems.zone_equipment(objects).items()}
    loops: dict[str, list[str]] = defaultdict(list)
    for loop in systems.air_loops(objects):
        for part in loop.parts:
            if part.kind == "Zone":
                loops[part.name.casefold()].append(loop.name)
    for name in objects.get("Zone", {}):
        folded, place = name.casefold(), places.get(name)
        yield ZoneDescription(
            name=name,
            storey=place.storey if place is not None else 0,
            area_m2=areas[name],
            multiplier=multipliers[name],
            is_conditioned=place.is_conditioned if place is not None else folded in equipment,
            setpoints=setpoints.get(folded, {}),
            air_loops=tuple(loops.get(folded, ())),
            equipment=tuple(equipment.get(folded, ())),
        )


def _named(objects: ModelObjects, prefix: str) -> Iterator[str]:
    for kind, items in objects.items():
        if kind == prefix or (prefix.endswith(":") and kind.startswith(prefix)):
            yield from (f"{kind} {name}" for name in items)


def _schedule_types(objects: ModelObjects) -> list[str]:
    return [kind for kind in objects if kind.startswith("Schedule:") and not kind.startswith(_SCHEDULE_PARTS)]


def _schedules(objects: ModelObjects) -> Iterator[ScheduleDescription]:
    names = {name.casefold() for kind in _schedule_types(objects) for name in objects[kind]}
    uses: dict[str, Counter[str]] = defaultdict(Counter)
    for kind, items in objects.items():
        if kind.startswith(("Schedule:", "Output")):
            continue
        for fields in items.values():
            for text in {text.casefold() for field, text in texts(fields) if field != "name"} & names:
                uses[text][kind] += 1
    for kind in _schedule_types(objects):
        for name in objects[kind]:
            yield ScheduleDescription(name, kind, dict(uses[name.casefold()].most_common()))


def _setpoints(objects: ModelObjects) -> dict[tuple[str, str], str]:
    """Return the schedule of each thermostat's setpoint by zone (case-folded) and control, or its schedules: `A or B`.

    A thermostat with several control types can have a setpoint, and a schedule of it, in each of them.
    """
    spelled = {name.casefold(): name for kind in _schedule_types(objects) for name in objects[kind]}
    schedules: dict[tuple[str, str], dict[str, None]] = defaultdict(dict)
    for zone, control, schedule in thermostat_setpoints(objects):
        schedules[zone, control][spelled.get(schedule, schedule)] = None
    return {setpoint: " or ".join(names) for setpoint, names in schedules.items()}


def _actuators(objects: ModelObjects, schedules: tuple[ScheduleDescription, ...]) -> Iterator[Actuatable]:
    """Yield the setpoints of thermostats, then the schedules that something uses."""
    overrides = ProgramOverrides(objects)
    zones = {name.casefold(): name for name in objects.get("Zone", {})}
    for (zone, control), schedule in _setpoints(objects).items():
        key, control_type = zones.get(zone, zone), control.title()
        conflicts = tuple(overrides.reasons(THERMOSTAT, control_type, key))
        yield Actuatable(THERMOSTAT, control_type, key, f"{control} of zone {key} (schedule {schedule})", conflicts)
    for each in schedules:
        if each.uses:
            users = ", ".join(f"{count} {kind}" for kind, count in each.uses.items())
            conflicts = tuple(overrides.reasons(each.kind, SCHEDULE_VALUE, each.name))
            yield Actuatable(each.kind, SCHEDULE_VALUE, each.name, users, conflicts)
