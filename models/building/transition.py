"""Convert models of earlier EnergyPlus versions where the transition is known, and reject the rest.

EnergyPlus itself only warns about another version and ignores fields that have since been renamed. The tables
follow its "Input Changes" pages (24.1 to 24.2, 24.2 to 25.1, 25.1 to 25.2) and a comparison of the schemas inside
its libraries 23.2, 25.1 and 25.2, because some renamed fields are on none of those pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from zenostat.models import energyplus
from zenostat.models.building import schema
from zenostat.topics.errors import InvalidConfig

Objects = Mapping[str, Mapping[str, Any]]
Renames = tuple[tuple[str, str], ...]
"""Patterns of whole field names, and their replacements."""


@dataclass(frozen=True, slots=True)
class ConversionResult:
    """A model converted to the engine's version, with a note on each change."""

    objects: dict[str, Any]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class VersionTransition:
    """Changes of the input format from one version to the next, by object type.

    Attributes:
        before, after: the two versions.
        renamed: renamed fields.
        listed: numbered fields that became the entries of a list: the list's name and the entries' fields.
        named: fields that became the object's name.
        dropped: removed fields that had no effect.
        defaults: fields whose default changed, with the old default.
        moved: other types whose fields changed position in an IDF.
    """

    before: str
    after: str
    renamed: Mapping[str, Renames] = field(default_factory=dict)
    listed: Mapping[str, tuple[str, Renames]] = field(default_factory=dict)
    named: Mapping[str, str] = field(default_factory=dict)
    dropped: Mapping[str, str] = field(default_factory=dict)
    defaults: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    moved: tuple[str, ...] = ()


_SPACES = (("zone_name", "zone_or_space_name"),)
TRANSITIONS = (
    VersionTransition(
        "24.1",
        "24.2",
        renamed={
            "Output:IlluminanceMap": _SPACES,
            "ZoneCoolTower:Shower": _SPACES,
            "ZoneRefrigerationDoorMixing": ((r"zone_([12])_name", r"zone_or_space_name_\1"),),
            "ZoneThermalChimney": (
                (r"zone_(\d+)_name", r"zone_or_space_name_\1"),
                (r"(relative_ratios_of_air_flow_rates_passing_through)_zone_(\d+)", r"\1_inlet_\2"),
            ),
        },
        listed={
            "MaterialProperty:PhaseChange": (
                "values",
                ((r"temperature_(\d+)", "temperature"), (r"enthalpy_(\d+)", "enthalpy")),
            ),
            "MaterialProperty:VariableThermalConductivity": (
                "values",
                ((r"temperature_(\d+)", "temperature"), (r"thermal_conductivity_(\d+)", "thermal_conductivity")),
            ),
        },
        moved=("HeatPump:PlantLoop:EIR:Cooling", "HeatPump:PlantLoop:EIR:Heating", "OutputControl:Files"),
    ),
    VersionTransition("24.2", "25.1"),
    VersionTransition(
        "25.1",
        "25.2",
        renamed={
            "Coil:Cooling:DX:VariableSpeed": (
                (r"speed_(\d+)_reference_unit_condenser_(air_)?flow_rate",
                 r"speed_\1_reference_unit_rated_condenser_air_flow_rate"),
            ),
            "Coil:Heating:DX:VariableSpeed": (
                (r"speed_(\d+)_(heating_capacity_function_of_air_flow_fraction_curve_name)", r"speed_\1_total_\2"),
            ),
            "Coil:Heating:WaterToAirHeatPump:VariableSpeedEquationFit": (
                ("speed_1_reference_unit_rated_air_flow", "speed_1_reference_unit_rated_air_flow_rate"),
            ),
            "Coil:WaterHeating:AirToWaterHeatPump:VariableSpeed": (
                (r"(rated_sensible_heat_ratio|rated_water_heating_capacity|rated_water_heating_cop)_at_speed_(\d+)",
                 r"speed_\2_\1"),
            ),
            "Output:Table:ReportPeriod": (("report_name_", "report_name"),),
        },
        listed={
            "ComfortViewFactorAngles": (
                "angles",
                ((r"surface_(\d+)_name", "surface_name"), (r"angle_factor_(\d+)", "angle_factor")),
            ),
        },
        named={"Output:Table:ReportPeriod": "name_"},
        dropped={
            "AirLoopHVAC:UnitaryHeatPump:AirToAir:MultiSpeed":
                "minimum_outdoor_dry_bulb_temperature_for_compressor_operation",
        },
        defaults={"HeatExchanger:Desiccant:BalancedFlow": ("economizer_lockout", "No")},
        moved=(
            "Coil:Cooling:WaterToAirHeatPump:EquationFit",
            "Coil:Cooling:WaterToAirHeatPump:ParameterEstimation",
            "Coil:Cooling:WaterToAirHeatPump:VariableSpeedEquationFit",
            "Coil:Heating:WaterToAirHeatPump:EquationFit",
            "Coil:Heating:WaterToAirHeatPump:ParameterEstimation",
            "Coil:WaterHeating:AirToWaterHeatPump:Pumped",
            "Coil:WaterHeating:AirToWaterHeatPump:Wrapped",
            "GroundHeatExchanger:System",
        ),
    ),
)  # fmt: skip
"""The known transitions, in order."""


def check_epjson(objects: Objects, *, name: str, engine: str | None = None) -> ConversionResult:
    """Convert a model of a known earlier version for the engine; the input is not modified.

    A model of the engine's own version, or without a version, is used as it is, as in EnergyPlus.

    Args:
        objects: a whole epJSON.
        name: of the file, for error messages.
        engine: the engine's version; None means the installed one.

    Raises:
        InvalidConfig: there is no transition from the model's version to the engine's, or the result does not match
            the engine's schema.
    """
    engine = engine or energyplus.version()
    if not all(isinstance(items, Mapping) and _all_fields(items) for items in objects.values()):
        raise InvalidConfig(
            "\n".join([f"{name} is not an epJSON file:", *schema.schema_errors(objects, complete=False)])
        )
    version = next((fields.get("version_identifier") for fields in objects.get("Version", {}).values()), None)
    transitions = _transitions(version, engine, name)
    if not transitions:
        return ConversionResult(dict(objects))
    result, notes = {kind: dict(items) for kind, items in objects.items()}, list[str]()
    for step in transitions:
        changes = [f"from {step.before} to {step.after}: {note}" for note in dict.fromkeys(_convert(step, result))]
        notes += changes or [f"from {step.before} to {step.after}: nothing to convert"]
    target = transitions[-1].after
    result["Version"] = {key: {"version_identifier": target} for key in list(result["Version"])[:1]}
    if errors := schema.schema_errors(result, complete=True):
        head = f"{name} is for EnergyPlus {version}, and these objects do not match {target} ({_advice(engine)}):"
        raise InvalidConfig("\n".join([head, *errors]))
    return ConversionResult(result, tuple(notes))


def check_idf(text: str, *, name: str, engine: str | None = None) -> tuple[str, ...]:
    """Check that EnergyPlus can read an IDF as it is, and return notes on its version.

    Fields of an IDF are positional, so an IDF of another version cannot be converted here.

    Raises:
        InvalidConfig: the IDF is of another version in which a field of one of its objects changed.
    """
    engine = engine or energyplus.version()
    kinds = idf_objects(text)
    version = next((fields.split(",")[0].strip() for kind, fields in kinds if kind.casefold() == "version"), None)
    transitions = _transitions(version, engine, name)
    if not transitions:
        return ()
    if len(transitions) > 1:
        raise InvalidConfig(f"{name} is an IDF for EnergyPlus {version}; {_advice(engine)}")
    (step,) = transitions
    changed = {
        k.casefold()
        for entry_field in (step.renamed, step.listed, step.named, step.dropped, step.defaults)
        for k in entry_field
    }
    changed |= {kind.casefold() for kind in step.moved}
    affected = sorted({kind for kind, _ in kinds if kind.casefold() in changed})
    if affected:
        raise InvalidConfig(
            f"{name} is an IDF for EnergyPlus {version} with objects whose fields changed in {step.after}: "
            f"{', '.join(affected)}; {_advice(engine)}"
        )
    return (f"from {step.before} to {step.after}: nothing to convert",)


def _all_fields(items: Mapping[str, Any]) -> bool:
    return all(isinstance(fields, Mapping) for fields in items.values())


def _transitions(version: object, engine: str, name: str) -> tuple[VersionTransition, ...]:
    """Return the transitions from a file's version to the engine's; none if it is the same or unknown."""
    target = _short(engine)
    own = _short(version) if version not in (None, "") else target
    if own == target:
        return ()
    begins, ends = [step.before for step in TRANSITIONS], [step.after for step in TRANSITIONS]
    if own not in begins or target not in ends[begins.index(own) :]:
        raise InvalidConfig(f"{name} is for EnergyPlus {version}; {_advice(engine)}")
    return TRANSITIONS[begins.index(own) : ends.index(target) + 1]


def _short(version: object) -> str:
    """Shorten `25.2.0` to `25.2`; text that is not a version is unchanged."""
    match = re.match(r"\s*(\d+\.\d+)", str(version))
    return match[1] if match else str(version)


def _advice(engine: str) -> str:
    early = [step.before for step in TRANSITIONS]
    return (
        f"the engine's version is {engine}: use a model for {_short(engine)}, or an epJSON for {', '.join(early)}, "
        "or update the file with EnergyPlus's IDFVersionUpdater"
    )


def _convert(step: VersionTransition, objects: dict[str, dict[str, Any]]) -> Iterable[str]:
    """Convert `objects` in place, one level deep, and yield a note on each change."""
    for kind, renames in step.renamed.items():
        yield from _each(objects, kind, lambda fields, r=renames: _rename(fields, r))
    for kind, (list_name, entry_fields) in step.listed.items():
        yield from _each(objects, kind, lambda fields, i=list_name, p=entry_fields: _list(fields, i, p))
    for kind, removed in step.dropped.items():
        yield from _each(objects, kind, lambda fields, g=removed: _drop(fields, g))
    for kind, (field_name, value) in step.defaults.items():
        yield from _each(objects, kind, lambda fields, n=field_name, v=value: _keep_default(fields, n, v))
    for kind, source in step.named.items():
        if any(source in fields for fields in objects.get(kind, {}).values()):
            items = {fields.get(source, name): dict(fields) for name, fields in objects[kind].items()}
            objects[kind] = {name: {f: v for f, v in fields.items() if f != source} for name, fields in items.items()}
            yield f"{kind}: {source} is now the object's name"


def _each(objects: dict[str, dict[str, Any]], kind: str, convert: Any) -> Iterable[str]:
    """Apply `convert`, which returns new fields and a note, to each object of a type."""
    for name, fields in objects.get(kind, {}).items():
        objects[kind][name], note = convert(fields)
        if note:
            yield f"{kind}: {note}"


def _rename(fields: Mapping[str, Any], renames: Renames) -> tuple[dict[str, Any], str]:
    result, notes = {}, []
    for name, value in fields.items():
        new_name = name
        for pattern, template in renames:
            if match := re.fullmatch(pattern, name):
                new_name = match.expand(template)
                notes.append(f"{name} is now {new_name}")
        result[new_name] = value
    return result, ", ".join(notes)


def _list(fields: Mapping[str, Any], list_name: str, entry_fields: Renames) -> tuple[dict[str, Any], str]:
    result: dict[str, Any] = {}
    entries: dict[int, dict[str, Any]] = {}
    for name, value in fields.items():
        for pattern, entry_field in entry_fields:
            if match := re.fullmatch(pattern, name):
                entries.setdefault(int(match[1]), {})[entry_field] = value
                break
        else:
            result[name] = value
    if not entries:
        return result, ""
    result[list_name] = [entries[number] for number in sorted(entries)]
    return result, f"its numbered fields are now the list {list_name}"


def _drop(fields: Mapping[str, Any], removed: str) -> tuple[dict[str, Any], str]:
    kept = {name: value for name, value in fields.items() if name != removed}
    return kept, f"{removed} had no effect and was removed" if removed in fields else ""


def _keep_default(fields: Mapping[str, Any], name: str, value: Any) -> tuple[dict[str, Any], str]:
    if fields.get(name, "") != "":
        return dict(fields), ""
    return {**fields, name: value}, f"{name} stays {value}, which is no longer its default"


def idf_objects(text: str) -> list[tuple[str, str]]:
    """Return the object type and the text of the fields of each object of an IDF, without comments."""
    bare = re.sub(r"!.*", "", text)
    objects = (entry.strip().partition(",") for entry in bare.split(";"))
    return [(kind.strip(), fields) for kind, _, fields in objects if kind.strip()]
