"""The points of a run: what the user named, checked against the model, or a sensible set found in it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from typing import TypeVar

from models.building.model import Building
from models.points.discovery import ActuatorPoint, MeterPoint, PointCatalog, Variable, locations
from topics.errors import ErrorCollector, InvalidConfig, UnknownName, UsageError, did_you_mean
from topics.keys import check_name, safe_name
from topics.messages import Actuator, Aggregation, Meter, Sensor
from topics.units import limits

S = TypeVar("S")
T = TypeVar("T")

Spec = Mapping[str, Sequence[object]]
MeterSpec = Mapping[str, str]

HVAC_POWER = "Facility Total HVAC Electricity Demand Rate"
ZONE_TEMPERATURE = "Zone Air Temperature"
THERMOSTAT = "Zone Temperature Control"

_ZONE_SENSORS = {
    "air_temperature": ZONE_TEMPERATURE,
    "relative_humidity": "Zone Air Relative Humidity",
    "occupants": "Zone People Occupant Count",
}
_SITE_SENSORS = {
    "outdoor_temperature": ("Site Outdoor Air Drybulb Temperature", "Environment"),
    "outdoor_humidity": ("Site Outdoor Air Relative Humidity", "Environment"),
    "hvac_electricity_power": (HVAC_POWER, "Whole Building"),
}
_FUELS = (
    "Electricity",
    "NaturalGas",
    "DistrictCooling",
    "DistrictHeatingWater",
    "DistrictHeatingSteam",
    "Propane",
    "FuelOilNo1",
    "FuelOilNo2",
    "Gasoline",
    "Diesel",
    "Coal",
    "OtherFuel1",
    "OtherFuel2",
)

# Thermostat bounds: those of the medium office in the paper that Zenostat follows (Sinergym). They meet
# at 22.5 degC because EnergyPlus ends the run when a heating setpoint lies above the cooling setpoint.
_SETPOINT_BOUNDS = {"Heating Setpoint": (15.0, 22.5), "Cooling Setpoint": (22.5, 30.0)}

_FEEDBACK = {
    (THERMOSTAT, "Heating Setpoint"): "Zone Thermostat Heating Setpoint Temperature",
    (THERMOSTAT, "Cooling Setpoint"): "Zone Thermostat Cooling Setpoint Temperature",
}

# Rates and flows: EnergyPlus's own reports are means, and energy follows only from means.
_RATES = {"W", "W/m2", "W/m", "W/m2-K", "kg/s", "kgWater/s", "m3/s", "kmol/s", "L/s", "ach"}

# EnergyPlus's own limits on surface temperatures (Input Output Reference, HeatBalanceAlgorithm and
# "Temperature out of bounds" warnings): air cannot leave them and the simulation go on.
_AIR_TEMPERATURE_BOUNDS = (-100.0, 200.0)


@dataclass(frozen=True, slots=True)
class Points:
    """The points of a run, in manifest order. `system`: which sensors follow the system timestep."""

    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]
    system: tuple[bool, ...]
    meter_handles: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class PointListing:
    """A point of a model as lists show it.

    Attributes:
        kind: `sensor`, `meter`, `actuator`, or `internal` (a fixed number of the model).
        name: the variable, the meter, the component type and control type, or the internal variable.
        key: what EnergyPlus calls the thing that has it; empty for a meter.
        low, high: limits that no value leaves, for an actuator those that it can be set to; None for none.
        where: the zone, air loop or plant loop that it belongs to, `Environment`, `facility` for the whole
            building, or nothing where the model does not tell.
    """

    kind: str
    name: str
    key: str
    unit: str
    low: float | None
    high: float | None
    where: str


def select_points(
    building: Building,
    survey: PointCatalog,
    sensors: Spec | None,
    meters: MeterSpec | None,
    actuators: Spec | None,
) -> Points:
    """The points that were asked for; None is the default set of that kind.

    Args:
        building: for the limits of its schedules.
        survey: the points that the model has.
        sensors: name to (variable, key) or (variable, key, reading).
        meters: name to meter.
        actuators: name to (component type, control type, key) or that with (…, low, high).

    Raises:
        UnknownName: points that the model does not have, all of them at once, with near names.
        InvalidConfig: names used twice or unfit for a topic, a reading or bounds that cannot be.
    """
    faults = ErrorCollector()
    wanted_sensors = default_sensors(survey) if sensors is None else sensors
    wanted_meters = default_meters(survey) if meters is None else meters
    wanted_actuators = default_actuators(survey) if actuators is None else actuators
    twice = set(wanted_sensors) & set(wanted_meters)
    if twice:
        faults.found.append(InvalidConfig(f"names used for a sensor and a meter: {', '.join(sorted(twice))}"))
    found_sensors = _each(wanted_sensors, lambda n, s: _sensor(survey, n, s), faults)
    found_meters = _each(wanted_meters, lambda n, s: _meter(survey, n, s), faults)
    found_actuators = _each(wanted_actuators, lambda n, s: _actuator(building, survey, n, s), faults)
    faults.raise_if_any()
    return Points(
        sensors=tuple(s for s, _ in found_sensors),
        meters=tuple(m for m, _ in found_meters),
        actuators=tuple(found_actuators),
        system=tuple(variable.system for _, variable in found_sensors),
        meter_handles=tuple(meter.index for _, meter in found_meters),
    )


def _each(wanted: Mapping[str, S], find: Callable[[str, S], T], faults: ErrorCollector) -> list[T]:
    """Finds each, keeping on after a fault so that all are said at once."""
    found = []
    for name, spec in wanted.items():
        try:
            found.append(find(check_name(name, "the point name"), spec))
        except UsageError as fault:
            faults.found.append(fault)
    return found


def _sensor(survey: PointCatalog, name: str, spec: Sequence[object]) -> tuple[Sensor, Variable]:
    variable, key, asked = _texts("sensor", name, spec, "(variable, key) or (variable, key, reading)", 2, 3)
    found = find_variable(survey, name, variable, key)
    if asked and asked not in list(Aggregation):
        raise InvalidConfig(f"sensor {name!r}: reading {asked!r}; there are: {', '.join(Aggregation)}")
    aggregation = Aggregation(asked) if asked else default_aggregation(found)
    if (aggregation is Aggregation.SUM) != found.summed and aggregation is not Aggregation.INSTANT:
        right = "sum" if found.summed else "mean"
        raise InvalidConfig(f"sensor {name!r}: EnergyPlus reports {variable!r} as a {right}, not as a {aggregation}")
    low, high = sensor_bounds(found)
    sensor = Sensor(
        name=name, variable=found.name, key=found.key, unit=found.unit, aggregation=aggregation, low=low, high=high
    )
    return sensor, found


def _texts(what: str, name: str, spec: Sequence[object], form: str, least: int, most: int) -> list[str]:
    parts = [] if isinstance(spec, str) else [str(part) for part in spec]
    if not least <= len(parts) <= most:
        raise InvalidConfig(f"{what} {name!r}: expected {form}, got {spec!r}")
    return parts + [""] * (most - len(parts))


def find_variable(survey: PointCatalog, name: str, variable: str, key: str) -> Variable:
    """The variable of that name and key, in any case; `UnknownName` lists near ones."""
    found = survey.by_variable.get((variable.casefold(), key.casefold()))
    if found is not None:
        return found
    same = [v for v in survey.variables if v.name.casefold() == variable.casefold()]
    if not same:
        raise UnknownName(
            f"sensor {name!r}: the model has no variable {variable!r}; "
            + did_you_mean(variable, (v.name for v in survey.variables))
        )
    raise UnknownName(f"sensor {name!r}: {variable!r} has no key {key!r}; {did_you_mean(key, (v.key for v in same))}")


def default_aggregation(variable: Variable) -> Aggregation:
    """`sum` for what EnergyPlus sums, `mean` for rates and flows, `instant` for states."""
    if variable.summed:
        return Aggregation.SUM
    return Aggregation.MEAN if variable.unit in _RATES else Aggregation.INSTANT


def sensor_bounds(variable: Variable) -> tuple[float | None, float | None]:
    """Limits that no value of the variable leaves; None where there is none."""
    name = variable.name
    if variable.unit == "degC" and name.startswith(("Zone ", "Site ")) and "Air " in name:
        return _AIR_TEMPERATURE_BOUNDS
    if name.endswith("Occupant Count") or (name.startswith("Site ") and variable.unit in ("W/m2", "m/s")):
        return (0.0, None)
    if name == HVAC_POWER:
        return (0.0, None)
    return limits(variable.unit)


def _meter(survey: PointCatalog, name: str, spec: object) -> tuple[Meter, MeterPoint]:
    for candidate in survey.meters:
        if candidate.name.casefold() == str(spec).casefold():
            return Meter(name=name, meter=candidate.name, unit=candidate.unit, low=_meter_low(candidate)), candidate
    raise UnknownName(
        f"meter {name!r}: the model has no meter {spec!r}; {did_you_mean(str(spec), (m.name for m in survey.meters))}"
    )


def _meter_low(meter: MeterPoint) -> float | None:
    """0 for a meter of a fuel: consumption is never negative."""
    return 0.0 if meter.name.split(":")[0] in _FUELS else None


def _actuator(building: Building, survey: PointCatalog, name: str, spec: Sequence[object]) -> Actuator:
    if isinstance(spec, str) or len(spec) not in (3, 5):
        raise InvalidConfig(
            f"actuator {name!r}: expected (component type, control type, key) or that with low and high, got {spec!r}"
        )
    found = find_actuator(survey, name, *(str(part) for part in spec[:3]))
    low, high = actuator_bounds(building, found)
    if len(spec) == 5:
        low, high = _bound(name, spec[3]), _bound(name, spec[4])
    if low is not None and high is not None and not low < high:
        raise InvalidConfig(f"actuator {name!r}: its lower bound {low} is not below its upper bound {high}")
    feedback = _FEEDBACK.get((found.component_type, found.control_type))
    if found.control_type == "Schedule Value":
        feedback = "Schedule Value"
    if feedback and (feedback.casefold(), found.key.casefold()) not in survey.by_variable:
        feedback = None
    return Actuator(
        name=name,
        component_type=found.component_type,
        control_type=found.control_type,
        key=found.key,
        unit=found.unit,
        low=low,
        high=high,
        feedback=feedback,
    )


def _bound(name: str, said: object) -> float | None:
    """A bound that the user gave: a finite number, or None for none."""
    if said is None:
        return None
    try:
        value = float(str(said))
    except ValueError:
        value = nan
    if not isfinite(value):
        raise InvalidConfig(f"actuator {name!r}: bound {said!r}; a finite number or None expected")
    return value


def find_actuator(survey: PointCatalog, name: str, component: str, control: str, key: str) -> ActuatorPoint:
    """The actuator of those three names, in any case; `UnknownName` says which of them is wrong."""
    found = survey.by_actuator.get((component.casefold(), control.casefold(), key.casefold()))
    if found is not None:
        return found
    of_type = [a for a in survey.actuators if a.component_type.casefold() == component.casefold()]
    if not of_type:
        raise UnknownName(
            f"actuator {name!r}: the model has no component type {component!r}; "
            + did_you_mean(component, (a.component_type for a in survey.actuators))
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


def actuator_bounds(building: Building, actuator: ActuatorPoint) -> tuple[float | None, float | None]:
    """Limits of an actuator: a thermostat's, its schedule's type limits, or its unit's."""
    if actuator.component_type == THERMOSTAT and actuator.control_type in _SETPOINT_BOUNDS:
        return _SETPOINT_BOUNDS[actuator.control_type]
    if actuator.control_type == "Schedule Value":
        schedule = building.find(actuator.component_type, actuator.key)
        bounds = building.find("ScheduleTypeLimits", str(schedule.get("schedule_type_limits_name", "")))
        low, high = bounds.get("lower_limit_value"), bounds.get("upper_limit_value")
        return (None if low is None else float(low), None if high is None else float(high))
    return limits(actuator.unit)


def thermostat_zones(survey: PointCatalog) -> dict[str, str]:
    """Keys of the zones whose thermostat can be set, in EnergyPlus's order, each with a safe name of its own."""
    zones: dict[str, str] = {}
    for actuator in survey.actuators:
        if actuator.component_type == THERMOSTAT and actuator.key not in zones:
            name = base = safe_name(actuator.key)
            number = 2
            while name in zones.values():
                name, number = f"{base}_{number}", number + 1
            zones[actuator.key] = name
    return zones


def default_sensors(survey: PointCatalog) -> dict[str, tuple[str, str]]:
    """Outdoor temperature and humidity, HVAC power, and each conditioned zone's air and occupants."""
    found = {name: (variable, key) for name, (variable, key) in _SITE_SENSORS.items()}
    for zone, name in thermostat_zones(survey).items():
        for suffix, variable in _ZONE_SENSORS.items():
            found[f"{name}_{suffix}"] = (variable, zone)
    return {
        name: (variable, key)
        for name, (variable, key) in found.items()
        if (variable.casefold(), key.casefold()) in survey.by_variable
    }


def default_meters(survey: PointCatalog) -> dict[str, str]:
    """The facility's meters of whatever fuels the model uses, and the HVAC's electricity."""
    has = {m.name for m in survey.meters}
    wanted = [f"{fuel}:Facility" for fuel in _FUELS] + ["Electricity:HVAC"]
    return {safe_name(name.replace(":", "_")): name for name in wanted if name in has}


def default_actuators(survey: PointCatalog) -> dict[str, tuple[str, str, str]]:
    """The heating and cooling setpoints of each zone."""
    zones = thermostat_zones(survey)
    return {
        f"{zones[a.key]}_{safe_name(a.control_type)}": (a.component_type, a.control_type, a.key)
        for a in survey.actuators
        if a.component_type == THERMOSTAT and a.control_type in _SETPOINT_BOUNDS
    }


def listing(survey: PointCatalog, building: Building) -> Iterator[PointListing]:
    """All points of a model, each with its bounds and its place; a tenth of a second for 20,000."""
    where = locations(building.objects)

    def place(key: str) -> str:
        return where.get(key.upper()) or _WHOLE.get(key.upper(), "")

    for v in survey.variables:
        yield PointListing("sensor", v.name, v.key, v.unit, *sensor_bounds(v), place(v.key))
    own_meters = {
        n for kind, items in building.objects.items() if kind.startswith("Meter:") for n in map(str.upper, items)
    }
    for m in survey.meters:
        yield PointListing(
            "meter", m.name, "", m.unit, _meter_low(m), None, _meter_place(m.name.upper(), where, own_meters)
        )
    for a in survey.actuators:
        name = f"{a.component_type} / {a.control_type}"
        yield PointListing("actuator", name, a.key, a.unit, *actuator_bounds(building, a), place(a.key))
    for i in survey.internal:
        yield PointListing("internal", i.name, i.key, i.unit, None, None, place(i.key))


# Keys by which EnergyPlus calls what belongs to no zone and no loop.
_WHOLE = {
    "ENVIRONMENT": "Environment",
    "WHOLE BUILDING": "facility",
    "FACILITY": "facility",
    "SITE": "facility",
    "SIMHVAC": "facility",
}


def _meter_place(name: str, where: Mapping[str, str], own: Collection[str]) -> str:
    """A zone for `…:Zone:NAME`, nothing for a kind of spaces or a meter that the model defines, else the facility."""
    if ":ZONE:" in name:
        return where.get(name.rpartition(":ZONE:")[2], "")
    return "" if ":SPACETYPE:" in name or name in own else "facility"
