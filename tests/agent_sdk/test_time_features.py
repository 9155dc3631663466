"""The fields of the clock, against EnergyPlus itself."""

import json
from datetime import date, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.energyplus_alone import run_energyplus

from zenostat.agent_sdk.envs.time_features import BOUNDS, time_features
from zenostat.models.building.model import for_episode, read_building, write
from zenostat.models.catalog import find_building, find_weather
from zenostat.topics.messages import TimeField

DIVISORS = (1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30, 60)
DATE = (TimeField.YEAR, TimeField.MONTH, TimeField.DAY_OF_MONTH, TimeField.DAY_OF_WEEK, TimeField.DAY_OF_YEAR)

# EnergyPlus's `year` is that of the weather file's row; that of the simulation is `calendar_year`.
_LOOK = """
at, seen = exchange, []
def look(state):
    if at.kind_of_sim(state) == 3 and not at.warmup_flag(state):
        names = ("calendar_year", "month", "day_of_month", "day_of_week", "day_of_year", "hour", "minutes")
        names += ("current_time", "system_time_step")
        seen.append([getattr(at, name)(state) for name in names])
runtime.callback_end_zone_timestep_after_zone_reporting(state, look)
"""
_FIELDS = (*DATE, TimeField.HOUR, TimeField.MINUTES, TimeField.CURRENT_TIME)


def test_time_features__clock_is_energyplus_own(tmp_path: Path) -> None:
    """From a Friday over a weekend and the end of September to a Monday.

    The API's minutes and hours of the day count system timesteps, which is the clock where the last one of a
    timestep was not shortened.
    """
    model = read_building(find_building("ref-small-office"))
    period = model.period("2017-09-29", "2017-10-02", 4)
    files = write(for_episode(model, period), tmp_path), find_weather("USA_CO_Denver").path, tmp_path
    done = run_energyplus(*files, before=_LOOK, after="print(json.dumps(seen))")
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert len(seen) == period.steps
    ours = [time_features(_FIELDS, period.time(k), period.time(k + 1)).tolist() for k in range(period.steps)]
    assert [row[:6] for row in ours] == [row[:6] for row in seen]
    nominal = [k for k in range(period.steps) if seen[k][8] == pytest.approx(1 / 4)]
    assert [ours[k][6:] for k in nominal] == [pytest.approx(seen[k][6:8]) for k in nominal]
    assert {tuple(seen[k][5:7]) for k in nominal} >= {(23, 45), (23, 60), (12, 15), (12, 60)}, "nothing was compared"


def fields_of(begin: datetime, end: datetime) -> dict[TimeField, float]:
    return dict(zip(TimeField, time_features(list(TimeField), begin, end).tolist(), strict=True))


@given(st.dates(max_value=date(9999, 12, 30)), st.sampled_from(DIVISORS), st.data())
def test_time_features__no_value_leaves_its_bounds(day: date, steps_per_hour: int, data: st.DataObject) -> None:
    step = data.draw(st.integers(0, 24 * steps_per_hour))
    midnight = datetime(day.year, day.month, day.day)
    end = midnight + timedelta(hours=1) * step / steps_per_hour
    begin = end - timedelta(hours=1) / steps_per_hour if step else end
    for field, value in fields_of(begin, end).items():
        low, high = BOUNDS[field]
        assert low <= value <= high, field


@given(st.dates(max_value=date(9999, 12, 30)), st.sampled_from(DIVISORS), st.data())
def test_time_features__hour_and_its_minutes_are_the_time_of_the_day(
    day: date, steps_per_hour: int, data: st.DataObject
) -> None:
    step = data.draw(st.integers(1, 24 * steps_per_hour))
    midnight = datetime(day.year, day.month, day.day)
    begin, end = (midnight + timedelta(hours=1) * k / steps_per_hour for k in (step - 1, step))
    fields = fields_of(begin, end)
    assert fields[TimeField.CURRENT_TIME] == pytest.approx(step / steps_per_hour)
    assert fields[TimeField.HOUR] + fields[TimeField.MINUTES] / 60 == pytest.approx(step / steps_per_hour)
    assert 1 <= fields[TimeField.MINUTES] <= 60


def test_time_features__each_field_has_bounds() -> None:
    assert list(BOUNDS) == list(TimeField)
    assert all(low < high for low, high in BOUNDS.values())


def test_time_features__sample_0_is_the_begin_of_the_day() -> None:
    begin = datetime(2016, 12, 31)  # a Saturday, and the 366th day
    assert fields_of(begin, begin) == {
        TimeField.YEAR: 2016,
        TimeField.MONTH: 12,
        TimeField.DAY_OF_MONTH: 31,
        TimeField.DAY_OF_WEEK: 7,
        TimeField.DAY_OF_YEAR: 366,
        TimeField.HOUR: 0,
        TimeField.MINUTES: 0,
        TimeField.CURRENT_TIME: 0,
    }


def test_time_features__last_timestep_of_a_year_belongs_to_it() -> None:
    fields = fields_of(datetime(2016, 12, 31, 23, 45), datetime(2017, 1, 1))
    assert (fields[TimeField.YEAR], fields[TimeField.MONTH], fields[TimeField.DAY_OF_MONTH]) == (2016, 12, 31)
    assert (fields[TimeField.HOUR], fields[TimeField.MINUTES], fields[TimeField.CURRENT_TIME]) == (23, 60, 24)


def test_time_fields__come_in_the_requested_order() -> None:
    begin, end = datetime(2017, 7, 2, 9), datetime(2017, 7, 2, 9, 15)  # a Sunday
    asked = [TimeField.CURRENT_TIME, TimeField.DAY_OF_WEEK, TimeField.HOUR]
    assert time_features(asked, begin, end).tolist() == [9.25, 1.0, 9.0]
    assert time_features([], begin, end).shape == (0,)
