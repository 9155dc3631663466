"""Models of other EnergyPlus versions: each known change converted, everything else refused by name."""

import copy
import functools
import re
from typing import Any

import pytest

from zenostat.models import energyplus
from zenostat.models.building import schema, transition
from zenostat.models.building.model import read_building
from zenostat.models.building.transition import TRANSITIONS, check_epjson, check_idf
from zenostat.models.catalog import find_building
from zenostat.topics.errors import InvalidConfig

pytestmark = pytest.mark.skipif(not energyplus.version().startswith("25.2"), reason="the tables end at 25.2")

OWN = {"Version": {"v": {"version_identifier": "25.2"}}}


def model(version: str | None, **objects: Any) -> dict[str, Any]:
    """A part of a model."""
    return ({"Version": {"v": {"version_identifier": version}}} if version else {}) | objects


def refused(model_data: dict[str, Any] | str, engine: str | None = None) -> str:
    def check() -> object:
        if isinstance(model_data, str):
            return check_idf(model_data, name="old.idf", engine=engine)
        return check_epjson(model_data, name="old.epJSON", engine=engine)

    with pytest.raises(InvalidConfig) as raised:
        check()
    return str(raised.value)


# epJSON


@pytest.mark.parametrize("version", ["25.2", "25.2.0", " 25.2", None])
def test_version_transition__engines_own_version_and_none_are_taken_as_they_are(version: str | None) -> None:
    model_data = model(version, Zone={"core": {"nothing_that_energyplus_knows": 1}})
    result = check_epjson(model_data, name="m")
    assert (result.objects, result.notes) == (model_data, ())
    assert result.objects["Zone"] is model_data["Zone"]


@pytest.mark.parametrize(
    ("version", "notes"),
    [
        ("25.1", ["from 25.1 to 25.2"]),
        ("24.2.0", ["from 24.2 to 25.1", "from 25.1 to 25.2"]),
        ("24.1", ["from 24.1 to 24.2", "from 24.2 to 25.1", "from 25.1 to 25.2"]),
    ],
)
def test_version_transition__earlier_version_without_what_changed_only_gets_the_engines_version(
    version: str, notes: list[str]
) -> None:
    result = check_epjson(model(version, Zone={"core": {}}), name="m")
    assert result.objects == OWN | {"Zone": {"core": {}}}
    assert result.notes == tuple(f"{note}: nothing to convert" for note in notes)


def test_version_transition__whole_model_passes_and_the_input_is_untouched() -> None:
    objects = dict(read_building(find_building("ref-small-office")).objects)
    objects["Version"] = {"Version 1": {"version_identifier": "24.1"}}
    before = copy.deepcopy(objects)
    result = check_epjson(objects, name="m")
    assert objects == before
    assert {k: v for k, v in result.objects.items() if k != "Version"} == {
        k: v for k, v in objects.items() if k != "Version"
    }
    assert result.objects["Version"] == {"Version 1": {"version_identifier": "25.2"}}


PAIRS = {"temperature_2": 30.0, "temperature_1": 20.0, "enthalpy_1": 1.0, "enthalpy_2": 9.0}


@pytest.mark.parametrize(
    ("version", "kind", "old", "new"),
    [
        ("24.1", "Output:IlluminanceMap", {"zone_name": "Z"}, {"zone_or_space_name": "Z"}),
        ("24.1", "ZoneCoolTower:Shower", {"zone_name": "Z"}, {"zone_or_space_name": "Z"}),
        ("24.1", "ZoneRefrigerationDoorMixing", {"zone_1_name": "A", "zone_2_name": "B"},
         {"zone_or_space_name_1": "A", "zone_or_space_name_2": "B"}),
        ("24.1", "ZoneThermalChimney",
         {"zone_name": "C", "zone_12_name": "A", "relative_ratios_of_air_flow_rates_passing_through_zone_12": 0.5},
         {"zone_name": "C", "zone_or_space_name_12": "A",
          "relative_ratios_of_air_flow_rates_passing_through_inlet_12": 0.5}),
        ("24.1", "MaterialProperty:PhaseChange",
         {"temperature_coefficient_for_thermal_conductivity": 0.1, **PAIRS},
         {"temperature_coefficient_for_thermal_conductivity": 0.1,
          "values": [{"temperature": 20.0, "enthalpy": 1.0}, {"temperature": 30.0, "enthalpy": 9.0}]}),
        ("24.1", "MaterialProperty:VariableThermalConductivity",
         {"temperature_1": 0.0, "thermal_conductivity_1": 0.2, "temperature_10": 9.0, "thermal_conductivity_10": 0.3},
         {"values": [{"temperature": 0.0, "thermal_conductivity": 0.2},
                     {"temperature": 9.0, "thermal_conductivity": 0.3}]}),
        ("25.1", "Coil:Cooling:DX:VariableSpeed",
         {"speed_7_reference_unit_condenser_flow_rate": 1.0, "speed_10_reference_unit_condenser_air_flow_rate": 2.0,
          "speed_1_reference_unit_rated_condenser_air_flow_rate": 3.0},
         {"speed_7_reference_unit_rated_condenser_air_flow_rate": 1.0,
          "speed_10_reference_unit_rated_condenser_air_flow_rate": 2.0,
          "speed_1_reference_unit_rated_condenser_air_flow_rate": 3.0}),
        ("25.1", "Coil:Heating:DX:VariableSpeed",
         {"speed_4_heating_capacity_function_of_air_flow_fraction_curve_name": "C"},
         {"speed_4_total_heating_capacity_function_of_air_flow_fraction_curve_name": "C"}),
        ("25.1", "Coil:Heating:WaterToAirHeatPump:VariableSpeedEquationFit",
         {"speed_1_reference_unit_rated_air_flow": 1.0}, {"speed_1_reference_unit_rated_air_flow_rate": 1.0}),
        ("25.1", "Coil:WaterHeating:AirToWaterHeatPump:VariableSpeed",
         {"rated_water_heating_capacity_at_speed_1": 9.0, "rated_water_heating_cop_at_speed_10": 3.0,
          "rated_sensible_heat_ratio_at_speed_2": 0.7, "rated_water_heating_capacity": 8.0},
         {"speed_1_rated_water_heating_capacity": 9.0, "speed_10_rated_water_heating_cop": 3.0,
          "speed_2_rated_sensible_heat_ratio": 0.7, "rated_water_heating_capacity": 8.0}),
        ("25.1", "ComfortViewFactorAngles", {"surface_1_name": "S", "angle_factor_1": 0.4},
         {"angles": [{"surface_name": "S", "angle_factor": 0.4}]}),
        ("25.1", "AirLoopHVAC:UnitaryHeatPump:AirToAir:MultiSpeed",
         {"minimum_outdoor_dry_bulb_temperature_for_compressor_operation": -8.0, "cooling_coil_name": "C"},
         {"cooling_coil_name": "C"}),
        ("25.1", "HeatExchanger:Desiccant:BalancedFlow", {}, {"economizer_lockout": "No"}),
        ("25.1", "HeatExchanger:Desiccant:BalancedFlow", {"economizer_lockout": "Yes"}, {"economizer_lockout": "Yes"}),
    ],
)  # fmt: skip
def test_version_transition__known_change_is_converted(
    version: str, kind: str, old: dict[str, Any], new: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    partly = functools.partial(
        schema.schema_errors, complete=False
    )  # the objects here have only the fields that matter
    monkeypatch.setattr(transition.schema, "schema_errors", lambda objects, complete: partly(objects))
    result = check_epjson(model(version) | {kind: {"it": old}}, name="m")
    assert result.objects[kind] == {"it": new}
    assert result.objects["Version"] == OWN["Version"]
    assert any(note.split(": ", 1)[1].startswith(kind) for note in result.notes) == (old != new)


def test_version_transition__what_was_a_name_in_a_field_becomes_the_objects_name() -> None:
    dates = {"begin_month": 1, "begin_day_of_month": 1, "begin_hour_of_day": 1,
             "end_month": 2, "end_day_of_month": 1, "end_hour_of_day": 1}  # fmt: skip
    old = {"Output:Table:ReportPeriod 1": {"name_": "Outage", "report_name_": "ThermalResilienceSummary", **dates}}
    result = check_epjson(model("25.1") | {"Output:Table:ReportPeriod": old}, name="m")
    assert result.objects["Output:Table:ReportPeriod"] == {
        "Outage": {"report_name": "ThermalResilienceSummary", **dates}
    }


def test_version_transition__what_still_does_not_fit_is_refused_by_name() -> None:
    message = refused(model("25.1", Zone={"core": {"multiplyer": 2}}, Zonne={}))
    assert message.startswith(
        "old.epJSON is for EnergyPlus 25.1, and these objects do not match 25.2 (the engine's version is 25.2"
    )
    field, kind = message.split("\n")[1:]
    assert field.startswith("Zone 'core' has no field 'multiplyer'; did you mean 'multiplier'")
    assert kind.startswith("EnergyPlus has no object type 'Zonne'; did you mean ")


@pytest.mark.parametrize("version", ["9.6", "23.2", "24.3", "26.1", "8", "new"])
def test_version_transition__other_versions_are_refused(version: str) -> None:
    assert refused(model(version, Zone={"core": {}})) == (
        f"old.epJSON is for EnergyPlus {version}; the engine's version is {energyplus.version()}: use a model for "
        "25.2, or an epJSON for 24.1, 24.2, 25.1, or update the file with EnergyPlus's IDFVersionUpdater"
    )


def test_version_transition__engine_beyond_the_tables_takes_its_own_version_only() -> None:
    assert check_epjson(model("26.1"), name="m", engine="26.1.0").notes == ()
    assert "the engine's version is 26.1.0" in refused(model("25.1"), engine="26.1.0")


def test_version_transition__steps_follow_each_other_to_this_engine() -> None:
    assert [step.after for step in TRANSITIONS[:-1]] == [step.before for step in TRANSITIONS[1:]]
    assert energyplus.version().startswith(TRANSITIONS[-1].after)


def test_version_transition__objects_that_are_none_are_refused() -> None:
    assert refused(model("25.1", Zone={"core": 3})).endswith("\nZone 'core': expected fields by name, got 3")
    assert "Version: expected objects by name, got '25.1'" in refused({"Version": "25.1"})


# IDF


@pytest.mark.parametrize(
    "text", ["Version,25.2;", "VERSION ,\n 25.2.0 ; ! the version\nZone,\n core;", "Zone, core;", ""]
)
def test_version_transition__idf_of_this_version_or_none_is_taken(text: str) -> None:
    assert check_idf(text, name="m") == ()


def test_version_transition__bundled_idf_is_of_this_version_and_so_is_it_one_before() -> None:
    text = find_building("ref-small-office").path.read_text(errors="replace")
    assert check_idf(text, name="m") == ()
    older = re.sub(r"(?im)^(\s*version\s*,\s*)[\d.]+", r"\g<1>25.1", text)
    assert check_idf(older, name="m") == ("from 25.1 to 25.2: nothing to convert",)


def test_version_transition__version_in_a_comment_is_none() -> None:
    assert check_idf("! Version, 9.0;\nZone, core; ! Version,8.9;", name="m") == ()


def test_version_transition__idf_with_moved_fields_is_refused_by_their_types() -> None:
    text = "Version,25.1;\nGROUNDHEATEXCHANGER:SYSTEM, g, in, out;\nCoil:Heating:DX:VariableSpeed, c;\nZone, core;"
    assert refused(text).startswith(
        "old.idf is an IDF for EnergyPlus 25.1 with objects whose fields changed in 25.2: "
        "Coil:Heating:DX:VariableSpeed, GROUNDHEATEXCHANGER:SYSTEM; the engine's version is 25.2"
    )


@pytest.mark.parametrize("version", ["24.1", "24.2", "9.6", "26.1"])
def test_version_transition__idf_of_another_version_is_refused(version: str) -> None:
    assert f"for EnergyPlus {version}; the engine's version is 25.2" in refused(f"Version,{version};\nZone, core;")
