"""Run period, points and task of a fake building, as in the manifest of a real node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from zenostat.agent_sdk.testing.rc_zones import Zone
from zenostat.topics import VERSION
from zenostat.topics.calendar import parse_day
from zenostat.topics.codec import validated
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, THERMOSTAT
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import check_name, safe_name
from zenostat.topics.messages import (
    Action,
    Actuator,
    Aggregation,
    DiscreteAction,
    Manifest,
    Meter,
    Mode,
    Policy,
    Sensor,
    Task,
    Versions,
)
from zenostat.topics.points import value_index
from zenostat.topics.task_actions import default_actions, equal_steps, named_actions

HEATING, COOLING = HEATING_SETPOINT, COOLING_SETPOINT

_THERMOSTAT = THERMOSTAT
_BOUNDS = {HEATING: (15.0, 22.5), COOLING: (22.5, 30.0)}
_AIR_DEGC = (-100.0, 200.0)
_YEAR = 2017


@dataclass(frozen=True)
class RunPeriod:
    """A run period of `steps` timesteps from `begin`."""

    begin: datetime
    steps: int
    steps_per_hour: int

    @property
    def step_s(self) -> float:
        """Length of a timestep in seconds."""
        return 3600.0 / self.steps_per_hour

    @classmethod
    def read(cls, begin: str, end: str | None, steps_per_hour: int) -> RunPeriod:
        """Read a run period from its first and last day.

        Raises:
            InvalidConfig: a day is invalid, `end` is before `begin`, or the hour is not divisible by the timestep.
        """
        first, last = _day("begin", begin), _day("end", begin if end is None else end)
        if last < first:
            raise InvalidConfig(f"end = {end!r} is before begin = {begin!r}; expected a later day")
        if not 1 <= steps_per_hour <= 60 or 60 % steps_per_hour:
            raise InvalidConfig(f"steps_per_hour = {steps_per_hour}; expected a divisor of 60")
        return cls(first, 24 * ((last - first).days + 1) * steps_per_hour, steps_per_hour)


def _day(name: str, text: str) -> datetime:
    return datetime.combine(parse_day(text, name, _YEAR), datetime.min.time())


def build_manifest(
    zones: Sequence[Zone],
    run: RunPeriod,
    equipment_control: bool,  # noqa: FBT001
    control: str,
    actions: Mapping[str, Sequence[str]] | None,
    discrete: int | None,
    time: tuple[str, ...],
    reward: Mapping[str, Any] | None,
    terminate: Sequence[Mapping[str, Any]],
) -> Manifest:
    """Build the manifest of a fake building; see `FakeBuilding`."""
    actuators = _actuators(zones)
    if equipment_control:
        actuators += [_actuator("equipment", "Schedule:Constant", "Schedule Value", "EQUIPMENT", "1", (0.0, 1.0))]
    sensors, meters = _sensors(zones), _meters()
    dimensions, choices = _actions(actuators, control, actions, discrete)
    task = _task(dimensions, choices, time, reward, terminate)
    manifest = Manifest(
        node="fake",
        instance="fake",
        building="fake",
        weather="fake",
        location="nowhere",
        begin=run.begin.isoformat(),
        end=(run.begin + timedelta(hours=run.steps / run.steps_per_hour)).isoformat(),
        step_s=run.step_s,
        steps=run.steps,
        mode=Mode.LOCKSTEP,
        policy=Policy.WAIT,
        sensors=tuple(sensors),
        meters=tuple(meters),
        actuators=tuple(actuators),
        task=task,
        versions=Versions(zenostat=VERSION, energyplus="none"),
    )
    _check_termination(manifest)
    return manifest


def with_unobserved(manifest: Manifest, names: Sequence[str]) -> Manifest:
    """Return the manifest with these sensors and meters unobserved; `InvalidConfig` if there is no such point."""
    index = value_index(manifest)
    for name in names:
        if name not in index:
            raise InvalidConfig(f"unobserved: {index.unknown(name)}")
    hidden = {"observed": False}
    return manifest.model_copy(
        update={
            "sensors": tuple(s.model_copy(update=hidden) if s.name in names else s for s in manifest.sensors),
            "meters": tuple(m.model_copy(update=hidden) if m.name in names else m for m in manifest.meters),
        }
    )


def _check_termination(manifest: Manifest) -> None:
    index = value_index(manifest)
    for limit in manifest.task.terminate:
        for name in limit.points:
            if name not in index:
                raise InvalidConfig(f"terminate: {index.unknown(name)}")


def _sensors(zones: Sequence[Zone]) -> list[Sensor]:
    outdoor = _sensor("outdoor_temperature", "Site Outdoor Air Drybulb Temperature", "ENVIRONMENT", "degC", _AIR_DEGC)
    power = Sensor(
        name="hvac_and_plant_power", variable="Facility Total HVAC Electricity Demand Rate", key="WHOLE BUILDING",
        unit="W", aggregation=Aggregation.MEAN, low=0.0,
    )  # fmt: skip
    sensors = [outdoor, power]
    for zone in zones:
        name, key = check_name(zone.name, "the zone"), zone.name.upper()
        sensors.append(_sensor(f"{name}_air_temperature", "Zone Air Temperature", key, "degC", _AIR_DEGC))
        sensors.append(_sensor(f"{name}_occupants", "Zone People Occupant Count", key, "1", (0.0, None)))
    return sensors


def _sensor(name: str, variable: str, key: str, unit: str, bounds: tuple[float, float | None]) -> Sensor:
    low, high = bounds
    return Sensor(name=name, variable=variable, key=key, unit=unit, aggregation=Aggregation.INSTANT, low=low, high=high)


def _meters() -> list[Meter]:
    meters = {"electricity_facility": "Electricity:Facility", "hvac_electricity": "HVAC:Electricity"}
    return [Meter(name=name, meter=meter, unit="J", low=0.0) for name, meter in meters.items()]


def _actuators(zones: Sequence[Zone]) -> list[Actuator]:
    """Return a heating and a cooling setpoint for each zone, in this order."""
    return [
        _actuator(f"{zone.name}_{safe_name(kind)}", _THERMOSTAT, kind, zone.name.upper(), "degC", bounds)
        for zone in zones
        for kind, bounds in _BOUNDS.items()
    ]


def _actuator(name: str, component: str, control: str, key: str, unit: str, bounds: tuple[float, float]) -> Actuator:
    feedback = f"Zone Thermostat {control} Temperature" if component == _THERMOSTAT else control
    return Actuator(
        name=name, component_type=component, control_type=control, key=key, unit=unit,
        low=bounds[0], high=bounds[1], feedback=feedback,
    )  # fmt: skip


def _actions(
    actuators: Sequence[Actuator], control: str, groups: Mapping[str, Sequence[str]] | None, discrete: int | None
) -> tuple[tuple[Action, ...], tuple[DiscreteAction, ...]]:
    if control not in ("point", "zone", "building"):
        raise InvalidConfig(f"control = {control!r}; expected 'point', 'zone' or 'building'")
    if discrete is not None and not 2 <= discrete <= 1000:
        raise InvalidConfig(f"discrete = {discrete}; expected 2 to 1000 steps")
    errors: list[str] = []
    if groups is None:
        actions = default_actions(actuators, control, errors)
    else:
        actions = named_actions(groups, actuators, errors)
    choices = () if discrete is None else equal_steps(actions, actuators, control, discrete, errors)
    if errors:
        raise InvalidConfig("\n".join(errors))
    return actions, choices


def _task(
    actions: tuple[Action, ...],
    choices: tuple[DiscreteAction, ...],
    time: tuple[str, ...],
    reward: Mapping[str, Any] | None,
    terminate: Sequence[Mapping[str, Any]],
) -> Task:
    limits = [
        {**{k: v for k, v in limit.items() if k != "duration_h"}, "duration_s": 3600.0 * limit.get("duration_h", 0.0)}
        for limit in terminate
    ]
    fields = {
        "time": time,
        "actions": actions,
        "discrete_actions": choices,
        "reward": None if reward is None else dict(reward),
        "terminate": limits,
    }
    return validated(Task, fields, "the fake building's task")
