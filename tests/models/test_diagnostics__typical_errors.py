"""Typical errors of models: each is told with its object, its field and its line, and no other error with it."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from support.data_packs import sinergym

from zenostat.models import schema
from zenostat.models.building.diagnostics import REQUIRED, Diagnostic, Severity, diagnose
from zenostat.models.catalog import find_building
from zenostat.models.input_format.epjson_reader import read_epjson
from zenostat.models.input_format.idf_reader import parse_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.models.input_format.source_model import SourceModel, SourceObject

MARK = "_TYPO"
MODELS = ["office-small", "sinergym/5ZoneAutoDXVAV", "warehouse"]
"""An IDF, an epJSON, and a second IDF with other systems."""

OWN_WARNINGS = {"office-small": ["data[8].field"]}
"""Fields of the models that have a warning: a schedule of the small office has `For: Weedends`."""


class Case(NamedTuple):
    """A typing error: the object types of which the first in the model is changed, its field, and what is said."""

    kinds: str
    field: str
    value: str
    words: str
    severity: Severity = Severity.ERROR


def wrong(kinds: str, field: str, noun: str) -> Case:
    """A reference to an object that does not exist."""
    return Case(kinds, field, MARK, f"the model has no .*{noun}.* of that name; did you mean '")


VALUES = {
    "lights-schedule": wrong("Lights", "schedule_name", "schedule"),
    "people-schedule": wrong("People", "number_of_people_schedule_name", "schedule"),
    "equipment-schedule": wrong("ElectricEquipment", "schedule_name", "schedule"),
    "infiltration-schedule": wrong("ZoneInfiltration:DesignFlowRate", "schedule_name", "schedule"),
    "setpoint-schedule": wrong(
        "ThermostatSetpoint:DualSetpoint", "heating_setpoint_temperature_schedule_name", "schedule"
    ),
    "thermostat-setpoint": wrong("ZoneControl:Thermostat", "control_1_name", "thermostat setpoint"),
    "surface-construction": wrong("BuildingSurface:Detailed", "construction_name", "construction"),
    "surface-zone": wrong("BuildingSurface:Detailed", "zone_name", "zone"),
    "window-wall": wrong("FenestrationSurface:Detailed", "building_surface_name", "surface"),
    "construction-layer": wrong("Construction", "outside_layer", "material"),
    "connections-zone": wrong("ZoneHVAC:EquipmentConnections", "zone_name", "zone"),
    "zone-equipment": wrong("ZoneHVAC:EquipmentList", "equipment[0].zone_equipment_name", "zone equipment"),
    "branch-component": wrong("Branch", "components[0].component_name", "branch equipment"),
    "branch-list": wrong("BranchList", "branches[0].branch_name", "branch"),
    "coil-curve": wrong(
        "Coil:Cooling:DX:SingleSpeed Coil:Cooling:DX:TwoSpeed",
        "total_cooling_capacity_function_of_temperature_curve_name",
        "curve of two variables",
    ),
    "inlet-node": Case(
        "Fan:ConstantVolume Fan:OnOff Fan:SystemModel Fan:VariableVolume",
        "air_inlet_node_name",
        MARK,
        "a node that nothing else in the model names; did you mean '",
        Severity.WARNING,
    ),
    "enumeration": Case("BuildingSurface:Detailed", "sun_exposure", "SunExposd", "did you mean 'SunExposed'"),
    "range": Case("Lights", "fraction_radiant", "1.75", "expected a number at least 0 and at most 1"),
    "text-for-number": Case("Material", "conductivity", "abc", "is 'abc'; expected a number above 0"),
    "integer": Case("Zone", "multiplier", "0", "is 0; expected an integer at least 1"),
}


class ModelText(NamedTuple):
    """A model file's text, and its objects with lines."""

    text: str
    is_idf: bool

    def read(self) -> SourceModel:
        """Read the text."""
        return parse_idf(self.text, engine_layout()) if self.is_idf else read_epjson(self.text)

    def with_line(self, number: int, change: Callable[[str], str]) -> ModelText:
        """Return the file with a line changed; lines count from 1."""
        lines = self.text.splitlines(keepends=True)
        lines[number - 1] = change(lines[number - 1])
        return self._replace(text="".join(lines))


@cache
def model_text(name: str) -> ModelText:
    """The text of a model."""
    if name.startswith("sinergym"):
        sinergym()
    path = find_building(name).path
    is_idf = path.suffix == ".idf"
    return ModelText(path.read_text("latin-1" if is_idf else "utf-8"), is_idf)


@cache
def source_of(name: str) -> SourceModel:
    """The objects of a model."""
    return model_text(name).read()


def first_object(name: str, kinds: str, field: str = "") -> SourceObject:
    """The first object of some types that has a value in a field."""
    for entry in source_of(name).entries:
        if entry.kind in kinds.split() and (not field or (field in entry.fields and entry.fields[field].text)):
            return entry
    pytest.skip(f"{name} has no {kinds} with {field}")


def diagnostics_of(model: ModelText) -> list[Diagnostic]:
    """The diagnostics of a changed model."""
    source = model.read()
    return diagnose(source.objects, source)


def errors_of(model: ModelText) -> list[Diagnostic]:
    """The errors of a changed model."""
    return [each for each in diagnostics_of(model) if each.severity is Severity.ERROR]


def mistyped(model: ModelText, entry: SourceObject, field: str, value: str) -> tuple[ModelText, int]:
    """The model with another value in a field, and the number of its line."""
    line, text = entry.fields[field]
    new = text + MARK if value == MARK else value
    pattern = rf"(^|[,:]\s*|\s){re.escape(text)}(?=\s*[,;])" if model.is_idf else rf'(": *)"?{re.escape(text)}"?(?=,|$)'
    quoted = new if model.is_idf or re.fullmatch(r"[\d.]+", new) else f'"{new}"'
    changed = model.with_line(line, lambda old: re.sub(pattern, lambda m: m[1] + quoted, old, count=1))
    (number,) = [
        i for i, (a, b) in enumerate(zip(model.text.splitlines(), changed.text.splitlines(), strict=True), 1) if a != b
    ]
    return changed, number


PAIRS = [
    pytest.param(case, name, marks=[pytest.mark.slow] * (name != MODELS[1]))
    for case in VALUES
    for name in MODELS
    if (case, name) != ("coil-curve", "warehouse")  # its coils have no curves
]


@pytest.mark.parametrize(("case", "name"), PAIRS)
def test_diagnose__typing_error_is_named_with_object_field_and_line(case: str, name: str) -> None:
    kinds, field, value, words, severity = VALUES[case]
    model = model_text(name)
    entry = first_object(name, kinds, field)
    changed, number = mistyped(model, entry, field, value)
    reported = [each for each in diagnostics_of(changed) if each.field == field or each.severity is Severity.ERROR]
    assert [(e.severity, e.kind, e.name, e.field, e.line) for e in reported] == [
        (severity, entry.kind, entry.name, field, number)
    ]
    assert re.search(words, reported[0].text), reported[0].text
    assert f"{entry.kind} {entry.name!r}" in str(reported[0])
    assert str(reported[0]).startswith(f"line {number}: ")


@pytest.mark.parametrize("name", MODELS)
def test_diagnose__no_error_in_the_models_themselves(name: str) -> None:
    assert [each.field for each in diagnostics_of(model_text(name))] == OWN_WARNINGS.get(name, [])


@pytest.mark.parametrize("name", MODELS)
def test_diagnose__unknown_type(name: str) -> None:
    model = model_text(name)
    word = "Zone," if model.is_idf else '"Zone": {'
    number = next(i for i, line in enumerate(model.text.splitlines(), 1) if line.strip().casefold() == word.casefold())
    changed = model.with_line(number, lambda line: re.sub("Zone", "Zonne", line, flags=re.IGNORECASE))
    reported = next(each for each in diagnostics_of(changed) if "Zonne" in each.text)
    first = number if model.is_idf else number + 1  # of the first object of that type
    assert (reported.severity, reported.kind, reported.line) == (Severity.ERROR, "Zonne", first)
    assert "EnergyPlus has no object type 'Zonne'; did you mean 'Zone'" in reported.text


@pytest.mark.parametrize("name", MODELS)
def test_diagnose__missing_required_field(name: str) -> None:
    model, entry = model_text(name), first_object(name, "Material", "conductivity")
    line, text = entry.fields["conductivity"]
    cut = re.escape(text) if model.is_idf else rf'"conductivity": *{re.escape(text)},'
    (reported,) = errors_of(model.with_line(line, lambda old: re.sub(cut, "", old, count=1)))
    assert (reported.kind, reported.name) == ("Material", entry.name)
    assert "lacks 'conductivity'" in reported.text
    assert reported.line == entry.line


@pytest.mark.parametrize("name", MODELS)
def test_diagnose__object_that_is_in_the_file_twice(name: str) -> None:
    model, entry = model_text(name), first_object(name, "Material")
    if model.is_idf:
        begin = model.text.splitlines()[entry.line - 2 :]
        end = next(i for i, line in enumerate(begin) if ";" in line.partition("!")[0])
        copy = "\n".join(begin[: end + 1])
        changed = model._replace(text=f"{model.text}\n{copy}\n")
        number = model.text.count("\n") + 3
    else:
        key = f'"{entry.name}": '
        changed = model.with_line(entry.line, lambda line: line.replace(key, f'{key}{{"roughness": "Smooth"}}, {key}'))
        number = entry.line
        changed = changed._replace(text=changed.text.replace(f"}}, {key}", f"}},\n{key}", 1))
        number += 1
    (reported,) = errors_of(changed)
    assert (reported.kind, reported.name, reported.line) == ("Material", entry.name, number)
    assert f"is in the file twice; first in line {entry.line}" in reported.text


@pytest.mark.parametrize("name", ["office-small", "warehouse"])
@pytest.mark.parametrize("sign", [",", ";"])
def test_diagnose__missing_comma_or_semicolon_of_an_idf(name: str, sign: str) -> None:
    model, entry = model_text(name), first_object(name, "Material")
    fields = [value.line for value in entry.fields.values() if value.text]
    number = fields[1] if sign == "," else fields[-1]
    changed = model.with_line(number, lambda line: line.replace(sign, " ", 1))
    reported = diagnostics_of(changed)[0]
    assert (reported.kind, reported.name, reported.line) == ("Material", entry.name, number)
    assert "',' or ';' is missing" in reported.text


@pytest.mark.parametrize("name", ["office-small", "warehouse"])
def test_diagnose__too_many_fields_of_an_idf(name: str) -> None:
    model, entry = model_text(name), first_object(name, "ScheduleTypeLimits")
    number = max(value.line for value in entry.fields.values())
    (reported,) = errors_of(model.with_line(number, lambda line: line.replace(";", ", , , 1, 2, 3;", 1)))
    assert (reported.kind, reported.name, reported.line) == ("ScheduleTypeLimits", entry.name, number)
    assert re.search(r"has \d fields, but the type has 5", reported.text)


@pytest.mark.parametrize("name", ["office-small", "warehouse"])
def test_diagnose__a_value_too_many_is_found_by_the_comments_of_an_idf(name: str) -> None:
    model, entry = model_text(name), first_object(name, "Lights", "watts_per_floor_area")
    line = entry.fields["watts_per_floor_area"].line
    (reported,) = errors_of(model.with_line(line, lambda old: f"    1.5,\n{old}"))
    assert (reported.kind, reported.name, reported.line) == ("Lights", entry.name, line)
    assert "'1.5', but the comments after it name the fields before: a value too many" in reported.text


@pytest.mark.parametrize("name", ["office-small", "warehouse"])
def test_diagnose__a_missing_value_is_found_by_the_comments_of_an_idf(name: str) -> None:
    model, entry = model_text(name), first_object(name, "Lights", "design_level_calculation_method")
    line = entry.fields["design_level_calculation_method"].line
    (reported,) = errors_of(model.with_line(line, lambda _: ""))
    assert (reported.kind, reported.name, reported.line) == ("Lights", entry.name, line)
    assert "the comment names lighting_level: a value is missing" in reported.text


@pytest.mark.parametrize("name", ["office-small", "warehouse"])
def test_diagnose__merge_that_git_could_not_finish(name: str) -> None:
    model, entry = model_text(name), first_object(name, "Lights", "design_level_calculation_method")
    begin = entry.line
    end = max(value.line for value in entry.fields.values())
    lines = model.text.splitlines()
    own = lines[begin - 1 : end]
    conflict = ["<<<<<<< HEAD", *own, "=======", *own, ">>>>>>> mine"]
    changed = model._replace(text="\n".join([*lines[: begin - 1], *conflict, *lines[end:], ""]))
    (reported,) = errors_of(changed)
    assert reported.line == begin
    assert reported.text.startswith("'<<<<<<< HEAD' begins two versions of the lines after it")


def without(objects: dict[str, Any], kind: str) -> dict[str, Any]:
    return {own: items for own, items in objects.items() if own != kind}


def test_diagnose__plant_loop_without_a_setpoint() -> None:
    objects = source_of("office-medium").objects
    (loop,) = objects["PlantLoop"].values()
    node = loop["loop_temperature_setpoint_node_name"]
    (reported,) = diagnose(without(objects, "SetpointManager:Scheduled"))
    assert (reported.severity, reported.kind) == (Severity.WARNING, "PlantLoop")
    assert f"is {node!r}, but no setpoint manager or EMS actuator sets that node" in reported.text


def test_diagnose__mixer_without_outdoor_air() -> None:
    objects = without(source_of("office-medium").objects, "OutdoorAir:NodeList")
    reported = [each for each in diagnose(objects) if each.kind == "OutdoorAir:Mixer"]
    assert {each.name for each in reported} == set(objects["OutdoorAir:Mixer"])
    assert all(each.field == "outdoor_air_stream_node_name" for each in reported)


def test_diagnose__unknown_field_of_an_epjson() -> None:
    model, entry = model_text(MODELS[1]), first_object(MODELS[1], "Lights", "schedule_name")
    line = entry.fields["schedule_name"].line
    missing, reported = errors_of(model.with_line(line, lambda old: old.replace("schedule_name", "schedul_name")))
    assert "lacks 'schedule_name'" in missing.text
    assert (reported.kind, reported.name, reported.field, reported.line) == ("Lights", entry.name, "schedul_name", line)
    assert "has no field 'schedul_name'; did you mean 'schedule_name'" in reported.text


def test_diagnose__value_that_is_the_name_of_another_type_is_said() -> None:
    source = read_epjson(
        '{"Building": {"B": {}}, "GlobalGeometryRules": {"G": {"coordinate_system": "World", '
        '"starting_vertex_position": "UpperLeftCorner", "vertex_entry_direction": "Counterclockwise"}}, '
        '"Zone": {"Z": {}}, "Lights": {\n"L": {"zone_or_zonelist_or_space_or_spacelist_name": "Z",\n'
        '"schedule_name": "z"}}}'
    )
    (reported,) = [each for each in diagnose(source.objects, source) if each.kind == "Lights"]
    assert str(reported) == "line 3: Lights 'L': schedule_name is 'z', which is a Zone, no schedule; there are none"


def test_diagnose__names_types_that_energyplus_requires() -> None:
    assert schema.document()["required"] == list(REQUIRED)
    assert [e.text for e in diagnose({"Building": {"B": {}}}) if e.severity is Severity.ERROR] == [
        "the model has no GlobalGeometryRules object; EnergyPlus requires one"
    ]


@pytest.mark.slow
def test_diagnose__no_error_in_any_bundled_model() -> None:
    sinergym()
    from zenostat.models.building.model import read_building
    from zenostat.models.catalog import buildings

    errors = {
        entry.name: [str(e) for e in diagnose(read_building(entry).objects) if e.severity is Severity.ERROR]
        for entry in buildings()
    }
    assert len(errors) >= 41
    assert {name: reported for name, reported in errors.items() if reported} == {}


def test_parse_idf__bundled_model_equals_energyplus_own_conversion() -> None:
    from zenostat.models.building.model import read_building

    assert source_of("office-small").objects == read_building(find_building("office-small")).objects


@pytest.mark.slow
def test_parse_idf__each_bundled_model_equals_energyplus_own_conversion() -> None:
    from zenostat.models.building.model import read_building
    from zenostat.models.catalog import bundled_buildings

    for entry in bundled_buildings():
        source = parse_idf(Path(entry.path).read_text("latin-1"), engine_layout())
        assert not source.issues
        assert source.objects == read_building(entry).objects, entry.name
