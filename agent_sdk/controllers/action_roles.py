"""What the actions of a task are to a controller: setpoints, water temperatures, switches, storage; and whose."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from agent_sdk.controllers.base import Values
from agent_sdk.controllers.comfort_band import rewarded_temperatures
from agent_sdk.controllers.parameters import bounds
from topics.messages import Action, Actuator, Manifest, Sensor

THERMOSTAT = "zone temperature control"
OCCUPANTS = "zone people occupant count"
ZONE_TEMPERATURES = ("zone air temperature", "zone mean air temperature")

# What a room's setpoint can be, and what tells heating water from chilled water.
_ROOM_DEGC = (10.0, 40.0)
_TEPID_DEGC = 20.0


class Role(StrEnum):
    """What an action is."""

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
    """One action of the task.

    Attributes:
        action: what it sets.
        role: what it is.
        temperatures: positions among the sample's values of the air temperatures that it rules.
        people: positions of the occupant counts of those zones; of all zones, where those are not measured.
    """

    action: Action
    role: Role
    temperatures: tuple[int, ...]
    people: tuple[int, ...]

    def clip(self, value: float) -> float:
        """The value within the action's bounds that is nearest."""
        low, high = bounds(self.action)
        return min(max(value, low), high)

    def at(self, value: float) -> Values:
        """All its actuators at that value, or the nearest within the bounds."""
        return dict.fromkeys(self.action.actuators, self.clip(value))


def bind_actions(manifest: Manifest) -> tuple[ActionBinding, ...]:
    """The actions of a node's task, in order."""
    actuators = {a.name: a for a in manifest.actuators}
    roles = [role_of(action, actuators[action.actuators[0]]) for action in manifest.task.actions]
    return tuple(
        ActionBinding(action, role, *_rooms(action, [actuators[name] for name in action.actuators], manifest))
        for action, role in zip(manifest.task.actions, roles, strict=True)
    )


def role_of(action: Action | Actuator, actuator: Actuator) -> Role:
    """What an action is: by what EnergyPlus says, where it does; else by words in the names and by the range."""
    if actuator.component_type.casefold() == THERMOSTAT:
        found = actuator.control_type.casefold()
        return Role(found) if found in SETPOINTS else Role.OTHER
    for text in (action.name, actuator.name, actuator.key):
        role = _by_words(text.casefold(), *bounds(action))
        if role is not Role.OTHER:
            return role
    return Role.OTHER


def _by_words(text: str, low: float, high: float) -> Role:
    if "charge" in text:
        return Role.STORAGE
    if (low, high) == (0.0, 1.0):
        return Role.AVAILABILITY if "avail" in text else Role.OTHER
    if "water" in text or "chw" in text or "hhw" in text:
        return Role.COLD_WATER if high <= _TEPID_DEGC else Role.HOT_WATER
    if high >= _ROOM_DEGC[0] and low <= _ROOM_DEGC[1]:
        if "cool" in text or "clg" in text:
            return Role.COOLING
        if "heat" in text or "htg" in text:
            return Role.HEATING
    return Role.OTHER


def temperature_sensors(manifest: Manifest) -> list[Sensor]:
    """The air temperatures that matter: those of the reward, else those of all zones."""
    named = rewarded_temperatures(manifest)
    if named:
        return [s for s in manifest.sensors if s.name in named]
    for variable in ZONE_TEMPERATURES:
        found = [s for s in manifest.sensors if s.variable.casefold() == variable]
        if found:
            return found
    return []


def _rooms(
    action: Action, actuators: Sequence[Actuator], manifest: Manifest
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Positions of temperatures and of occupant counts: by zone for thermostats, else by name, else all."""
    places = {s.name: i for i, s in enumerate(manifest.sensors)}
    people = {s.key.casefold(): places[s.name] for s in manifest.sensors if s.variable.casefold() == OCCUPANTS}
    sensors = temperature_sensors(manifest)
    if actuators[0].component_type.casefold() == THERMOSTAT:
        zones = {a.key.casefold() for a in actuators}
        measured = [
            s for s in manifest.sensors if s.key.casefold() in zones and s.variable.casefold() in ZONE_TEMPERATURES
        ]
    else:
        measured = _named_alike(action.name, [a.name for a in manifest.task.actions], sensors) or sensors
        zones = {s.key.casefold() for s in measured}
    counted = [place for zone, place in people.items() if zone in zones]
    return tuple(places[s.name] for s in measured or sensors), tuple(counted or people.values())


def _named_alike(name: str, peers: Iterable[str], sensors: Sequence[Sensor]) -> list[Sensor]:
    """The sensors that share a word with the name which not all have: `radiant_bed1` and `bedroom01_temperature`."""
    others = [_words(peer) for peer in peers if peer != name]
    own = {word for word in _words(name) if sum(word in words for words in others) == 0}
    found = [s for s in sensors if any(_alike(mine, its) for mine in own for its in _words(s.name))]
    return found if len(found) < len(sensors) else []


def _words(name: str) -> set[tuple[str, int]]:
    """Words with the number that follows them (0 if none)."""
    pairs: list[tuple[str, str]] = re.findall(r"([a-z]+)(\d*)", name.casefold())
    return {(word, int(digits or 0)) for word, digits in pairs}


def _alike(mine: tuple[str, int], its: tuple[str, int]) -> bool:
    return len(mine[0]) > 2 and its[0].startswith(mine[0]) and mine[1] == its[1]
