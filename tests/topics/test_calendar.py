"""Days, times of day, days of the week and moments: what is accepted, what it means, and what is rejected."""

import calendar as standard
from datetime import date, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.agent_sdk.time_series import Period
from zenostat.topics.calendar import (
    LEAP_YEAR,
    WEEKDAY_NAMES,
    WEEKDAYS,
    check_hours,
    format_duration,
    format_month_day,
    hour_of_leap_year,
    in_hours,
    is_month_day,
    parse_clock_time,
    parse_day,
    parse_moment,
    parse_moment_within,
    parse_weekdays,
)
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import When

DAYS = st.dates(date(1990, 1, 1), date(2100, 12, 31))
MOMENTS = st.datetimes(datetime(1990, 1, 1), datetime(2100, 12, 31)).map(lambda moment: moment.replace(microsecond=0))
HOURS = st.integers(0, 23)
ENDS = st.integers(0, 24)


# Days


@given(DAYS)
def test_calendar__day_is_read_back_as_it_is_written(day: date) -> None:
    assert parse_day(day.isoformat(), "begin", 1) == day
    assert parse_day(format_month_day(day.month, day.day), "begin", day.year) == day


@pytest.mark.parametrize("text", ["7-1", "07-1", "7-01", " 07-01 ", "2018-7-1"])
def test_calendar__zeros_and_blanks_may_differ(text: str) -> None:
    assert parse_day(text, "begin", 2018) == date(2018, 7, 1)


@pytest.mark.parametrize("text", ["", "07", "07/01", "1 July", "07-01-2018", "17-07-01", "2018-07-01T00:00", "07-001"])
def test_calendar__another_format_is_no_day(text: str) -> None:
    with pytest.raises(InvalidConfig, match=r"end .* is not a date; write it as MM-DD or YYYY-MM-DD"):
        parse_day(text, "end")


@pytest.mark.parametrize("text", ["00-01", "13-01", "07-00", "07-32", "02-30", "2018-04-31"])
def test_calendar__day_that_no_year_has_is_no_calendar_date(text: str) -> None:
    with pytest.raises(InvalidConfig, match=r"begin .* is not a calendar date"):
        parse_day(text, "begin")


def test_calendar__29_february_exists_in_leap_years_only() -> None:
    assert parse_day("02-29", "begin") == date(LEAP_YEAR, 2, 29)
    with pytest.raises(InvalidConfig, match="'02-29' does not exist in 2017, the model's year"):
        parse_day("02-29", "begin", 2017)
    with pytest.raises(InvalidConfig, match=r"'2018-02-29' does not exist in 2018$"):
        parse_day("2018-02-29", "begin", 2016)


@given(st.integers(-1, 14), st.integers(-1, 33))
def test_calendar__month_has_the_days_of_a_leap_year(month: int, day: int) -> None:
    lengths = dict(enumerate((31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31), start=1))
    assert is_month_day(month, day) == (1 <= day <= lengths.get(month, 0))


@pytest.mark.parametrize(("month", "day"), [(10**20, 1), (1, 10**20)])
def test_calendar__number_beyond_any_date_is_no_day(month: int, day: int) -> None:
    assert not is_month_day(month, day)


# Moments


@given(MOMENTS, st.sampled_from(["T", " "]))
def test_calendar__moment_is_read_back_as_it_is_written(moment: datetime, separator: str) -> None:
    text = moment.isoformat(separator)
    assert parse_moment(text, 1) == moment
    assert parse_moment(text[len("2017-") :], moment.year) == moment


def test_calendar__seconds_and_the_time_of_day_may_be_left_out() -> None:
    assert parse_moment("07-03T08:15", 2017) == datetime(2017, 7, 3, 8, 15)
    assert parse_moment("07-03", 2017) == datetime(2017, 7, 3)
    assert parse_moment(" 02-29 ") == datetime(LEAP_YEAR, 2, 29)


@pytest.mark.parametrize(
    "text", ["", "noon", "08:00", "7-3", "07-03T8:00", "07-03T08", "2017-07-03T08:00Z", "17-07-03"]
)
def test_calendar__another_format_is_no_moment(text: str) -> None:
    with pytest.raises(ValueError, match="expected a date and time such as 2017-07-03T08:00"):
        parse_moment(text)


@pytest.mark.parametrize("text", ["13-01", "02-30", "07-03T24:00", "07-03T08:60", "2017-02-29T00:00"])
def test_calendar__moment_that_does_not_exist_is_rejected(text: str) -> None:
    with pytest.raises(ValueError, match="is not a valid date and time"):
        parse_moment(text)


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("12-31", datetime(2019, 12, 31)),
        ("01-01T06:00", datetime(2020, 1, 1, 6)),
        ("02-29", datetime(2020, 2, 29)),
        ("12-29", datetime(2019, 12, 29)),  # nearest to the period
        ("03-05", datetime(2020, 3, 5)),
        ("2021-03-05", datetime(2021, 3, 5)),
    ],
)
def test_calendar__moment_without_a_year_is_in_the_period_or_nearest_to_it(text: str, moment: datetime) -> None:
    assert parse_moment_within(text, datetime(2019, 12, 30), datetime(2020, 3, 1)) == moment


def test_calendar__day_that_no_year_of_a_period_has_is_rejected() -> None:
    with pytest.raises(ValueError, match="is not a valid date and time"):
        parse_moment_within("02-29", datetime(2017, 1, 1), datetime(2018, 12, 31))


# Times of each day or year


@given(MOMENTS)
def test_calendar__time_of_each_day_or_year_is_read_back(moment: datetime) -> None:
    assert parse_clock_time(f"{moment:%H:%M}", "schedule") == (moment.hour, moment.minute)
    expected = (moment.month, moment.day, moment.hour, moment.minute)
    assert parse_clock_time(f"{moment:%m-%d %H:%M}", "schedule") == expected


def test_calendar__each_year_may_have_29_february() -> None:
    assert parse_clock_time("02-29 00:00", "schedule") == (2, 29, 0, 0)


@pytest.mark.parametrize(
    "text",
    ["", "7:30", "07:5", "07:30:00", "24:00", "07:60", "02-30 07:30", "13-01 07:30", "07-01", "07-01T07:30", 7, None],
)
def test_calendar__another_text_is_no_clock_time(text: Any) -> None:
    with pytest.raises(InvalidConfig, match=r"schedule: .* is not a time; write '07:30' or '07-01 07:30'"):
        parse_clock_time(text, "schedule")


# Days of the week


def test_calendar__position_of_a_weekday_is_that_of_the_standard_library() -> None:
    monday = date(2017, 7, 3)
    for position, (name, full_name) in enumerate(zip(WEEKDAYS, WEEKDAY_NAMES, strict=True)):
        assert (monday + timedelta(position)).weekday() == position
        assert (full_name, name) == (standard.day_name[position], full_name[:3].lower())


@pytest.mark.parametrize(
    ("text", "days"),
    [
        ("sun", {6}),
        ("mon-fri", {0, 1, 2, 3, 4}),
        ("Sat-Mon, wed", {5, 6, 0, 2}),
        ("mon-sun", set(range(7))),
        ("tue-tue", {1}),
        ("mon,mon", {0}),
        (" FRI - sat ", {4, 5}),
    ],
)
def test_calendar__weekdays_are_names_and_spans(text: str, days: set[int]) -> None:
    assert parse_weekdays(text, "days") == days


@given(st.integers(0, 6), st.integers(0, 6))
def test_calendar__span_of_weekdays_ends_at_the_next_day_of_that_name(first: int, last: int) -> None:
    days = [first]
    while days[-1] != last:
        days.append((days[-1] + 1) % 7)
    assert parse_weekdays(f"{WEEKDAYS[first]}-{WEEKDAYS[last]}", "days") == set(days)


@pytest.mark.parametrize("text", ["", "monday", "mon-", "-mon", "mon-fri-sun", "mon;tue", "0", "mon,"])
def test_calendar__other_texts_are_no_weekdays(text: str) -> None:
    with pytest.raises(InvalidConfig, match=r"days = .*; expected weekdays, such as 'mon-fri'"):
        parse_weekdays(text, "days")


# Hours of the day


@given(HOURS, ENDS)
def test_calendar__span_of_hours_is_not_empty(start: int, end: int) -> None:
    if start == end:
        with pytest.raises(ValueError, match="a different end"):
            check_hours((start, end))
    else:
        assert check_hours((start, end)) == (start, end)
        assert any(in_hours((start, end), hour) for hour in range(24))


@given(HOURS, HOURS)
def test_calendar__span_and_its_complement_are_a_day(start: int, end: int) -> None:
    if start != end:
        assert all(in_hours((start, end), hour) != in_hours((end, start), hour) for hour in range(24))


@pytest.mark.parametrize(
    "hours", [(-1, 6), (24, 6), (8, 25), (8, -1), (8.5, 8.5), (float("nan"), 6.0), (6.0, float("nan"))]
)
def test_calendar__hours_that_no_day_has_are_rejected(hours: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="expected a start from 0 to below 24 h"):
        check_hours(hours)


@pytest.mark.parametrize(
    ("hours", "inside", "outside"),
    [((8.5, 17), (8.5, 12.0, 16.99), (8.49, 17.0, 0.0)), ((22, 6), (22.0, 23.5, 0.0, 5.99), (6.0, 12.0, 21.99))],
)
def test_calendar__start_is_inclusive_and_an_end_exclusive(
    hours: tuple[float, float], inside: tuple[float, ...], outside: tuple[float, ...]
) -> None:
    assert in_hours(hours, np.array(inside)).tolist() == [True] * len(inside)
    assert in_hours(hours, np.array(outside)).tolist() == [False] * len(outside)
    assert [in_hours(hours, hour) for hour in (*inside, *outside)] == [True] * len(inside) + [False] * len(outside)


@pytest.mark.parametrize("hours", [[8, 8], [24, 2], [8, 25]])
def test_calendar__faults_and_tables_reject_the_same_hours(hours: list[int]) -> None:
    for model in (When, Period):
        with pytest.raises(ValueError, match="expected a start from 0 to below 24 h"):
            model.model_validate({"value": 1.0, "hours": hours} if model is Period else {"hours": hours})


@given(MOMENTS)
def test_calendar__hour_of_a_leap_year_is_the_same_in_each_year(moment: datetime) -> None:
    in_leap_year = moment.replace(year=LEAP_YEAR)
    assert hour_of_leap_year(moment) == (in_leap_year - datetime(LEAP_YEAR, 1, 1)) // timedelta(hours=1)


@pytest.mark.parametrize(
    ("seconds", "text"), [(1, "1 s"), (90, "90 s"), (0.5, "0.5 s"), (60, "1 min"), (900, "15 min"), (3600, "1 h")]
)
def test_format_duration__unit_without_remainder(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text
