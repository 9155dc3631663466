"""Models for which EnergyPlus reads the whole weather file before the run period."""

from typing import Any

import pytest

from zenostat.models.building.model import read_building
from zenostat.models.building.whole_weather import reads_whole_weather
from zenostat.models.catalog import find_building


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("Site:WaterMainsTemperature", {"calculation_method": "CorrelationFromWeatherFile"}),
        ("SizingPeriod:WeatherFileDays", {"begin_month": 1}),
        ("SizingPeriod:WeatherFileConditionType", {"period_selection": "SummerExtreme"}),
        ("People", {"thermal_comfort_model_type": [{"thermal_comfort_model_type": "AdaptiveASH55"}]}),
        ("People", {"thermal_comfort_model_2_type": "AdaptiveCEN15251"}),
        ("ZoneControl:Thermostat:OperativeTemperature", {"adaptive_comfort_model_type": "AdaptiveASH55CentralLine"}),
    ],
)
def test_whole_weather__such_objects_are_found(kind: str, fields: dict[str, Any]) -> None:
    assert reads_whole_weather({"Zone": {"z": {}}, kind: {"object": fields}}) == kind


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("Site:WaterMainsTemperature", {"calculation_method": "Correlation"}),
        ("People", {"thermal_comfort_model_type": "Fanger"}),
        ("ZoneControl:Thermostat:OperativeTemperature", {"adaptive_comfort_model_type": "None"}),
    ],
)
def test_whole_weather__others_are_not(kind: str, fields: dict[str, Any]) -> None:
    assert not reads_whole_weather({kind: {"object": fields}})


def test_whole_weather__reference_office_is_not_such_a_model() -> None:
    assert not reads_whole_weather(read_building(find_building("ref-small-office")).objects)
