"""What in a model fights the actuators of a scenario, found before it runs.

What wins over what was tried with EnergyPlus 25.2:

- An `EnergyManagementSystem:Actuator` on the same control always wins, wherever its program is called, and
  even if no program sets it: EnergyPlus then gives the building its own control back.
- A zone's thermostat (`Zone Temperature Control`) wins over the schedule of its setpoint. So EMS programs
  that set thermostat schedules do not disturb a scenario that sets zones; the reverse is a fight.
- A thermostat with one setpoint (`ThermostatSetpoint:SingleHeating`) offers the other to actuators as well,
  and does nothing with it.
- IT equipment under `FlowControlWithApproachTemperatures` fixes the supply air's temperature: its zone's
  temperature and power are the same at any cooling setpoint.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

from topics.messages import Actuator

Objects = Mapping[str, Mapping[str, Any]]

_ZONE_CONTROL = "zone temperature control"
_SCHEDULE_VALUE = "schedule value"
_APPROACH = "FlowControlWithApproachTemperatures"
_EMS = "EnergyManagementSystem:"

_DUAL = {
    "heating_setpoint_temperature_schedule_name": ("heating setpoint",),
    "cooling_setpoint_temperature_schedule_name": ("cooling setpoint",),
}
"""Fields of a dual setpoint and the zone control that each is."""

_SINGLE = {
    "ThermostatSetpoint:SingleHeating": ("heating setpoint",),
    "ThermostatSetpoint:SingleCooling": ("cooling setpoint",),
    "ThermostatSetpoint:SingleHeatingOrCooling": ("heating setpoint", "cooling setpoint"),
}

_BEFORE_RUN = {"endofzonesizing", "endofsystemsizing", "aftercomponentinputreadin", "unitarysystemsizing"}
"""Calling points of EMS programs that run before the simulation only; what they set is forgotten by then."""


def conflicts(objects: Objects, actuators: Sequence[Actuator]) -> list[str]:
    """A line for each thing in the model that takes an actuator's effect away, and why.

    Args:
        objects: the model, with the scenario's changes.
        actuators: those of the scenario, as EnergyPlus names them.
    """
    found = [
        f"actuator {name!r}: {text}"
        for name, texts in overridden_actuators(objects, actuators).items()
        for text in texts
    ]
    found.extend(_plugins(objects, actuators))
    return list(dict.fromkeys(found))


def overridden_actuators(objects: Objects, actuators: Sequence[Actuator]) -> dict[str, list[str]]:
    """By actuator, why it has no effect; those that have one are not in it."""
    model = _Model(objects)
    found = {actuator.name: list(model.against(actuator)) for actuator in actuators}
    return {name: texts for name, texts in found.items() if texts}


class _Model:
    """A model's EMS, thermostats and uses of schedules, names folded."""

    def __init__(self, objects: Objects) -> None:
        self.objects = objects
        self.ems = _Programs(objects)
        self.thermostats = list(_thermostats(objects))
        self.by_approach = dict(_approach_zones(objects))

    @cached_property
    def users(self) -> dict[str, set[str]]:
        """Types of the objects that use a name; walks the whole model."""
        return _users(self.objects)

    def against(self, actuator: Actuator) -> Iterator[str]:
        """What takes one actuator's effect away."""
        control = (_fold(actuator.component_type), _fold(actuator.control_type), _fold(actuator.key))
        reads = self.ems.readers(control[2]) if control[1] == _SCHEDULE_VALUE else []
        taken = list(self._same_control(control, reads))
        yield from taken
        yield from _external(self.objects, control)
        if control[0] == _ZONE_CONTROL:
            yield from self._missing(control[2], control[1])
            yield from self._approach([(control[2], control[1])])
        elif control[1] == _SCHEDULE_VALUE:
            governed = [(zone, what) for zone, what, schedule in self.thermostats if schedule == control[2]]
            yield from self._overruled(governed, actuator.key)
            yield from self._approach(governed)
            if not taken:
                yield from self._unused(actuator.key, reads)

    def _same_control(self, control: tuple[str, str, str], reads: list[str]) -> Iterator[str]:
        for name in self.ems.actuators.get(control, ()):
            setters = self.ems.setters(name)
            if setters:
                both = [program for program in setters if program in reads]
                also = f" ({_these('program', both)} also reads it)" if both else ""
                said = f"EMS {_these('program', setters)} sets the same control by {_EMS}Actuator {name!r}"
                yield f"{said}{also}, and wins"
            else:
                yield (
                    f"{_EMS}Actuator {name!r} is on the same control and no program sets it in the run; "
                    "EnergyPlus then gives the building its own control back"
                )

    def _overruled(self, governed: list[tuple[str, str]], schedule: str) -> Iterator[str]:
        for zone, what in governed:
            for name in self.ems.actuators.get((_ZONE_CONTROL, what, zone), ()):
                if setters := self.ems.setters(name, value_only=True):
                    yield (
                        f"EMS {_these('program', setters)} sets the {what} of zone {self._zone(zone)!r} by "
                        f"{_EMS}Actuator {name!r}, which wins over schedule {schedule!r} there"
                    )

    def _missing(self, zone: str, what: str) -> Iterator[str]:
        has = {control for own, control, _ in self.thermostats if own == zone}
        if has and what in ("heating setpoint", "cooling setpoint") and what not in has:
            yield f"the thermostat of zone {self._zone(zone)!r} has a {' and a '.join(sorted(has))} only"

    def _approach(self, governed: list[tuple[str, str]]) -> Iterator[str]:
        for zone, what in governed:
            if what == "cooling setpoint" and zone in self.by_approach:
                yield (
                    f"the cooling setpoint of zone {self._zone(zone)!r} has no effect: ElectricEquipment:ITE:AirCooled "
                    f"{self.by_approach[zone]!r} is under {_APPROACH}, which rule the supply air"
                )

    def _unused(self, schedule: str, reads: list[str]) -> Iterator[str]:
        users = self.users.get(_fold(schedule), set())
        if not users and reads:
            yield f"no object uses schedule {schedule!r}; only EMS {_these('program', reads)} reads it"
        elif not users:
            yield f"nothing in the model uses schedule {schedule!r}"
        elif all(kind.startswith("Sizing") for kind in users):
            yield f"schedule {schedule!r} is used for sizing only ({', '.join(sorted(users))})"

    def _zone(self, folded: str) -> str:
        return next((name for name in self.objects.get("Zone", {}) if _fold(name) == folded), folded)


class _Programs:
    """The EMS programs that run during the simulation, what each sets and what each reads."""

    def __init__(self, objects: Objects) -> None:
        self.actuators: dict[tuple[str, str, str], list[str]] = {}
        for name, fields in objects.get(_EMS + "Actuator", {}).items():
            self.actuators.setdefault(_control(fields), []).append(name)
        self._sensors = {
            _fold(name): _fold(fields.get("output_variable_or_output_meter_index_key_name"))
            for name, fields in objects.get(_EMS + "Sensor", {}).items()
            if _fold(fields.get("output_variable_or_output_meter_name")) == _SCHEDULE_VALUE
        }
        self._lines = {
            name: [str(line.get("program_line", "")) for line in fields.get("lines", ())]
            for kind in ("Program", "Subroutine")
            for name, fields in objects.get(_EMS + kind, {}).items()
        }
        called = {
            _fold(entry.get("program_name"))
            for fields in objects.get(_EMS + "ProgramCallingManager", {}).values()
            if _fold(fields.get("energyplus_model_calling_point")) not in _BEFORE_RUN
            for entry in fields.get("programs", ())
        }
        self.running = self._reached(called)

    def setters(self, actuator: str, *, value_only: bool = False) -> list[str]:
        """The running programs that set an EMS actuator; `value_only`: without those that only release it."""
        pattern = re.compile(rf"\s*SET\s+{re.escape(actuator)}\s*=\s*([^!]*)", re.IGNORECASE)
        found = []
        for name in self.running:
            values = [_fold(match[1]) for line in self._lines[name] if (match := pattern.match(line))]
            if any(not value_only or value != "null" for value in values):
                found.append(name)
        return found

    def readers(self, schedule: str) -> list[str]:
        """The running programs that read a schedule (its name folded) by an EMS sensor."""
        sensors = [name for name, key in self._sensors.items() if key == schedule]
        return [name for name in self.running if any(s in _words(self._lines[name]) for s in sensors)]

    def _reached(self, called: set[str]) -> list[str]:
        """Programs that are called, and those that they `RUN`."""
        reached, left = list[str](), set(called)
        while left:
            one = left.pop()
            for name in self._lines:
                if _fold(name) == one and name not in reached:
                    reached.append(name)
                    lines = self._lines[name]
                    left |= {_fold(m[1]) for line in lines if (m := re.match(r"\s*RUN\s+(\w+)", line, re.IGNORECASE))}
        return [name for name in self._lines if name in reached]


def _words(lines: list[str]) -> set[str]:
    """Every name in a program, folded; comments are left out."""
    return {word.casefold() for line in lines for word in re.findall(r"\w+", line.partition("!")[0])}


def _control(fields: Mapping[str, Any]) -> tuple[str, str, str]:
    return (
        _fold(fields.get("actuated_component_type")),
        _fold(fields.get("actuated_component_control_type")),
        _fold(fields.get("actuated_component_unique_name")),
    )


def _zones(objects: Objects, name: object) -> list[str]:
    """The zones, folded, that a zone, zone list, space or space list of that name stands for."""
    wanted = _fold(name)
    for lists, entries, entry, deeper in (
        ("ZoneList", "zones", "zone_name", False),
        ("SpaceList", "spaces", "space_name", True),
    ):
        for own, fields in objects.get(lists, {}).items():
            if _fold(own) == wanted:
                names = [each.get(entry) for each in fields.get(entries, ())]
                return [z for n in names for z in (_zones(objects, n) if deeper else [_fold(n)])]
    for own, fields in objects.get("Space", {}).items():
        if _fold(own) == wanted:
            return [_fold(fields.get("zone_name"))]
    return [wanted]


def _thermostats(objects: Objects) -> Iterator[tuple[str, str, str]]:
    """(zone, control, schedule), all folded, of each setpoint that some thermostat uses."""
    setpoints = {
        (_fold(kind), _fold(name)): (kind, fields)
        for kind in ("ThermostatSetpoint:DualSetpoint", *_SINGLE)
        for name, fields in objects.get(kind, {}).items()
    }
    for thermostat in objects.get("ZoneControl:Thermostat", {}).values():
        for number in range(1, 5):
            named = (thermostat.get(f"control_{number}_object_type"), thermostat.get(f"control_{number}_name"))
            kind, fields = setpoints.get((_fold(named[0]), _fold(named[1])), ("", {}))
            sources = (
                dict.fromkeys(("setpoint_temperature_schedule_name",), _SINGLE[kind]) if kind in _SINGLE else _DUAL
            )
            for zone in _zones(objects, thermostat.get("zone_or_zonelist_name")):
                for source, controls in sources.items():
                    for control in controls if kind else ():
                        yield zone, control, _fold(fields.get(source))


def _approach_zones(objects: Objects) -> Iterator[tuple[str, str]]:
    """(zone, IT equipment) where approach temperatures rule the supply air, which is behind VAV terminals only."""
    outlets = {
        _fold(fields.get("air_outlet_node_name"))
        for kind, items in objects.items()
        if kind.startswith("AirTerminal:SingleDuct:VAV:")
        for fields in items.values()
    }
    for name, fields in objects.get("ElectricEquipment:ITE:AirCooled", {}).items():
        method = _fold(fields.get("air_flow_calculation_method"))
        if method == _fold(_APPROACH) and _fold(fields.get("supply_air_node_name")) in outlets:
            for zone in _zones(objects, fields.get("zone_or_space_name")):
                yield zone, name


def _users(objects: Objects) -> dict[str, set[str]]:
    """Each text in the model, folded, and the types of the objects that have it in their fields.

    EMS, outputs and thermostat setpoints that no thermostat uses do not count as users.
    """
    used = {
        (_fold(thermostat.get(f"control_{n}_object_type")), _fold(thermostat.get(f"control_{n}_name")))
        for thermostat in objects.get("ZoneControl:Thermostat", {}).values()
        for n in range(1, 5)
    }
    found: dict[str, set[str]] = {}
    for kind, items in objects.items():
        optional = kind in ("ThermostatSetpoint:DualSetpoint", *_SINGLE)
        for name, fields in items.items() if not kind.startswith((_EMS, "Output")) else ():
            if not optional or (_fold(kind), _fold(name)) in used:
                for text in _texts(fields):
                    found.setdefault(text, set()).add(kind)
    return found


def _texts(value: object) -> Iterator[str]:
    """Every text in an object's fields, folded."""
    if isinstance(value, str):
        yield value.casefold()
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _texts(each)
    elif isinstance(value, Sequence):
        for each in value:
            yield from _texts(each)


def _external(objects: Objects, control: tuple[str, str, str]) -> Iterator[str]:
    """External interfaces that may set the same control, or the same schedule."""
    for kind, items in objects.items():
        if not kind.startswith("ExternalInterface:"):
            continue
        for name, fields in items.items():
            schedule = kind.endswith("Schedule") and control[1] == _SCHEDULE_VALUE and _fold(name) == control[2]
            if schedule or (kind.endswith("Actuator") and _control(fields) == control):
                yield f"{kind} {name!r} is on the same control and may win"


def _plugins(objects: Objects, actuators: Sequence[Actuator]) -> Iterator[str]:
    plugins = objects.get("PythonPlugin:Instance", {})
    if plugins and actuators:
        names = ", ".join(repr(actuator.name) for actuator in actuators[:3]) + (", …" if len(actuators) > 3 else "")
        for name, fields in plugins.items():
            what = f"{fields.get('python_module_name')}.{fields.get('plugin_class_name')}"
            yield f"actuators {names}: PythonPlugin:Instance {name!r} runs {what}, which may set the same controls"


def _these(noun: str, names: list[str]) -> str:
    return f"{noun}{'s' if len(names) > 1 else ''} {', '.join(map(repr, names))}"


def _fold(text: object) -> str:
    return "" if text is None else str(text).strip().casefold()
