"""The run period, points and task of a fake building, as a real node says them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from pydantic import ValidationError

import topics
from agent_sdk.testing.rc_zones import Zone
from topics.codec import describe_validation_errors
from topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, THERMOSTAT
from topics.errors import InvalidConfig, did_you_mean
from topics.keys import check_name
from topics.messages import (
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
    TerminationLimit,
    Versions,
)

HEATING, COOLING = HEATING_SETPOINT, COOLING_SETPOINT

_THERMOSTAT = THERMOSTAT
_BOUNDS = {HEATING: (15.0, 22.5), COOLING: (22.5, 30.0)}
_AIR_DEGC = (-100.0, 200.0)
_YEAR = 2017


@dataclass(frozen=True)
class Run:
    """From `begin` on, `steps` timesteps."""

    begin: datetime
    steps: int
    steps_per_hour: int

    @property
    def step_s(self) -> float:
        """Length of a timestep in seconds."""
        return 3600.0 / self.steps_per_hour

    @classmethod
    def read(cls, begin: str, end: str | None, steps_per_hour: int) -> Run:
        """Both days included; `InvalidConfig` if they are none, or the wrong way round."""
        first, last = _day("begin", begin), _day("end", begin if end is None else end)
        if last < first:
            raise InvalidConfig(f"end = {end!r} lies before begin = {begin!r}; a later day expected")
        if not 1 <= steps_per_hour <= 60 or 60 % steps_per_hour:
            raise InvalidConfig(f"steps_per_hour = {steps_per_hour}; a divisor of 60 expected")
        return cls(first, 24 * ((last - first).days + 1) * steps_per_hour, steps_per_hour)


def _day(what: str, text: str) -> datetime:
    try:
        return datetime.strptime(text if len(text) > 5 else f"{_YEAR}-{text}", "%Y-%m-%d")
    except ValueError:
        raise InvalidConfig(f"{what} = {text!r}; MM-DD or YYYY-MM-DD expected") from None


def manifest_of(
    zones: Sequence[Zone],
    run: Run,
    dimming: bool,  # noqa: FBT001
    control: str,
    actions: Mapping[str, Sequence[str]] | None,
    discrete: int | None,
    time: tuple[str, ...],
    reward: Mapping[str, Any] | None,
    terminate: Sequence[Mapping[str, Any]],
) -> Manifest:
    """All that a fake building says of itself; see `FakeBuilding`."""
    actuators = _actuators(zones)
    if dimming:
        actuators += [_actuator("equipment", "Schedule:Constant", "Schedule Value", "EQUIPMENT", "1", (0.0, 1.0))]
    sensors, meters = _sensors(zones), _meters()
    made = _found(actuators, control) if actions is None else _named(actuators, actions)
    task = _task(made, _steps(made, actuators, control, discrete), time, reward, terminate)
    known = {s.name for s in sensors} | {m.name for m in meters}
    for limit in task.terminate:
        for name in limit.points:
            if name not in known:
                raise InvalidConfig(f"terminate: there is no sensor or meter {name!r}; {did_you_mean(name, known)}")
    return Manifest(
        node="fake",
        instance="fake",
        building="fake",
        weather="fake",
        location="nowhere",
        begin=run.begin.isoformat(),
        end=(run.begin + timedelta(hours=run.steps / run.steps_per_hour)).isoformat(),
        steps_per_hour=run.steps_per_hour,
        steps=run.steps,
        mode=Mode.LOCKSTEP,
        policy=Policy.WAIT,
        sensors=tuple(sensors),
        meters=tuple(meters),
        actuators=tuple(actuators),
        task=task,
        versions=Versions(zenostat=topics.VERSION, energyplus="none"),
    )


def _sensors(zones: Sequence[Zone]) -> list[Sensor]:
    outdoor = _sensor("outdoor_temperature", "Site Outdoor Air Drybulb Temperature", "ENVIRONMENT", "degC", _AIR_DEGC)
    power = Sensor(
        name="hvac_electricity_power", variable="Facility Total HVAC Electricity Demand Rate", key="WHOLE BUILDING",
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
    named = {"electricity_facility": "Electricity:Facility", "electricity_hvac": "Electricity:HVAC"}
    return [Meter(name=name, meter=meter, unit="J", low=0.0) for name, meter in named.items()]


def _actuators(zones: Sequence[Zone]) -> list[Actuator]:
    """A heating and a cooling setpoint for each zone, in that order."""
    return [
        _actuator(f"{zone.name}_{_safe(kind)}", _THERMOSTAT, kind, zone.name.upper(), "degC", bounds)
        for zone in zones
        for kind, bounds in _BOUNDS.items()
    ]


def _actuator(name: str, component: str, control: str, key: str, unit: str, bounds: tuple[float, float]) -> Actuator:
    feedback = f"Zone Thermostat {control} Temperature" if component == _THERMOSTAT else control
    return Actuator(
        name=name, component_type=component, control_type=control, key=key, unit=unit,
        low=bounds[0], high=bounds[1], feedback=feedback,
    )  # fmt: skip


def _safe(kind: str) -> str:
    return kind.lower().replace(" ", "_")


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
    try:
        return Task.model_validate(
            {
                "time": time,
                "actions": actions,
                "discrete_actions": choices,
                "reward": None if reward is None else dict(reward),
                "terminate": [TerminationLimit.model_validate(limit) for limit in limits],
            }
        )
    except ValidationError as error:
        raise InvalidConfig(f"the fake building's task: {describe_validation_errors(error)}") from None


def _found(actuators: Sequence[Actuator], control: str) -> tuple[Action, ...]:
    if control not in ("point", "zone", "building"):
        raise InvalidConfig(f"control = {control!r}; 'point', 'zone' or 'building' expected")
    groups: dict[str, list[Actuator]] = {}
    for actuator in actuators:
        together = control == "building" and actuator.component_type == _THERMOSTAT
        groups.setdefault(_safe(actuator.control_type) if together else actuator.name, []).append(actuator)
    return tuple(_action(name, members) for name, members in groups.items())


def _named(actuators: Sequence[Actuator], actions: Mapping[str, Sequence[str]]) -> tuple[Action, ...]:
    by_name, taken, made = {a.name: a for a in actuators}, set[str](), []
    for name, members in actions.items():
        for member in members:
            if member not in by_name:
                raise InvalidConfig(
                    f"action {name!r}: there is no actuator {member!r}; {did_you_mean(member, by_name)}"
                )
            if member in taken:
                raise InvalidConfig(f"action {name!r}: the actuator {member!r} belongs to another action already")
            taken.add(member)
        if not members:
            raise InvalidConfig(f"action {name!r} has no actuators; name at least one")
        made.append(_action(check_name(name, "the action"), [by_name[member] for member in members]))
    return tuple(made)


def _action(name: str, members: Sequence[Actuator]) -> Action:
    first = members[0]
    return Action(
        name=name, unit=first.unit, low=first.low, high=first.high, actuators=tuple(member.name for member in members)
    )


def _steps(
    actions: Sequence[Action], actuators: Sequence[Actuator], control: str, count: int | None
) -> tuple[DiscreteAction, ...]:
    """Equal steps, as a scenario's `discrete: count` has them: heating setpoints upwards, cooling ones downwards."""
    if count is None:
        return ()
    if count < 2:
        raise InvalidConfig(f"discrete = {count}; at least 2 steps expected")
    by_name = {a.name: a for a in actuators}
    groups: dict[str, list[Action]] = {}
    for action in actions:
        first = by_name[action.actuators[0]]
        paired = first.component_type == _THERMOSTAT and control != "point"
        group = ("all" if control == "building" else first.key) if paired else action.name
        groups.setdefault(f"{first.component_type}/{group}", []).append(action)
    choices = []
    for members in groups.values():
        columns = []
        for action in members:
            assert action.low is not None
            assert action.high is not None
            steps = np.linspace(action.low, action.high, count)
            columns.append(steps[::-1] if by_name[action.actuators[0]].control_type == COOLING else steps)
        rows = tuple(tuple(row) for row in np.column_stack(columns).tolist())
        choices.append(DiscreteAction(actions=tuple(a.name for a in members), values=rows))
    return tuple(choices)
