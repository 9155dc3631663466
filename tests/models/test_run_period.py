"""Days, timesteps and calendars, counted by hand."""

import calendar
from datetime import date, datetime, timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.models.building.model import Building
from zenostat.models.run_period import Period, year_of
from zenostat.models.weather.header import Header, check_covers
from zenostat.topics.calendar import parse_day
from zenostat.topics.errors import InvalidConfig

WEEKDAYS = list(calendar.day_name)
DIVISORS = [1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30, 60]


def building(**run_period: Any) -> Building:
    return Building("b", {"Building": {"b": {}}, "RunPeriod": {"r": run_period}}, "0")


@pytest.mark.parametrize(
    ("begin", "end", "steps_per_hour", "steps"),
    [
        (date(2017, 7, 1), date(2017, 7, 1), 1, 24),
        (date(2017, 7, 1), date(2017, 7, 1), 4, 96),
        (date(2017, 7, 1), date(2017, 7, 7), 6, 7 * 24 * 6),
        (date(2017, 1, 1), date(2017, 12, 31), 4, 35_040),
        (date(2016, 1, 1), date(2016, 12, 31), 4, 35_136),
        (date(2017, 2, 28), date(2017, 3, 1), 60, 2 * 1440),
        (date(2016, 2, 28), date(2016, 3, 1), 60, 3 * 1440),
    ],
)
def test_run_period__both_days_are_included(begin: date, end: date, steps_per_hour: int, steps: int) -> None:
    assert Period(begin, end, steps_per_hour).steps == steps


@pytest.mark.parametrize("steps_per_hour", DIVISORS)
def test_run_period__day_ends_at_midnight_to_the_microsecond(steps_per_hour: int) -> None:
    period = Period(date(2017, 12, 31), date(2017, 12, 31), steps_per_hour)
    assert period.time(0) == datetime(2017, 12, 31)
    assert period.time(period.steps) == datetime(2018, 1, 1)
    assert period.step_s * period.steps == 86_400.0
    assert all(
        period.time(k + 1) - period.time(k) == timedelta(minutes=60 // steps_per_hour) for k in range(period.steps)
    )


def test_run_period__there_is_no_summer_time() -> None:
    # 26 March 2017 has 23 hours on clocks in Europe, and 24 in a simulation.
    period = Period(date(2017, 3, 26), date(2017, 3, 26), 1)
    assert [period.time(k).hour for k in (1, 2, 3, 4)] == [1, 2, 3, 4]
    assert period.steps == 24


@pytest.mark.parametrize("steps_per_hour", [*sorted(set(range(-1, 62)) - set(DIVISORS)), 120])
def test_run_period__timestep_divides_the_hour(steps_per_hour: int) -> None:
    with pytest.raises(InvalidConfig, match=rf"{steps_per_hour} does not divide the hour.*1, 2, 3, 4, 5, 6, 10"):
        Period(date(2017, 7, 1), date(2017, 7, 1), steps_per_hour)


def test_run_period__period_does_not_end_before_it_begins() -> None:
    with pytest.raises(InvalidConfig, match=r"ends \(2017-06-30\) before it begins \(2017-07-01\)"):
        Period(date(2017, 7, 1), date(2017, 6, 30), 4)


@pytest.mark.parametrize("day", [date(1, 1, 1), date(1582, 12, 31), date(9999, 12, 31)])
def test_period__years_that_cannot_be_simulated_are_refused(day: date) -> None:
    with pytest.raises(InvalidConfig, match=rf"run period {day} to {day} is outside the years 1583 to 9998"):
        Period(day, day, 4)
    assert Period(date(1583, 1, 1), date(9998, 12, 31), 1).steps > 0


# Days


@pytest.mark.parametrize(
    ("text", "year", "day"),
    [
        ("07-01", 2017, date(2017, 7, 1)),
        ("7-1", 2013, date(2013, 7, 1)),
        ("2018-07-01", 2017, date(2018, 7, 1)),
        ("  12-31 ", 2017, date(2017, 12, 31)),
        ("02-29", 2016, date(2016, 2, 29)),
        ("2016-02-29", 2017, date(2016, 2, 29)),
    ],
)
def test_run_period__day_is_written_with_or_without_its_year(text: str, year: int, day: date) -> None:
    assert parse_day(text, "begin", year) == day


@pytest.mark.parametrize("text", ["", "July 1", "07/01", "2017-07", "07-01-2017", "07-01T00:00", "1.7.", "-7-1", "07-"])
def test_run_period__what_is_no_day_is_refused_with_the_form(text: str) -> None:
    with pytest.raises(InvalidConfig, match=r"begin .* is not a date; write it as MM-DD or YYYY-MM-DD") as raised:
        parse_day(text, "begin", 2017)
    assert repr(text) in str(raised.value)


@pytest.mark.parametrize("text", ["02-29", "2017-02-29"])
def test_run_period__day_that_is_not_in_the_calendar_is_refused(text: str) -> None:
    with pytest.raises(InvalidConfig, match=r"end .* does not exist in 2017"):
        parse_day(text, "end", 2017)


@given(st.dates())
def test_run_period__any_day_can_be_written_out(day: date) -> None:
    assert parse_day(day.isoformat(), "begin", 1) == day


# The year of a weekday


@pytest.mark.parametrize(
    ("month", "weekday", "year"),
    [  # years that begin with that weekday, from a calendar; EnergyPlus's WeatherManager has the same table
        (1, "Sunday", 2017), (1, "Monday", 2007), (1, "Tuesday", 2013), (1, "Wednesday", 2014), (1, "Thursday", 2015),
        (1, "Friday", 2010), (1, "Saturday", 2011),
        (7, None, 2017), (7, "", 2017), (7, "SummerDesignDay", 2017), (7, "CustomDay1", 2017),  # no weekday is named
    ],
)  # fmt: skip
def test_run_period__year_has_its_first_day_on_the_weekday(month: int, weekday: str | None, year: int) -> None:
    assert year_of(month, 1, weekday) == year


@given(st.dates(date(2017, 1, 1), date(2017, 12, 31)), st.sampled_from(WEEKDAYS))
def test_run_period__year_is_the_latest_common_one_that_has_the_day_on_that_weekday(day: date, weekday: str) -> None:
    def fits(year: int) -> bool:
        return not calendar.isleap(year) and f"{date(year, day.month, day.day):%A}" == weekday

    year = year_of(day.month, day.day, weekday)
    assert fits(year)
    assert year <= 2017
    assert not [later for later in range(year + 1, 2018) if fits(later)]


@pytest.mark.parametrize("weekday", WEEKDAYS)
def test_run_period__leap_day_on_a_weekday_is_in_a_leap_year(weekday: str) -> None:
    # EnergyPlus takes a leap year for it; no common year has the day.
    year = year_of(2, 29, weekday)
    assert f"{date(year, 2, 29):%A}" == weekday


# A model's own period and what is asked for


def test_run_period__model_without_a_run_period_runs_the_whole_of_2017_in_quarter_hours() -> None:
    period = Building("b", {"Building": {"b": {}}}, "0").period(None, None, None)
    assert (period.begin, period.end, period.steps_per_hour) == (date(2017, 1, 1), date(2017, 12, 31), 4)


def test_run_period__defaults_to_the_models_period_and_timestep() -> None:
    own = building(begin_month=3, begin_day_of_month=5, end_month=4, end_day_of_month=6, begin_year=2012)
    own.objects["Timestep"] = {"t": {"number_of_timesteps_per_hour": 4}}
    period = own.period(None, None, None)
    assert (period.begin, period.end, period.steps_per_hour) == (date(2012, 3, 5), date(2012, 4, 6), 4)


def test_run_period__days_without_a_year_are_in_the_models_calendar() -> None:
    own = building(begin_month=1, begin_day_of_month=1, day_of_week_for_start_day="Tuesday")
    period = own.period("07-01", "07-07", 12)
    assert (period.begin, period.end, period.steps_per_hour) == (date(2013, 7, 1), date(2013, 7, 7), 12)
    assert f"{date(2013, 1, 1):%A}" == "Tuesday"


def test_run_period__end_without_a_year_is_in_the_year_of_the_begin() -> None:
    assert building(begin_year=2017).period("2018-07-01", "07-07", None).end == date(2018, 7, 7)


@pytest.mark.parametrize(
    ("begin", "end", "first", "last"),
    [
        (None, None, date(2017, 10, 1), date(2018, 3, 31)),
        ("12-01", None, date(2017, 12, 1), date(2018, 3, 31)),
        (None, "01-31", date(2017, 10, 1), date(2018, 1, 31)),
        ("12-01", "01-31", date(2017, 12, 1), date(2018, 1, 31)),
        ("02-01", None, date(2017, 2, 1), date(2017, 3, 31)),
        ("11-01", "11-30", date(2017, 11, 1), date(2017, 11, 30)),
    ],
)
def test_run_period__end_without_a_year_is_after_new_year_where_the_models_own_is(
    begin: str | None, end: str | None, first: date, last: date
) -> None:
    own = building(begin_month=10, begin_day_of_month=1, end_month=3, end_day_of_month=31)
    period = own.period(begin, end, None)
    assert (period.begin, period.end) == (first, last)


@pytest.mark.parametrize("own", [{}, {"begin_month": 10, "begin_day_of_month": 1, "end_month": 3}])
def test_run_period__end_with_a_year_before_the_begin_is_refused_with_the_form(own: dict[str, int]) -> None:
    with pytest.raises(InvalidConfig, match=r"ends \(2017-01-31\) before it begins .* write the day as YYYY-MM-DD"):
        building(**own).period("2017-12-01", "2017-01-31" if own else "01-31", None)


# What the weather has

SUMMER = Header("Denver", 39.8, -104.7, -7.0, 1650.0, first=(5, 1), last=(9, 30))


@pytest.mark.parametrize(
    ("begin", "end"), [("05-01", "05-01"), ("05-01", "09-30"), ("09-30", "09-30"), ("2018-07-01", "2018-07-07")]
)
def test_run_period__period_within_the_weather_is_taken(begin: str, end: str) -> None:
    check_covers(SUMMER, building().period(begin, end, None), "denver")


@pytest.mark.parametrize(
    ("begin", "end", "words"),
    [("04-30", "05-02", "begins on 04-30"), ("09-01", "10-01", "ends on 10-01"), ("01-01", "12-31", "begins on 01-01")],
)
def test_run_period__period_outside_the_weather_is_refused_with_what_there_is(begin: str, end: str, words: str) -> None:
    with pytest.raises(InvalidConfig, match=f"{words}, outside the weather file denver.*05-01 to 09-30"):
        check_covers(SUMMER, building().period(begin, end, None), "denver")
