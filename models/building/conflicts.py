"""Find what in a building model overrides the actuators of a scenario, before anything runs.

The order of precedence was determined by experiment with EnergyPlus 25.2:

- An `EnergyManagementSystem:Actuator` on the same control always takes precedence, at whatever calling point its
  program runs, and even if no program sets it: EnergyPlus then returns the control to the building.
- A zone's thermostat (`Zone Temperature Control`) takes precedence over the schedule of its setpoint. So EMS programs
  that set thermostat schedules do not affect a scenario that sets zones; the reverse is a conflict.
- A thermostat with one setpoint (`ThermostatSetpoint:SingleHeating`) offers an actuator for the other one as well,
  which has no effect.
- IT equipment under `FlowControlWithApproachTemperatures` determines the supply air temperature: its zone's
  temperature and power do not depend on the cooling setpoint.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.energyplus_names import SCHEDULE_VALUE, THERMOSTAT
from zenostat.topics.messages import Actuator

_ZONE_CONTROL = THERMOSTAT.casefold()
_SCHEDULE_VALUE = SCHEDULE_VALUE.casefold()
_APPROACH = "FlowControlWithApproachTemperatures"
_EMS = "EnergyManagementSystem:"

_DUAL = {
    "heating_setpoint_temperature_schedule_name": ("heating setpoint",),
    "cooling_setpoint_temperature_schedule_name": ("cooling setpoint",),
}
"""Schedule fields of a dual setpoint and their zone controls."""

_SINGLE = {
    "ThermostatSetpoint:SingleHeating": ("heating setpoint",),
    "ThermostatSetpoint:SingleCooling": ("cooling setpoint",),
    "ThermostatSetpoint:SingleHeatingOrCooling": ("heating setpoint", "cooling setpoint"),
}

_BEFORE_RUN = {"endofzonesizing", "endofsystemsizing", "aftercomponentinputreadin", "unitarysystemsizing"}
"""Calling points of EMS programs that run only before the simulation; values that they set do not last into it."""


def conflicts(objects: ModelObjects, actuators: Sequence[Actuator]) -> list[str]:
    """Return a line for each conflict between the model and an actuator, with the reason.

    Args:
        objects: the model, with the scenario's edits.
        actuators: those of the scenario, as EnergyPlus names them.
    """
    lines = [
        f"actuator {name!r}: {text}"
        for name, texts in overridden_actuators(objects, actuators).items()
        for text in texts
    ]
    lines.extend(_plugins(objects, actuators))
    return list(dict.fromkeys(lines))


def overridden_actuators(objects: ModelObjects, actuators: Sequence[Actuator]) -> dict[str, list[str]]:
    """Return the reasons why actuators have no effect, by actuator; actuators without conflicts are left out."""
    model = _Model(objects)
    reasons = {actuator.name: list(model.reasons(actuator)) for actuator in actuators}
    return {name: texts for name, texts in reasons.items() if texts}


class ProgramOverrides:
    """Programs that may set a control during the simulation: EMS programs, plug-ins, external interfaces."""

    def __init__(self, objects: ModelObjects) -> None:
        self._objects, self._programs = objects, _Programs(objects)

    def reasons(self, component_type: str, control_type: str, key: str) -> Iterator[str]:
        """Yield what may set a control, named as EnergyPlus names its actuator."""
        control = (_fold(component_type), _fold(control_type), _fold(key))
        for name in self._programs.actuators.get(control, ()):
            if setters := self._programs.setters(name):
                yield f"EMS {_programs(setters)} sets it through {_EMS}Actuator {name!r}"
        yield from _external(self._objects, control)
        for name in self._objects.get("PythonPlugin:Instance", {}):
            yield f"PythonPlugin:Instance {name!r} may set it"


class _Model:
    """A model's EMS, thermostats and schedule users; names are case-folded."""

    def __init__(self, objects: ModelObjects) -> None:
        self.objects = objects
        self.ems = _Programs(objects)
        self.thermostats = list(thermostat_setpoints(objects))
        self.by_approach = dict(_approach_zones(objects))

    @cached_property
    def users(self) -> dict[str, set[str]]:
        """Types of the objects that refer to a name; visits the whole model."""
        return _users(self.objects)

    def reasons(self, actuator: Actuator) -> Iterator[str]:
        """Yield the reasons why an actuator has no effect."""
        control = (_fold(actuator.component_type), _fold(actuator.control_type), _fold(actuator.key))
        reads = self.ems.readers(control[2]) if control[1] == _SCHEDULE_VALUE else []
        same_control = list(self._same_control(control, reads))
        yield from same_control
        yield from _external(self.objects, control)
        if control[0] == _ZONE_CONTROL:
            yield from self._missing_setpoint(control[2], control[1])
            yield from self._fixed_supply_air([(control[2], control[1])])
        elif control[1] == _SCHEDULE_VALUE:
            governed = [(zone, setpoint) for zone, setpoint, schedule in self.thermostats if schedule == control[2]]
            yield from self._overridden_schedule(governed, actuator.key)
            yield from self._fixed_supply_air(governed)
            if not same_control:
                yield from self._unused_schedule(actuator.key, reads)

    def _same_control(self, control: tuple[str, str, str], reads: list[str]) -> Iterator[str]:
        for name in self.ems.actuators.get(control, ()):
            setters = self.ems.setters(name)
            if setters:
                readers = [program for program in setters if program in reads]
                note = f" ({_programs(readers)} also reads it)" if readers else ""
                programs = f"EMS {_programs(setters)}"
                yield f"{programs} sets the same control through {_EMS}Actuator {name!r}{note} and takes precedence"
            else:
                yield (
                    f"{_EMS}Actuator {name!r} is on the same control, but no program sets it during the run; "
                    "EnergyPlus then returns the control to the building"
                )

    def _overridden_schedule(self, governed: list[tuple[str, str]], schedule: str) -> Iterator[str]:
        for zone, setpoint in governed:
            for name in self.ems.actuators.get((_ZONE_CONTROL, setpoint, zone), ()):
                if setters := self.ems.setters(name, value_only=True):
                    yield (
                        f"EMS {_programs(setters)} sets the {setpoint} of zone {self._zone(zone)!r} "
                        f"through {_EMS}Actuator {name!r}, which takes precedence over schedule {schedule!r} there"
                    )

    def _missing_setpoint(self, zone: str, setpoint: str) -> Iterator[str]:
        setpoints = {control for own, control, _ in self.thermostats if own == zone}
        if setpoints and setpoint in ("heating setpoint", "cooling setpoint") and setpoint not in setpoints:
            yield f"the thermostat of zone {self._zone(zone)!r} has only a {' and a '.join(sorted(setpoints))}"

    def _fixed_supply_air(self, governed: list[tuple[str, str]]) -> Iterator[str]:
        for zone, setpoint in governed:
            if setpoint == "cooling setpoint" and zone in self.by_approach:
                yield (
                    f"the cooling setpoint of zone {self._zone(zone)!r} has no effect: ElectricEquipment:ITE:AirCooled "
                    f"{self.by_approach[zone]!r} uses {_APPROACH}, which determines the supply air temperature"
                )

    def _unused_schedule(self, schedule: str, reads: list[str]) -> Iterator[str]:
        users = self.users.get(_fold(schedule), set())
        if not users and reads:
            yield f"no object uses schedule {schedule!r}; only EMS {_programs(reads)} reads it"
        elif not users:
            yield f"nothing in the model uses schedule {schedule!r}"
        elif all(kind.startswith("Sizing") for kind in users):
            yield f"schedule {schedule!r} is used for sizing only ({', '.join(sorted(users))})"

    def _zone(self, folded: str) -> str:
        return next((name for name in self.objects.get("Zone", {}) if _fold(name) == folded), folded)


class _Programs:
    """The EMS programs that run during the simulation, with the actuators that they set and the sensors they read."""

    def __init__(self, objects: ModelObjects) -> None:
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
        """Return the running programs that set an EMS actuator; `value_only`: except those that only set it to null."""
        pattern = re.compile(rf"\s*SET\s+{re.escape(actuator)}\s*=\s*([^!]*)", re.IGNORECASE)
        setters = []
        for name in self.running:
            values = [_fold(match[1]) for line in self._lines[name] if (match := pattern.match(line))]
            if any(not value_only or value != "null" for value in values):
                setters.append(name)
        return setters

    def readers(self, schedule: str) -> list[str]:
        """Return the running programs that read a schedule (a case-folded name) through an EMS sensor."""
        sensors = [name for name, key in self._sensors.items() if key == schedule]
        return [name for name in self.running if any(s in _words(self._lines[name]) for s in sensors)]

    def _reached(self, called: set[str]) -> list[str]:
        """Return the programs that are called, and those that they `RUN`."""
        reached, pending = list[str](), set(called)
        run = re.compile(r"\s*RUN\s+(\w+)", re.IGNORECASE)
        while pending:
            program = pending.pop()
            for name in self._lines:
                if _fold(name) == program and name not in reached:
                    reached.append(name)
                    pending |= {_fold(m[1]) for line in self._lines[name] if (m := run.match(line))}
        return [name for name in self._lines if name in reached]


def _words(lines: list[str]) -> set[str]:
    """Return all names in a program, case-folded, without comments."""
    return {word.casefold() for line in lines for word in re.findall(r"\w+", line.partition("!")[0])}


def _control(fields: Mapping[str, Any]) -> tuple[str, str, str]:
    return (
        _fold(fields.get("actuated_component_type")),
        _fold(fields.get("actuated_component_control_type")),
        _fold(fields.get("actuated_component_unique_name")),
    )


def _zones(objects: ModelObjects, name: object) -> list[str]:
    """Return the zones, case-folded, of a zone, zone list, space or space list."""
    folded = _fold(name)
    for list_type, entries_field, name_field, nested in (
        ("ZoneList", "zones", "zone_name", False),
        ("SpaceList", "spaces", "space_name", True),
    ):
        for own, fields in objects.get(list_type, {}).items():
            if _fold(own) == folded:
                names = [member.get(name_field) for member in fields.get(entries_field, ())]
                return [z for n in names for z in (_zones(objects, n) if nested else [_fold(n)])]
    for own, fields in objects.get("Space", {}).items():
        if _fold(own) == folded:
            return [_fold(fields.get("zone_name"))]
    return [folded]


def thermostat_setpoints(objects: ModelObjects) -> Iterator[tuple[str, str, str]]:
    """Yield (zone, control, schedule), all case-folded, for each setpoint that a thermostat uses."""
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


def thermostats(objects: ModelObjects, zone: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and fields of the thermostats of a zone (a case-folded name)."""
    for name, fields in objects.get("ZoneControl:Thermostat", {}).items():
        if zone in _zones(objects, fields.get("zone_or_zonelist_name")):
            yield name, fields


def _approach_zones(objects: ModelObjects) -> Iterator[tuple[str, str]]:
    """Yield (zone, IT equipment) where approach temperatures determine the supply air: only at VAV terminals."""
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


def _users(objects: ModelObjects) -> dict[str, set[str]]:
    """Return each string in the model, case-folded, with the types of the objects that have it in their fields.

    EMS objects, outputs and thermostat setpoints that no thermostat uses do not count as users.
    """
    used = {
        (_fold(thermostat.get(f"control_{n}_object_type")), _fold(thermostat.get(f"control_{n}_name")))
        for thermostat in objects.get("ZoneControl:Thermostat", {}).values()
        for n in range(1, 5)
    }
    users: dict[str, set[str]] = {}
    for kind, items in objects.items():
        optional = kind in ("ThermostatSetpoint:DualSetpoint", *_SINGLE)
        for name, fields in items.items() if not kind.startswith((_EMS, "Output")) else ():
            if not optional or (_fold(kind), _fold(name)) in used:
                for text in _texts(fields):
                    users.setdefault(text, set()).add(kind)
    return users


def _texts(value: object) -> Iterator[str]:
    """Yield all strings in an object's fields, case-folded."""
    if isinstance(value, str):
        yield value.casefold()
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, Sequence):
        for item in value:
            yield from _texts(item)


def _external(objects: ModelObjects, control: tuple[str, str, str]) -> Iterator[str]:
    """Yield the external interfaces that may set the same control or the same schedule."""
    for kind, items in objects.items():
        if not kind.startswith("ExternalInterface:"):
            continue
        for name, fields in items.items():
            schedule = kind.endswith("Schedule") and control[1] == _SCHEDULE_VALUE and _fold(name) == control[2]
            if schedule or (kind.endswith("Actuator") and _control(fields) == control):
                yield f"{kind} {name!r} is on the same control and may take precedence"


def _plugins(objects: ModelObjects, actuators: Sequence[Actuator]) -> Iterator[str]:
    plugins = objects.get("PythonPlugin:Instance", {})
    if plugins and actuators:
        names = ", ".join(repr(actuator.name) for actuator in actuators[:3]) + (", …" if len(actuators) > 3 else "")
        for name, fields in plugins.items():
            plugin = f"{fields.get('python_module_name')}.{fields.get('plugin_class_name')}"
            yield f"actuators {names}: PythonPlugin:Instance {name!r} runs {plugin}, which may set the same controls"


def _programs(names: list[str]) -> str:
    return f"program{'s' if len(names) > 1 else ''} {', '.join(map(repr, names))}"


def _fold(text: object) -> str:
    return "" if text is None else str(text).strip().casefold()
