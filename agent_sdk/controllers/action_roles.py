"""Roles of a task's actions (setpoint, water temperature, availability, storage) and the zones that they serve."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite

from zenostat.agent_sdk.controllers.base import Values
from zenostat.agent_sdk.controllers.comfort_band import rewarded_temperatures
from zenostat.topics import energyplus_names
from zenostat.topics.energyplus_names import ZONE_TEMPERATURES
from zenostat.topics.messages import Action, Actuator, Manifest, Sensor
from zenostat.topics.points import bounds, value_index

THERMOSTAT = energyplus_names.THERMOSTAT.casefold()
OCCUPANTS = "zone people occupant count"

# Range of zone setpoints, and the limit between chilled water and heating water.
_ZONE_SETPOINT_DEGC = (10.0, 40.0)
_MAX_CHILLED_DEGC = 20.0


class Role(StrEnum):
    """Quantity that an action sets."""

    HEATING = "heating setpoint"
    COOLING = "cooling setpoint"
    HOT_WATER = "hot water temperature"
    COLD_WATER = "chilled water temperature"
    AVAILABILITY = "availability"
    STORAGE = "storage"
    OTHER = "other"


SETPOINTS = (Role.HEATING, Role.COOLING)


@dataclass(frozen=True, slots=True)
class ActionBinding:
    """One action of the task, with its role and the points of the zones that it serves.

    Attributes:
        action: the action; of a relative one, with the bounds that all its actuators have.
        role: what it sets.
        temperatures: indices of the air temperatures that it controls, in `sample.values`.
        people: indices of the occupant counts of these zones, or of all zones if these have none.
    """

    action: Action
    role: Role
    temperatures: tuple[int, ...]
    people: tuple[int, ...]

    def clip(self, value: float) -> float:
        """Clip a value to the action's bounds."""
        low, high = bounds(self.action)
        return min(max(value, low), high)

    def at(self, value: float) -> Values:
        """Set all actuators of the action to a value, clipped to its bounds."""
        return dict.fromkeys(self.action.actuators, self.clip(value))


_TEMPERATURE_UNITS = ("degC", "1", "")
"""The unit of a schedule may be unknown, but that of a heater's power is not."""


def bind_actions(manifest: Manifest) -> tuple[ActionBinding, ...]:
    """Return a binding for each action of a node's task, in order."""
    actuators = {a.name: a for a in manifest.actuators}
    return tuple(
        ActionBinding(
            absolute := _absolute(action, actuators),
            role_of(absolute, actuators[action.actuators[0]]),
            *_zone_points(action, [actuators[name] for name in action.actuators], manifest),
        )
        for action in manifest.task.actions
    )


def setpoint_pairs(manifest: Manifest) -> list[tuple[int, int]]:
    """Return the positions of the heating and the cooling setpoint of the same zones that can cross.

    Where the bounds already keep them apart, there is no pair. Offsets of a pair that do not cross keep the setpoints
    at least as far apart as the baseline control does.
    """
    bindings = list(enumerate(bind_actions(manifest)))
    return [
        (i, j)
        for i, heater in bindings
        for j, cooler in bindings
        if heater.role is Role.HEATING
        and cooler.role is Role.COOLING
        and (set(heater.temperatures) & set(cooler.temperatures) or not heater.temperatures)
        and bounds(heater.action)[1] > bounds(cooler.action)[0]
    ]


def _absolute(action: Action, actuators: Mapping[str, Actuator]) -> Action:
    """Return an action; of a relative one, that which sets absolute values."""
    if not action.relative:
        return action
    members = [actuators[name] for name in action.actuators]
    lows, highs = zip(*map(bounds, members), strict=True)
    low, high = (value if isfinite(value) else None for value in (max(lows), min(highs)))
    return action.model_copy(update={"low": low, "high": high, "unit": members[0].unit, "relative": False})


def role_of(action: Action | Actuator, actuator: Actuator) -> Role:
    """Derive the role of an action: from the actuator's type for thermostats, else from names and bounds."""
    if actuator.component_type.casefold() == THERMOSTAT:
        control_type = actuator.control_type.casefold()
        return Role(control_type) if control_type in SETPOINTS else Role.OTHER
    for text in (action.name, actuator.name, actuator.key):
        role = _role_from_name(text.casefold(), action.unit, *bounds(action))
        if role is not Role.OTHER:
            return role
    return Role.OTHER


def _role_from_name(text: str, unit: str, low: float, high: float) -> Role:
    if "charge" in text:
        return Role.STORAGE
    if (low, high) == (0.0, 1.0):
        return Role.AVAILABILITY if "avail" in text else Role.OTHER
    if unit not in _TEMPERATURE_UNITS:
        return Role.OTHER
    if "water" in text or "chw" in text or "hhw" in text:
        return Role.COLD_WATER if high <= _MAX_CHILLED_DEGC else Role.HOT_WATER
    if high >= _ZONE_SETPOINT_DEGC[0] and low <= _ZONE_SETPOINT_DEGC[1]:
        if "cool" in text or "clg" in text:
            return Role.COOLING
        if "heat" in text or "htg" in text:
            return Role.HEATING
    return Role.OTHER


def temperature_sensors(manifest: Manifest) -> list[Sensor]:
    """Return the air temperatures to control: those of the reward if it names any, else those of all zones."""
    rewarded = rewarded_temperatures(manifest)
    if rewarded:
        return [s for s in manifest.sensors if s.name in rewarded]
    for variable in ZONE_TEMPERATURES:
        sensors = [s for s in manifest.sensors if s.observed and s.variable.casefold() == variable]
        if sensors:
            return sensors
    return []


def _zone_points(
    action: Action, actuators: Sequence[Actuator], manifest: Manifest
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return indices of temperatures and occupant counts: by zone for thermostats, else by similar names, else all."""
    indices = value_index(manifest)
    observed = [s for s in manifest.sensors if s.observed]
    people = {s.key.casefold(): indices[s.name] for s in observed if s.variable.casefold() == OCCUPANTS}
    sensors = temperature_sensors(manifest)
    if actuators[0].component_type.casefold() == THERMOSTAT:
        zones = {a.key.casefold() for a in actuators}
        measured = [s for s in observed if s.key.casefold() in zones and s.variable.casefold() in ZONE_TEMPERATURES]
    else:
        measured = _similar_sensors(action.name, [a.name for a in manifest.task.actions], sensors) or sensors
        zones = {s.key.casefold() for s in measured}
    counts = [index for zone, index in people.items() if zone in zones]
    return tuple(indices[s.name] for s in measured or sensors), tuple(counts or people.values())


def _similar_sensors(name: str, peers: Iterable[str], sensors: Sequence[Sensor]) -> list[Sensor]:
    """Return the sensors that share a distinctive word with a name: `radiant_bed1`, `bedroom01_temperature`."""
    peer_words = [_words(peer) for peer in peers if peer != name]
    distinctive = {word for word in _words(name) if sum(word in words for words in peer_words) == 0}
    similar = [s for s in sensors if any(_is_similar(a, b) for a in distinctive for b in _words(s.name))]
    return similar if len(similar) < len(sensors) else []


def _words(name: str) -> set[tuple[str, int]]:
    """Split a name into words, each with the number that follows it (0 if none)."""
    pairs: list[tuple[str, str]] = re.findall(r"([a-z]+)(\d*)", name.casefold())
    return {(word, int(digits or 0)) for word, digits in pairs}


def _is_similar(word: tuple[str, int], longer: tuple[str, int]) -> bool:
    return len(word[0]) > 2 and longer[0].startswith(word[0]) and word[1] == longer[1]
