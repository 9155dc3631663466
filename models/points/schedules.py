"""Values of the building's own schedules: they depend on time alone, so they are known before the simulation runs."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.models import energyplus
from zenostat.models.building.conflicts import ProgramOverrides, thermostat_setpoints, thermostats
from zenostat.models.building.external_files import versions_of_files
from zenostat.models.building.model import Building, for_episode, write
from zenostat.models.building.source_lines import locator
from zenostat.models.input_format.source_model import ObjectsOfType
from zenostat.models.points.selection import Points
from zenostat.models.run_period import Period
from zenostat.topics.arrays import Floats
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, SCHEDULE_VALUE, THERMOSTAT
from zenostat.topics.errors import ErrorCollector, InvalidConfig
from zenostat.topics.keys import MAX_NAME, safe_name
from zenostat.topics.messages import Actuator, Aggregation, Sensor

_KEPT = (
    "Version",
    "Building",
    "GlobalGeometryRules",
    "Timestep",
    "RunPeriod",
    "RunPeriodControl:SpecialDays",
    "RunPeriodControl:DaylightSavingTime",
    "ScheduleTypeLimits",
)
"""Objects, besides the schedules, that determine the value of a schedule."""

_CONTROL_TYPES = {HEATING_SETPOINT: (1.0, 3.0, 4.0), COOLING_SETPOINT: (2.0, 3.0, 4.0)}
"""Values of a thermostat's control type schedule with which it has this setpoint (Input Output Reference,
ZoneControl:Thermostat)."""

_MODIFIERS = (
    "ZoneControl:Thermostat:OperativeTemperature",
    "ZoneControl:Thermostat:ThermalComfort",
    "ZoneControl:Thermostat:TemperatureAndHumidity",
    "ZoneControl:Thermostat:StagedDualSetpoint",
    "AvailabilityManager:OptimumStart",
    "DemandManager:Thermostats",
    "FaultModel:ThermostatOffset",
)
"""Objects that move a thermostat's setpoint away from its schedule."""

_HOLIDAYS = b"HOLIDAYS/DAYLIGHT SAVINGS"
_FORMAT = "1"
_LEAD_TOLERANCE_S = 0.5
_MOST_RECENT = 16
_RECENT: dict[tuple[object, ...], dict[int, list[float]]] = {}
"""Values of the episodes that started last: resets by a fork take milliseconds."""


def schedule_values(building: Building, period: Period, weather: Path, names: list[str]) -> Floats:
    """Return the values of schedules in each timestep of a run period, as EnergyPlus computes them; cached.

    Args:
        building: the model.
        period: the run period.
        weather: its weather file, whose holidays and daylight saving time the run period may use.
        names: the schedules, in any case.

    Returns:
        Shape (timesteps, schedules), float64.

    Raises:
        ModelError: EnergyPlus cannot read a schedule.
    """
    objects = _schedules_alone(for_episode(building, period))

    def make(target: Path) -> None:
        model = write(objects, target.parent)
        file = building.file or building.name
        energyplus.call("schedules", model, json.dumps(names), weather, target, file=file, locate=locator(file))

    content = json.dumps([objects, names], sort_keys=True)
    key = digest(content, _holidays(weather), energyplus.version(), _FORMAT, *versions_of_files(objects))
    return np.frombuffer(cached_bytes(f"schedules/{key}.f64", make), np.float64).reshape(period.steps, len(names))


def _schedules_alone(objects: dict[str, ObjectsOfType]) -> dict[str, ObjectsOfType]:
    kept = {
        kind: items
        for kind, items in objects.items()
        if kind in _KEPT or (kind.startswith("Schedule:") and kind != "Schedule:File:Shading")
    }
    no = ("do_zone_sizing_calculation", "do_system_sizing_calculation", "do_plant_sizing_calculation")
    control = dict.fromkeys((*no, "run_simulation_for_sizing_periods"), "No")
    control["run_simulation_for_weather_file_run_periods"] = "Yes"
    return kept | {"SimulationControl": {"zenostat": control}}


def scheduled_values(points: Points, building: Building, period: Period, weather: Path) -> dict[int, list[float]]:
    """Return, for each sensor with a lead by position, its value at each sample, from sample 0 on.

    At the end of the run period, a schedule keeps the value of the last timestep.
    """
    leading = {i: sensor for i, sensor in enumerate(points.sensors) if sensor.lead_s}
    if not leading:
        return {}
    places = tuple((i, sensor.key, sensor.lead_s) for i, sensor in leading.items())
    files = tuple(versions_of_files(building.objects))
    key = (building.content, files, period, _holidays(weather), places)
    if key not in _RECENT:
        names = sorted({sensor.key for sensor in leading.values()})
        values = schedule_values(building, period, weather, names)
        samples = np.arange(period.steps + 1)
        while len(_RECENT) >= _MOST_RECENT:
            _RECENT.pop(next(iter(_RECENT)), None)
        _RECENT[key] = {
            i: values[np.minimum(samples + _timesteps(s, period) - 1, period.steps - 1), names.index(s.key)].tolist()
            for i, s in leading.items()
        }
    return _RECENT[key]


def _holidays(weather: Path) -> bytes:
    """Return the line of a weather file's header with its holidays and daylight saving time; empty without one."""
    with weather.open("rb") as file:
        return next((line for line in islice(file, 8) if line.startswith(_HOLIDAYS)), b"")


def _timesteps(sensor: Sensor, period: Period) -> int:
    return round(sensor.lead_s / period.step_s)


def with_leads(points: Points, leads_h: Mapping[str, float], building: Building, period: Period) -> Points:
    """Return the points with these sensors, by name, reporting their schedule so many hours ahead.

    Raises:
        InvalidConfig: a sensor is no schedule, its schedule is not known beforehand, or a lead is no multiple of the
            timestep.
    """
    schedules, errors = ScheduleNames(building), ErrorCollector()

    def lead(sensor: Sensor) -> Sensor:
        seconds = 3600.0 * leads_h[sensor.name]
        count = round(seconds / period.step_s)
        if sensor.variable != SCHEDULE_VALUE:
            raise InvalidConfig(f"sensor {sensor.name!r}: lead_h is for {SCHEDULE_VALUE!r}, not {sensor.variable!r}")
        if count < 1 or abs(seconds - count * period.step_s) > _LEAD_TOLERANCE_S:
            raise InvalidConfig(
                f"sensor {sensor.name!r}: lead_h = {leads_h[sensor.name]:g} is no multiple of the timestep of "
                f"{period.step_s:g} s"
            )
        try:
            key = schedules.check(sensor.key)
        except InvalidConfig as error:
            raise InvalidConfig(f"sensor {sensor.name!r}: {error}") from None
        return sensor.model_copy(
            update={"key": key, "lead_s": count * period.step_s, "aggregation": Aggregation.INSTANT}
        )

    sensors = [
        (errors.collect(lambda s=s: lead(s)) or s) if s.name in leads_h else s  # type: ignore[misc]
        for s in points.sensors
    ]
    errors.raise_if_any()
    return replace(points, sensors=tuple(sensors))


def with_baseline_sensors(
    points: Points, names: Collection[str], fixed: Collection[str], building: Building, period: Period, weather: Path
) -> Points:
    """Return the points with, for these actuators, a sensor of their value under baseline control in the next timestep.

    Actuators that follow the same schedule share a sensor. The bounds of the actuators are widened to that schedule, so
    that an offset starts from the baseline; where heating and cooling setpoints meet, they stay.

    Args:
        points: the points of a run.
        names: the actuators.
        fixed: actuators whose bounds the user has set: these stay as they are.
        building: the model.
        period: the run period.
        weather: a weather file of the scenario.

    Raises:
        InvalidConfig: the value of an actuator under baseline control depends on more than time; lists all of them.
        ModelError: EnergyPlus cannot read a schedule.
    """
    schedules, errors = ScheduleNames(building), ErrorCollector()
    by_name = {actuator.name: actuator for actuator in points.actuators}

    def find(name: str) -> tuple[str, tuple[str, tuple[float, ...]] | None]:
        try:
            return schedules.of_actuator(by_name[name]), schedules.control_type(by_name[name])
        except InvalidConfig as error:
            raise InvalidConfig(
                f"actuator {name!r} cannot be set relative to the building's own control: {error}"
            ) from None

    collected = ((name, errors.collect(lambda name=name: find(name))) for name in names)  # type: ignore[misc]
    followed = {name: schedule for name, schedule in collected if schedule is not None}
    errors.raise_if_any()
    needed = {own for own, _ in followed.values()} | {control[0] for _, control in followed.values() if control}
    columns = sorted(needed)
    values = dict(zip(columns, schedule_values(building, period, weather, columns).T, strict=True))
    sensors, actuators = list(points.sensors), dict(by_name)
    for name, (own, control) in followed.items():
        if control and not np.isin(values[control[0]], control[1]).all():
            errors.errors.append(
                InvalidConfig(
                    f"actuator {name!r} cannot be set relative to the building's own control: its schedule "
                    f"{control[0]!r} switches the setpoint off at times"
                )
            )
            continue
        sensor = _next_value(sensors, own, by_name[name].unit, period)
        widened = {} if name in fixed else _widened(by_name[name], values[own])
        actuators[name] = by_name[name].model_copy(update={"baseline_sensor": sensor.name, **widened})
    errors.raise_if_any()
    added = len(sensors) - len(points.sensors)
    return replace(
        points, sensors=tuple(sensors), system=(*points.system, *[False] * added), actuators=tuple(actuators.values())
    )


def _next_value(sensors: list[Sensor], schedule: str, unit: str, period: Period) -> Sensor:
    """Return the sensor of a schedule's value in the next timestep; without one, append it."""
    for sensor in sensors:
        if sensor.lead_s and sensor.key == schedule and _timesteps(sensor, period) == 1:
            return sensor
    taken, base = {sensor.name for sensor in sensors}, f"{safe_name(schedule)[: MAX_NAME - len('_next_999')]}_next"
    name = next(n for n in (base, *(f"{base}_{i}" for i in range(2, len(taken) + 3))) if n not in taken)
    sensors.append(Sensor(name=name, variable=SCHEDULE_VALUE, key=schedule, unit=unit, lead_s=period.step_s))
    return sensors[-1]


def _widened(actuator: Actuator, values: Floats) -> dict[str, float]:
    widened = {}
    if actuator.low is not None and actuator.control_type != COOLING_SETPOINT:
        widened["low"] = min(actuator.low, float(values.min()))
    if actuator.high is not None and actuator.control_type != HEATING_SETPOINT:
        widened["high"] = max(actuator.high, float(values.max()))
    return widened


class ScheduleNames:
    """The schedules of a building whose values depend on time alone, and the actuators that follow one."""

    def __init__(self, building: Building) -> None:
        self._objects = building.objects
        self._overrides = ProgramOverrides(building.objects)
        self._names = {
            name.casefold(): (kind, name)
            for kind, items in building.objects.items()
            if kind.startswith("Schedule:") and not kind.startswith(("Schedule:Day", "Schedule:Week"))
            for name in items
        }

    def check(self, name: str) -> str:
        """Return the name of a schedule as the model spells it.

        Raises:
            InvalidConfig: there is no such schedule, or a program of the model sets it.
        """
        if name.casefold() not in self._names:
            raise InvalidConfig(f"the model has no schedule {name!r} whose values are known beforehand")
        kind, own = self._names[name.casefold()]
        for reason in self._overrides.reasons(kind, SCHEDULE_VALUE, own):
            raise InvalidConfig(f"schedule {own!r} is not known beforehand: {reason}")
        return own

    def of_actuator(self, actuator: Actuator) -> str:
        """Return the schedule that sets an actuator's control while nobody commands it.

        Raises:
            InvalidConfig: it depends on more than time; the text says on what.
        """
        if actuator.control_type == SCHEDULE_VALUE:
            return self.check(actuator.key)
        if actuator.component_type != THERMOSTAT or actuator.control_type not in _CONTROL_TYPES:
            raise InvalidConfig("only schedules, and setpoints of thermostats that follow one, are known beforehand")
        for reason in self._overrides.reasons(actuator.component_type, actuator.control_type, actuator.key):
            raise InvalidConfig(reason)
        zone, control = actuator.key.casefold(), actuator.control_type.casefold()
        schedules = {
            name for own, setpoint, name in thermostat_setpoints(self._objects) if (own, setpoint) == (zone, control)
        }
        if len(schedules) != 1:
            raise InvalidConfig(f"the thermostat has {len(schedules)} schedules for this setpoint; expected one")
        for what in self._modifiers(zone):
            raise InvalidConfig(f"{what} moves the setpoint with the state of the building")
        return self.check(schedules.pop())

    def control_type(self, actuator: Actuator) -> tuple[str, tuple[float, ...]] | None:
        """Return the schedule that switches a setpoint, and the values that leave it on; None of another actuator."""
        if actuator.component_type != THERMOSTAT:
            return None
        _, fields = next(thermostats(self._objects, actuator.key.casefold()))
        return self.check(str(fields["control_type_schedule_name"])), _CONTROL_TYPES[actuator.control_type]

    def _modifiers(self, zone: str) -> Iterator[str]:
        """Yield what may move the setpoints of a zone (a case-folded name) away from their schedules."""
        own = {name.casefold(): fields for name, fields in thermostats(self._objects, zone)}
        for name, fields in own.items():
            if float(fields.get("temperature_difference_between_cutout_and_setpoint") or 0.0):
                yield f"the difference between cutout and setpoint of ZoneControl:Thermostat {name!r}"
        for kind in _MODIFIERS:
            for name, fields in self._objects.get(kind, {}).items():
                if kind.startswith("AvailabilityManager") or not {zone, *own}.isdisjoint(_texts(fields)):
                    yield f"{kind} {name!r}"


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts of an object, case-folded, also those in lists of groups."""
    if isinstance(value, str):
        yield value.casefold()
    elif isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(part)
