"""Which output objects of a model an episode keeps."""

from typing import Any

from zenostat.models.building.output_objects import with_requests, without_files

WET_BULB = {"key_value": "*", "variable_name": "Zone Wetbulb Globe Temperature", "reporting_frequency": "Hourly"}
OTHER = {"key_value": "*", "variable_name": "Zone Air Temperature", "reporting_frequency": "Hourly"}


def _requests(**objects: Any) -> dict[str, Any]:
    return without_files({"Output:Variable": {"1": WET_BULB, "2": OTHER}, **objects}).get("Output:Variable", {})


def test_without_files__keeps_requests_that_programs_depend_on() -> None:
    """EnergyPlus computes the variable only on request, and an EMS program would read 0 without it."""
    sensor = {"output_variable_or_output_meter_name": "ZONE WETBULB GLOBE TEMPERATURE"}
    assert _requests() == {}
    assert _requests(**{"EnergyManagementSystem:Sensor": {"s": sensor}}) == {"1": WET_BULB}


def test_without_files__keeps_only_diagnostics_that_act() -> None:
    both = [{"key": "DisplayExtraWarnings"}, {"key": "DoNotMirrorDetachedShading"}]
    kept = without_files({"Output:Diagnostics": {"d": {"diagnostics": both}}, "Zone": {"z": {}}})
    assert kept["Output:Diagnostics"] == {"zenostat": {"diagnostics": both[1:]}}
    assert kept["Zone"] == {"z": {}}
    assert "Output:Diagnostics" not in without_files({"Output:Diagnostics": {"d": {"diagnostics": both[:1]}}})


def test_with_requests__adds_to_the_models_own() -> None:
    objects = {"Output:Variable": {"1": OTHER}}
    added = with_requests(objects, [("Zone Wetbulb Globe Temperature", "ATTIC")])["Output:Variable"]
    assert added == {"1": OTHER, "zenostat 1": WET_BULB | {"key_value": "ATTIC", "reporting_frequency": "RunPeriod"}}
    assert with_requests(objects, []) == objects == {"Output:Variable": {"1": OTHER}}
