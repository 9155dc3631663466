"""Needs of a run that a model or a weather file may lack: accepted with a sentence, or refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from support.weather_files import run

from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.models.building.model import Building, for_episode
from zenostat.models.building.run_needs import assumptions, lacks_design_days, simulation_control
from zenostat.models.catalog import find_weather
from zenostat.models.run_period import Period
from zenostat.models.weather.header import check_complete, read_header
from zenostat.models.weather.records import check_records, missing_values
from zenostat.topics.errors import InvalidConfig

DENVER = find_weather("USA_CO_Denver").path
SIZED = {"s": {"do_zone_sizing_calculation": "Yes"}}
AUTOSIZED = {"Sizing:Zone": {"z": {}}, "Fan:OnOff": {"f": {"maximum_flow_rate": "Autosize"}}}


@pytest.mark.parametrize(
    ("objects", "sentences"),
    [
        ({"RunPeriod": {"a": {}}}, []),
        ({}, ["no RunPeriod, so an episode is a whole year"]),
        ({"RunPeriod": {"a": {}, "b": {}}}, ["several RunPeriod objects; 'a' is simulated, not 'b'"]),
        (
            {"SimulationControl": {"s": {"run_simulation_for_weather_file_run_periods": "No"}}},
            ["no RunPeriod", "sizing periods only; an episode simulates the weather file"],
        ),
        ({"RunPeriod": {"a": {}}, "SimulationControl": SIZED}, ["sized for the design days of the weather file"]),
        ({"RunPeriod": {"a": {}}, "SimulationControl": SIZED, "SizingPeriod:WeatherFileDays": {"d": {}}}, []),
        (
            {"RunPeriod": {"a": {}}, "SizingPeriod:DesignDay": {"d": {}}, **AUTOSIZED},
            ["no SimulationControl; it is sized, since fields of it are Autosize"],
        ),
    ],
)
def test_assumptions__are_one_sentence_each(objects: dict[str, Any], sentences: list[str]) -> None:
    actual = list(assumptions(objects, has_dates=False))
    assert len(actual) == len(sentences)
    assert all(words in sentence for words, sentence in zip(sentences, actual, strict=True))


def test_assumptions__dates_of_the_scenario_need_no_run_period() -> None:
    assert list(assumptions({}, has_dates=True)) == []


def test_simulation_control__requests_what_an_autosized_model_needs() -> None:
    control = simulation_control(AUTOSIZED)
    assert (control["do_zone_sizing_calculation"], control["do_plant_sizing_calculation"]) == ("Yes", "No")
    assert lacks_design_days(AUTOSIZED)
    own = {"SimulationControl": {"s": {"do_zone_sizing_calculation": "No"}}, **AUTOSIZED}
    assert simulation_control(own)["do_zone_sizing_calculation"] == "No"
    assert not lacks_design_days(own)
    assert "do_zone_sizing_calculation" not in simulation_control({"Sizing:Zone": {"z": {}}})


def test_run_period__of_the_model_that_has_no_such_day_is_named() -> None:
    own = {"begin_month": 2, "begin_day_of_month": 1, "end_month": 2, "end_day_of_month": 30}
    building = Building("b", {"Building": {"b": {}}, "RunPeriod": {"Winter": own}}, "0", (), "/home/me/mine.idf")
    with pytest.raises(InvalidConfig, match=r"RunPeriod 'Winter' of /home/me/mine\.idf ends on 02-30, which is no day"):
        building.period(None, None, None)
    assert building.period("02-01", "02-28", None).steps == 28 * 96


@pytest.mark.parametrize(
    ("years", "end", "words"),
    [
        ({"day_of_week_for_start_day": "Wednesday"}, (2, 29), "ends on 02-29, which 2017 does not have"),
        ({"begin_year": 2016, "end_year": 2018}, (2, 29), "ends on 02-29, which 2018 does not have"),
        ({"end_year": 2014}, (3, 5), r"ends in 2014, but begins in 2017 \(it has no begin_year\)"),
        ({"begin_year": 2016, "end_year": 2015}, (3, 5), "ends in 2015, but begins in 2016;"),
    ],
)
def test_run_period__of_the_model_with_years_that_cannot_be_is_named(
    years: dict[str, Any], end: tuple[int, int], words: str
) -> None:
    own = {"begin_month": 2, "begin_day_of_month": 1, "end_month": end[0], "end_day_of_month": end[1], **years}
    building = Building("b", {"Building": {"b": {}}, "RunPeriod": {"Winter": own}}, "0", (), "/home/me/mine.idf")
    with pytest.raises(InvalidConfig, match=rf"RunPeriod 'Winter' of /home/me/mine\.idf {words}"):
        building.period(None, None, None)


@pytest.mark.parametrize(("weekday", "year"), [("Monday", 2007), ("UseWeatherFile", 2017), (None, 2017)])
def test_run_period__of_another_start_day_has_the_year_with_that_weekday(weekday: str | None, year: int) -> None:
    own = {"begin_month": 1, "begin_day_of_month": 1, "end_month": 12, "end_day_of_month": 31}
    if weekday:
        own |= {"day_of_week_for_start_day": weekday}
    building = Building("b", {"Building": {"b": {}}, "RunPeriod": {"r": own}}, "0")
    period = building.period(None, None, None)
    assert period.begin == date(year, 1, 1)
    assert weekday != "Monday" or period.begin.strftime("%A") == weekday
    (written,) = for_episode(building, Period(period.begin, period.begin, 4))["RunPeriod"].values()
    assert "day_of_week_for_start_day" not in written  # EnergyPlus has the weekday of the year


# Weather files


def weather(folder: Path, change: Callable[[list[str]], object]) -> Path:
    """Denver's weather with changed lines; lines[8] is the first hour."""
    lines = DENVER.read_text("latin-1").splitlines()
    change(lines)
    path = folder / "changed.epw"
    path.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    return path


def _swap(lines: list[str]) -> None:
    lines[100], lines[101] = lines[101], lines[100]


def _move_hours(lines: list[str]) -> None:
    lines += lines[8 + 77 : 8 + 81]
    del lines[8 + 77 : 8 + 81]


def _with_cell(lines: list[str], index: int, text: str) -> None:
    """Change a cell of the fifth hour of 5 January."""
    cells = lines[108].split(",")
    cells[index] = text
    lines[108] = ",".join(cells)


def _from_hour_0(lines: list[str]) -> None:
    """Count the hours of each day from 0 to 23."""
    for index in range(8, len(lines)):
        year, month, day, hour, rest = lines[index].split(",", 4)
        lines[index] = ",".join((year, month, day, str(int(hour) - 1), rest))


ORDER = {
    "hours from 0 to 23": (_from_hour_0, "line 9: the record is for 01-01, hour 0, expected hour 1 of a day"),
    "hours that are missing": (_move_hours, "line 86: the record is for 01-04, hour 10, expected hour 6 of a day"),
    "two hours in another order": (_swap, "line 101: the record is for 01-04, hour 22, expected hour 21 of a day"),
    "a day in two": (
        lambda lines: lines.__setitem__(8 + 30, lines[8 + 30].replace(",1,2,7,", ",1,3,7,", 1)),
        "line 39: the record is for 01-03, expected 01-02",
    ),
    "a text": (lambda lines: _with_cell(lines, 6, "abc"), "line 109: dry_bulb_temperature is 'abc', expected a number"),
    "a blank": (lambda lines: _with_cell(lines, 13, " "), "line 109: global_horizontal_radiation is '', expected a"),
    "no numbers": (lambda lines: lines.__setitem__(20, "hello"), "line 21: expected year, month, day and hour"),
}


@pytest.mark.parametrize("case", ORDER)
def test_check_records__names_the_line(case: str, tmp_path: Path) -> None:
    change, words = ORDER[case]
    path = weather(tmp_path, change)
    with pytest.raises(InvalidConfig) as caught:
        check_records(read_header(path), path)
    assert str(caught.value).startswith(f"{path}, {words}")


def test_check_records__accepts_a_file_that_ends_with_ctrl_z(tmp_path: Path) -> None:
    path = weather(tmp_path, list)
    path.write_bytes(path.read_bytes() + b"\x1a")
    check_records(read_header(path), path)
    check_complete(read_header(path), path)


def test_check_records__accepts_the_wheel_s_files() -> None:
    check_records(read_header(DENVER), DENVER)
    assert list(missing_values(DENVER, "USA_CO_Denver")) == []


@pytest.mark.process
@pytest.mark.parametrize(
    ("index", "text", "is_read"),
    [(6, "abc", False), (26, " ", False), (28, "", True), (30, "abc", False), (33, "", True), (34, "abc", True)],
)
def test_check_records__refuses_the_cells_at_which_energyplus_ends(
    index: int, text: str, is_read: bool, tmp_path: Path
) -> None:
    path = weather(tmp_path, lambda lines: _with_cell(lines, index, text))
    assert (run(tmp_path / "run", path, date(2017, 1, 5), date(2017, 1, 5)).code == 0) == is_read
    with nullcontext() if is_read else pytest.raises(InvalidConfig, match=r"line 109: .* expected a number"):
        check_records(read_header(path), path)


def test_missing_values__are_counted_by_column(tmp_path: Path) -> None:
    def change(lines: list[str]) -> None:
        for number in (12, 13):
            cells = lines[number].split(",")
            cells[6], cells[9] = "99.9", "999999"
            lines[number] = ",".join(cells)

    (sentence,) = missing_values(weather(tmp_path, change), "mine")
    assert sentence.startswith(
        "mine has missing values: dry_bulb_temperature (2), atmospheric_station_pressure (2); EnergyPlus uses the last"
    )


# In a plan


@pytest.fixture
def model(tmp_path: Path) -> Callable[..., str]:
    from zenostat.models.building.model import read_building
    from zenostat.models.catalog import find_building

    own = read_building(find_building("ref-small-office")).objects

    def write(*left_out: str) -> str:
        path = tmp_path / "mine.epJSON"
        path.write_text(json.dumps({kind: items for kind, items in own.items() if kind not in left_out}))
        return str(path)

    return write


@pytest.mark.process
def test_plan__model_without_design_days_and_weather_without_them_is_refused(
    model: Callable[..., str], tmp_path: Path
) -> None:
    settings = {"building": model("SizingPeriod:DesignDay"), "begin": "07-01", "end": "07-01"}
    bare = weather(tmp_path, lambda lines: lines.__setitem__(1, "DESIGN CONDITIONS,0"))
    with pytest.raises(InvalidConfig, match=r"mine\.epJSON requests sizing .* has no design days .* has none either"):
        plan(read_config({**settings, "weather": str(bare)}))
    with pytest.raises(InvalidConfig, match=r"has no design days .* the scenario has sizing: model"):
        plan(read_config({**settings, "weather": "USA_CO_Denver", "sizing": "model"}))


@pytest.mark.process
def test_plan__edit_of_the_location_needs_the_models_own() -> None:
    settings = {"building": "ref-small-office", "weather": "USA_CO_Denver", "begin": "07-01", "end": "07-01"}
    settings |= {"edits": {"Site:Location": {"*": {"latitude": 10.0}}}}
    with pytest.raises(InvalidConfig, match="Site:Location '\\*' has no effect"):
        plan(read_config(settings))
    own = plan(read_config({**settings, "sizing": "model"})).building.objects["Site:Location"]
    assert [place["latitude"] for place in own.values()] == [10.0]


@pytest.mark.process
def test_plan__weather_file_in_which_an_hour_is_missing_is_refused(tmp_path: Path) -> None:
    path = weather(tmp_path, _move_hours)
    with pytest.raises(InvalidConfig, match=r"changed\.epw, line 86: the record is for 01-04, hour 10"):
        plan(read_config({"building": "ref-small-office", "weather": str(path), "begin": "07-01", "end": "07-01"}))


@pytest.mark.process
def test_plan__values_beforehand_of_a_run_period_that_is_refused_are_no_second_error() -> None:
    settings = {"building": "ref-small-office", "weather": "USA_CO_Denver", "begin": "2016-12-30", "end": "2017-01-03"}
    with pytest.raises(InvalidConfig) as caught:
        plan(read_config({**settings, "relative": 2.0}))
    assert str(caught.value).startswith("the run period 2016-12-30 to 2017-01-03 goes over New Year from a leap year")
    assert "\n" not in str(caught.value)
