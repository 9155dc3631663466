"""Prices and intensities by the clock: tables, series, files, their units and mistakes."""

import csv
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from support.data_packs import sinergym
from support.examples import examples

from zenostat.agent_sdk.time_series import (
    HOURS,
    LEAP_HOURS,
    Constant,
    HourlyFile,
    HourlySeries,
    Intensity,
    Price,
    Signal,
    TimeOfUse,
    grams_per_kwh,
    per_kwh,
)
from zenostat.topics import yaml12
from zenostat.topics.calendar import hour_of_leap_year, in_hours
from zenostat.topics.errors import InvalidConfig

SIGNAL: TypeAdapter[Any] = TypeAdapter(Signal)
YEAR = tuple(float(hour) for hour in range(HOURS))
LEAP_YEAR = tuple(float(hour) for hour in range(LEAP_HOURS))


def written(folder: Path, rows: list[str], name: str = "prices.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def a_year(header: str = "hour;value", hours: int = HOURS) -> list[str]:
    return [header, *(f"{hour};{hour / 4}" for hour in range(hours))]


# The hour of the year


@pytest.mark.parametrize(
    ("year", "moment", "row"),
    [
        (YEAR, datetime(2017, 1, 1, 0, 0), 0),
        (YEAR, datetime(2017, 1, 1, 0, 59), 0),
        (YEAR, datetime(2017, 1, 1, 1, 0), 1),
        (YEAR, datetime(2017, 2, 28, 23), 1415),
        (YEAR, datetime(2017, 3, 1, 0), 1416),
        (YEAR, datetime(2017, 12, 31, 23, 45), 8759),
        (YEAR, datetime(2016, 3, 1, 0), 1416),  # after a leap day the rows are those of other years
        (YEAR, datetime(2016, 2, 29, 5), 1397),  # a leap day is the day before it
        (LEAP_YEAR, datetime(2016, 2, 28, 23), 1415),
        (LEAP_YEAR, datetime(2016, 2, 29, 5), 1421),
        (LEAP_YEAR, datetime(2016, 3, 1, 0), 1440),
        (LEAP_YEAR, datetime(2017, 2, 28, 23), 1415),
        (LEAP_YEAR, datetime(2017, 3, 1, 0), 1440),  # passes over the leap day's rows
        (LEAP_YEAR, datetime(2017, 12, 31, 23), 8783),
    ],
    ids=lambda value: "" if isinstance(value, tuple | list) else str(value),
)
def test_time_series__years_with_and_without_a_leap_day(year: Any, moment: datetime, row: int) -> None:
    assert HourlySeries(hourly=year, unit="EUR/kWh").at(moment) == float(row)


@given(st.datetimes(datetime(1990, 1, 1), datetime(2030, 12, 31)))
def test_time_series__hour_is_that_of_the_calendar(moment: datetime) -> None:
    same = datetime(2000, moment.month, moment.day, moment.hour)
    assert hour_of_leap_year(moment) == (same - datetime(2000, 1, 1)) // timedelta(hours=1)


def test_time_series__several_moments_give_an_array() -> None:
    moments = [datetime(2017, 1, 1, 3), datetime(2017, 1, 2, 0), datetime(2016, 2, 29, 0)]
    for signal in (
        Constant(value=2.0, unit="EUR/kWh"),
        HourlySeries(hourly=YEAR, unit="EUR/kWh"),
        TimeOfUse(table=({"value": 1.0, "hours": (2, 4)},), otherwise=0.5, unit="EUR/kWh"),  # type: ignore[arg-type]
    ):
        values = signal.at(moments)
        assert isinstance(values, np.ndarray)
        assert values.tolist() == [signal.at(moment) for moment in moments]
        assert isinstance(signal.at(moments[0]), float)


@pytest.mark.parametrize("length", [0, 1, 8736, 8761, 8785])
def test_time_series__series_is_a_year(length: int) -> None:
    with pytest.raises(ValidationError, match=f"8760 or 8784 hours expected, got {length}"):
        HourlySeries(hourly=(1.0,) * length, unit="EUR/kWh")


# Tables

WORKDAYS = ["mon", "tue", "wed", "thu", "fri"]
TABLE = TimeOfUse.model_validate(
    {
        "table": [{"value": 9.0, "hours": [12, 14], "months": [7, 8]},
            {"value": 3.0, "hours": [8, 20], "weekdays": WORKDAYS}, {"value": 0.5, "hours": [22, 6]}],
        "otherwise": 1.0,
        "unit": "EUR/kWh",
    }
)  # fmt: skip


@pytest.mark.parametrize(
    ("moment", "value"),
    [
        (datetime(2017, 1, 2, 7, 45), 1.0),  # a Monday
        (datetime(2017, 1, 2, 8, 0), 3.0),
        (datetime(2017, 1, 2, 19, 45), 3.0),
        (datetime(2017, 1, 2, 20, 0), 1.0),
        (datetime(2017, 1, 1, 12, 0), 1.0),  # a Sunday
        (datetime(2017, 7, 3, 12, 0), 9.0),  # the first that holds
        (datetime(2017, 7, 2, 13, 45), 9.0),
        (datetime(2017, 7, 3, 14, 0), 3.0),
        (datetime(2017, 1, 1, 21, 45), 1.0),
        (datetime(2017, 1, 1, 22, 0), 0.5),
        (datetime(2017, 1, 2, 0, 0), 0.5),
        (datetime(2017, 1, 2, 5, 45), 0.5),
        (datetime(2017, 1, 2, 6, 0), 1.0),
    ],
)
def test_time_series__first_period_that_holds(moment: datetime, value: float) -> None:
    assert TABLE.at(moment) == value


@given(st.integers(0, 23), st.integers(0, 24))
def test_time_series__span_of_hours_and_its_other_half_are_a_day(first: int, end: int) -> None:
    if first == end or (first, end) == (0, 24):
        return
    inside = [hour for hour in range(24) if in_hours((first, end), hour)]
    assert first in inside
    assert end % 24 not in inside or end % 24 == first
    assert len(inside) == (end - first) % 24


@pytest.mark.parametrize(
    "wrong",
    [
        {"hours": [8, 8]}, {"hours": [24, 2]}, {"hours": [8, 25]}, {"hours": [8]}, {"weekdays": ["monday"]},
        {"weekdays": []}, {"months": [0]}, {"months": [13]}, {"months": []}, {"value": "1"}, {"price": 1},
    ],
    ids=str,
)  # fmt: skip
def test_time_series__period_that_cannot_be(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        SIGNAL.validate_python({"table": [{"value": 1.0} | wrong], "otherwise": 1.0, "unit": "EUR/kWh"})


# Files


def test_time_series__column_of_a_file(tmp_path: Path) -> None:
    path = written(tmp_path, a_year())
    for column in ("value", 2):
        signal = HourlyFile(csv=path, column=column, unit="EUR/MWh", delimiter=";")
        assert signal.at(datetime(2017, 1, 1, 7, 30)) == 1.75
        assert signal.at(datetime(2017, 12, 31, 23)) == 8759 / 4
        assert signal.at(datetime(2016, 2, 29, 1)) == signal.at(datetime(2016, 2, 28, 1)) == (57 * 24 + 25) / 4


def test_time_series__header_may_stand_further_down_or_not_at_all(tmp_path: Path) -> None:
    above = written(tmp_path, ["prices of 2023", "", *a_year()], "above.csv")
    signal = HourlyFile(csv=above, column="value", unit="EUR/MWh", delimiter=";", header_row=3)
    assert signal.at(datetime(2017, 1, 1, 1)) == 0.25
    bare = written(tmp_path, a_year()[1:], "bare.csv")
    signal = HourlyFile(csv=bare, column=2, unit="EUR/MWh", delimiter=";", header_row=0)
    assert signal.at(datetime(2017, 1, 1, 1)) == 0.25


def test_time_series__commas_in_numbers_marks_at_the_beginning_and_leap_years(tmp_path: Path) -> None:
    path = tmp_path / "comma.csv"
    rows = [row.replace(".", ",") for row in a_year("value;hour", LEAP_HOURS)]
    path.write_text("\n".join(rows), encoding="utf-8-sig")
    signal = HourlyFile(csv=path, column="hour", unit="EUR/MWh", delimiter=";", decimal=",")
    assert signal.at(datetime(2016, 2, 29, 1)) == (59 * 24 + 1) / 4
    assert HourlyFile(csv=path, column="value", unit="EUR/MWh", delimiter=";", decimal=",").at(
        datetime(2017, 1, 1, 9)
    ) == 9.0  # fmt: skip


def test_time_series__packs_prices() -> None:
    path = sinergym() / "sinergym/data/energy_cost/PVPC_active_energy_billing_Iberian_Peninsula_2023.csv"
    signal = HourlyFile(csv=path, column="value", unit="EUR/MWh", delimiter=";")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    assert signal.at(datetime(2017, 1, 1, 0)) == 41.45
    assert signal.at(datetime(1991, 1, 1, 2, 45)) == 58.07
    assert signal.at(datetime(2017, 12, 31, 23)) == 105.23
    hours = [datetime(2023, 1, 1) + timedelta(hours=k) for k in range(HOURS)]
    assert signal.at(hours).tolist() == [float(row["value"]) for row in rows]


def broken(rows: list[str], **lines: str) -> list[str]:
    return [lines.get(f"line{number}", row) for number, row in enumerate(rows, 1)]


FILES: dict[str, tuple[list[str], dict[str, Any], str]] = {
    "no such column": (a_year(), {"column": "valu"}, "column 'valu' is missing in line 1.*did you mean 'value'"),
    "other delimiter": (a_year(), {"delimiter": ","}, "is missing in line 1, with ',' between"),
    "column twice": (a_year("value;value"), {}, "is not unique"),
    "no header there": (a_year(), {"header_row": 9000}, "is missing in line 9000"),
    "too short": (a_year(hours=8759), {}, "a year has 8760 hours, or 8784 with 29 February; the file has 8759"),
    "only a header": (a_year(hours=0), {}, "the file has 0"),
    "empty": ([""], {}, "'value' is missing"),
    "no number": (broken(a_year(), line5="3;n/a"), {}, "column 'value' has no number in line 5$"),
    "nan and infinity": (broken(a_year(), line7="5;nan", line9="7;inf"), {}, "no number in line 7, 9$"),
    "a short row": (broken(a_year(), line3="1"), {}, "no number in line 3$"),
    "no such number of a column": (a_year(), {"column": 3}, "3 has no number in line 2, 3, 4, 5, 6 and 8755 more"),
    "commas": ([row.replace(".", ",") for row in a_year()], {}, "no number in line 2, 3, 4, 5, 6 and 8755 more"),
}  # fmt: skip


@pytest.mark.parametrize(("rows", "how", "words"), FILES.values(), ids=FILES)
def test_time_series__file_that_is_no_year_of_numbers(
    tmp_path: Path, rows: list[str], how: dict[str, Any], words: str
) -> None:
    path = written(tmp_path, rows)
    signal = HourlyFile.model_validate({"csv": path, "column": "value", "unit": "EUR/MWh", "delimiter": ";"} | how)
    with pytest.raises(InvalidConfig, match=words) as raised:
        signal.load()
    assert str(path) in str(raised.value)


def test_time_series__file_that_cannot_be_read(tmp_path: Path) -> None:
    latin = tmp_path / "latin.csv"
    latin.write_bytes("hour;value\n0;Término\n".encode("latin-1"))
    errors = {
        tmp_path / "none.csv": "^there is no file .*/none.csv$",
        tmp_path: f"^{tmp_path} is a folder; expected a file$",
        latin: "^cannot read .*/latin.csv: 'utf-8' codec can't decode byte",
        Path("~nobody_of_that_name/x.csv"): "^cannot read .*x.csv: Could not determine home directory",
    }
    for path, text in errors.items():
        with pytest.raises(InvalidConfig, match=text):
            HourlyFile(csv=path, column="value", unit="EUR/MWh").load()


@pytest.mark.parametrize(
    "wrong",
    [{"delimiter": ";;"}, {"delimiter": ""}, {"column": 0}, {"column": ""}, {"header_row": -1}, {"decimal": ";"},
     {"unit": ""}, {"sheet": 1}],
    ids=str,
)  # fmt: skip
def test_time_series__file_that_cannot_be(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        SIGNAL.validate_python({"csv": "x.csv", "column": "value", "unit": "EUR/MWh"} | wrong)


def test_time_series__what_does_not_fit_together() -> None:
    with pytest.raises(ValidationError, match="cannot be both the delimiter"):
        HourlyFile(csv=Path("x"), column="a", unit="EUR/MWh", decimal=",")
    with pytest.raises(ValidationError, match="the column is a number"):
        HourlyFile(csv=Path("x"), column="a", unit="EUR/MWh", header_row=0)


# Forms and units


@pytest.mark.parametrize("wrong", [0.25, "0.25", None, [], {}, {"unit": "EUR/kWh"}, {"values": 1}], ids=str)
def test_time_series__what_is_no_signal(wrong: Any) -> None:
    with pytest.raises(ValidationError, match=r"a time series expected: \{value: 0\.25, unit: EUR/kWh\}"):
        SIGNAL.validate_python(wrong)


numbers = st.floats(-1e6, 1e6)
units = st.sampled_from(["EUR/kWh", "ct/kWh", "EUR/MWh"])
periods = st.fixed_dictionaries(
    {"value": numbers},
    optional={
        "hours": st.sampled_from([[0, 24], [8, 20], [22, 6]]),
        "weekdays": st.lists(st.sampled_from(WORKDAYS), min_size=1, max_size=3),
        "months": st.lists(st.integers(1, 12), min_size=1, max_size=3),
    },
)
signals = st.one_of(
    st.builds(lambda value, unit: {"value": value, "unit": unit}, numbers, units),
    st.fixed_dictionaries({"table": st.lists(periods, min_size=1, max_size=3), "otherwise": numbers, "unit": units}),
    st.builds(lambda value, unit: {"hourly": [value] * HOURS, "unit": unit}, numbers, units),
    st.fixed_dictionaries(
        {"csv": st.sampled_from(["/a.csv", "/b c/d.csv"]), "column": st.integers(1, 9), "unit": units},
        optional={"delimiter": st.just(";"), "decimal": st.just("."), "header_row": st.integers(0, 3)},
    ),
)


@pytest.mark.slow
@settings(max_examples=examples(60), deadline=None)
@given(signals)
def test_time_series__signal_that_was_written_is_read_back(fields: dict[str, Any]) -> None:
    signal = SIGNAL.validate_python(fields)
    plain = {"signal": signal.model_dump(mode="json", exclude_defaults=True)}
    again = SIGNAL.validate_python(yaml12.parse(yaml12.dump(plain), "it")["signal"])
    assert again == signal
    assert type(again) is type(signal)


def test_time_series__signal_that_was_used_is_still_the_same() -> None:
    used, fresh = HourlySeries(hourly=YEAR, unit="EUR/kWh"), HourlySeries(hourly=YEAR, unit="EUR/kWh")
    used.at(datetime(2017, 1, 1))
    assert used == fresh
    assert used.model_dump() == fresh.model_dump()
    with pytest.raises(ValidationError, match="frozen"):
        used.unit = "EUR/MWh"


@pytest.mark.parametrize(
    ("factor_of", "unit", "factor"),
    [
        (per_kwh, "EUR/kWh", 1.0), (per_kwh, "EUR/MWh", 1e-3), (per_kwh, "ct / kWh", 1.0), (per_kwh, "$/Wh", 1e3),
        (per_kwh, "EUR/GJ", 0.0036),
        (grams_per_kwh, "g/kWh", 1.0), (grams_per_kwh, "kg/MWh", 1.0), (grams_per_kwh, "kg/kWh", 1e3),
        (grams_per_kwh, "t/MWh", 1e3), (grams_per_kwh, "gCO2eq/kWh", 1.0), (grams_per_kwh, "g CO2/kWh", 1.0),
    ],
)  # fmt: skip
def test_time_series__prices_and_intensities_by_energy(factor_of: Any, unit: str, factor: float) -> None:
    assert factor_of(unit) == pytest.approx(factor)


@pytest.mark.parametrize(
    ("kind", "words", "units"),
    [
        (Price, "a unit per energy expected", ("EUR", "EUR/h", "/kWh", "EUR/", "kWh")),
        (Intensity, "a mass per energy expected", ("EUR/kWh", "lb/MWh", "CO2/kWh")),
    ],
)
def test_time_series__price_is_by_energy_and_intensity_a_mass(kind: Any, words: str, units: tuple[str, ...]) -> None:
    for unit in units:
        with pytest.raises(ValidationError, match=words):
            TypeAdapter(kind).validate_python({"value": 1.0, "unit": unit})
