"""Apply alarm rules to the points of a plant: which value has which limits, and when they apply."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from fnmatch import fnmatchcase
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from zenostat.bridge.alarms.state_machine import Limits
from zenostat.topics.alarm_rules import AlarmRule, AlarmRules
from zenostat.topics.calendar import WEEKDAYS, in_hours
from zenostat.topics.energyplus_names import OCCUPANTS
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Meter, Sensor
from zenostat.topics.points import bounds

if TYPE_CHECKING:
    from zenostat.bridge.node.plant import PlantDescription

MAX_ALARMS = 2000
"""Largest number of alarms in a slot."""

ROUNDING = 1e-9
"""Part of a timestep by which a delay may exceed whole timesteps: decimal fractions of seconds are not exact."""


@dataclass(frozen=True, slots=True)
class PointAlarm:
    """The alarm of one point.

    Attributes:
        name: of the alarm.
        rule: its rule.
        point: the point.
        column: of the point among the values of a sample.
        occupants: the column of the occupants on which it depends; None if it does not.
        suppressor: the column of the point of its condition of suppression; None without one.
        limits: with delays in timesteps.
    """

    name: str
    rule: AlarmRule
    point: Sensor | Meter
    column: int
    occupants: int | None
    suppressor: int | None
    limits: Limits


def applies_at(rule: AlarmRule, moment: datetime) -> bool:
    """Return whether a rule applies at a simulated time, occupancy aside."""
    if rule.weekdays is not None and WEEKDAYS[moment.weekday()] not in rule.weekdays:
        return False
    seconds = moment.hour * 3600 + moment.minute * 60 + moment.second + moment.microsecond / 1e6
    return rule.hours is None or bool(in_hours(rule.hours, seconds / 3600))


def read_rules(path: Path) -> AlarmRules:
    """Read alarm rules from a YAML file.

    Raises:
        InvalidConfig: the file cannot be read, or is not valid; the text lists all errors.
    """
    from zenostat.topics import yaml12  # slow to import, and only files need it

    return yaml12.read_model(path, AlarmRules)


def point_alarms(rules: AlarmRules, plant: PlantDescription) -> tuple[PointAlarm, ...]:
    """Return the alarms of a plant, in the order of the rules, then of the points.

    Raises:
        InvalidConfig: lists unknown points, units that are not those of the points, and zones without occupants.
    """
    points: list[Sensor | Meter] = [*plant.sensors, *plant.meters]
    errors: list[str] = []
    alarms = [alarm for rule in rules.alarms for alarm in _alarms_of(rule, points, plant.run_period.step_s, errors)]
    if len(alarms) > MAX_ALARMS:
        errors.append(f"the rules have {len(alarms)} alarms; at most {MAX_ALARMS} are possible")
    if errors:
        raise InvalidConfig("\n".join(f"alarms: {error}" for error in errors))
    return tuple(alarms)


def _alarms_of(
    rule: AlarmRule, points: Sequence[Sensor | Meter], step_s: float, errors: list[str]
) -> Iterator[PointAlarm]:
    columns = _columns(rule, points, errors)
    if not _check_units(rule, [points[column] for column in columns], errors):
        return
    low, high = bounds(rule)
    return_delay_s = rule.delay_s if rule.return_delay_s is None else rule.return_delay_s
    delay, return_delay = (ceil(seconds / step_s - ROUNDING) for seconds in (rule.delay_s, return_delay_s))
    limits = Limits(low, high, rule.deadband, delay, return_delay)
    suppressor = _suppressor(rule, points, errors)
    for column in columns:
        name = rule.name if len(columns) == 1 else f"{rule.name}/{points[column].name}"
        occupants = _occupants(rule, points[column], points, errors)
        yield PointAlarm(name, rule, points[column], column, occupants, suppressor, limits)


def _columns(rule: AlarmRule, points: Sequence[Sensor | Meter], errors: list[str]) -> list[int]:
    """Return the columns of the rule's points; as in a fault plan, only names match points added for pictures."""
    names = [point.name for point in points]
    selected = set[int]()
    for pattern in rule.points:
        matching = [
            column
            for column, point in enumerate(points)
            if point.name == pattern or ("*" in pattern and point.observed and fnmatchcase(point.name, pattern))
        ]
        if not matching and "*" in pattern:
            errors.append(f"{rule.name}: no sensor or meter matches {pattern!r}; {did_you_mean(pattern, names)}")
        elif not matching:
            errors.append(f"{rule.name}: no sensor or meter {pattern!r}; {did_you_mean(pattern, names)}")
        selected.update(matching)
    return sorted(selected)


def _check_units(rule: AlarmRule, points: Sequence[Sensor | Meter], errors: list[str]) -> bool:
    """Add an error unless all points have one unit, that of the rule if it has one; return whether they do."""
    by_unit = {point.unit: point.name for point in reversed(points)}
    if rule.unit is not None:
        wrong = [point for point in points if point.unit != rule.unit]
        errors += [f"{rule.name}: {point.name} is in {point.unit}, not in {rule.unit}" for point in wrong]
        return not wrong
    if len(by_unit) > 1:
        units = ", ".join(f"{name} is in {unit}" for unit, name in by_unit.items())
        errors.append(f"{rule.name}: its points have different units, for which one limit is not right: {units}")
    return len(by_unit) <= 1


def _suppressor(rule: AlarmRule, points: Sequence[Sensor | Meter], errors: list[str]) -> int | None:
    """Return the column of the point of a rule's condition of suppression."""
    condition, names = rule.suppress_when, [point.name for point in points]
    if condition is None:
        return None
    if condition.point not in names:
        similar = did_you_mean(condition.point, names)
        errors.append(f"{rule.name}: suppress_when: no sensor or meter {condition.point!r}; {similar}")
        return None
    column = names.index(condition.point)
    if condition.unit is not None and condition.unit != points[column].unit:
        errors.append(
            f"{rule.name}: suppress_when: {condition.point} is in {points[column].unit}, not in {condition.unit}"
        )
    return column


def _occupants(
    rule: AlarmRule, point: Sensor | Meter, points: Sequence[Sensor | Meter], errors: list[str]
) -> int | None:
    """Return the column of the number of occupants on which a rule depends."""
    if rule.occupied is False:
        return None
    names = [other.name for other in points]
    if isinstance(rule.occupied, str):
        if rule.occupied in names:
            return names.index(rule.occupied)
        errors.append(f"{rule.name}: occupied: no sensor {rule.occupied!r}; {did_you_mean(rule.occupied, names)}")
        return None
    key = point.key.casefold() if isinstance(point, Sensor) else None
    for column, other in enumerate(points):
        if (
            isinstance(other, Sensor)
            and other.variable.casefold() == OCCUPANTS.casefold()
            and other.key.casefold() == key
        ):
            return column
    errors.append(
        f"{rule.name}: the occupants of the zone of {point.name} are not measured; with `monitoring` they are, or name "
        "a sensor that counts them (occupied: NAME)"
    )
    return None
