"""EnergyPlus's schema: no false alarms on real models, and the same verdict as EnergyPlus itself."""

import copy
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.energyplus_alone import run_energyplus
from support.run_cli import run_python

from zenostat.models import schema
from zenostat.models.building.model import for_episode, read_building, write
from zenostat.models.catalog import Entry, buildings, find_building, find_weather

MATERIAL = {"roughness": "Smooth", "thickness": 0.1, "conductivity": 0.2, "density": 800.0, "specific_heat": 900.0}


def material(**edits: Any) -> dict[str, dict[str, dict[str, Any]]]:
    return {"Material": {"brick": {**MATERIAL, **edits}}}


def only(objects: Mapping[str, Any], *, complete: bool = True) -> str:
    (fault,) = schema.schema_errors(objects, complete=complete)
    return fault


@pytest.mark.parametrize("entry", buildings(), ids=lambda entry: entry.name)
def test_building_schema__no_bundled_model_has_a_fault(entry: Entry) -> None:
    assert schema.schema_errors(read_building(entry).objects, complete=True) == []


# The same verdict as EnergyPlus


@pytest.fixture(scope="module")
def office() -> dict[str, Any]:
    """A small office whose run is over at once: EnergyPlus checks the input first."""
    model = read_building(find_building("ref-small-office"))
    objects = for_episode(model, model.period("07-03", "07-03", None))
    objects["SimulationControl"] = {"none": {"run_simulation_for_weather_file_run_periods": "No"}}
    return objects


CASES: dict[str, tuple[str, str, Any, bool]] = {
    "a whole number for a number": ("Material", "density", 785, False),
    "an optional word left blank": ("Building", "terrain", "", False),
    "a number as a text": ("Material", "thickness", "0.0127", True),
    "a word in another case": ("Material", "roughness", "mediumROUGH", True),
    "another word": ("Material", "roughness", "Silky", True),
    "a required word left blank": ("Material", "roughness", "", True),
    "null": ("Material", "thermal_absorptance", None, True),
    "true for a number": ("Material", "thickness", True, True),
    "too small": ("Material", "specific_heat", 99.9, True),
    "exactly the limit that is left out": ("Material", "thickness", 0, True),
    "exactly the limit that is allowed": ("Material", "specific_heat", 100, False),
    "a float for a whole number": ("Building", "maximum_number_of_warmup_days", 25.0, True),
    "a word in place of a number": ("Zone", "volume", "Autocalculate", False),
    "that word in another case": ("Zone", "volume", "AUTOCALCULATE", True),
    "out of range beside a word": ("BuildingSurface:Detailed", "view_factor_to_ground", 1.5, True),
    "a text in a list's entry": ("BuildingSurface:Detailed", "vertices", [{"vertex_x_coordinate": "a"}] * 3, True),
    "an entry that lacks a field": ("BuildingSurface:Detailed", "vertices", [{"vertex_x_coordinate": 1.0}] * 3, True),
}


@pytest.mark.variants
@pytest.mark.parametrize("case", CASES)
def test_building_schema__fault_is_what_energyplus_refuses(case: str, office: dict[str, Any], folder: Path) -> None:
    kind, field, value, refused = CASES[case]
    objects = copy.deepcopy(office)
    next(iter(objects[kind].values()))[field] = value
    assert bool(schema.schema_errors(objects, complete=True)) == refused
    run_energyplus(write(objects, folder), find_weather("Denver").path, folder)
    errors = (folder / "eplusout.err").read_text()
    assert ("Errors occurred on processing input file" in errors) == refused


@pytest.mark.slow
def test_building_schema__types_fields_and_required_fields_are_those_of_the_wheels_own_classes() -> None:
    program = """
import json
from pyenergyplus.model import EnergyPlusModel
full = EnergyPlusModel.model_json_schema(by_alias=True)
found = {}
for kind, said in full["properties"].items():
    for choice in said.get("anyOf", [said]):
        for entry in choice.get("patternProperties", {}).values():
            shape = full["$defs"][entry["$ref"].split("/")[-1]] if "$ref" in entry else {}
            found[kind] = [sorted(shape.get("properties", [])), sorted(shape.get("required", []))]
print(json.dumps(found))
"""
    done = run_python("-P", "-c", program, check=True)
    theirs = {kind: tuple(map(tuple, fields)) for kind, fields in json.loads(done.stdout).items()}
    kinds = schema._schema()["types"]
    ours = {
        kind: (tuple(sorted(fields["fields"])), tuple(sorted(fields["required"]))) for kind, fields in kinds.items()
    }
    assert ours == theirs


# What is said


def test_building_schema__right_object_has_no_fault() -> None:
    assert schema.schema_errors(material(), complete=True) == []


def test_building_schema__unknown_names_list_near_ones() -> None:
    assert only({"Materiall": {}}).startswith("EnergyPlus has no object type 'Materiall'; did you mean 'Material'")
    assert only({"MATERIAL": {}}) == "EnergyPlus has no object type 'MATERIAL'; EnergyPlus spells it 'Material'"
    assert only(material(thicknes=0.1)).startswith("Material 'brick' has no field 'thicknes'; did you mean 'thickness'")
    assert "'Thickness'" in only(material(Thickness=0.1))


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ({"thickness": -1}, "thickness is -1; expected a number above 0"),
        ({"thickness": float("nan")}, "thickness is nan; expected a number above 0"),
        ({"thickness": "thick"}, "thickness is 'thick'; expected a number above 0"),
        ({"solar_absorptance": 1.1}, "solar_absorptance is 1.1; expected a number at least 0 and at most 1"),
        ({"roughness": "SMOOTH"}, "roughness is 'SMOOTH'; EnergyPlus requires 'Smooth'"),
        ({"thickness": None}, "thickness is null; expected a number above 0, or no such field"),
    ],
)  # fmt: skip
def test_schema_errors__name_the_right_values_beside_a_wrong_one(edits: dict[str, Any], message: str) -> None:
    assert only(material(**edits)) == f"Material 'brick': {message}"


def test_schema_errors__name_words_and_limits_of_a_field_with_both() -> None:
    fault = only({"Boiler:HotWater": {"b": {"nominal_capacity": "big"}}}, complete=False)
    assert fault == "Boiler:HotWater 'b': nominal_capacity is 'big'; expected a number above 0, or 'Autosize'"


def test_schema_errors__name_the_place_in_a_list() -> None:
    corners = [{"vertex_x_coordinate": 0.0, "vertex_y_coordinate": 0.0, "vertex_z_coordinate": "up"}]
    (fault,) = schema.schema_errors({"BuildingSurface:Detailed": {"wall": {"vertices": corners}}}, complete=False)
    assert fault == "BuildingSurface:Detailed 'wall': vertices[0].vertex_z_coordinate is 'up'; expected a number"
    (lacking,) = schema.schema_errors({"Schedule:Year": {"y": {"schedule_weeks": [{}]}}}, complete=True)
    assert "'schedule_week_name'" in lacking
    assert lacking.startswith("Schedule:Year 'y' lacks ")
    assert lacking.endswith(" in schedule_weeks[0]")


def test_building_schema__missing_fields_are_faults_of_complete_objects_only() -> None:
    assert schema.schema_errors({"Material": {"brick": {"density": 1.0}}}, complete=False) == []
    fault = only({"Material": {"brick": {"density": 1.0}}})
    assert fault == "Material 'brick' lacks 'roughness', 'thickness', 'conductivity', 'specific_heat'"


def test_schema_errors__name_objects_that_are_none() -> None:
    assert only({"Material": {"brick": 3}}) == "Material 'brick': expected fields by name, got 3"
    assert only({"Material": [1]}) == "Material: expected objects by name, got [1]"
    assert only({"Material": {" ": MATERIAL}}) == "Material: an object without a name"
    assert "a model has only one, got 2" in only({"Timestep": {"a": {}, "b": {}}})


def test_building_schema__what_converters_leave_behind_is_no_fault() -> None:
    assert (
        schema.schema_errors(material(idf_order=3, idf_max_fields=9, idf_max_extensible_fields=0), complete=True) == []
    )


def test_schema_errors__come_all_at_once() -> None:
    errors = schema.schema_errors(material(thickness=-1, density="x", colour="red") | {"Zonne": {}}, complete=True)
    assert len(errors) == 4


# Respelling


@given(st.sampled_from(["Smooth", "MediumRough", "VeryRough"]), st.randoms())
def test_building_schema__words_in_any_case_are_respelled(word: str, random: Any) -> None:
    mixed = "".join(random.choice((c.upper(), c.lower())) for c in word)
    assert schema.canonical_fields("Material", {"roughness": mixed}) == {"roughness": word}


@given(st.floats(allow_nan=False))
def test_building_schema__number_is_a_fault_where_it_is_out_of_range(value: float) -> None:
    wrong = not (value > 0 and value != float("inf"))
    assert bool(schema.schema_errors(material(conductivity=value), complete=True)) == wrong


def test_building_schema__whole_floats_become_integers_where_they_must_and_only_there() -> None:
    right = schema.canonical_fields("Building", {"maximum_number_of_warmup_days": 25.0, "north_axis": 25.0})
    assert [(name, type(value)) for name, value in right.items()] == [
        ("maximum_number_of_warmup_days", int),
        ("north_axis", float),
    ]
    left = {"maximum_number_of_warmup_days": 25.5, "colour": "RED"}
    assert schema.canonical_fields("Building", left) == left


# The stored file


@pytest.fixture
def fresh(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(folder))
    schema._schema.cache_clear()
    yield folder
    schema._schema.cache_clear()


def test_building_schema__schema_is_read_out_of_the_library_once(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "Material" in schema.types()
    monkeypatch.setattr(schema, "_embedded", None)
    schema._schema.cache_clear()
    assert schema.canonical_type("MATERIAL") == "Material"
    assert len(list((fresh / "v2" / "schema").glob("*.json"))) == 1
