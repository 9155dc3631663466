"""Faults of schedules: each found before EnergyPlus starts, if and only if EnergyPlus itself ends at it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest
from support.box_model import box_model, exit_code

from zenostat.models.building.diagnostics import Severity, diagnose
from zenostat.models.building.model import Building
from zenostat.models.building.schedule_fields import is_in_year
from zenostat.models.building.schedule_rules import schedule_findings
from zenostat.models.catalog import bundled_weathers
from zenostat.models.input_format.idf_reader import parse_idf
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.models.points.discovery import discover
from zenostat.topics.errors import InvalidConfig

ON = ("For: AllDays", "Until: 24:00", 1.0)
YEAR = "Through: 12/31"
DAY = (YEAR, "For: AllDays")

REFUSED: dict[str, tuple[tuple[Any, ...], int, str]] = {
    "year ends in June": (("Through: 6/30", *ON), 0, "the days after 6/30 have no values"),
    "year ends a day early": (("Through: 12/30", *ON), 0, "the last field with 'Through:' must be 'Through: 12/31'"),
    "no day types": ((YEAR, "Until: 24:00", 1.0), 1, "where a field such as 'For: AllDays' is expected"),
    "unknown day type": ((YEAR, "For: Weekdys", "Until: 24:00", 1.0), 1, "names no day type; expected one or more of"),
    "day type twice": ((YEAR, *ON, "For: Monday", "Until: 24:00", 0.0), 4, "but Monday has values already"),
    "day type twice in a field": ((YEAR, "For: Weekdays Monday", "Until: 24:00", 1.0), 1, "Monday has values already"),
    "day ends early": ((*DAY, "Until: 22:00", 1.0), 2, "the values after 22:00 are missing"),
    "no such hour": ((*DAY, "Until: 25:00", 1.0), 2, "expected 0:00 to 24:00"),
    "no such minute": ((*DAY, "Until: 8:60", 1.0, "Until: 24:00", 0.0), 2, "expected 0:00 to 24:00"),
    "negative time": ((*DAY, "Until: -1:00", 1.0, "Until: 24:00", 0.0), 2, "expected 0:00 to 24:00"),
    "time without minutes": ((*DAY, "Until: 8", 1.0, "Until: 24:00", 0.0), 2, "expected hours:minutes"),
    "time with seconds": ((*DAY, "Until: 24:00:00", 1.0), 2, "expected hours:minutes"),
    "half an hour": ((*DAY, "Until: 8.5:00", 1.0, "Until: 24:00", 0.0), 2, "expected hours:minutes"),
    "time decreases": ((*DAY, "Until: 8:00", 1.0, "Until: 6:00", 0.0, "Until: 24:00", 0.0), 4, "before 8:00"),
    "time after the day": ((*DAY, "Until: 24:00", 1.0, "Until: 8:00", 0.0), 4, "times must increase"),
    "value is a word": ((*DAY, "Until: 24:00", "on"), 3, "which is a number"),
    "value has a unit": ((*DAY, "Until: 24:00", "5%"), 3, "which is a number"),
    "value is not finite": ((*DAY, "Until: 24:00", "nan"), 3, "which is a number"),
    "value in full-width digits": ((*DAY, "Until: 24:00", "\uff11\uff15"), 3, "which is a number"),
    "value is missing": ((*DAY, "Until: 24:00"), 2, "after which the value is missing"),
    "decimal comma": ((*DAY, "Until: 24:00", 0, 5), 4, "where a field such as 'Until: 24:00' is expected"),
    "two values": ((*DAY, "Until: 12:00", 1.0, 2.0, "Until: 24:00", 1.0), 4, "'Until: 24:00' is expected"),
    "interpolate yes": ((*DAY, "Interpolate: Yes", "Until: 24:00", 1.0), 2, "one of No, Average, Linear"),
    "interpolate nothing": ((*DAY, "Interpolate:", "Until: 24:00", 1.0), 2, "one of No, Average, Linear"),
    "blank interpolation": ((*DAY, "", "Until: 24:00", 1.0), 2, "'Until: 24:00' is expected"),
    "until misspelled": ((*DAY, "Unitl: 24:00", 1.0), 2, "'Until: 24:00' is expected"),
    "untill": ((*DAY, "Untill: 24:00", 1.0), 2, "expected hours:minutes"),
    "second until misspelled": ((*DAY, "Until: 8:00", 1.0, "Utnil: 24:00", 1.0), 4, "'Until: 24:00' is expected"),
    "time without until": ((*DAY, "24:00", 1.0), 2, "'Until: 24:00' is expected"),
    "value without time": ((*DAY, 1.0), 2, "'Until: 24:00' is expected"),
    "through misspelled": (("Trough: 12/31", *ON), 0, "'Through: 12/31' is expected"),
    "second through misspelled": (("Through: 6/30", *ON, "Trough: 12/31", *ON), 4, "'Until: 24:00' is expected"),
    "for misspelled": ((YEAR, "Fro: AllDays", "Until: 24:00", 1.0), 1, "'For: AllDays' is expected"),
    "day types with a comma": ((YEAR, "For: Weekdays", "Sunday", "Until: 24:00", 1.0), 2, "'Until: 24:00' is expected"),
    "dates decrease": (("Through: 6/30", *ON, "Through: 3/31", *ON, YEAR, *ON), 4, "before 6/30"),
    "year twice": ((YEAR, *ON, YEAR, *ON), 4, "the whole year has values already"),
    "month 13": (("Through: 13/31", *ON), 0, "is no day of the year"),
    "day first": (("Through: 31/12", *ON), 0, "the month is first"),
    "30 February": (("Through: 2/30", *ON, YEAR, *ON), 0, "is no day of the year"),
    "day of the year": (("Through: 365", *ON), 0, "is no date"),
    "date with a point": (("Through: 12.31", *ON), 0, "is no date"),
    "last Sunday": (("Through: Last Sunday in December", *ON), 0, "is no date"),
    "date without a date": (("Through:", *ON), 0, "the days after it have no values"),
    "blank in the middle": (("Through: 6/30", *ON, "", YEAR, *ON), 4, "'Until: 24:00' is expected"),
    "nothing": ((), -1, "it has no fields"),
    "only a date": ((YEAR,), 0, "after which the values are missing"),
    "ends with a date": (("Through: 6/30", *ON, YEAR), 4, "after which the values are missing"),
}  # fmt: skip
"""Fields of a Schedule:Compact, the field that is wrong, and what its error says."""

ACCEPTED: dict[str, tuple[tuple[Any, ...], str]] = {
    "as documented": ((YEAR, *ON), ""),
    "without colons": (("Through 12/31", "For AllDays", "Until 24:00", 1.0), ""),
    "any case": (("THROUGH:12/31", "for:alldays", "until:24:00", 1.0), ""),
    "glued": (("Through:12/31", "ForAllDays", "Until:24:00", "1.5d0"), ""),
    "rest of the days": ((YEAR, "For: Weekdays", "Until: 24:00", 1.0, "For: AllOtherDays", "Until: 24:00", 0.0), ""),
    "all day types": (
        (
            *(YEAR, "For: Weekends", "Until: 24:00", 1.0, "For: Holiday SummerDesignDay", "Until: 24:00", 0.0),
            *("For: Weekdays CustomDay1", "Until: 24:00", 0.0, "For: WinterDesignDay CustomDay2", "Until: 24:00", 0.0),
        ),
        "",
    ),
    "interpolated": ((*DAY, "Interpolate: Average", "Until: 8:00", 1.0, "Until: 24:00", 0.0), ""),
    "interpolated, short": ((*DAY, "No", "Until: 24:00", 1.0), ""),
    "linear": ((*DAY, "Interpolate:linear", "Until: 24:00", 1.0), ""),
    "words of a date": (("Through: 30 June", *ON, "Through: December 31", *ON), ""),
    "date with dashes": (("Through: 12-31", *ON), ""),
    "date with a year": (("Through: 12/31/2017", *ON), ""),
    "without 29 February": (("Through: 2/28", *ON, YEAR, *ON), ""),
    "with 29 February": (("Through: 2/29", *ON, YEAR, *ON), ""),
    "quarters": ((*DAY, "Until: 7:15", 1.0, "Until: 7:30", 2.0, "Until: 24:00", 0.0), ""),
    "time without hours": ((*DAY, "Until: :30", 1.0, "Until: 24:00", 0.0), ""),
    "blanks at the end": ((YEAR, *ON, "", ""), ""),
    "missing day types": ((YEAR, "For: Weekdays", "Until: 24:00", 1.0), "there is no value for Sunday, Saturday"),
    "unknown day type": ((YEAR, "For: Weedends Monday", "Until: 24:00", 1.0, "For: AllOtherDays", "Until: 24:00", 0.0),
                         "EnergyPlus ignores 'Weedends', which is no day type; did you mean 'Weekends'"),
    "time twice": ((*DAY, "Until: 8:00", 1.0, "Until: 8:00", 2.0, "Until: 24:00", 0.0), "is not after 8:00"),
    "time twice, half": ((*DAY, "Until: 8:30", 1.0, "Until: 8:30", 2.0, "Until: 24:00", 0.0), "is not after 8:30"),
    "earlier in the hour": ((*DAY, "Until: 8:30", 1.0, "Until: 8:15", 2.0, "Until: 24:00", 0.0), "is not after 8:30"),
    "after the day": ((*DAY, "Until: 24:30", 1.0), "EnergyPlus ends the day at 24:00"),
    "blank value": ((*DAY, "Until: 12:00", "", "Until: 24:00", 1.0), "EnergyPlus uses 0"),
    "date twice": (("Through: 6/30", *ON, "Through: 6/30", *ON, YEAR, *ON), "adds no day"),
    "ends with day types": ((*DAY,), "EnergyPlus uses 0"),
    "date after the year": ((YEAR, *ON, YEAR), "EnergyPlus ignores: the whole year has values already"),
    "blank date": (("Through:", *ON, YEAR, *ON), "adds no day"),
}  # fmt: skip
"""Fields of a Schedule:Compact, and what its warning says."""

INTERVAL = {"time": "Until: 24:00", "value_until_time": 1.0}
DAYS = {f"{day}_schedule_day_name": "D" for day in ("sunday", "monday", "tuesday", "wednesday", "thursday", "friday",
        "saturday", "holiday", "summerdesignday", "winterdesignday", "customday1", "customday2")}  # fmt: skip
ALL_DAYS = {"W": {"data": [{"daytype_list": "For: AllDays", "schedule_day_name": "D"}]}}


def compact(fields: tuple[Any, ...]) -> dict[str, Any]:
    """A schedule of a model with these fields; an empty text is a blank one."""
    entries = [{"field": field} if field != "" else {} for field in fields]
    return {"Schedule:Compact": {"S": {"schedule_type_limits_name": "Any number", "data": entries}}}


def dates(*ends: tuple[int, int, int, int]) -> dict[str, Any]:
    """A Schedule:Year with a week for each range of dates: month and day of its start and of its end."""
    names = ("start_month", "start_day", "end_month", "end_day")
    weeks = [{"schedule_week_name": "W", **dict(zip(names, each, strict=True))} for each in ends]
    return {"S": {"schedule_type_limits_name": "Any number", "schedule_weeks": weeks}}


def of_day(kind: str, **fields: Any) -> dict[str, Any]:
    """Objects of a year that has one day schedule."""
    limits = {"schedule_type_limits_name": "Any number"}
    return {kind: {"D": limits | fields}, "Schedule:Week:Compact": ALL_DAYS, "Schedule:Year": dates((1, 1, 12, 31))}


def of_week(*lists: str) -> dict[str, Any]:
    """Objects of a year that has one week, with these lists of day types."""
    week = {"W": {"data": [{"daytype_list": each, "schedule_day_name": "D"} for each in lists]}}
    return of_day("Schedule:Day:Interval", data=[INTERVAL]) | {"Schedule:Week:Compact": week}


def of_year(*ends: tuple[int, int, int, int]) -> dict[str, Any]:
    """Objects of a year with a week for each range of dates."""
    return of_week("AllDays") | {"Schedule:Year": dates(*ends)}


def with_date(kind: str, text: str) -> dict[str, Any]:
    """Objects of a year with a special day, or with daylight saving time, from a date."""
    end = {"end_date": "11/30"} if kind == "DaylightSavingTime" else {}
    return of_year((1, 1, 12, 31)) | {f"RunPeriodControl:{kind}": {"R": {"start_date": text, **end}}}


DATES = {
    **dict.fromkeys(("12/31", "31 Dec", "December 31", "1st January", "2/29", "12/31/2017", "2017-12-31"), ""),
    **dict.fromkeys(("1st Sunday in October", "1 Sunday in oct", "2nd Monday of May", "Last Sunday in March"), ""),
    **dict.fromkeys(("1st October Sunday", "last sun mar"), ""),
    "31/12": "the month is first",
    "2/30": "is no day of the year",
    "30 February": "is no date",
    "367": "is no date",
    **dict.fromkeys(("First Sunday in October", "6th Sunday in May", "1st Sunday in Foo"), "'1st Sunday in May'"),
    **dict.fromkeys(
        ("1st Foo in May", "Sunday in May", "March 2nd Sunday", "Last Day of March"), "'Last Sunday in May'"
    ),
    **dict.fromkeys(("Dec", "January 1st", "Last Monday in August 2017"), "expected one such as '31 Dec'"),
}
"""Dates of special days and of daylight saving time, and what the error says."""

OTHERS: dict[str, tuple[dict[str, Any], str, str]] = {
    "compact, value with a sign in epJSON": (compact((*DAY, "Until: 24:00", "+1")), "data[3].field", "is a number"),
    "interval": (of_day("Schedule:Day:Interval", data=[INTERVAL]), "", ""),
    "interval, without until": (of_day("Schedule:Day:Interval", data=[INTERVAL | {"time": "24:00"}]), "", ""),
    "interval, day ends early": (
        of_day("Schedule:Day:Interval", data=[INTERVAL | {"time": "18:00"}]), "data[0].time", "values after 18:00"),
    "interval, no time": (of_day("Schedule:Day:Interval", data=[INTERVAL | {"time": "noon"}]), "data[0].time",
                          "expected hours:minutes"),
    "interval, decreasing": (
        of_day("Schedule:Day:Interval", data=[INTERVAL | {"time": "9:00"}, INTERVAL | {"time": "8:00"}, INTERVAL]),
        "data[1].time", "before 9:00"),
    "interval, value missing": (
        of_day("Schedule:Day:Interval", data=[INTERVAL | {"time": "8:00"}, {"time": "24:00"}]),
        "data[1].value_until_time", "is missing"),
    "interval, empty": (of_day("Schedule:Day:Interval"), "", "it has no times"),
    "list": (of_day("Schedule:Day:List", minutes_per_item=60, extensions=[{"value": 1.0}] * 24), "", ""),
    "list, half hours": (of_day("Schedule:Day:List", minutes_per_item=30, extensions=[{"value": 1.0}] * 48), "", ""),
    "list, too short": (of_day("Schedule:Day:List", minutes_per_item=60, extensions=[{"value": 1.0}] * 23),
                        "minutes_per_item", "a day has 24 values, but it has 23"),
    "list, uneven": (of_day("Schedule:Day:List", minutes_per_item=45, extensions=[{"value": 1.0}] * 32),
                     "minutes_per_item", "does not divide the hour"),
    "list, no minutes": (of_day("Schedule:Day:List", extensions=[{"value": 1.0}] * 24), "", "lacks 'minutes_per_item'"),
    "week": (of_week("Weekdays", "For AllOtherDays"), "", ""),
    "week, incomplete": (of_week("Weekdays", "Weekends"), "", "no schedule for Holiday, SummerDesignDay"),
    "week, twice": (of_week("Weekdays", "Friday", "AllOtherDays"), "data[1].daytype_list", "Friday has values already"),
    "week, unknown": (of_week("Weekdys", "AllOtherDays"), "data[0].daytype_list", "names no day type"),
    "year": (of_year((1, 1, 12, 31)), "", ""),
    "year, over New Year": (of_year((11, 1, 2, 28), (3, 1, 10, 31)), "", ""),
    "year, gap": (of_year((1, 1, 5, 31), (7, 1, 12, 31)), "", "no week of it has 6/1"),
    "year, overlap": (of_year((1, 1, 6, 30), (6, 30, 12, 31)), "schedule_weeks[1].start_month", "has 6/30"),
    **{f"{kind}, {text}": (with_date(kind, text), "start_date" if words else "", words)
       for kind in ("DaylightSavingTime", "SpecialDays") for text, words in DATES.items()},
}  # fmt: skip
"""Objects of other schedules and of dates, the field that is wrong, and what its error says."""


@pytest.mark.parametrize("case", REFUSED)
def test_diagnose__fault_of_a_compact_schedule_has_its_field_and_line(case: str) -> None:
    fields, index, words = REFUSED[case]
    source = parse_idf(write_idf(box_model("S") | compact(fields), engine_layout()), engine_layout())
    (error,) = [each for each in diagnose(source.objects, source) if each.severity is Severity.ERROR]
    path = f"data[{index}].field" if index >= 0 else ""
    assert (error.kind, error.name, error.field) == ("Schedule:Compact", "S", path)
    assert words in error.text
    assert error.line == source.line("Schedule:Compact", "S", path) is not None
    if index >= 0:
        assert error.line == source.line("Schedule:Compact", "S", "name") + 2 + index
        assert f"{path} is {fields[index]!r}, " in error.text


@pytest.mark.parametrize("case", ACCEPTED)
def test_schedule_findings__what_energyplus_accepts_is_no_error(case: str) -> None:
    fields, words = ACCEPTED[case]
    findings = list(schedule_findings(compact(fields)))
    assert [each.is_fatal for each in findings] == [False] * bool(words)
    assert not words or words in findings[0].text


@pytest.mark.parametrize("case", OTHERS)
def test_schedule_findings__of_days_weeks_and_years(case: str) -> None:
    objects, path, words = OTHERS[case]
    findings = list(schedule_findings(objects))
    assert [(each.name, each.field, each.is_fatal) for each in findings] == (
        [(findings[0].name, path, True)] if words else []
    )
    assert not words or words in findings[0].text


def test_schedule_findings__warn_of_a_day_of_a_year_that_no_calendar_has() -> None:
    (finding,) = schedule_findings(with_date("SpecialDays", "31/12/2017"))
    assert (finding.field, finding.is_fatal) == ("start_date", False)
    assert "the month is first" in finding.text


@pytest.mark.parametrize(
    ("text", "years"),
    [
        ("5th Monday in February", {2016}),
        ("5th Sunday in March", {2019, 2020}),
        ("5 March Friday", {2017, 2018, 2019}),
        ("4th Monday in February", range(2016, 2021)),
        ("Last Monday in February", range(2016, 2021)),
        ("31 March", range(2016, 2021)),
    ],
)
def test_is_in_year__not_all_years_have_a_fifth_weekday(text: str, years: Collection[int]) -> None:
    assert [year for year in range(2016, 2021) if is_in_year(text, year)] == [*years]


@pytest.mark.parametrize(("kind", "end"), [("SpecialDays", "start_date"), ("DaylightSavingTime", "end_date")])
def test_period__year_has_the_dates_of_special_days(kind: str, end: str) -> None:
    days = {"RunPeriodControl:" + kind: {"R": {"start_date": "1/1", end: "5th Sunday in March"}}}
    model = Building("m", box_model() | days, "")
    for year in (2016, 2019):  # a leap year is left to EnergyPlus
        assert model.period(f"{year}-03-01", f"{year}-03-02", None).begin.year == year
    with pytest.raises(InvalidConfig, match=f"{end} '5th Sunday in March', which 2017 does not have; choose"):
        model.period("2017-03-01", "2017-03-02", None)


@pytest.mark.slow
@pytest.mark.process
def test_schedule_findings__energyplus_ends_at_exactly_those_that_are_fatal(tmp_path: Path) -> None:
    cases = {f"{case} (refused)": compact(REFUSED[case][0]) for case in REFUSED}
    cases |= {f"{case} (accepted)": compact(ACCEPTED[case][0]) for case in ACCEPTED}
    cases |= {case: OTHERS[case][0] for case in OTHERS}
    differing = {}
    for number, (case, objects) in enumerate(cases.items()):
        is_refused = any(each.is_fatal for each in schedule_findings(objects))
        code = exit_code(box_model("S") | objects, tmp_path / str(number))
        if is_refused != (code != 0):
            differing[case] = code
    assert differing == {}


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("kind", ["SpecialDays", "DaylightSavingTime"])
def test_is_in_year__energyplus_ends_in_a_year_without_the_date(kind: str, tmp_path: Path) -> None:
    text = "5th Sunday in March"
    codes = {}
    for year in (2017, 2019):
        period = {"begin_month": 1, "begin_day_of_month": 1, "end_month": 1, "end_day_of_month": 1}
        model = box_model("S") | with_date(kind, text)
        model["RunPeriod"] = {"Day": {**period, "begin_year": year, "end_year": year}}
        codes[year] = exit_code(model, tmp_path / str(year))
    assert {year: code == 0 for year, code in codes.items()} == {2017: False, 2019: True}
    assert {year: is_in_year(text, year) for year in codes} == {2017: False, 2019: True}
    assert discover(Building("box", model, str(tmp_path)), bundled_weathers()[0].path).meters, (
        "it does not depend on the year"
    )
