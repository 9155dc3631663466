"""Weather between the rows of a weather file."""

import numpy as np
import pytest

from zenostat.topics.weather import WeatherColumn

HOUR_S = 3600.0


@pytest.mark.parametrize("rows_per_hour", [1, 4])
def test_weather__first_interval_begins_with_the_end_of_the_first_day(rows_per_hour):
    interval_s = HOUR_S / rows_per_hour
    column = WeatherColumn(np.arange(48.0 * rows_per_hour), interval_s)
    of_day_end = 24.0 * rows_per_hour - 1.0
    assert column.at(interval_s * np.array([0.0, 0.25, 1.0, 2.0])) == pytest.approx(
        [of_day_end, 0.75 * of_day_end, 0.0, 1.0]
    )
    assert column.at(np.array([49 * HOUR_S])) == [48.0 * rows_per_hour - 1.0], "the last row is held"


def test_weather__angle_takes_the_shorter_arc():
    column = WeatherColumn(np.resize([290.0, 80.0], 24), HOUR_S, period=360.0)
    quarters = HOUR_S * np.arange(1.0, 3.1, 0.25)
    assert column.at(quarters) == pytest.approx([290.0, 327.5, 5.0, 42.5, 80.0, 42.5, 5.0, 327.5, 290.0])


def test_weather__mean_of_an_interval_is_valid_in_its_middle():
    column = WeatherColumn(np.arange(24.0), HOUR_S, is_mean=True)
    assert column.at(HOUR_S * np.array([0.5, 1.0, 1.5])) == pytest.approx([0.0, 0.5, 1.0])


def test_weather__missing_values_are_skipped():
    column = WeatherColumn(np.array([np.nan, 1.0, np.nan, np.nan, 4.0, *[np.nan] * 19]), HOUR_S)
    assert column.at(HOUR_S * np.array([0.0, 1.0, 2.0, 3.0, 9.0])) == pytest.approx([1.0, 1.0, 1.0, 2.0, 4.0])
