"""Input files of other EnergyPlus versions: converted where it is known how, else refused by name.

EnergyPlus itself only warns of another version, and passes over fields that have another name by now. The
tables follow its "Input Changes" pages (24.1 to 24.2, 24.2 to 25.1, 25.1 to 25.2) and a comparison of the
schemas inside its libraries 23.2, 25.1 and 25.2: some changes of field names are on no page.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from models import energyplus
from models.building import schema
from topics.errors import InvalidConfig

Objects = Mapping[str, Mapping[str, Any]]
Renames = tuple[tuple[str, str], ...]
"""Patterns of whole field names and what they are now."""


@dataclass(frozen=True, slots=True)
class ConversionResult:
    """A model for the engine, and what was done to it, a line each."""

    objects: dict[str, Any]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class VersionTransition:
    """What changed in the input from one version to the next, by object type.

    Attributes:
        before, after: the two versions.
        renamed: fields with another name.
        listed: numbered fields that became the entries of a list: its name and the entries' fields.
        named: fields that became the object's name.
        dropped: fields that are gone and had no effect.
        defaults: fields whose default changed, with the old one.
        moved: other types whose fields moved within an IDF.
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
STEPS = (
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
"""What is known, in order."""


def check_epjson(objects: Objects, *, name: str, engine: str | None = None) -> ConversionResult:
    """The model for the engine, converted if it is of an earlier known version; the input is not touched.

    A model of the engine's own version, or of none, is taken as it is (EnergyPlus does the same).

    Args:
        objects: a whole epJSON.
        name: of the file, for the error.
        engine: the engine's version; None is the installed one.

    Raises:
        InvalidConfig: no way from its version to the engine's, or objects that do not fit the engine's schema.
    """
    engine = engine or energyplus.version()
    if not all(isinstance(items, Mapping) and _all_fields(items) for items in objects.values()):
        raise InvalidConfig(
            "\n".join([f"{name} is not an epJSON file:", *schema.schema_errors(objects, complete=False)])
        )
    said = next((fields.get("version_identifier") for fields in objects.get("Version", {}).values()), None)
    steps = _steps(said, engine, name)
    if not steps:
        return ConversionResult(dict(objects))
    result, notes = {kind: dict(items) for kind, items in objects.items()}, list[str]()
    for step in steps:
        done = [f"from {step.before} to {step.after}: {note}" for note in dict.fromkeys(_convert(step, result))]
        notes += done or [f"from {step.before} to {step.after}: nothing to convert"]
    result["Version"] = {each: {"version_identifier": steps[-1].after} for each in list(result["Version"])[:1]}
    if faults := schema.schema_errors(result, complete=True):
        head = f"{name} is of EnergyPlus {said}, and this does not fit {steps[-1].after} ({_advice(engine)}):"
        raise InvalidConfig("\n".join([head, *faults]))
    return ConversionResult(result, tuple(notes))


def check_idf(text: str, *, name: str, engine: str | None = None) -> tuple[str, ...]:
    """What to note of an IDF that EnergyPlus can read as it is; its fields go by place.

    Raises:
        InvalidConfig: of another version, unless none of its objects' fields has moved since.
    """
    engine = engine or energyplus.version()
    kinds = idf_objects(text)
    said = next((fields.split(",")[0].strip() for kind, fields in kinds if kind.casefold() == "version"), None)
    steps = _steps(said, engine, name)
    if not steps:
        return ()
    if len(steps) > 1:
        raise InvalidConfig(f"{name} is an IDF of EnergyPlus {said}; {_advice(engine)}")
    (step,) = steps
    changed = {
        k.casefold() for part in (step.renamed, step.listed, step.named, step.dropped, step.defaults) for k in part
    }
    changed |= {kind.casefold() for kind in step.moved}
    hit = sorted({kind for kind, _ in kinds if kind.casefold() in changed})
    if hit:
        raise InvalidConfig(
            f"{name} is an IDF of EnergyPlus {said} with objects whose fields are others in {step.after}: "
            f"{', '.join(hit)}; {_advice(engine)}"
        )
    return (f"from {step.before} to {step.after}: nothing to convert",)


def _all_fields(items: Mapping[str, Any]) -> bool:
    return all(isinstance(fields, Mapping) for fields in items.values())


def _steps(said: object, engine: str, name: str) -> tuple[VersionTransition, ...]:
    """The steps from the version that a file names to the engine's; none if it is the same or not named."""
    target = _short(engine)
    own = _short(said) if said not in (None, "") else target
    if own == target:
        return ()
    begins, ends = [step.before for step in STEPS], [step.after for step in STEPS]
    if own not in begins or target not in ends[begins.index(own) :]:
        raise InvalidConfig(f"{name} is of EnergyPlus {said}; {_advice(engine)}")
    return STEPS[begins.index(own) : ends.index(target) + 1]


def _short(version: object) -> str:
    """`25.2.0` is `25.2`; what is no version stays as it is."""
    found = re.match(r"\s*(\d+\.\d+)", str(version))
    return found[1] if found else str(version)


def _advice(engine: str) -> str:
    early = [step.before for step in STEPS]
    return (
        f"this engine is {engine}: give a model of {_short(engine)}, or an epJSON of {', '.join(early)}, "
        "or bring it up with EnergyPlus's own IDFVersionUpdater"
    )


def _convert(step: VersionTransition, objects: dict[str, dict[str, Any]]) -> Iterable[str]:
    """Converts `objects` in place, one level deep, and says what was done."""
    for kind, renames in step.renamed.items():
        yield from _each(objects, kind, lambda fields, r=renames: _rename(fields, r))
    for kind, (into, parts) in step.listed.items():
        yield from _each(objects, kind, lambda fields, i=into, p=parts: _list(fields, i, p))
    for kind, gone in step.dropped.items():
        yield from _each(objects, kind, lambda fields, g=gone: _drop(fields, g))
    for kind, (late, value) in step.defaults.items():
        yield from _each(objects, kind, lambda fields, n=late, v=value: _keep_default(fields, n, v))
    for kind, source in step.named.items():
        if any(source in fields for fields in objects.get(kind, {}).values()):
            items = {fields.get(source, name): dict(fields) for name, fields in objects[kind].items()}
            objects[kind] = {name: {f: v for f, v in fields.items() if f != source} for name, fields in items.items()}
            yield f"{kind}: {source} is now the object's name"


def _each(objects: dict[str, dict[str, Any]], kind: str, convert: Any) -> Iterable[str]:
    """Applies `convert` (fields in, new fields and a note out) to each object of a type."""
    for name, fields in objects.get(kind, {}).items():
        objects[kind][name], note = convert(fields)
        if note:
            yield f"{kind}: {note}"


def _rename(fields: Mapping[str, Any], renames: Renames) -> tuple[dict[str, Any], str]:
    result, done = {}, []
    for name, value in fields.items():
        now = name
        for pattern, new in renames:
            if found := re.fullmatch(pattern, name):
                now = found.expand(new)
                done.append(f"{name} is now {now}")
        result[now] = value
    return result, ", ".join(done)


def _list(fields: Mapping[str, Any], into: str, parts: Renames) -> tuple[dict[str, Any], str]:
    result: dict[str, Any] = {}
    entries: dict[int, dict[str, Any]] = {}
    for name, value in fields.items():
        for pattern, part in parts:
            if found := re.fullmatch(pattern, name):
                entries.setdefault(int(found[1]), {})[part] = value
                break
        else:
            result[name] = value
    if not entries:
        return result, ""
    result[into] = [entries[number] for number in sorted(entries)]
    return result, f"its numbered fields are now the list {into}"


def _drop(fields: Mapping[str, Any], gone: str) -> tuple[dict[str, Any], str]:
    left = {name: value for name, value in fields.items() if name != gone}
    return left, f"{gone} had no effect and is gone" if gone in fields else ""


def _keep_default(fields: Mapping[str, Any], name: str, value: Any) -> tuple[dict[str, Any], str]:
    if fields.get(name, "") != "":
        return dict(fields), ""
    return {**fields, name: value}, f"{name} stays {value}, which is no longer its default"


def idf_objects(text: str) -> list[tuple[str, str]]:
    """Object type and the text of the fields of each object of an IDF; comments are left out."""
    bare = re.sub(r"!.*", "", text)
    objects = (entry.strip().partition(",") for entry in bare.split(";"))
    return [(kind.strip(), fields) for kind, _, fields in objects if kind.strip()]
