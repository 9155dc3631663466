"""Weather summaries: climate zone, years and means, against hand-made files and the bundled ones."""

from pathlib import Path

import numpy as np
import pytest

from zenostat.models import catalog
from zenostat.models.weather.summary import climate_zone, weather_summary
from zenostat.topics.errors import InvalidConfig


def epw(path: Path, temperature: np.ndarray, *, years: tuple[int, ...] = (2019,), humidity: float = 50.0) -> Path:
    """An EPW of `temperature` (degC), a row a day of 24 hours; `years`: of its days, in turn."""
    header = ["LOCATION,Town,-,LND,Own,000000,10.0,20.0,1.0,300.0", "DESIGN CONDITIONS,0", *["COMMENTS"] * 5]
    header[4] = "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0"
    rows = [
        f"{years[day % len(years)]},1,1,{hour + 1},60,?9?9#,{value},0,{humidity}," + ",".join(["0"] * 26)
        for day, values in enumerate(temperature)
        for hour, value in enumerate(values)
    ]
    path.write_text("\n".join([*header, "DATA PERIODS,1,1,Data,Sunday, 1/ 1,12/31", *rows]) + "\n")
    return path


def constant(temperature_c: float, days: int = 365) -> np.ndarray:
    return np.full((days, 24), temperature_c)


# A year at one temperature has 365 (T - 10) cooling and 365 (18.3 - T) heating degree days: the limits lie
# at 26.44, 23.70 and 19.59 degC, and (heating) at 12.82, 10.08, 7.34, 4.60 and -0.88 degC.
@pytest.mark.parametrize(
    ("temperature_c", "zone"),
    [
        (26.5, "0"), (26.4, "1"), (23.8, "1"), (23.6, "2"), (19.7, "2"), (19.5, "3"), (12.9, "3"), (12.7, "4"),
        (10.2, "4"), (10.0, "5"), (7.4, "5"), (7.2, "6"), (4.7, "6"), (4.5, "7"), (-0.8, "7"), (-1.0, "8"),
    ],
)  # fmt: skip
def test_weather_summary__climate_zone_follows_degree_days(temperature_c: float, zone: str) -> None:
    assert climate_zone(constant(temperature_c)) == zone


def test_weather_summary__degree_days_are_of_daily_means() -> None:
    swing = constant(19.5) + 15.0 * np.sin(np.arange(24) / 24 * 2 * np.pi)
    assert climate_zone(swing) == climate_zone(constant(19.5)) == "3"


def test_weather_summary__two_years_are_judged_as_one_and_a_month_not_at_all() -> None:
    assert climate_zone(constant(10.0, 730)) == climate_zone(constant(10.0))
    assert climate_zone(constant(10.0, 31)) == ""


@pytest.mark.parametrize("entry", catalog.bundled_weathers(), ids=lambda e: e.name)
def test_weather_summary__bundled_weather_has_its_facts(entry: catalog.Entry) -> None:
    summary = weather_summary(entry.path)
    rows = [line.split(",") for line in entry.path.read_text("latin-1").splitlines()[8:]]
    assert summary.mean_temperature_degC == pytest.approx(sum(float(row[6]) for row in rows) / 8760)
    assert summary.mean_humidity_pct == pytest.approx(sum(float(row[8]) for row in rows) / 8760)
    assert summary.years == "typical year"
    assert (summary.first, summary.last) == ((1, 1), (12, 31))
    # Places whose county's zone in the Standard is far from a limit.
    known = {"Denver": "5", "Golden": "5", "Boulder": "5", "Miami": "1", "Orlando": "2", "Tampa": "2", "Chicago": "5"}
    known |= {"San.Francisco": "3", "Fresno": "3", "Sterling": "4"}
    assert summary.climate_zone == known.get(entry.name.split("_")[2], summary.climate_zone)


@pytest.mark.parametrize(
    ("line", "zone"),
    [
        (' - Climate type "5B" (ASHRAE Standard 196-2006 Climate Zone)**', "5B"),
        (' - Climate type "7" (ASHRAE Standards 90.1-2004 and 90.2-2004 Climate Zone)**', "7"),
        (' - Climate Zone "3C" (ASHRAE Standard 169-2021)', "3C"),
        (' - Climate type "BSk" (Köppen classification)**', "0"),  # the file's own
    ],
)
def test_weather_summary__stat_file_beside_names_the_zone(tmp_path: Path, line: str, zone: str) -> None:
    path = epw(tmp_path / "a.epw", constant(30.0))
    (tmp_path / "a.stat").write_text(f"Statistics\n{line}\n", encoding="latin-1")
    assert weather_summary(path).climate_zone == zone


@pytest.mark.parametrize(
    ("years", "text"), [((2019,), "2019"), ((1999, 1987), "typical year"), ((2001, 2005), "typical year")]
)
def test_weather_summary__years_are_those_of_the_rows(tmp_path: Path, years: tuple[int, ...], text: str) -> None:
    assert weather_summary(epw(tmp_path / "a.epw", constant(10.0), years=years)).years == text


def test_weather_summary__missing_value_is_left_out_of_the_mean(tmp_path: Path) -> None:
    temperature = constant(10.0)
    temperature[3, 4:9] = 99.9
    summary = weather_summary(epw(tmp_path / "a.epw", temperature, humidity=999.0 / 3))
    assert summary.mean_temperature_degC == pytest.approx(10.0)
    assert summary.climate_zone == "5"


def test_weather_summary__file_without_a_single_temperature_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"a\.epw has no dry-bulb temperature"):
        weather_summary(epw(tmp_path / "a.epw", constant(99.9)))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("", "0 rows"),
        ("2019,1,1,1,60,?9,10,0,50,0\n", "1 rows, which is not a multiple of 24 rows per day"),
        ("2019,1,1,1,60,?9,warm,0,50,0\n", "cannot be read"),
    ],
)
def test_weather_summary__rows_that_are_no_days_of_numbers_are_refused_with_the_files_name(
    tmp_path: Path, rows: str, words: str
) -> None:
    path = epw(tmp_path / "broken.epw", constant(10.0, 0))
    path.write_text(path.read_text() + rows)
    with pytest.raises(InvalidConfig, match=rf"broken\.epw.*{words}"):
        weather_summary(path)
