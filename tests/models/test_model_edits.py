"""Edits to a model: what they do, what they leave alone, and how wrong ones are refused."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.energyplus_reference import Alone, Case

from zenostat.models.building.edits import Edits, apply_edits
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Meter

BRICK = {"roughness": "Smooth", "thickness": 0.1, "conductivity": 0.2, "density": 800.0, "specific_heat": 900.0}
MODEL: dict[str, dict[str, Any]] = {
    "Material": {"Brick": BRICK, "Gypsum": {**BRICK, "solar_absorptance": 0.5}},
    "Timestep": {"Timestep 1": {"number_of_timesteps_per_hour": 6}},
    "Zone": {"Core": {}, "Attic": {"idf_order": 3, "unknown_but_there": 1}},
}


def refused(edits: Any, model: dict[str, Any] = MODEL) -> list[str]:
    with pytest.raises(InvalidConfig) as raised:
        apply_edits(model, edits)
    return str(raised.value).split("\n")


def test_model_edits__field_changes_and_the_rest_is_shared_and_untouched() -> None:
    before = copy.deepcopy(MODEL)
    result = apply_edits(MODEL, {"Material": {"Brick": {"conductivity": 0.4}}})
    assert result["Material"]["Brick"] == {**BRICK, "conductivity": 0.4}
    assert before == MODEL
    assert result["Zone"] is MODEL["Zone"]
    assert result["Material"]["Gypsum"] is MODEL["Material"]["Gypsum"]


def test_model_edits__types_names_and_words_are_found_in_any_case() -> None:
    result = apply_edits(MODEL, {"MATERIAL": {"brick": {"roughness": "veryROUGH"}}})
    assert result["Material"]["Brick"]["roughness"] == "VeryRough"
    assert list(result) == list(MODEL)
    assert list(result["Material"]) == ["Brick", "Gypsum"]


def test_model_edits__exact_name_goes_before_one_in_another_case() -> None:
    model = {"Zone": {"core": {}, "Core": {}}}
    assert apply_edits(model, {"Zone": {"Core": {"multiplier": 2}}})["Zone"] == {"core": {}, "Core": {"multiplier": 2}}
    assert refused({"Zone": {"CORE": {"multiplier": 2}}}, model) == [
        "Zone 'CORE' matches several objects: 'core', 'Core'"
    ]


def test_model_edits__none_removes_a_field_and_an_object() -> None:
    result = apply_edits(MODEL, {"Material": {"Gypsum": {"solar_absorptance": None}, "Brick": None}})
    assert result["Material"] == {"Gypsum": BRICK}
    assert "Timestep" not in apply_edits(MODEL, {"Timestep": {"*": None}})


def test_model_edits__star_is_every_object_of_the_type() -> None:
    result = apply_edits(MODEL, {"Material": {"*": {"thickness": 0.3}}})
    assert {name: fields["thickness"] for name, fields in result["Material"].items()} == {"Brick": 0.3, "Gypsum": 0.3}


def test_model_edits__new_name_adds_a_complete_object() -> None:
    result = apply_edits(MODEL, {"Material": {"Straw": BRICK}, "Schedule:Constant": {"Always": {"hourly_value": 1}}})
    assert list(result["Material"]) == ["Brick", "Gypsum", "Straw"]
    assert result["Schedule:Constant"] == {"Always": {"hourly_value": 1}}


def test_model_edits__list_is_replaced_as_a_whole() -> None:
    lines = [{"program_line": "SET a = 1"}, {"program_line": "SET b = 2"}]
    model = {"EnergyManagementSystem:Program": {"P": {"lines": lines}}}
    result = apply_edits(model, {"EnergyManagementSystem:Program": {"P": {"lines": lines[:1]}}})
    assert result["EnergyManagementSystem:Program"]["P"]["lines"] == lines[:1]


def test_model_edits__misspelled_name_states_the_near_one_and_what_a_new_object_would_lack() -> None:
    assert refused({"Material": {"Gypsumm": {"conductivity": 0.4}}}) == [
        "Material 'Gypsumm': the model has no such object (did you mean 'Gypsum'?); "
        "a new one needs 'roughness', 'thickness', 'density', 'specific_heat'"
    ]


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ({"Materiel": {"Brick": {}}}, "EnergyPlus has no object type 'Materiel'; did you mean 'Material'"),
        ({"Material": {"Brick": {"thicknes": 1.0}}}, "Material 'Brick' has no field 'thicknes'; did you mean"),
        ({"Material": {"Brick": {"thicknes": None}}}, "Material 'Brick' has no field 'thicknes'; did you mean"),
        ({"Material": {"Brick": {"thickness": 0}}}, "Material 'Brick': thickness is 0; expected a number above 0"),
        ({"Material": {"*": {"thickness": 0}}}, "Material '*': thickness is 0; expected a number above 0"),
        ({"Material": {"Brick": {"thickness": None}}}, "Material 'Brick': 'thickness' is required"),
        ({"Material": {"Bric": None}}, "Material 'Bric': the model has no such object; did you mean 'Brick'"),
        ({"Lights": {"*": {}}}, "Lights '*': the model has no object of this type; there are none"),
        ({"Material": {"Brick": 3}}, "Material 'Brick': expected fields by name, or null to remove it; got 3"),
        ({"Material": 3}, "Material: expected objects by name, got 3"),
        ({"Timestep": {"mine": {"number_of_timesteps_per_hour": 4}}},
         "Timestep 'mine': a model has only one object of this type, here 'Timestep 1'; '*' refers to it as well"),
    ],
)  # fmt: skip
def test_model_edits__wrong_change_is_refused(edits: Any, message: str) -> None:
    (line,) = refused(edits)
    assert line.startswith(message)


def test_model_edits__all_faults_come_in_one_report() -> None:
    wrong = {"Materiel": {}, "Material": {"Brick": {"thickness": 0, "color": 1}, "Bric": None}}
    assert len(refused(wrong)) == 4


def test_model_edits__what_was_wrong_in_the_model_before_is_not_the_changes_fault() -> None:
    result = apply_edits(MODEL, {"Zone": {"Attic": {"multiplier": 2}}})
    assert result["Zone"]["Attic"]["unknown_but_there"] == 1


@given(st.dictionaries(st.sampled_from(["thickness", "conductivity", "density"]), st.floats(0.001, 1e6)))
def test_model_edits__change_and_its_reverse_give_the_model_back(fields: dict[str, float]) -> None:
    edited = apply_edits(MODEL, {"Material": {"Brick": fields}})
    back: Edits = {"Material": {"Brick": {name: BRICK[name] for name in fields}}}
    assert apply_edits(edited, back) == MODEL


def heat(model: dict[str, Any], folder: Path) -> float:
    """Heat that the systems gave on a winter day, J."""
    folder.mkdir()
    path = folder / "model.epJSON"
    path.write_text(json.dumps(model))
    meter = Meter(name="heat", meter="Heating:EnergyTransfer", unit="J")
    run = Alone(Case(str(path), "USA_CO_Denver", "01-10", "01-10", 6), [], [meter], folder / "run")
    return float(run.values().sum())


@pytest.mark.slow
def test_model_edits__insulation_saves_heat_on_a_winter_day(folder: Path) -> None:
    model = read_building(find_building("ref-small-office")).objects
    assert heat(apply_edits(model, _insulation(model)), folder / "better") < 0.98 * heat(model, folder / "own")


def _insulation(model: dict[str, Any]) -> Edits:
    """Half the conductivity, twice the resistance, of every material."""
    return {
        "Material": {name: {"conductivity": f["conductivity"] / 2} for name, f in model["Material"].items()},
        "Material:NoMass": {
            name: {"thermal_resistance": f["thermal_resistance"] * 2} for name, f in model["Material:NoMass"].items()
        },
    }
