"""Parameters of models as edits, and runs of whole periods."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.energyplus_reference import Case, run_both

from zenostat.models import schema
from zenostat.models.building.model import read_building
from zenostat.models.calibration.model_edits import (
    KINDS,
    SCHEDULES,
    ModelParameter,
    describe_places,
    edits_of,
    places,
    read_parameter,
)
from zenostat.models.calibration.runs import ModelRuns
from zenostat.models.calibration.targets import TargetFinder
from zenostat.models.catalog import find_building, find_weather
from zenostat.topics.errors import InvalidConfig, UnknownName

COMPACT = {
    "data": [{"field": field} for field in ("Through: 12/31", "For: AllDays", "Until: 08:00", 15.0, "Until: 24:00", 21)]
}
OBJECTS: dict[str, Any] = {
    "Lights": {
        "Core lights": {"watts_per_floor_area": 10.0, "schedule_name": "On"},
        "Hall lights": {"watts_per_floor_area": 6.0, "lighting_level": "Autosize"},
    },
    "Material": {"Wall insulation": {"conductivity": 0.05}, "Brick": {"conductivity": 0.9}},
    "Material:NoMass": {"Roof Insulation": {"thermal_resistance": 4.0}},
    "Schedule:Compact": {"Heating": COMPACT},
    "Schedule:Day:Hourly": {"Day": {"hour_1": 0.1, "hour_2": 0.9, "schedule_type_limits_name": "Fraction"}},
    "Schedule:Week:Daily": {"Week": {"monday_schedule_day_name": "Day", "sunday_schedule_day_name": "Day"}},
    "Schedule:Year": {"On": {"schedule_weeks": [{"schedule_week_name": "Week"}]}},
    "ThermostatSetpoint:DualSetpoint": {"T": {"heating_setpoint_temperature_schedule_name": "heating"}},
}


def edited(parameter: ModelParameter, value: float) -> dict[str, Any]:
    return edits_of(OBJECTS, parameter, value)


# Edits


def test_kinds__name_types_and_fields_that_energyplus_has() -> None:
    for kind in KINDS.values():
        for edit in kind.edits:
            assert schema.canonical_type(edit.type) == edit.type
            assert edit.fields or edit.type in SCHEDULES
            for field in edit.fields:
                assert schema.has_field(edit.type, field), (edit.type, field)


def test_edits_of__changes_the_selected_numbers() -> None:
    assert edited(read_parameter("p", "lighting"), 1.5) == {
        "Lights": {"Core lights": {"watts_per_floor_area": 15.0}, "Hall lights": {"watts_per_floor_area": 9.0}}
    }
    assert edited(read_parameter("p", "lighting", "core*"), 2.0) == {
        "Lights": {"Core lights": {"watts_per_floor_area": 20.0}}
    }
    named = {"Lights": {"Core [x] lights": {"lighting_level": 10.0}, "Core x lights": {"lighting_level": 10.0}}}
    assert edits_of(named, read_parameter("p", "lighting", "core [X] l?ghts"), 2.0) == {
        "Lights": {"Core [x] lights": {"lighting_level": 20.0}}
    }
    assert edited(read_parameter("p", "insulation"), 2.0) == {
        "Material": {"Wall insulation": {"conductivity": 0.025}},
        "Material:NoMass": {"Roof Insulation": {"thermal_resistance": 8.0}},
    }


def test_edits_of__changes_the_values_of_schedules_alone() -> None:
    data = edited(read_parameter("p", "heating_setpoint"), -1.5)["Schedule:Compact"]["Heating"]["data"]
    assert [entry["field"] for entry in data] == [
        "Through: 12/31", "For: AllDays", "Until: 08:00", 13.5, "Until: 24:00", 19.5,
    ]  # fmt: skip
    assert COMPACT["data"][3] == {"field": 15.0}  # the model itself is unchanged
    at_least = [{"type": "Lights", "fields": ["schedule_name"], "operation": "at_least"}]
    assert edited(read_parameter("p", at_least), 0.3) == {
        "Schedule:Day:Hourly": {"Day": {"hour_1": 0.3, "hour_2": 0.9}}
    }
    put = [{"type": "Schedule:Day:Hourly", "objects": "day", "operation": "set"}]
    assert edited(read_parameter("p", put), 0.5) == {"Schedule:Day:Hourly": {"Day": {"hour_1": 0.5, "hour_2": 0.5}}}


def test_describe_places__names_operation_field_and_objects() -> None:
    text = describe_places(places(OBJECTS, read_parameter("p", "insulation")))
    assert text == (
        "divide conductivity of Material 'Wall insulation'; multiply thermal_resistance of Material:NoMass "
        "'Roof Insulation'"
    )


@pytest.mark.parametrize(
    ("edit", "objects", "error"),
    [
        ("lightning", None, "there is no kind 'lightning'; did you mean 'lighting'"),
        ([{"type": "Light", "fields": "lighting_level"}], None, "EnergyPlus has no object type 'Light'"),
        ([{"type": "Lights", "fields": "level"}], None, "Lights has no field 'level'"),
        ([{"type": "Lights"}], None, "fields: missing"),
        ([{"type": "Lights", "fields": "lighting_level", "operation": "double"}], None, "'double' is none of multiply"),
        ([{"type": "Lights", "field": "lighting_level"}], None, "there is no field 'field'; did you mean 'fields'"),
        ([], None, "the name of a kind or a list of edits expected"),
        ([{"type": "Lights", "fields": "lighting_level"}], "*", "only with the name of a kind"),
        ("lighting", "attic*", "no Lights with a name like 'attic*'"),
        ("gas_equipment", None, "the model has no GasEquipment"),
        ([{"type": "Lights", "fields": "lighting_level"}], None, "has no number as lighting_level"),
    ],
)
def test_parameters__errors_name_what_would_be_right(edit: Any, objects: str | None, error: str) -> None:
    with pytest.raises(InvalidConfig) as caught:
        places(OBJECTS, read_parameter("p", edit, objects))
    assert error in str(caught.value)


def test_targets__headers_of_energyplus_csv_may_have_keys_with_colons() -> None:
    finder = TargetFinder(read_building(find_building("ref-small-office")), find_weather("USA_IL_Chicago").path)
    fan = finder.find("a column", "psz-ac:1_fan:Fan Electricity Rate")
    assert (fan.variable, fan.key.casefold(), fan.unit) == ("Fan Electricity Rate", "psz-ac:1_fan", "W")
    zone = finder.find("a column", "CORE_ZN:Zone Mean Air Temperature")
    assert (zone.variable, zone.unit) == ("Zone Mean Air Temperature", "degC")


# Runs


def runs(**changes: Any) -> ModelRuns:
    weather = find_weather("USA_IL_Chicago").path
    finder = TargetFinder(read_building(find_building("ref-small-office")), weather)
    names = ("electricity_facility", "naturalgas_facility", "core_zn_air_temperature", "HVAC:Electricity")
    targets = tuple(finder.find("a column", name) for name in names)
    parameters = (read_parameter("lighting", "lighting"), read_parameter("heating_setpoint", "heating_setpoint"))
    return ModelRuns(**{"model": "ref-small-office", "weather": weather, "parameters": parameters, "targets": targets}
                     | changes)  # fmt: skip


DAYS = (date(2017, 1, 9), date(2017, 1, 9))


@pytest.mark.slow
@pytest.mark.process
def test_simulate__values_are_those_of_a_node_and_repeat_to_the_bit(folder: Path) -> None:
    model = runs(sizing="weather")
    hours = model.simulate({}, DAYS)
    assert hours.shape == (24, 4)
    assert np.array_equal(hours, model.simulate({}, DAYS))
    case = Case("ref-small-office", "USA_IL_Chicago", "2017-01-09", "2017-01-09", 6)
    sensors = {"room": ["Zone Mean Air Temperature", "CORE_ZN", "mean"]}
    meters = {"electricity": "Electricity:Facility", "hvac": "HVAC:Electricity"}
    manifest, values, _ = run_both(case, folder, sensors=sensors, meters=meters, actuators={})
    of = {name: values[:, column].reshape(24, 6) for column, name in enumerate(manifest.names)}
    assert hours[:, 0] == pytest.approx(of["electricity"].sum(axis=1), rel=1e-12)
    assert hours[:, 2] == pytest.approx(of["room"].mean(axis=1), rel=1e-12)
    assert hours[:, 3] == pytest.approx(of["hvac"].sum(axis=1), rel=1e-12)


@pytest.mark.slow
@pytest.mark.process
def test_simulate__keys_and_the_written_model_keep_their_characters(tmp_path: Path) -> None:
    office, idf, weather = tmp_path / "office.epJSON", tmp_path / "calibrated.idf", find_weather("USA_IL_Chicago").path
    office.write_text(json.dumps(read_building(find_building("ref-small-office")).objects).replace("Core_ZN", "Å 室"))
    variable = {"variable": "Zone Mean Air Temperature", "key": "Å 室"}
    targets = (TargetFinder(read_building(find_building(str(office))), weather).find("a column", variable),)
    model = runs(model=str(office), targets=targets)
    model.write_model({}, idf)
    assert np.array_equal(runs(model=str(idf), targets=targets).simulate({}, DAYS), model.simulate({}, DAYS))


@pytest.mark.slow
@pytest.mark.process
def test_simulate__parameters_act_and_the_written_model_is_the_calibrated_one(tmp_path: Path) -> None:
    model, values = runs(), {"lighting": 1.5, "heating_setpoint": -1.0}
    before, after = model.simulate({}, DAYS), model.simulate(values, DAYS)
    assert after[:, 0].sum() > 1.05 * before[:, 0].sum()  # more light
    assert after[:6, 2].mean() < before[:6, 2].mean()  # a cooler night
    assert np.array_equal(model.simulate({"lighting": 1.0, "heating_setpoint": 0.0}, DAYS), before)
    for suffix in (".epJSON", ".idf"):
        path = tmp_path / f"calibrated{suffix}"
        model.write_model(values, path, ["calibrated: lighting = 1.5"])
        assert np.array_equal(runs(model=str(path)).simulate({}, DAYS), after), suffix


@pytest.mark.slow
@pytest.mark.process
def test_check__names_parameter_and_limit_before_anything_is_simulated() -> None:
    model = runs(parameters=(read_parameter("eta", "heating_efficiency"),))
    with pytest.raises(InvalidConfig, match=r"parameters.eta = 2: .*burner_efficiency is 1.6; expected .* at most 1"):
        model.check([DAYS], {"eta": (0.5, 2.0)})
    with pytest.raises(
        UnknownName,
        match=r"a column: the model has no point 'electricty_facility' .*did you mean 'electricity_facility'",
    ):
        TargetFinder(model.building, model.weather).find("a column", "electricty_facility")
