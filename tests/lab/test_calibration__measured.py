"""Measured data of a calibration: units, intervals, daylight saving, and errors with their lines."""

from __future__ import annotations

from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.calibration_model import Series

from zenostat.lab.calibration.config import Calibration, read_calibration
from zenostat.lab.calibration.headings import read_headings
from zenostat.lab.calibration.measured import MeasuredData, read_measured
from zenostat.lab.calibration.objective import column_errors, compare
from zenostat.topics.errors import InvalidConfig

METER, ROOM, POWER = Series("meter", "J", True), Series("room", "degC", False), Series("power", "W", False)
HOURS = [f"2017-03-12 {hour:02}:00" for hour in range(24)]


def configuration(**changes: Any) -> Calibration:
    fields: dict[str, Any] = {
        "timestamps": "begin", "periods": [["2017-03-12", "2017-03-12"]], "trials": 1,
        "parameters": {"a": {"edit": "people", "low": 0, "high": 1}},
    }  # fmt: skip
    return read_calibration({**fields, **changes})


def read(path: Path, lines: list[str], *targets: Series, utc_offset_h: float = -7.0, **changes: Any) -> MeasuredData:
    path.write_text("\n".join(lines) + "\n")
    config = configuration(**changes)
    _, headings = read_headings(path, config)
    return read_measured(path, config, headings, targets, utc_offset_h)


def rows(times: list[str], *values: str) -> list[str]:
    return [",".join([time, *values]) for time in times]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "measured.csv"


# Units


@pytest.mark.parametrize(
    ("target", "unit", "hour", "value"),
    [
        (METER, "kWh", 7.2e6, 2.0),
        (METER, "kW", 7.2e6, 2.0),  # the mean power of an hour with 2 kWh
        (METER, "kBtu", 1.05505585262e6, 1.0),
        (POWER, "kWh", 2000.0, 2.0),
        (POWER, "kW", 2000.0, 2.0),
        (ROOM, "degC", 20.0, 20.0),
        (ROOM, "C", 20.0, 20.0),
        (ROOM, "degF", 20.0, 68.0),
    ],
)
def test_measured_column__converts_simulated_hours(
    file: Path, target: Series, unit: str, hour: float, value: float
) -> None:
    data = read(file, [f"time,{target.name} [{unit}]", *rows(HOURS, "20")], target)
    assert data.columns[0].of_hours(np.array([hour])) == pytest.approx(value)


@pytest.mark.parametrize(("unit", "value", "tolerance"), [("degC", "20", 0.5), ("degF", "68", 0.9)])
def test_measured_column__has_the_tolerance_of_a_temperature_in_its_unit(
    file: Path, unit: str, value: str, tolerance: float
) -> None:
    columns = {f"room [{unit}]": {"variable": "Zone Mean Air Temperature", "key": "room", "tolerance": 0.5}}
    data = read(file, [f"time,room [{unit}]", *rows(HOURS, value)], ROOM, columns=columns)
    assert data.columns[0].tolerance == pytest.approx(tolerance)


def test_read_measured__adds_or_averages_parts_of_hours(file: Path) -> None:
    times = [f"2017-03-12 {hour:02}:{minute:02}" for hour in range(24) for minute in (0, 15, 30, 45)]
    lines = [f"{time},{number % 4},{10 + number % 4}" for number, time in enumerate(times)]
    data = read(file, ["time,meter (kWh),power (kW)", *lines], METER, POWER)
    assert data.columns[0].values.tolist() == [6.0] * 24
    assert data.columns[1].values.tolist() == [11.5] * 24
    assert data.lines[:3] == (2, 6, 10)


@pytest.mark.parametrize(("timestamps", "first"), [("begin", "03:00:00"), ("end", "02:45:00")])
def test_read_measured__missing_part_of_an_hour_is_named_alone(file: Path, timestamps: str, first: str) -> None:
    times = [
        f"2017-03-1{day} {hour:02}:{minute:02}" for day in "123" for hour in range(24) for minute in (0, 15, 30, 45)
    ]
    times.remove("2017-03-12 03:00")
    lines = ["time,meter (kWh)", *rows(times, "1")]
    before = 2 + times.index("2017-03-12 03:15")
    with pytest.raises(InvalidConfig, match=rf"before line {before}: no data for 2017-03-12 {first} to 2017-03-12 0"):
        read(file, lines, METER, timestamps=timestamps)
    data = read(file, lines, METER, timestamps=timestamps, missing="leave_out")
    assert len(data.rows_of((date(2017, 3, 12), date(2017, 3, 12)))) == 23
    with pytest.raises(InvalidConfig, match="no hour has all of its 4 rows"):
        read(file, ["time,meter (kWh)", *rows(times[1:4] + times[5:7], "1")], METER, missing="leave_out",
             periods=[["2017-03-11", "2017-03-11"]])  # fmt: skip


@pytest.mark.parametrize(
    ("time_format", "midnight", "is_midnight"),
    [
        (None, "2017-03-12 24:00", True),
        (None, "2017-03-12T24:00:00-07:00", True),
        ("%m/%d/%Y %H:%M:%S", "03/12/2017 24:00:00", True),
        ("%H:%M %d.%m.%Y", "24:00 12.03.2017", True),
        (None, "2017-03-12 24:15", False),
        (None, "2017-03-12 24:00:01", False),
        (None, "9999-12-31 24:00", False),
    ],
)
def test_read_measured__24_00_is_midnight_of_the_next_day(
    file: Path, time_format: str | None, midnight: str, is_midnight: bool
) -> None:
    before = [datetime(2017, 3, 12, hour) for hour in range(1, 24)]
    zone = "-07:00" if midnight.endswith("-07:00") else ""
    times = [f"{time:{time_format or '%Y-%m-%dT%H:%M'}}{zone}" for time in before]
    lines = ["time,meter [kWh]", *rows([*times, midnight], "1")]
    settings: dict[str, Any] = {"timestamps": "end", "time_format": time_format}
    if is_midnight:
        assert read(file, lines, METER, **settings).ends[-1] == datetime(2017, 3, 13)
    else:
        with pytest.raises(InvalidConfig, match=f"'{midnight}' is no timestamp"):
            read(file, lines, METER, **settings)


def test_column_errors__rows_of_days_have_no_limits(file: Path) -> None:
    """A model whose hours are off by half of the measured ones, and right on the sum of each day."""
    first, last = date(2017, 3, 12), date(2017, 3, 15)
    hours = [f"2017-03-{day} {hour:02}:00" for day in range(12, 16) for hour in range(24)]
    settings: dict[str, Any] = {"periods": [[str(first), str(last)]]}
    simulated = {(first, last): 3.6e6 * np.tile([0.5, 1.5], 48)[:, None]}
    verdicts = {}
    for times, value in ((hours, "1"), (hours[::24], "24")):
        data = read(file, ["time,meter [kWh]", *rows(times, value)], METER, **settings)
        (errors,) = column_errors(data, compare(data, simulated), 1)
        verdicts[len(times)] = (errors.is_hourly_within, errors.is_monthly_within)
    assert verdicts == {96: (False, None), 4: (None, None)}


def test_read_measured__rows_between_stamps_are_bills_with_monthly_limits(file: Path) -> None:
    stamps = ["2017-01-01", "2017-02-01", "2017-03-01", "2017-04-01"]
    periods = [["2017-01-01", "2017-03-31"]]
    lines = ["date,meter [kWh]", *(f"{stamp},{number}" for number, stamp in enumerate(stamps))]
    begun = read(file, lines, METER, periods=periods)
    assert begun.is_monthly
    assert begun.begins[1] == datetime(2017, 2, 1)
    assert begun.ends[1] == datetime(2017, 3, 1)
    assert begun.columns[0].values.tolist() == [0.0, 1.0, 2.0]
    ended = read(file, lines, METER, periods=periods, timestamps="end")
    assert ended.columns[0].values.tolist() == [1.0, 2.0, 3.0]
    assert ended.columns[0].of_hours(np.full(24 * 31, 3.6e6)) == pytest.approx(744.0)


@pytest.mark.parametrize("timestamps", ["begin", "end"])
def test_read_measured__missing_bill_is_an_error_or_left_out(file: Path, timestamps: str) -> None:
    """Without 1 March, the bill of February would be compared with February and March."""
    stamps = [f"2017-{month:02}-01" for month in (1, 2, 4, 5, 6)]
    lines = ["date,meter [kWh]", *(f"{stamp},7" for stamp in stamps)]
    settings: dict[str, Any] = {"periods": [["2017-01-01", "2017-05-31"]], "timestamps": timestamps}
    with pytest.raises(
        InvalidConfig, match=rf"line {3 if timestamps == 'begin' else 4}: its row lasts .* 59 days, .* 31 d"
    ):
        read(file, lines, METER, **settings)
    data = read(file, lines, METER, missing="leave_out", **settings)
    assert np.isnan(data.columns[0].values).tolist() == [False, True, False, False]
    explicit = read(file, lines, METER, interval="between", **settings)
    assert not np.isnan(explicit.columns[0].values).any()


@pytest.mark.parametrize(("timestamps", "lacks"), [("begin", "line 13.* has no end"), ("end", "line 2.* beginning")])
def test_read_measured__bill_without_an_end_or_a_beginning_is_an_error(file: Path, timestamps: str, lacks: str) -> None:
    year, first = 2017, 1 if timestamps == "begin" else 2
    stamps = [datetime(year + (month - 1) // 12, (month - 1) % 12 + 1, 1) for month in range(first, first + 12)]
    lines = ["date,meter [kWh]", *(f"{stamp},7" for stamp in stamps)]
    settings: dict[str, Any] = {"periods": [["2017-01-01", "2017-12-31"]], "timestamps": timestamps}
    with pytest.raises(InvalidConfig, match=lacks):
        read(file, lines, METER, **settings)
    closing = [*lines, "2018-01-01,"] if timestamps == "begin" else [lines[0], "2017-01-01,", *lines[1:]]
    assert len(read(file, closing, METER, **settings).lines) == 12
    assert len(read(file, lines, METER, missing="leave_out", **settings).lines) == 11


def test_read_measured__bills_that_do_not_cover_a_period_are_an_error(file: Path) -> None:
    lines = ["date,meter [kWh]", "2017-01-01,7", "2017-02-01 09:00,7", "2017-03-01,7", "2017-03-29,"]
    assert len(read(file, lines, METER, periods=[["2017-01-01", "2017-03-28"]]).lines) == 3
    with pytest.raises(InvalidConfig, match=r"no data for 2017-03-29 .* to 2017-04-01 .*beyond them do not count"):
        read(file, lines, METER, periods=[["2017-01-01", "2017-03-31"]])
    with pytest.raises(InvalidConfig, match=r"no data for 2017-03-01 .* to 2017-03-16"):
        read(file, lines, METER, periods=[["2017-01-01", "2017-03-15"]])


def test_read_measured__missing_day_between_daily_stamps_is_an_error(file: Path) -> None:
    lines = ["date,meter [kWh]", *rows([f"2017-03-{day:02}" for day in (11, 12, 13, 15, 16)], "7")]
    with pytest.raises(InvalidConfig, match=r"line 4: its row lasts .* 2 days, and most rows 1 days"):
        read(file, lines, METER, interval="between", periods=[["2017-03-11", "2017-03-15"]])


def test_read_measured__days_and_bills_of_summer_time_begin_on_the_day_before(file: Path) -> None:
    """Midnight of a clock with daylight saving time is 23:00 of the day before in standard time."""
    settings: dict[str, Any] = {"interval": "between", "time_zone": "America/Denver"}
    days = ["date,meter [kWh]", *rows([f"2017-07-{day:02}" for day in (9, 10, 11, 12)], "7")]
    with pytest.raises(InvalidConfig, match=r"line 3 lasts from 2017-07-09 23:00:00 .*: begin on 2017-07-09 to inc"):
        read(file, days, METER, periods=[["2017-07-10", "2017-07-10"]], **settings)
    day = date(2017, 7, 9), date(2017, 7, 10)
    assert read(file, days, METER, periods=[[str(each) for each in day]], **settings).rows_of(day) == [1]
    bills = ["date,meter [kWh]", *rows([f"2017-{month:02}-01" for month in (5, 6, 7, 8, 9)], "7")]
    with pytest.raises(InvalidConfig, match=r"no data for 2017-06-01 .*line 3 .*: begin on 2017-05-31 to include it"):
        read(file, bills, METER, periods=[["2017-06-01", "2017-07-31"]], **settings)
    months = date(2017, 5, 31), date(2017, 7, 31)
    assert read(file, bills, METER, periods=[[str(each) for each in months]], **settings).rows_of(months) == [1, 2]


# Time


def test_read_measured__converts_daylight_saving_time(file: Path) -> None:
    spring = [hour for hour in HOURS if " 02:" not in hour] + ["2017-03-13 00:00"]
    data = read(file, ["time,meter [kWh]", *rows(spring, "1")], METER, time_zone="America/Denver")
    assert data.begins == tuple(datetime(2017, 3, 12, hour) for hour in range(24))
    autumn = [f"2017-11-05 {hour:02}:00" for hour in (0, 1, 1, *range(2, 23))]
    days = [["2017-11-05", "2017-11-05"]]
    first = ["2017-11-04 23:00"]  # 0:00 summer time is 23:00 standard time
    data = read(
        file, ["time,meter [kWh]", *rows([*first, *autumn, "2017-11-05 23:00"], "1")], METER,
        time_zone="America/Denver", periods=days,
    )  # fmt: skip
    assert data.begins[2:5] == (datetime(2017, 11, 5), datetime(2017, 11, 5, 1), datetime(2017, 11, 5, 2))


def test_read_measured__converts_the_repeated_hour_of_quarters(file: Path) -> None:
    """From 1:00 to 2:00, the clock goes through the same four quarters twice."""
    clock = [f"2017-11-05 01:{minute:02}" for minute in (0, 15, 30, 45)]
    times = ["2017-11-05 00:45", *clock, *clock, "2017-11-05 02:00"]
    data = read(
        file, ["time,meter [kWh]", *rows(times, "1")], METER, time_zone="America/Denver", missing="leave_out",
        timestamps="begin", interval="15min", periods=[["2017-11-05", "2017-11-05"]],
    )  # fmt: skip
    assert data.begins == (datetime(2017, 11, 5), datetime(2017, 11, 5, 1))  # standard time, UTC-7
    assert data.columns[0].values.tolist() == [4.0, 4.0]
    with pytest.raises(InvalidConfig, match="line 11: 2017-11-05 01:45 occurs again, after line 10"):
        read(file, ["time,meter [kWh]", *rows([*times[:-1], times[-2]], "1")], METER, time_zone="America/Denver")


@pytest.mark.parametrize(
    ("zone", "utc_offset_h", "begin"),
    [
        ("Europe/Dublin", 0.0, datetime(2017, 7, 2, 23)),  # summer time is the standard of its database
        ("Europe/Berlin", 1.0, datetime(2017, 7, 2, 23)),
        ("Australia/Sydney", 10.0, datetime(2017, 7, 3)),  # its winter
        ("Asia/Kolkata", 5.5, datetime(2017, 7, 3)),
    ],
)
def test_read_measured__standard_time_is_that_of_the_winter(
    file: Path, zone: str, utc_offset_h: float, begin: datetime
) -> None:
    times = [f"2017-07-03 {hour:02}:00" for hour in range(3)]
    data = read(
        file, ["time,meter [kWh]", *rows(times, "1")], METER, utc_offset_h=utc_offset_h, time_zone=zone,
        missing="leave_out", periods=[["2017-07-02", "2017-07-03"]],
    )  # fmt: skip
    assert data.begins[0] == begin


def test_read_measured__converts_timestamps_with_an_offset(file: Path) -> None:
    times = [f"2017-03-12T{hour:02}:00:00Z" for hour in range(7, 24)]
    times += [f"2017-03-13T{hour:02}:00:00Z" for hour in range(7)]
    data = read(file, ["time,meter [kWh]", *rows(times, "1")], METER)
    assert data.begins[0] == datetime(2017, 3, 12)


# Errors


@pytest.mark.parametrize(
    ("lines", "changes", "error"),
    [
        (["time,meter [kWh]", *rows(HOURS[:5] + HOURS[4:], "1")], {},
         "line 7: 2017-03-12 04:00 occurs again, after line 6"),
        (["time,meter [kWh]", *rows(HOURS[:4] + HOURS[3:], "1")], {}, "set time_zone (as America/Denver)"),
        (["time,meter [kWh]", *rows([*HOURS[:5], HOURS[7], HOURS[5]], "1")], {},
         "line 8: 2017-03-12 05:00 is before the time of line 7; sort the rows"),
        (["time,meter [kWh]", *rows(HOURS[:2] + HOURS[3:], "1")], {},
         "before line 4: no data for 2017-03-12 02:00:00 to 2017-03-12 03:00:00, within periods[0]; add the rows"),
        (["time,meter [kWh]", *rows(HOURS[:2] + HOURS[3:], "1")], {}, "daylight saving"),
        (["time,meter [kWh]", *rows(HOURS[:20], "1")], {}, "no data for 2017-03-12 20:00:00 to 2017-03-13"),
        (["time,meter [kWh]", *rows(HOURS[:6], "1"), f"{HOURS[6]},", *rows(HOURS[7:], "1")], {},
         "line 8, column 'meter [kWh]': no value, within periods[0]"),
        (["time,meter [kWh]", *rows(HOURS[:6], "1"), f"{HOURS[6]},1;5", *rows(HOURS[7:], "1")], {},
         "line 8, column 'meter [kWh]': '1;5' is no number"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"periods": [["2018-03-12", "2018-03-12"]]},
         "periods[0]: 2018-03-12 to 2018-03-12 has no measured data; measured.csv covers 2017-03-12 00:00:00 to "
         "2017-03-13 00:00:00 (lines 2 to 25)"),
        (["time,meter [degC]", *rows(HOURS, "1")], {},
         "line 1: column 'meter [degC]' has the unit 'degC', but meter is in J; expected one of J, kJ"),
        (["time,meter", *rows(HOURS, "1")], {}, "line 1: column 'meter' has no unit; write it in brackets"),
        (["time,meter [kWh]", "12.03.2017 0:00,1"], {}, "line 2: '12.03.2017 0:00' is no timestamp; expected ISO 8601"),
        (["time,meter [kWh]", *rows([hour[:-2] + "07" for hour in HOURS], "1")], {},
         "line 2: 2017-03-12 00:07:00 is no multiple of 60 min after midnight"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"time_zone": "Europe/Berlin"}, "the weather file UTC-7"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"time_zone": "America"}, "'America' is no IANA time zone"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"time_zone": "America/Denver"},
         "line 4: 2017-03-12 02:00:00 does not exist in America/Denver"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"columns": {"metre": "x"}}, "no header 'metre' in line 1"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"interval": "15min"},
         "interval is 15min, but the timestamps are 1:00:00 apart or more"),
        (["time,meter [kWh]", *rows(HOURS[:6], "1"), f"{HOURS[6]},1_0", *rows(HOURS[7:], "1")], {},
         "line 8, column 'meter [kWh]': '1_0' is no number"),
        (["time,meter [kWh]", "9999-12-31 23:00,1"], {}, "line 2: '9999-12-31 23:00' is no timestamp"),
        (["time,meter [kWh]", "0001-01-01 00:00,1"], {"time_zone": "America/Denver"}, "'0001-01-01 00:00' is no"),
        (["time,meter [kWh]", *rows(HOURS, "1")], {"time_zone": "localtime"}, "'localtime' is no IANA time zone"),
        (["time,t [degC],t [degF]"], {"columns": {"t": "x"}},
         "'t' stands for 't [degC]' and 't [degF]' in line 1 of measured.csv; write one with its unit"),
        (["time"], {}, "line 1: a header with a column of timestamps and measured columns expected"),
    ],
)  # fmt: skip
def test_read_measured__errors_have_line_and_what_is_right(
    file: Path, lines: list[str], changes: dict[str, Any], error: str
) -> None:
    with pytest.raises(InvalidConfig) as caught:
        read(file, lines, METER, **changes)
    assert error in str(caught.value)


def test_read_measured__temperatures_in_another_unit_are_an_error_with_the_line(file: Path) -> None:
    lines = ["time,room [degC]", *rows(HOURS[:3], "21"), *rows(HOURS[3:], "70")]
    with pytest.raises(InvalidConfig, match=r"line 5, column 'room \[degC\]': 70 degC is no temperature .*\(degF\?\)"):
        read(file, lines, ROOM)


def test_read_measured__leaves_out_what_is_missing_if_asked_to(file: Path) -> None:
    lines = ["time,meter [kWh]", *rows(HOURS[:6], "1"), f"{HOURS[6]},", *rows(HOURS[9:], "1")]
    data = read(file, lines, METER, missing="leave_out")
    assert len(data.lines) == 22
    assert np.isnan(data.columns[0].values).sum() == 1
