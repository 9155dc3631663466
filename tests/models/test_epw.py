"""Weather files: what the header says, what is refused, and that the rest of a file stays byte for byte."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from support.weather_files import STEPS_PER_HOUR, run

from zenostat.models.catalog import find_weather, weathers
from zenostat.models.run_period import Period
from zenostat.models.weather.epw import COLUMNS, find_column, read, write
from zenostat.models.weather.fixed_width import FixedWidthWeather
from zenostat.models.weather.header import DesignConditions, Header, check_complete, check_covers, read_header
from zenostat.models.weather.noise import ColumnNoise, with_noise
from zenostat.models.weather.records import check_records
from zenostat.topics.errors import InvalidConfig, UnknownName

DENVER = find_weather("USA_CO_Denver").path
YEAR = 8760


def lines_of(path: Path) -> list[str]:
    return path.read_bytes().decode("latin-1").split("\n")


def edited(folder: Path, change: Callable[[list[str]], list[str]]) -> Path:
    """Denver's file with its lines changed; the last line of the list is the empty one after the last line end."""
    path = folder / "edited.epw"
    path.write_bytes("\n".join(change(lines_of(DENVER))).encode("latin-1"))
    return path


def with_leap_day(lines: list[str], observed: str) -> list[str]:
    """29 February is 28 February again; 8 header lines, 31 + 28 days before."""
    at = 8 + (31 + 28) * 24
    extra = [",".join([*r.split(",")[:1], "2", "29", *r.split(",")[3:]]) for r in lines[at - 24 : at]]
    lines = lines[:at] + extra + lines[at:]
    lines[4] = f"HOLIDAYS/DAYLIGHT SAVINGS,{observed},0,0,0"
    return lines


# The header


def test_epw__header_states_place_days_and_design_conditions() -> None:
    # Read off the file by hand; the design conditions are those of ASHRAE for Buckley.
    header = read_header(DENVER)
    assert header.place == "Denver-Aurora-Buckley AFB, CO, USA"
    assert (header.latitude_deg, header.longitude_deg, header.time_zone_h, header.elevation_m) == (
        39.72,
        -104.75,
        -7.0,
        1726.0,
    )
    assert (header.first, header.last, header.leap, header.records_per_hour) == ((1, 1), (12, 31), False, 1)
    assert header.design == DesignConditions(
        heating_month=12,
        heating_dry_bulb_c=-17.9,
        heating_wind_m_s=2.5,
        heating_wind_deg=180.0,
        cooling_month=7,
        cooling_range_k=14.8,
        cooling_dry_bulb_c=33.9,
        cooling_wet_bulb_c=15.0,
        cooling_wind_m_s=3.6,
        cooling_wind_deg=30.0,
    )


def test_epw__header_without_design_conditions_has_none() -> None:
    assert read_header(find_weather("USA_CO_Boulder").path).design is None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (",Heating,12,-17.9,", ",Heating,13,-17.9,"),  # no such month
        (",Heating,12,-17.9,", ",Heating,12,-179,"),
        (",Heating,12,-17.9,", ",Heating,-17.9,"),  # a form that is shifted by one
        (",Cooling,7,14.8,33.9,15,", ",Cooling,7,14.8,33.9,35,"),  # wet bulb above dry bulb
        (",Cooling,7,14.8,33.9,15,", ",Cooling,7,14.8,n/a,15,"),
        (",Cooling,", ",Elsewhere,"),
    ],
)
def test_epw__design_conditions_that_cannot_be_are_none(folder: Path, old: str, new: str) -> None:
    def change(lines: list[str]) -> list[str]:
        assert old in lines[1]
        return [lines[0], lines[1].replace(old, new), *lines[2:]]

    header = read_header(edited(folder, change))
    assert header.design is None
    assert header.elevation_m == 1726.0  # the rest of the header holds


def test_epw__file_that_is_no_epw_is_refused(folder: Path) -> None:
    path = folder / "no.epw"
    path.write_text("Version,25.2;\n")
    for reader in (read_header, read):
        with pytest.raises(InvalidConfig, match="should begin with LOCATION"):
            reader(path)


# Columns


@pytest.mark.parametrize(
    "text", ["dry_bulb_temperature", "Dry Bulb Temperature", "DRY-BULB temperature ", "dry_bulb", "DryBulb"]
)
def test_epw__column_is_found_however_it_is_spelled(text: str) -> None:
    assert find_column(text) is COLUMNS["dry_bulb_temperature"]


def test_epw__unknown_column_names_near_ones() -> None:
    with pytest.raises(UnknownName, match=r"no weather column 'wet bulb temperature'.*'dry_bulb_temperature'"):
        find_column("wet bulb temperature")


def test_epw__columns_are_where_the_dictionary_has_them() -> None:
    # Line 21 of the file (1 January, 13:00) by eye, in the order of EnergyPlus's EPW data dictionary.
    weather = read(DENVER)
    assert weather.times[12].tolist() == [2005, 1, 1, 13, 0]
    expected = {
        "dry_bulb_temperature": 4.0,
        "dew_point_temperature": -2.0,
        "relative_humidity": 64,
        "atmospheric_station_pressure": 81600,
        "extraterrestrial_horizontal_radiation": 641,
        "extraterrestrial_direct_normal_radiation": 1415,
        "horizontal_infrared_radiation_intensity": 273,
        "global_horizontal_radiation": 475,
        "direct_normal_radiation": 957,
        "diffuse_horizontal_radiation": 39,
        "global_horizontal_illuminance": 50436,
        "direct_normal_illuminance": 92505,
        "diffuse_horizontal_illuminance": 8363,
        "zenith_luminance": 1115,
        "wind_direction": 20,
        "wind_speed": 3.6,
        "total_sky_cover": 3,
        "opaque_sky_cover": 3,
        "visibility": 112.7,
        "ceiling_height": 77777,
        "present_weather_observation": 9,
        "precipitable_water": 50,
        "aerosol_optical_depth": 0.0410,
        "snow_depth": 0,
        "days_since_last_snowfall": 88,
        "albedo": 0.220,
        "liquid_precipitation_depth": 999.0,
        "liquid_precipitation_quantity": 99.0,
    }
    assert {name: weather.column(name)[12] for name in COLUMNS} == expected
    assert weather.column("wind_speed").shape == (len(weather),) == (YEAR,)


def test_epw__column_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        read(DENVER).column("wind_speed")[0] = 1.0


# Reading and writing


@pytest.mark.parametrize("name", ["USA_CO_Denver", "USA_FL_Miami", "USA_IL_Chicago"])
def test_epw__file_returns_byte_for_byte_where_nothing_changed(folder: Path, name: str) -> None:
    source = find_weather(name).path
    weather = read(source)
    write(weather, folder / "none.epw", {})
    write(weather, folder / "same.epw", {name: weather.column(name) for name in COLUMNS})
    assert (folder / "none.epw").read_bytes() == (folder / "same.epw").read_bytes() == source.read_bytes()


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("tail", ["", "x", "x x ", "x\x1a"])
def test_epw__line_ends_and_what_follows_the_last_row_are_kept(folder: Path, end: str, tail: str) -> None:
    # As it came, with one line end after the last row, and with blank lines after it.
    text = end.join(lines_of(DENVER)[:-1]) + tail.replace("x", end)
    path = folder / "ends.epw"
    path.write_bytes(text.encode("latin-1"))
    weather = read(path)
    write(weather, folder / "out.epw", {"liquid_precipitation_quantity": weather.column("rh") + 0.5})
    lines = (folder / "out.epw").read_bytes().decode("latin-1").split(end)
    assert len(lines) == len(text.split(end))
    assert all(row.endswith(f",{h + 0.5:.4f}") for row, h in zip(lines[8:], weather.column("rh"), strict=False))
    assert [row.rpartition(",")[0] for row in lines[8 : 8 + YEAR]] == [r.rpartition(",")[0] for r in weather.rows]


def test_epw__file_with_line_ends_of_both_kinds_is_read(folder: Path) -> None:
    lines = [line.rstrip("\r") for line in lines_of(DENVER)]
    path = folder / "mixed.epw"
    path.write_bytes("\r\n".join([*lines[:100], "\n".join(lines[100:])]).encode("latin-1"))
    weather = read(path)
    assert np.array_equal(weather.table, read(DENVER).table)
    write(weather, folder / "out.epw", {})
    assert (folder / "out.epw").read_bytes() == path.read_bytes()
    FixedWidthWeather(weather).write(folder / "padded.epw", {})
    assert np.array_equal(read(folder / "padded.epw").table, weather.table)


def test_epw__only_the_columns_that_were_given_change(folder: Path) -> None:
    weather = read(DENVER)
    dry, wind = weather.column("dry_bulb") + np.linspace(0.1, 1.0, YEAR), weather.column("wind_speed").copy()
    wind[100] += 0.12345
    write(weather, folder / "out.epw", {"Dry Bulb Temperature": dry, "wind_speed": wind})
    written = read(folder / "out.epw")
    assert np.abs(written.column("dry_bulb") - dry).max() <= 0.00005 + 1e-9  # four decimals
    assert np.abs(written.column("wind_speed") - wind).max() <= 0.00005 + 1e-9
    assert written.head == weather.head
    for k, (before, after) in enumerate(zip(weather.rows, written.rows, strict=True)):
        differ = [i for i, (a, b) in enumerate(zip(before.split(","), after.split(","), strict=True)) if a != b]
        assert differ == ([6, 21] if k == 100 else [6])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros(24), r"shape \(8760,\), got \(24,\)"),
        (np.full(YEAR, np.nan), "row 0 is not finite"),
        (np.r_[np.zeros(YEAR - 1), np.inf], "row 8759 is not finite"),
    ],
)
def test_epw__values_that_cannot_be_written_are_refused(folder: Path, values: np.ndarray, words: str) -> None:
    with pytest.raises(InvalidConfig, match=f"wind_speed: .*{words}"):
        write(read(DENVER), folder / "out.epw", {"wind_speed": values})
    assert not (folder / "out.epw").exists()


def shortened(lines: list[str], width: int) -> list[str]:
    return [*lines[:8], *(",".join(row.split(",")[:width]) for row in lines[8:])]


@pytest.mark.parametrize("width", [32, 33, 34])
def test_epw__lines_without_the_last_cells_are_read_as_energyplus_does(folder: Path, width: int) -> None:
    path, whole = edited(folder, lambda lines: shortened(lines, width)), read(DENVER)
    weather = read(path)
    assert weather.width == width
    for name, column in COLUMNS.items():
        expected = whole.column(name) if column.index < width else column.missing
        assert (weather.column(name) == expected).all()
    write(weather, folder / "same.epw", {name: weather.column(name) for name in COLUMNS})
    assert (folder / "same.epw").read_bytes() == path.read_bytes()
    noisy = with_noise(weather, {"temperature": ColumnNoise(sigma=2.0)}, np.random.default_rng(0)).columns
    write(weather, folder / "noisy.epw", noisy)
    padded = FixedWidthWeather(weather)
    padded.write(folder / "padded.epw", noisy)
    assert np.array_equal(read(folder / "padded.epw").table, read(folder / "noisy.epw").table)
    last = {"liquid_precipitation_quantity": np.zeros(YEAR)}
    words = f"no column liquid_precipitation_quantity: its lines have {width} of"
    with pytest.raises(InvalidConfig, match=words):
        write(weather, folder / "no.epw", last)
    with pytest.raises(InvalidConfig, match=words):
        padded.write(folder / "no.epw", last)
    assert not (folder / "no.epw").exists()


def test_epw__short_lines_give_the_same_simulation_padded_and_not(folder: Path) -> None:
    short = edited(folder, lambda lines: shortened(lines, 32))
    FixedWidthWeather(read(short)).write(folder / "padded.epw", {})
    runs = []
    for name, path in (("whole", DENVER), ("short", short), ("padded", folder / "padded.epw")):
        (folder / name).mkdir()
        runs.append(run(folder / name, path, date(2017, 7, 3), date(2017, 7, 4)).values[0])
    assert np.array_equal(runs[1], runs[2])
    assert np.array_equal(runs[0], runs[1])  # of the dry bulb


# Files that are not sound


def cut_at_row(rows: int) -> Callable[[list[str]], list[str]]:
    return lambda lines: [*lines[: 8 + rows], ""]


def cell(line: int, index: int, text: str) -> Callable[[list[str]], list[str]]:
    def change(lines: list[str]) -> list[str]:
        cells = lines[line - 1].split(",")
        cells[index] = text
        return [*lines[: line - 1], ",".join(cells), *lines[line:]]

    return change


@pytest.mark.variants
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (cut_at_row(0), r"there are 0 rows, DATA PERIODS requires 8760 \(1/ 1 to 12/31, 1 per hour\)"),
        (cut_at_row(31 * 24), r"there are 744 rows, .*8760 .*; the last, line 752, is for 1/31"),
        (cut_at_row(YEAR - 1), "there are 8759 rows, .*line 8767, is for 12/31"),
        (lambda lines: [*lines[:-1], lines[-2], ""], "there are 8761 rows"),
        (lambda lines: [*lines[:-2], lines[-2][:80]], r"line 8768 has \d+ cells, expected 35"),
        (lambda lines: [*lines[:9], lines[9] + ",0", *lines[10:]], "line 10 has 36 cells, expected 35"),
        (lambda lines: shortened(lines, 31), "line 9 has 31 cells, expected 35"),
        (lambda lines: [*lines[:9], *shortened(lines, 32)[9:]], "line 10 has 32 cells, expected 35"),
        (lambda lines: [*shortened(lines, 32)[:9], *lines[9:]], "line 10 has 35 cells, expected 32"),
        (cell(1000, 6, "warm"), "line 1000: dry_bulb_temperature is 'warm', expected a number"),
        (cell(1000, 34, ""), "line 1000: liquid_precipitation_quantity is '', expected a number"),
        (cell(9, 8, "nan"), "line 9: relative_humidity is 'nan'"),
        (cell(9, 8, "inf"), "line 9: relative_humidity is 'inf'"),
        (cell(20, 1, "x"), "line 20: month is 'x'"),
        (
            lambda lines: [*lines[:100], *lines[101:200], lines[199], *lines[200:]],  # one away, one twice
            r"line 104 is for 1/5, expected 1/4",
        ),
        (lambda lines: [*lines[:4], "HOLIDAYS/DAYLIGHT SAVINGS,Yes,0,0,0", *lines[5:]],
         r"there are 8760 rows, DATA PERIODS requires 8784 .*with 29 February"),
    ],
)  # fmt: skip
def test_epw__file_that_is_not_sound_is_refused_with_the_line(
    folder: Path, change: Callable[[list[str]], list[str]], words: str
) -> None:
    with pytest.raises(InvalidConfig, match=words) as raised:
        read(edited(folder, change))
    assert "edited.epw" in str(raised.value)


def test_epw__all_faults_are_in_one_report_that_stays_short(folder: Path) -> None:
    def change(lines: list[str]) -> list[str]:
        lines = [*lines[:300], ""]
        for line in range(20, 30):
            lines = cell(line, 7, "?")(lines)
        return lines

    with pytest.raises(InvalidConfig) as raised:
        read(edited(folder, change))
    first, *faults = str(raised.value).splitlines()
    assert "edited.epw" in first
    assert "there are 292 rows" in faults[0]
    assert [f"line {n}: dew_point_temperature" in f for n, f in zip(range(20, 24), faults[1:5], strict=True)] == [
        True
    ] * 4
    assert faults[5].strip() == "and 6 more"  # 11 faults, 5 told
    assert len(faults) == 6


@pytest.mark.parametrize(
    ("per_hour", "timesteps", "is_read"), [(1, 6, True), (4, 4, True), (4, 2, False), (4, 12, False)]
)
def test_epw__file_of_parts_of_hours_needs_as_many_timesteps(per_hour: int, timesteps: int, is_read: bool) -> None:
    header, day = replace(read_header(DENVER), records_per_hour=per_hour), date(2017, 7, 3)
    if is_read:
        check_covers(header, Period(day, day, timesteps), "x")
        return
    with pytest.raises(InvalidConfig, match=f"has 4 records per hour, .*: set steps_per_hour to 4, not {timesteps}"):
        check_covers(header, Period(day, day, timesteps), "x")


@pytest.mark.parametrize("observed", ["Yes", "No"])
def test_epw__file_with_29_february_is_read(folder: Path, observed: str) -> None:
    # Where the header denies the day, EnergyPlus skips it.
    weather = read(edited(folder, lambda lines: with_leap_day(lines, observed)))
    assert len(weather) == YEAR + 24
    assert weather.header.leap == (observed == "Yes")


@pytest.mark.parametrize("days", ["1/ 1/2016,12/31/2016", "1/1/2017,12/31/2017"])
def test_epw__data_periods_may_have_years(folder: Path, days: str) -> None:
    # A leap year whose 29 February the header denies has 365 days.
    weather = read(edited(folder, lambda lines: [*lines[:7], f"DATA PERIODS,1,1,Data,Friday,{days}", *lines[8:]]))
    assert (weather.header.first, weather.header.last) == ((1, 1), (12, 31))


def test_epw__data_may_go_from_autumn_to_spring(folder: Path) -> None:
    def change(lines: list[str]) -> list[str]:
        winter, autumn = lines[8 : 8 + 90 * 24], lines[8 + 273 * 24 : -1]  # to 31 March, from 1 October
        return [*lines[:7], "DATA PERIODS,1,1,Data,Sunday,10/1,3/31", *autumn, *winter, ""]

    assert len(read(edited(folder, change))) == (92 + 90) * 24


def test_epw__half_hours_are_read(folder: Path) -> None:
    def change(lines: list[str]) -> list[str]:
        lines[7] = lines[7].replace("DATA PERIODS,1,1,", "DATA PERIODS,1,2,")
        return lines[:8] + [row for row in lines[8:-1] for _ in range(2)] + [""]

    weather = read(edited(folder, change))
    assert (len(weather), weather.record_h) == (2 * YEAR, 0.5)


# Which run periods a file covers

FULL = Header("", 0.0, 0.0, 0.0, 0.0, first=(1, 1), last=(12, 31))
LEAP = Header("", 0.0, 0.0, 0.0, 0.0, first=(1, 1), last=(12, 31), leap=True)
PART = Header("", 0.0, 0.0, 0.0, 0.0, first=(2, 1), last=(9, 30))


@pytest.mark.parametrize(
    ("header", "begin", "end"),
    [
        (FULL, date(2017, 12, 30), date(2018, 1, 2)),
        (FULL, date(2017, 7, 1), date(2019, 6, 30)),
        (FULL, date(2017, 3, 1), date(2020, 2, 28)),
        (FULL, date(2015, 12, 30), date(2016, 1, 3)),
        (LEAP, date(2016, 2, 27), date(2017, 1, 3)),
        (FULL, date(2016, 1, 1), date(2016, 2, 28)),
        (LEAP, date(2016, 2, 29), date(2016, 2, 29)),
        (LEAP, date(2015, 1, 1), date(2017, 12, 31)),
        (LEAP, date(2017, 2, 28), date(2017, 3, 1)),
        (PART, date(2016, 3, 1), date(2016, 9, 30)),
    ],
)
def test_epw__run_period_that_the_file_has_is_taken(header: Header, begin: date, end: date) -> None:
    check_covers(header, Period(begin, end, 4), "x")


@pytest.mark.parametrize(
    ("header", "begin", "end", "words"),
    [
        (PART, date(2017, 9, 1), date(2018, 3, 1), "crosses a year boundary .* whole year; x covers 02-01 to 09-30"),
        (PART, date(2017, 9, 1), date(2017, 10, 1), "ends on 10-01, outside .* x, which covers 02-01 to 09-30"),
        (FULL, date(2016, 2, 27), date(2016, 3, 2), "2016-02-29, .*2017.* by 2016-02-28, or begin on 2016-03-01"),
        (FULL, date(2016, 2, 29), date(2016, 3, 2), "contains 2016-02-29"),
        (FULL, date(2016, 2, 27), date(2016, 2, 29), "contains 2016-02-29"),
        (FULL, date(2015, 12, 1), date(2017, 1, 31), "contains 2016-02-29"),
        (PART, date(2016, 2, 2), date(2016, 9, 30), "contains 2016-02-29"),
        (FULL, date(2016, 12, 30), date(2017, 1, 3), "over New Year from a leap year .* such as 2017 .* by 2016-12-31"),
        (LEAP, date(2016, 2, 28), date(2017, 1, 3), "over New Year from a leap year"),
    ],
)  # fmt: skip
def test_epw__run_period_that_the_file_has_not_is_refused(header: Header, begin: date, end: date, words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        check_covers(header, Period(begin, end, 4), "x")


SUMMER_TO_SUMMER = Header("", 0.0, 0.0, 0.0, 0.0, first=(7, 1), last=(6, 30))
WINTER = Header("", 0.0, 0.0, 0.0, 0.0, first=(10, 1), last=(3, 31))
HALVES = Header("", 0.0, 0.0, 0.0, 0.0, first=(1, 1), last=(6, 30), more=(((7, 1), (12, 31)),))


def in_periods(header: Header, lines: list[str]) -> list[str]:
    """Denver's rows in the days of a header."""
    rows = lines[8:-1]
    ordered = [row for period in header.periods for row in _of_days(rows, *period)]
    dates = ",".join(f"Data,Sunday,{a}/{b},{c}/{d}" for (a, b), (c, d) in header.periods)
    return [*lines[:7], f"DATA PERIODS,{len(header.periods)},1,{dates}", *ordered, ""]


def _of_days(rows: list[str], first: tuple[int, int], last: tuple[int, int]) -> list[str]:
    days = [tuple(map(int, row.split(",")[1:3])) for row in rows]
    begin, end = days.index(first), len(days) - days[::-1].index(last)
    return rows[begin:end] if begin < end else rows[begin:] + rows[:end]


@pytest.mark.parametrize(
    ("header", "begin", "end", "is_covered"),
    [
        (SUMMER_TO_SUMMER, date(2017, 7, 3), date(2017, 7, 4), True),
        (SUMMER_TO_SUMMER, date(2018, 1, 3), date(2018, 1, 4), True),
        (SUMMER_TO_SUMMER, date(2017, 12, 30), date(2018, 1, 2), True),
        (SUMMER_TO_SUMMER, date(2017, 6, 28), date(2017, 7, 3), True),
        (WINTER, date(2017, 12, 30), date(2018, 1, 2), True),
        (WINTER, date(2018, 1, 3), date(2018, 1, 4), True),
        (WINTER, date(2018, 3, 30), date(2018, 4, 2), False),
        (WINTER, date(2018, 3, 30), date(2018, 10, 3), False),
        (WINTER, date(2018, 6, 1), date(2018, 6, 3), False),
        (HALVES, date(2017, 7, 3), date(2017, 7, 4), True),
        (HALVES, date(2017, 2, 3), date(2017, 6, 30), True),
        (HALVES, date(2017, 6, 29), date(2017, 7, 2), False),
        (HALVES, date(2017, 12, 30), date(2018, 1, 2), False),
    ],
)
def test_check_covers__is_what_energyplus_simulates(
    header: Header, begin: date, end: date, is_covered: bool, folder: Path
) -> None:
    path = edited(folder, lambda lines: in_periods(header, lines))
    own = read_header(path)
    assert own.periods == header.periods
    check_complete(own, path)
    assert run(folder / "run", path, begin, end).code == (0 if is_covered else 1)
    if is_covered:
        check_covers(own, Period(begin, end, 4), "x")
    else:
        with pytest.raises(InvalidConfig, match=r"year boundary|outside the weather file|not within one of the data"):
            check_covers(own, Period(begin, end, 4), "x")


@pytest.mark.parametrize(
    ("line", "column", "value", "words"),
    [
        (8, 2, "0", "line 8: DATA PERIODS has 0 records per hour"),
        (8, 2, "-1", "line 8: DATA PERIODS has -1 records"),
        (8, 2, "7", "which does not divide the hour"),
        (8, 5, "2/30", "line 8: DATA PERIODS has 2/30, which is no day"),
        (8, 6, "13/31", "line 8: DATA PERIODS has 13/31, which is no day"),
        (8, 1, "0", "the header cannot be read"),
        (1, 9, "inf", "line 1: LOCATION has elevation inf, expected -1000 to"),
        (1, 6, "nan", "line 1: LOCATION has latitude nan"),
        (1, 7, "999", "line 1: LOCATION has longitude 999, expected -180 to 180"),
    ],
)
def test_read_header__number_that_cannot_be_is_named_with_its_line(
    line: int, column: int, value: str, words: str, folder: Path
) -> None:
    def change(lines: list[str]) -> list[str]:
        cells = lines[line - 1].split(",")
        return [*lines[: line - 1], ",".join([*cells[:column], value, *cells[column + 1 :]]), *lines[line:]]

    with pytest.raises(InvalidConfig, match=rf"edited\.epw.* {words}"):
        read_header(edited(folder, change))


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_read_header__place_has_its_characters(encoding: str, folder: Path) -> None:
    first, rest = DENVER.read_bytes().split(b"\n", 1)
    cells = ["LOCATION", "Ålesund", "à", "NOR", *first.decode().split(",")[4:]]
    path = folder / "place.epw"
    path.write_bytes(",".join(cells).encode(encoding) + b"\n" + rest)
    header = read_header(path)
    assert header.place == read(path).header.place == "Ålesund, à, NOR"
    check_complete(header, path)
    check_records(header, path)


def test_epw__day_that_its_year_lacks_is_refused(folder: Path) -> None:
    days = "DATA PERIODS,1,1,Data,Sunday,2/29/2017,12/31/2017"
    with pytest.raises(InvalidConfig, match="line 8: DATA PERIODS has a day that its year lacks"):
        read(edited(folder, lambda lines: [*lines[:7], days, *lines[8:]]))


# What EnergyPlus does with them: the reasons for the above


def test_epw__energyplus_goes_on_with_the_files_begin_after_new_year(folder: Path) -> None:
    period = Period(date(2017, 12, 30), date(2018, 1, 2), STEPS_PER_HOUR)
    ran = run(folder, DENVER, period.begin, period.end)
    assert ran.code == 0
    (days,), (values,) = ran.days, ran.values
    assert days == [(12, 30, "Saturday"), (12, 31, "Sunday"), (1, 1, "Monday"), (1, 2, "Tuesday")]
    assert len(values) == period.steps == 4 * 24 * 4
    dry = read(DENVER).column("dry_bulb")
    assert np.array_equal(values[STEPS_PER_HOUR - 1 :: STEPS_PER_HOUR, 0], np.r_[dry[-48:], dry[:48]])


def test_epw__energyplus_leaves_29_february_out_where_the_file_has_none(folder: Path) -> None:
    ran = run(folder, DENVER, date(2016, 2, 28), date(2016, 3, 2))
    assert ran.code == 0
    assert ran.days == [[(2, 28, "Sunday"), (3, 1, "Monday"), (3, 2, "Tuesday")]]  # 1 March 2016 was a Tuesday
    assert "** Warning **" not in ran.errors


def test_epw__energyplus_gives_up_on_a_run_period_that_begins_on_29_february_where_the_file_has_none(
    folder: Path,
) -> None:
    ran = run(folder, DENVER, date(2016, 2, 29), date(2016, 3, 2))
    assert ran.code == 1
    assert "searching for first day 2/29" in ran.errors


def test_epw__energyplus_has_29_february_where_the_file_has_it(folder: Path) -> None:
    path = edited(folder, lambda lines: with_leap_day(lines, "Yes"))
    ran = run(folder / "run", path, date(2016, 2, 28), date(2016, 3, 1))
    assert ran.days == [[(2, 28, "Sunday"), (2, 29, "Monday"), (3, 1, "Tuesday")]]


@pytest.mark.parametrize(
    ("begin", "end", "missing"),
    [
        (date(2016, 2, 27), date(2017, 1, 2), 0),
        (date(2016, 2, 28), date(2017, 1, 2), 1),
        (date(2016, 12, 31), date(2017, 1, 1), 1),
        (date(2015, 12, 31), date(2016, 1, 1), 0),
    ],
)
def test_epw__energyplus_leaves_out_a_day_after_new_year_from_a_leap_year(
    begin: date, end: date, missing: int, folder: Path
) -> None:
    path = edited(folder, lambda lines: with_leap_day(lines, "Yes"))
    (days,) = run(folder / "run", path, begin, end).days
    assert (end - begin).days + 1 - len(days) == missing
    with pytest.raises(InvalidConfig, match="leaves out its last day") if missing else nullcontext():
        check_covers(read_header(path), Period(begin, end, STEPS_PER_HOUR), path.name)


@pytest.mark.slow
def test_epw__each_file_of_the_wheel_is_sound() -> None:
    assert {len(read(entry.path)) for entry in weathers()} == {YEAR}
