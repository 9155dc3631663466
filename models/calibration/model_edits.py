"""Parameters of a building model as edits of its objects: a factor on all infiltration, an offset of a setpoint.

A parameter selects numeric fields of objects by type, by a pattern of names and by field, and changes each with its
value: `multiply`, `divide`, `add`, `set`, `at_least` or `at_most`. A field that names a schedule stands for the values
of that schedule. What EnergyPlus sizes itself (`Autosize`) is no number and stays as it is.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from zenostat.models import schema
from zenostat.models.building.compact_schedules import compact_values
from zenostat.models.building.edits import Edits
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.errors import InvalidConfig, did_you_mean

OPERATIONS: dict[str, Callable[[float, float], float]] = {
    "multiply": operator.mul,
    "divide": operator.truediv,
    "add": operator.add,
    "set": lambda _, value: value,
    "at_least": max,
    "at_most": min,
}
"""Functions of a field's number and the parameter's value."""

NEUTRAL = {"multiply": 1.0, "divide": 1.0, "add": 0.0}
"""Values that leave a model as it is, by operation."""

SCHEDULES = (
    "Schedule:Compact", "Schedule:Constant", "Schedule:Day:Hourly", "Schedule:Day:Interval", "Schedule:Day:List",
)  # fmt: skip
"""Types whose values an edit can change; a `Schedule:Year` or `Schedule:Week:…` stands for the days that it names."""

_EDIT_FIELDS = ("type", "fields", "objects", "operation")


@dataclass(frozen=True)
class FieldEdit:
    """Edit of numeric fields.

    Attributes:
        type: object type.
        fields: fields of it; of a schedule, none: its values are meant.
        operation: one of `OPERATIONS`.
        objects: pattern of object names in any case, with `*` and `?`.
    """

    type: str
    fields: tuple[str, ...] = ()
    operation: str = "multiply"
    objects: str = "*"


@dataclass(frozen=True)
class Kind:
    """Kind of parameter: its edits, its unit, and what it is.

    Attributes:
        unit: unit of the parameter's value; `1` for a factor.
        is_complete: whether each of the edits has to find an object, rather than any of them.
    """

    text: str
    unit: str
    edits: tuple[FieldEdit, ...]
    is_complete: bool = False


def _factor(text: str, *edits: tuple[str, tuple[str, ...]], operation: str = "multiply", objects: str = "*") -> Kind:
    return Kind(text, "1", tuple(FieldEdit(kind, fields, operation, objects) for kind, fields in edits))


def _setpoint(use: str) -> Kind:
    field = f"{use}_setpoint_temperature_schedule_name"
    single = "ThermostatSetpoint:SingleHeating" if use == "heating" else "ThermostatSetpoint:SingleCooling"
    edits = (
        FieldEdit("ThermostatSetpoint:DualSetpoint", (field,), "add"),
        FieldEdit(single, ("setpoint_temperature_schedule_name",), "add"),
    )
    return Kind(f"offset of all values of the {use} setpoint schedules", "K", edits)


_INSULATION = (
    FieldEdit("Material", ("conductivity",), "divide", "*insul*"),
    FieldEdit("Material:NoMass", ("thermal_resistance",), "multiply", "*insul*"),
)
_PEOPLE = (
    FieldEdit("People", ("number_of_people", "people_per_floor_area"), "multiply"),
    FieldEdit("People", ("floor_area_per_person",), "divide"),
)

KINDS: dict[str, Kind] = {
    "infiltration": _factor(
        "factor on infiltration flows and leakage areas",
        ("ZoneInfiltration:DesignFlowRate", (
            "design_flow_rate", "flow_rate_per_floor_area", "flow_rate_per_exterior_surface_area",
            "air_changes_per_hour",
        )),
        ("ZoneInfiltration:EffectiveLeakageArea", ("effective_air_leakage_area",)),
        ("ZoneInfiltration:FlowCoefficient", ("flow_coefficient",)),
    ),
    "insulation": Kind("factor on the thermal resistance of materials named `*insul*`", "1", _INSULATION),
    "window_u_factor": _factor("factor on the U-factor of simple glazing", (
        "WindowMaterial:SimpleGlazingSystem", ("u_factor",),
    )),
    "window_solar_gain": _factor("factor on the solar heat gain coefficient of simple glazing", (
        "WindowMaterial:SimpleGlazingSystem", ("solar_heat_gain_coefficient",),
    )),
    "thermal_mass": _factor("factor on the surface of internal mass", ("InternalMass", ("surface_area",))),
    "lighting": _factor("factor on installed lighting power", (
        "Lights", ("lighting_level", "watts_per_floor_area", "watts_per_person"),
    )),
    "equipment": _factor("factor on installed power of electric equipment", (
        "ElectricEquipment", ("design_level", "watts_per_floor_area", "watts_per_person"),
    )),
    "gas_equipment": _factor("factor on installed power of gas equipment", (
        "GasEquipment", ("design_level", "power_per_floor_area", "power_per_person"),
    )),
    "people": Kind("factor on the number of people", "1", _PEOPLE),
    "outdoor_air": _factor("factor on design outdoor air flows", (
        "DesignSpecification:OutdoorAir", (
            "outdoor_air_flow_per_person", "outdoor_air_flow_per_zone_floor_area", "outdoor_air_flow_per_zone",
            "outdoor_air_flow_air_changes_per_hour",
        ),
    )),
    "cooling_efficiency": _factor(
        "factor on the rated COP of DX cooling coils and chillers",
        ("Coil:Cooling:DX:SingleSpeed", ("gross_rated_cooling_cop",)),
        ("Coil:Cooling:DX:TwoSpeed", ("high_speed_gross_rated_cooling_cop", "low_speed_gross_rated_cooling_cop")),
        ("Coil:Cooling:DX:MultiSpeed", tuple(f"speed_{n}_gross_rated_cooling_cop" for n in range(1, 5))),
        ("Chiller:Electric:EIR", ("reference_cop",)),
        ("Chiller:Electric:ReformulatedEIR", ("reference_cop",)),
    ),
    "heating_efficiency": _factor(
        "factor on the efficiency of burners and boilers and on the rated COP of heat pumps; at most 1 as efficiency",
        ("Coil:Heating:Fuel", ("burner_efficiency",)),
        ("Boiler:HotWater", ("nominal_thermal_efficiency",)),
        ("Coil:Heating:DX:SingleSpeed", ("gross_rated_heating_cop",)),
    ),
    "fan_efficiency": _factor(
        "factor on the total efficiency of fans",
        *((kind, ("fan_total_efficiency",)) for kind in (
            "Fan:ConstantVolume", "Fan:VariableVolume", "Fan:OnOff", "Fan:SystemModel",
        )),
    ),
    "heating_setpoint": _setpoint("heating"),
    "cooling_setpoint": _setpoint("cooling"),
}  # fmt: skip
"""Kinds of parameters by name."""


@dataclass(frozen=True)
class ModelParameter:
    """A parameter of a model.

    Attributes:
        name: its name.
        edits: what it changes.
        unit: unit of its value; `1` for a factor.
        is_complete: whether each of the edits has to find an object.
    """

    name: str
    edits: tuple[FieldEdit, ...]
    unit: str = "1"
    is_complete: bool = False

    @property
    def neutral(self) -> float | None:
        """The value that leaves a model as it is; None if there is none."""
        values = {NEUTRAL.get(edit.operation) for edit in self.edits}
        return values.pop() if len(values) == 1 else None


def read_parameter(name: str, edit: object, objects: str | None = None, unit: str | None = None) -> ModelParameter:
    """Return a parameter from a kind's name, or from a list of edits as mappings.

    Args:
        name: name of the parameter.
        edit: a key of `KINDS`, or a list of `{type, fields, objects, operation}`.
        objects: with a kind, a pattern that replaces those of its edits.
        unit: unit of a list of edits.

    Raises:
        InvalidConfig: there is no such kind, type, field or operation.
    """
    where = f"parameters.{name}"
    if isinstance(edit, str):
        if edit not in KINDS:
            hint = did_you_mean(edit, KINDS, limit=len(KINDS))
            raise InvalidConfig(f"{where}.edit: there is no kind {edit!r}; {hint}")
        kind = KINDS[edit]
        edits = kind.edits if objects is None else tuple(replace(each, objects=objects) for each in kind.edits)
        return ModelParameter(name, edits, kind.unit, kind.is_complete)
    if objects is not None:
        raise InvalidConfig(f"{where}.objects: only with the name of a kind; each edit of a list has its own")
    if not isinstance(edit, Sequence) or not edit:
        raise InvalidConfig(f"{where}.edit: the name of a kind or a list of edits expected, got {edit!r}")
    read = tuple(_read_edit(f"{where}.edit[{number}]", each) for number, each in enumerate(edit))
    return ModelParameter(name, read, unit or "1", is_complete=True)


def _read_edit(where: str, fields: object) -> FieldEdit:
    if not isinstance(fields, Mapping):
        raise InvalidConfig(f"{where}: a mapping with type, fields, objects and operation expected, got {fields!r}")
    for field in fields:
        if field not in _EDIT_FIELDS:
            raise InvalidConfig(f"{where}: there is no field {field!r}; {did_you_mean(str(field), _EDIT_FIELDS)}")
    kind = schema.canonical_type(str(fields.get("type", "")))
    if kind is None:
        raise InvalidConfig(f"{where}.type: {schema.unknown_type(str(fields.get('type', '')))}")
    edit = str(fields.get("operation", "multiply"))
    if edit not in OPERATIONS:
        raise InvalidConfig(f"{where}.operation: {edit!r} is none of {', '.join(OPERATIONS)}")
    names = fields.get("fields", ())
    names = (names,) if isinstance(names, str) else tuple(map(str, names))
    for name in names:
        if not schema.has_field(kind, name):
            raise InvalidConfig(f"{where}.fields: {kind} {schema.unknown_field(kind, name)}")
    if not names and kind not in SCHEDULES:
        raise InvalidConfig(f"{where}.fields: missing; only an edit of a schedule has none, which means its values")
    return FieldEdit(kind, names, edit, str(fields.get("objects", "*")))


class Place(NamedTuple):
    """A number of a model: object type, object name, path of the field (`data[3].field`), and the number."""

    kind: str
    name: str
    path: str
    number: float


def places(objects: ModelObjects, parameter: ModelParameter) -> list[tuple[FieldEdit, Place]]:
    """Return the numbers that a parameter changes, each with its edit.

    Raises:
        InvalidConfig: there is none.
    """
    result: list[tuple[FieldEdit, Place]] = []
    for edit in parameter.edits:
        matched = list(dict.fromkeys(_places(objects, edit)))
        if not matched and parameter.is_complete:
            raise InvalidConfig(f"parameters.{parameter.name}: {_nothing_to_edit(objects, edit)}")
        result += [(edit, place) for place in matched]
    if not result:
        texts = "; ".join(_nothing_to_edit(objects, edit) for edit in parameter.edits)
        raise InvalidConfig(f"parameters.{parameter.name}: {texts}")
    return result


def _matching(objects: ModelObjects, edit: FieldEdit) -> Iterator[tuple[str, Mapping[str, Any]]]:
    pattern = edit.objects.casefold().replace("[", "[[]")  # only * and ? are wildcards
    for name, fields in objects.get(edit.type, {}).items():
        if fnmatchcase(name.casefold(), pattern):
            yield name, fields


def _places(objects: ModelObjects, edit: FieldEdit) -> Iterator[Place]:
    for name, fields in _matching(objects, edit):
        if not edit.fields:
            yield from _schedule_places(edit.type, name, fields)
        for field in edit.fields:
            value = fields.get(field)
            if isinstance(value, str) and field.endswith("schedule_name"):
                yield from _places_of_schedule(objects, value, set())
            elif isinstance(value, int | float) and not isinstance(value, bool):
                yield Place(edit.type, name, field, float(value))


def _places_of_schedule(objects: ModelObjects, name: str, visited: set[str]) -> Iterator[Place]:
    """Yield the values of a schedule; of those of years and weeks, the values of their days."""
    if name.casefold() in visited:
        return
    visited.add(name.casefold())
    for kind, items in objects.items():
        if not kind.startswith("Schedule:"):
            continue
        for own, fields in items.items():
            if own.casefold() != name.casefold():
                continue
            if kind in SCHEDULES:
                yield from _schedule_places(kind, own, fields)
            else:
                for text in _texts(fields):
                    yield from _places_of_schedule(objects, text, visited)


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from _texts(part)
    elif isinstance(value, list):
        for part in value:
            yield from _texts(part)


_VALUE_OF_ENTRY = {"Schedule:Day:Interval": ("data", "value_until_time"), "Schedule:Day:List": ("extensions", "value")}


def _schedule_places(kind: str, name: str, fields: Mapping[str, Any]) -> Iterator[Place]:
    if kind == "Schedule:Compact":
        for path, number in compact_values(fields):
            yield Place(kind, name, path, number)
    elif kind in _VALUE_OF_ENTRY:
        field, member = _VALUE_OF_ENTRY[kind]
        for index, entry in enumerate(fields.get(field, ())):
            if isinstance(entry.get(member), int | float):
                yield Place(kind, name, f"{field}[{index}].{member}", float(entry[member]))
    else:
        for field, value in fields.items():
            if isinstance(value, int | float) and (field == "hourly_value" or re.fullmatch(r"hour_\d+", field)):
                yield Place(kind, name, field, float(value))


def _nothing_to_edit(objects: ModelObjects, edit: FieldEdit) -> str:
    """Return why an edit changes nothing, and what would be right."""
    kinds = [kind for kind in objects if objects[kind]]
    if not objects.get(edit.type):
        return f"the model has no {edit.type}; {did_you_mean(edit.type, kinds)}"
    names = [name for name, _ in _matching(objects, edit)]
    if not names:
        hint = did_you_mean(edit.objects, objects[edit.type])
        return f"the model has no {edit.type} with a name like {edit.objects!r}; {hint}"
    fields = " or ".join(edit.fields) or "value"
    return f"{edit.type} {names[0]!r} has no number as {fields} (what EnergyPlus sizes cannot be edited)"


def edits_of(objects: ModelObjects, parameter: ModelParameter, value: float) -> Edits:
    """Return the edits of a model, as of a scenario, for a value of a parameter; see `apply_edits`."""
    changed: dict[tuple[str, str], dict[str, Any]] = {}
    for edit, place in places(objects, parameter):
        fields = changed.setdefault((place.kind, place.name), {})
        number = OPERATIONS[edit.operation](place.number, value)
        _put(objects[place.kind][place.name], fields, place.path, number)
    edits: Edits = {}
    for (kind, name), fields in changed.items():
        edits.setdefault(kind, {})[name] = fields
    return edits


_ENTRY = re.compile(r"(\w+)\[(\d+)\]\.(\w+)")


def _put(own: Mapping[str, Any], fields: dict[str, Any], path: str, number: float) -> None:
    match = _ENTRY.fullmatch(path)
    if match is None:
        fields[path] = number
        return
    field, index, member = match[1], int(match[2]), match[3]
    if field not in fields:
        fields[field] = [dict(entry) for entry in own[field]]
    fields[field][index][member] = number


def describe_places(places_of_parameter: Iterable[tuple[FieldEdit, Place]]) -> str:
    """Return what a parameter changes: `multiply air_changes_per_hour of 6 ZoneInfiltration:DesignFlowRate`."""
    groups: dict[tuple[str, str, str], dict[str, None]] = {}
    for edit, place in places_of_parameter:
        field = "values" if place.kind in SCHEDULES else place.path
        groups.setdefault((edit.operation, field, place.kind), {})[place.name] = None
    return "; ".join(
        f"{edit} {field} of {kind} {next(iter(names))!r}" if len(names) == 1 else
        f"{edit} {field} of {len(names)} {kind}"
        for (edit, field, kind), names in groups.items()
    )  # fmt: skip
