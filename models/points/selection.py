"""Select the points of a run: those that the user named, checked against the model, or a default set."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import TypeVar

from zenostat.models.building.model import Building
from zenostat.models.points.discovery import ActuatorPoint, MeterPoint, PointCatalog, Variable
from zenostat.models.points.thermostat_bounds import setpoint_bounds
from zenostat.topics.energyplus_names import (
    COMPUTED_ON_REQUEST,
    COOLING_SETPOINT,
    COOLING_SETPOINT_VARIABLE,
    FUELS,
    HEATING_SETPOINT,
    HEATING_SETPOINT_VARIABLE,
    HVAC_METERS,
    HVAC_POWER,
    OCCUPANTS,
    SCHEDULE_VALUE,
    THERMOSTAT,
    ZONE_TEMPERATURE,
)
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName, UsageError, did_you_mean
from zenostat.topics.keys import MAX_NAME, check_name, safe_name
from zenostat.topics.messages import Actuator, Aggregation, Meter, Sensor
from zenostat.topics.printable import replace_controls
from zenostat.topics.units import limits

S = TypeVar("S")
T = TypeVar("T")

Spec = Mapping[str, Sequence[object]]
MeterSpec = Mapping[str, str]

_ZONE_SENSORS = {
    "air_temperature": ZONE_TEMPERATURE,
    "relative_humidity": "Zone Air Relative Humidity",
    "occupants": OCCUPANTS,
}
_LONGEST_ZONE = MAX_NAME - len("_thermostat_heating_setpoint") - len("_999")
"""Characters of a zone's name in the names of points, before the longest suffix and a number."""

_SITE_SENSORS = {
    "outdoor_temperature": ("Site Outdoor Air Drybulb Temperature", "Environment"),
    "outdoor_humidity": ("Site Outdoor Air Relative Humidity", "Environment"),
    "hvac_and_plant_power": (HVAC_POWER, "Whole Building"),
}

_FEEDBACK = {
    (THERMOSTAT, HEATING_SETPOINT): HEATING_SETPOINT_VARIABLE,
    (THERMOSTAT, COOLING_SETPOINT): COOLING_SETPOINT_VARIABLE,
}

# Rates and flows: EnergyPlus itself reports their means, and energy can be calculated only from means.
_RATES = {"W", "W/m2", "W/m", "W/m2-K", "kg/s", "kgWater/s", "m3/s", "kmol/s", "L/s", "ach"}

# What EnergyPlus reports for a node that has no such setpoint (`SensedNodeFlagValue` in its source).
_NODE_SETPOINT = "System Node Setpoint "
_NO_SETPOINT = -999.0

# EnergyPlus's own limits on surface temperatures (Input Output Reference, HeatBalanceAlgorithm and
# "Temperature out of bounds" warnings): no simulation continues with air beyond them.
_AIR_TEMPERATURE_BOUNDS = (-100.0, 200.0)


@dataclass(frozen=True, slots=True)
class Points:
    """The points of a run, in manifest order.

    Attributes:
        system: for each sensor, whether it is updated each system timestep.
        meter_parts: for each meter, EnergyPlus's meters that add up to it.
        own_keys: EnergyPlus's keys with control characters, by the keys in the messages, which have none.
    """

    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]
    system: tuple[bool, ...]
    meter_parts: tuple[tuple[MeterPoint, ...], ...]
    own_keys: Mapping[str, str] = field(default_factory=dict)

    def own_key(self, point: Sensor | Actuator) -> str:
        """Return the key of a point as EnergyPlus has it."""
        return self.own_keys.get(point.key, point.key)

    @property
    def requested(self) -> tuple[tuple[str, str], ...]:
        """Name and key of the output variables that EnergyPlus computes only on request; each once."""
        names = [(s.variable, self.own_key(s)) for s in self.sensors if s.variable.casefold() in COMPUTED_ON_REQUEST]
        return tuple(dict.fromkeys(names))


def select_points(
    building: Building,
    available: PointCatalog,
    sensors: Spec | None,
    meters: MeterSpec | None,
    actuators: Spec | None,
    *,
    paired: bool = False,
) -> Points:
    """Return the requested points; None selects the default points of that kind.

    Args:
        building: for the limits of its schedules.
        available: the points of the model.
        sensors: name to (variable, key) or (variable, key, aggregation).
        meters: name to meter.
        actuators: name to (component type, control type, key) or (component type, control type, key, low, high).
        paired: whether all zones have one pair of setpoints.

    Raises:
        UnknownName: the model lacks some of the points; the text lists all of them, with similar names.
        InvalidConfig: a name is used twice or not allowed in a topic, an actuator has two names, or an aggregation or
            bounds are invalid.
    """
    errors = ErrorCollector()
    wanted_sensors = default_sensors(available) if sensors is None else sensors
    wanted_meters = default_meters(available) if meters is None else meters
    wanted_actuators = default_actuators(available) if actuators is None else actuators
    duplicates = set(wanted_sensors) & set(wanted_meters)
    if duplicates:
        duplicate_names = ", ".join(sorted(duplicates))
        errors.errors.append(InvalidConfig(f"names used for both a sensor and a meter: {duplicate_names}"))
    selected_sensors = _each(wanted_sensors, lambda n, s: _sensor(available, n, s), errors)
    selected_meters = _each(wanted_meters, lambda n, s: _meter(available, n, s), errors)
    selected_actuators = _each(
        wanted_actuators, lambda n, s: _actuator(building, available, n, s, paired=paired), errors
    )
    errors.errors += _repeated_actuators(selected_actuators)
    errors.raise_if_any()
    return Points(
        sensors=tuple(s for s, _ in selected_sensors),
        meters=tuple(m for m, _ in selected_meters),
        actuators=tuple(selected_actuators),
        system=tuple(variable.system for _, variable in selected_sensors),
        meter_parts=tuple(meter.measured for _, meter in selected_meters),
        own_keys={replace_controls(key): key for key in _keys(available) if not key.isprintable()},
    )


def _keys(available: PointCatalog) -> set[str]:
    return {variable.key for variable in available.variables} | {actuator.key for actuator in available.actuators}


def _each(wanted: Mapping[str, S], find: Callable[[str, S], T], errors: ErrorCollector) -> list[T]:
    """Find each point; errors are collected, so that all are reported at once."""
    points = []
    for name, spec in wanted.items():
        try:
            points.append(find(check_name(name, "the point name"), spec))
        except UsageError as error:
            errors.errors.append(error)
    return points


def _repeated_actuators(actuators: Sequence[Actuator]) -> Iterator[InvalidConfig]:
    """Yield an error for each actuator of EnergyPlus that has several names; the last of them would set it."""
    names: dict[tuple[str, str, str], list[str]] = {}
    for actuator in actuators:
        names.setdefault((actuator.component_type, actuator.control_type, actuator.key), []).append(actuator.name)
    for point, same in names.items():
        if len(same) > 1:
            yield InvalidConfig(
                f"actuators {', '.join(map(repr, same))} are one actuator of EnergyPlus ({', '.join(point)}); keep one"
            )


def _sensor(available: PointCatalog, name: str, spec: Sequence[object]) -> tuple[Sensor, Variable]:
    parts = [] if isinstance(spec, str) else [str(part) for part in spec]
    if len(parts) not in (2, 3):
        raise InvalidConfig(f"sensor {name!r}: expected (variable, key) or (variable, key, aggregation), got {spec!r}")
    variable_name, key, requested = [*parts, ""][:3]
    variable = find_variable(available, name, variable_name, key)
    if requested and requested not in list(Aggregation):
        raise InvalidConfig(f"sensor {name!r}: no aggregation {requested!r}; there are: {', '.join(Aggregation)}")
    aggregation = Aggregation(requested) if requested else default_aggregation(variable)
    if (aggregation is Aggregation.SUM) != variable.summed and aggregation is not Aggregation.INSTANT:
        reported = "sum" if variable.summed else "mean"
        raise InvalidConfig(
            f"sensor {name!r}: EnergyPlus reports {variable_name!r} as a {reported}, not as a {aggregation}"
        )
    low, high = sensor_bounds(variable)
    sensor = Sensor(
        name=name,
        variable=variable.name,
        key=variable.key,
        unit=variable.unit,
        aggregation=aggregation,
        low=low,
        high=high,
    )
    return sensor, variable


def find_variable(available: PointCatalog, name: str, variable: str, key: str) -> Variable:
    """Return the variable of that name and key, in any case; `UnknownName` lists similar ones."""
    match = available.by_variable.get((variable.casefold(), key.casefold()))
    if match is not None:
        return match
    same_name = [v for v in available.variables if v.name.casefold() == variable.casefold()]
    if not same_name:
        raise UnknownName(
            f"sensor {name!r}: the model has no variable {variable!r}; "
            + did_you_mean(variable, (v.name for v in available.variables))
        )
    raise UnknownName(
        f"sensor {name!r}: {variable!r} has no key {key!r}; {did_you_mean(key, (v.key for v in same_name))}"
    )


def default_aggregation(variable: Variable) -> Aggregation:
    """Return `sum` for variables that EnergyPlus sums, `mean` for rates and flows, `instant` for states."""
    if variable.summed:
        return Aggregation.SUM
    return Aggregation.MEAN if variable.unit in _RATES else Aggregation.INSTANT


def sensor_bounds(variable: Variable) -> tuple[float | None, float | None]:
    """Return the bounds of the variable's values; None if there is none."""
    name = variable.name
    if name.startswith(_NODE_SETPOINT):
        return (_NO_SETPOINT, None)
    if variable.unit == "degC" and name.startswith(("Zone ", "Site ")) and "Air " in name:
        return _AIR_TEMPERATURE_BOUNDS
    if name.endswith("Occupant Count") or (name.startswith("Site ") and variable.unit in ("W/m2", "m/s")):
        return (0.0, None)
    if name == HVAC_POWER:
        return (0.0, None)
    return limits(variable.unit)


def _meter(available: PointCatalog, name: str, spec: object) -> tuple[Meter, MeterPoint]:
    for candidate in available.meters:
        if candidate.name.casefold() == str(spec).casefold():
            return Meter(name=name, meter=candidate.name, unit=candidate.unit, low=meter_low(candidate)), candidate
    hint = did_you_mean(str(spec), (m.name for m in available.meters))
    raise UnknownName(f"meter {name!r}: the model has no meter {spec!r}; {hint}")


def meter_low(meter: MeterPoint) -> float | None:
    """Return 0 for the consumption of a fuel, or of the HVAC, which is never negative."""
    return 0.0 if meter.name.split(":")[0] in FUELS or meter.name in HVAC_METERS else None


def _actuator(
    building: Building, available: PointCatalog, name: str, spec: Sequence[object], *, paired: bool
) -> Actuator:
    if isinstance(spec, str) or len(spec) not in (3, 5):
        raise InvalidConfig(
            f"actuator {name!r}: expected (component type, control type, key) or "
            f"(component type, control type, key, low, high), got {spec!r}"
        )
    point = find_actuator(available, name, *(str(part) for part in spec[:3]))
    low, high = actuator_bounds(building, point, paired=paired)
    if len(spec) == 5:
        low, high = _bound(name, spec[3]), _bound(name, spec[4])
    if low is not None and high is not None and not low < high:
        raise InvalidConfig(f"actuator {name!r}: its lower bound {low} is not below its upper bound {high}")
    feedback = _FEEDBACK.get((point.component_type, point.control_type))
    if point.control_type == SCHEDULE_VALUE:
        feedback = SCHEDULE_VALUE
    if feedback and (feedback.casefold(), point.key.casefold()) not in available.by_variable:
        feedback = None
    return Actuator(
        name=name,
        component_type=point.component_type,
        control_type=point.control_type,
        key=point.key,
        unit=point.unit,
        low=low,
        high=high,
        feedback=feedback,
    )


def _bound(name: str, bound: object) -> float | None:
    """Return a user's bound: a finite number, or None."""
    if bound is None:
        return None
    try:
        value = float(str(bound))
    except ValueError:
        value = nan
    if not isfinite(value):
        raise InvalidConfig(f"actuator {name!r}: bound {bound!r}; expected a finite number or None")
    return value


def find_actuator(available: PointCatalog, name: str, component: str, control: str, key: str) -> ActuatorPoint:
    """Return the actuator with those three names, in any case; `UnknownName` reports which one is wrong."""
    match = available.by_actuator.get((component.casefold(), control.casefold(), key.casefold()))
    if match is not None:
        return match
    of_type = [a for a in available.actuators if a.component_type.casefold() == component.casefold()]
    if not of_type:
        raise UnknownName(
            f"actuator {name!r}: the model has no component type {component!r}; "
            + did_you_mean(component, (a.component_type for a in available.actuators))
        )
    of_control = [a for a in of_type if a.control_type.casefold() == control.casefold()]
    if not of_control:
        raise UnknownName(
            f"actuator {name!r}: {component!r} has no control type {control!r}; "
            + did_you_mean(control, (a.control_type for a in of_type))
        )
    raise UnknownName(
        f"actuator {name!r}: {component!r}, {control!r} has no key {key!r}; "
        f"{did_you_mean(key, (a.key for a in of_control))}"
    )


def actuator_bounds(
    building: Building, actuator: ActuatorPoint, *, paired: bool = False
) -> tuple[float | None, float | None]:
    """Return an actuator's bounds: a thermostat's, its schedule's type limits, or those of its unit.

    With `paired`, thermostats' are those of one pair of setpoints for all zones.
    """
    if actuator.component_type == THERMOSTAT:
        setpoints = setpoint_bounds(building, actuator.control_type, None if paired else actuator.key)
        if setpoints is not None:
            return setpoints
    if actuator.control_type == SCHEDULE_VALUE:
        schedule = building.find(actuator.component_type, actuator.key)
        bounds = building.find("ScheduleTypeLimits", str(schedule.get("schedule_type_limits_name", "")))
        low, high = bounds.get("lower_limit_value"), bounds.get("upper_limit_value")
        return (None if low is None else float(low), None if high is None else float(high))
    return limits(actuator.unit)


def thermostat_zones(available: PointCatalog) -> dict[str, str]:
    """Return the keys of the zones with a controllable thermostat, in EnergyPlus's order, each with a unique name."""
    zones: dict[str, str] = {}
    for actuator in available.actuators:
        if actuator.component_type == THERMOSTAT and actuator.key not in zones:
            name = base = safe_name(actuator.key)[:_LONGEST_ZONE]
            number = 2
            while name in zones.values():
                name, number = f"{base}_{number}", number + 1
            zones[actuator.key] = name
    return zones


def default_sensors(available: PointCatalog) -> dict[str, tuple[str, str]]:
    """Return outdoor temperature and humidity, HVAC and plant power, and each conditioned zone's air and occupants."""
    candidates = {name: (variable, key) for name, (variable, key) in _SITE_SENSORS.items()}
    for zone, name in thermostat_zones(available).items():
        for suffix, variable in _ZONE_SENSORS.items():
            candidates[f"{name}_{suffix}"] = (variable, zone)
    return {
        name: (variable, key)
        for name, (variable, key) in candidates.items()
        if (variable.casefold(), key.casefold()) in available.by_variable
    }


def default_meters(available: PointCatalog) -> dict[str, str]:
    """Return the facility's meters of the fuels that the model uses, and the HVAC's electricity if it uses any."""
    names = {m.name for m in available.meters if m.measured}
    candidates = [f"{fuel}:Facility" for fuel in FUELS] + ["HVAC:Electricity"]
    return {safe_name(name.replace(":", "_")): name for name in candidates if name in names}


def default_actuators(available: PointCatalog) -> dict[str, tuple[str, str, str]]:
    """Return the heating and cooling setpoints of each zone."""
    zones = thermostat_zones(available)
    return {
        f"{zones[a.key]}_{safe_name(a.control_type)}": (a.component_type, a.control_type, a.key)
        for a in available.actuators
        if a.component_type == THERMOSTAT and a.control_type in (HEATING_SETPOINT, COOLING_SETPOINT)
    }
