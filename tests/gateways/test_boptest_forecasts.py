"""BOPTEST's forecasts: the error model, weather and the sun, prices, and test periods."""

from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest

from zenostat.gateways.boptest import forecast_errors
from zenostat.gateways.boptest.baseline import ZoneSchedules
from zenostat.gateways.boptest.forecast import Forecaster
from zenostat.gateways.boptest.parsing import BadRequest
from zenostat.gateways.boptest.prices import rate_at, read_rates
from zenostat.gateways.boptest.simulation import YEAR_S
from zenostat.gateways.boptest.test_periods import find_test_periods
from zenostat.gateways.boptest.weather import COLUMNS, Weather, wet_bulb
from zenostat.topics.errors import InvalidConfig

DAY_S = 86400


@pytest.mark.variants
@pytest.mark.parametrize(
    ("level", "mean", "deviation"),
    # Stationary mean mu / (1 - F) and deviation K / sqrt(1 - F^2) of a first-order autoregression.
    [("low", 0.0, 0.4 / np.sqrt(1 - 0.92**2)), ("high", -0.015 / 0.05, 0.7 / np.sqrt(1 - 0.95**2))],
)
def test_boptest_forecasts__temperature_errors_have_the_moments_of_their_autoregression(level, mean, deviation):
    last = np.array([forecast_errors.temperature_errors(level, 80, seed)[-1] for seed in range(3000)])
    assert last.mean() == pytest.approx(mean, abs=4 * deviation / np.sqrt(3000))
    assert last.std() == pytest.approx(deviation, rel=0.06)
    assert forecast_errors.temperature_errors(level, 9, 3)[:4].tolist() == (
        forecast_errors.temperature_errors(level, 4, 3).tolist()
    )


def test_boptest_forecasts__first_temperature_error_is_numpys_legacy_draw():
    assert forecast_errors.temperature_errors("medium", 1, 12)[0] == np.random.RandomState(12).normal(0.15, 1.2)


@pytest.mark.parametrize("level", forecast_errors.LEVELS)
def test_boptest_forecasts__solar_forecasts_stay_within_their_share_of_the_truth_and_nights_stay_dark(level):
    truth = np.maximum(0.0, 700.0 * np.sin(np.arange(49) / 24 * 2 * np.pi - np.pi / 2))
    forecast = forecast_errors.solar_forecast(level, truth, 5)
    assert (forecast[truth == 0.0] == 0.0).all()
    assert (forecast >= 0.2 * truth).all()
    assert (forecast <= 2.0 * truth).all()
    assert np.abs(forecast - truth).max() > 1.0
    assert (forecast_errors.solar_forecast(level, truth, 5) == forecast).all()


def test_boptest_forecasts__test_periods_follow_their_definitions():
    days, bins = 365, 96
    heating, cooling = np.zeros((days, bins)), np.zeros((days, bins))
    heating[:120, 30] = np.linspace(9000, 3100, 120)  # falls day by day
    heating[5, 30] = 50_000  # before the first day that can be chosen
    cooling[100:300, 50] = np.linspace(100, 8000, 200)
    cooling[250, 60:62] = (20_000, 20_000)
    periods = find_test_periods(heating.ravel(), cooling.ravel(), 900)
    assert periods["peak_heat_day"] == 14
    daily = heating.max(axis=1)
    median = np.median(daily[daily > 1])
    assert daily[periods["typical_heat_day"]] == daily[14:358][daily[14:358] <= median].max()
    assert periods["peak_cool_day"] == 250
    overlap = np.minimum(daily, cooling.max(axis=1))
    assert overlap[periods["mix_day"]] == overlap[14:358].max()


def test_boptest_forecasts__periods_of_a_load_that_the_building_lacks_are_left_out():
    cooling = np.random.default_rng(0).uniform(100, 1000, 365 * 96)
    assert {*find_test_periods(np.zeros(365 * 96), cooling, 900)} == {"peak_cool_day", "typical_cool_day"}


def test_boptest_forecasts__peaks_are_means_of_15_minutes():
    load = np.zeros(365 * 288)
    load[100 * 288] = 3000.0  # five minutes: a mean of 1000 W
    load[200 * 288 : 200 * 288 + 3] = 1500.0
    assert find_test_periods(load, np.zeros_like(load), 300)["peak_heat_day"] == 200


def weather(latitude_deg=40.0, interval_s=3600.0, **columns):
    rows = int(30 * DAY_S / interval_s)
    all_columns = {name: np.full(rows, np.nan) for name in COLUMNS} | {
        name: np.resize(np.asarray(values, float), rows) for name, values in columns.items()
    }
    return Weather(0.0, interval_s, all_columns, latitude_deg, -105.0, -7.0)


POLAR_DAY = -80.0
"""A latitude at which the sun does not set in January."""


def test_boptest_forecasts__data_after_the_run_period_are_those_of_its_second_year():
    hours = np.arange(2 * 8760, dtype=float)
    columns = {name: np.full(len(hours), np.nan) for name in COLUMNS} | {"dry_bulb_temperature": hours}
    series = Weather(0.0, 3600.0, columns, 40.0, -105.0, -7.0)
    rates = read_rates()
    dynamic = next(name for name in rates.points if "Dynamic" in name and "Price" in name)
    ends = []

    class Ahead:
        begin_s, step_s = 30 * DAY_S, 3600

        def reach(self, row):
            ends.append(row)
            return min(row, 2 * 8760 - 30 * 24)

        trajectory = SimpleNamespace(fault_free_values=np.arange(2 * 8760.0 - 30 * 24 + 1)[:, None])

    schedules = ZoneSchedules.__new__(ZoneSchedules)
    schedules._columns, schedules.points = {"LowerSetp[core]": (0, 1.0, 0.0)}, {"LowerSetp[core]": ("K", "")}
    forecaster = Forecaster(series, rates, schedules)
    names = ["TDryBul", "LowerSetp[core]", dynamic]
    now_s, interval_s = 600 * DAY_S, 5 * DAY_S + 3600
    forecast = forecaster.forecast(names, now_s, 2.9 * YEAR_S, interval_s, {}, Ahead())
    assert forecast["time"][-1] > 4 * YEAR_S
    for place, time_s in enumerate(forecast["time"]):
        same = time_s
        while same > 2 * YEAR_S:
            same -= YEAR_S
        assert forecast["TDryBul"][place] == pytest.approx(273.15 + max(same / 3600 - 1, 0))
        assert forecast["LowerSetp[core]"][place] == min((same - 30 * DAY_S) // 3600 + 1, 2 * 8760 - 30 * 24)
        assert forecast[dynamic][place] == rate_at(rates.points[dynamic][0], np.array([float(same)]))[0]
    assert max(ends) <= 2 * 8760 - 30 * 24 + 1


def test_boptest_forecasts__weather_now_is_that_of_a_forecast_and_constant_where_two_rows_are_equal():
    series = weather(dry_bulb_temperature=[10.1, 20.3, 20.3], relative_humidity=[33.0])
    times_s = 777.0 * np.arange(40)
    for name in ("TDryBul", "relHum", "solAlt"):
        assert [series.now(time_s)[name] for time_s in times_s] == series.at(name, times_s).tolist()
    assert {*series.at("relHum", times_s)} == {0.33}
    assert {*series.at("TDryBul", np.arange(2.0, 3.1, 0.125) * 3600)} == {20.3 + 273.15}


@pytest.mark.parametrize("seed", [0, 7])
def test_boptest_forecasts__each_seed_is_repeatable_also_0(seed):
    points = {"TDryBul": "temperature_uncertainty", "HGloHor": "solar_uncertainty"}
    scenario = {**dict.fromkeys(points.values(), "high"), "seed": seed}

    def forecast(now_s):
        series = weather(dry_bulb_temperature=[10.0, 20.0], global_horizontal_radiation=[0.0, 300.0, 600.0])
        forecaster = Forecaster(series, read_rates(), SimpleNamespace(points={}))
        return forecaster.forecast([*points], now_s, DAY_S, 3600.0, scenario, None)

    assert forecast(0.0) == forecast(0.0)
    assert forecast(0.0)["TDryBul"] != forecast(DAY_S)["TDryBul"]


@pytest.mark.parametrize(("now_s", "horizon_s"), [(2700.0, 1800.0), (3000.0, 4500.0), (2700.0, 2.0 * DAY_S - 900.0)])
def test_boptest_forecasts__error_of_the_last_full_hour_holds_after_it(now_s, horizon_s):
    """Half an hour from 0:45 on ends at 1:15; BOPTEST draws errors for 0:00 and 1:00."""
    points = {"TDryBul": "temperature_uncertainty", "HGloHor": "solar_uncertainty"}
    levels = {**dict.fromkeys(points.values(), "low"), "seed": 3}
    radiation = [600.0, 800.0, 700.0, 900.0]
    series = weather(POLAR_DAY, dry_bulb_temperature=[10.0, 12.0, 9.0, 17.0], global_horizontal_radiation=radiation)
    forecaster = Forecaster(series, read_rates(), SimpleNamespace(points={}))
    truth, forecast = (forecaster.forecast([*points], now_s, horizon_s, 300.0, s, None) for s in ({}, levels))
    last_s = 3600.0 * (horizon_s // 3600 + 1)
    place = forecast["time"].index(last_s)
    assert place < len(forecast["time"]) - 1
    for name in points:
        errors = np.subtract(truth[name], forecast[name])
        assert abs(errors[place]) > 0.05
        assert errors[place:] == pytest.approx(errors[place])


def test_boptest_forecasts__sunset_after_the_last_full_hour_is_dark():
    series = weather(POLAR_DAY, global_horizontal_radiation=[600.0, 300.0, 0.0, 0.0, 0.0, 0.0])
    forecaster = Forecaster(series, read_rates(), SimpleNamespace(points={}))
    scenario = {"solar_uncertainty": "high", "seed": 1}
    truth, forecast = (
        np.array(forecaster.forecast(["HGloHor"], 3540.0, 7140.0, 60.0, s, None)["HGloHor"]) for s in ({}, scenario)
    )
    assert truth[0] > 300.0
    assert (forecast >= 0.2 * truth - 1e-9).all()
    assert (forecast <= 2.0 * truth + 1e-9).all()
    assert (truth[91:] == 0.0).all(), "from 2:30 on, the middle of the first hour without sun"


@pytest.mark.parametrize(
    ("horizon_s", "interval_s", "text"),
    [
        (1.0, 1e-6, "would have 2000002 values, including times; at most 2000000 can be requested"),
        (1e300, 1e-300, "at most 2000000 can"),
        (3600.0, 1e-320, "at most 2000000 can"),
        (1e12, 1e11, "longer than 94608000 s"),
        (1e300, 1e300, "longer than 94608000 s"),
    ],
)
@pytest.mark.parametrize("point", ["solAlt", "PriceElectricPowerConstant"])
def test_boptest_forecasts__horizon_beyond_a_few_years_is_refused(point, horizon_s, interval_s, text):
    forecaster = Forecaster(weather(dry_bulb_temperature=[0.0]), read_rates(), SimpleNamespace(points={}))
    with pytest.raises(BadRequest, match=text):
        forecaster.forecast([point], 0.0, horizon_s, interval_s, {}, None)
    assert forecaster.forecast([point], 0.0, 3.0 * 365 * DAY_S, 365.0 * DAY_S, {}, None)["time"][-1] == 3 * 365 * DAY_S


def test_boptest_forecasts__weather_is_linear_between_hours_and_gaps_are_filled():
    series = weather(dry_bulb_temperature=[0.0, 10.0, np.nan, 30.0])
    assert "relHum" not in series.points
    assert series.at("TDryBul", np.array([3600.0, 5400.0, 3 * 3600.0])) == pytest.approx([273.15, 278.15, 293.15])
    assert series.now(5400.0)["TDryBul"] == pytest.approx(278.15)
    assert [*series.now(5400.0)] == [*series.points]


def test_boptest_forecasts__radiation_of_a_row_is_that_of_the_middle_of_its_hour():
    series = weather(
        POLAR_DAY, direct_normal_radiation=100.0 * np.arange(24), horizontal_infrared_radiation_intensity=np.arange(24)
    )
    hours = 3600.0 * np.array([0.5, 1.0, 1.5, 23.5])
    assert series.at("HDirNor", hours) == pytest.approx([0.0, 50.0, 100.0, 2300.0])
    assert series.at("HDirNor", np.array([0.0])) == pytest.approx([0.5 * 2300.0]), "the first day's last hour before it"
    assert series.at("HHorIR", 3600.0 * np.array([1.0, 2.0])) == pytest.approx([0.0, 1.0]), "no mean in an EPW file"
    quarters = weather(POLAR_DAY, 900.0, direct_normal_radiation=np.arange(96))
    assert quarters.at("HDirNor", 900.0 * np.array([1.0, 2.0])).tolist() == [0.0, 1.0], "each is that of its timestep"


def test_boptest_forecasts__sun_that_is_down_does_not_shine():
    series = weather(global_horizontal_radiation=[500.0], direct_normal_radiation=[500.0])
    times_s = np.arange(0.0, DAY_S, 600.0)
    is_up = series.at("solAlt", times_s) > 0.0
    assert 0.3 < is_up.mean() < 0.5
    for name in ("HGloHor", "HDirNor"):
        assert series.at(name, times_s).tolist() == np.where(is_up, 500.0, 0.0).tolist()


def test_boptest_forecasts__sun_is_in_the_south_at_solar_noon_and_as_high_as_geometry_states():
    series = weather(dry_bulb_temperature=[0.0])
    times = 171 * DAY_S + np.arange(0.0, DAY_S, 60.0)  # the solstice: declination 23.45 degrees
    altitude, hour_angle = series.at("solAlt", times), series.at("solHouAng", times)
    assert np.degrees(altitude.max()) == pytest.approx(90 - 40 + 23.45, abs=0.1)
    assert abs(hour_angle[altitude.argmax()]) < np.radians(0.3)
    # The site is on the meridian of its time zone, and the equation of time is below 2 minutes that day.
    assert times[altitude.argmax()] % DAY_S == pytest.approx(DAY_S / 2, abs=150)
    assert series.at("solZen", times) == pytest.approx(np.pi / 2 - altitude)
    equinox = 79 * DAY_S + np.arange(0.0, DAY_S, 60.0)
    assert (series.at("solAlt", equinox) > 0).mean() == pytest.approx(0.5, abs=0.01)


def test_boptest_forecasts__wet_bulb_temperatures():
    air = np.array([293.15, 293.15, 303.15])
    humidity, pressure = np.array([1.0, 0.5, 0.2]), 101_325.0
    wet, dry = wet_bulb(air, humidity, np.full(3, pressure)) - 273.15, air - 273.15
    assert wet[0] == pytest.approx(20.0)
    # Adiabatic saturation, ASHRAE Handbook Fundamentals 2017, chapter 1, equation 33.
    saturated, vapor = (611.2 * np.exp(17.62 * t / (243.12 + t)) for t in (wet, dry))
    ratio_at_wet_bulb = 0.621945 * saturated / (pressure - saturated)
    ratio = ((2501 - 2.326 * wet) * ratio_at_wet_bulb - 1.006 * (dry - wet)) / (2501 + 1.86 * dry - 4.186 * wet)
    vapor = vapor * humidity
    assert ratio == pytest.approx(0.621945 * vapor / (pressure - vapor), rel=0.05)


def test_boptest_forecasts__prices_can_be_set_by_scenario_or_all_at_once():
    rates = read_rates({"dynamic": 0.5, "gas": 0.01})
    assert rates.prices_of("dynamic")["electricity"].series.at(datetime(2017, 1, 2)) == 0.5
    assert rate_at(rates.points["PriceGasPower"][0], np.array([0.0, 7200.0])).tolist() == [0.01, 0.01]
    flat = read_rates({"electricity": 0.3})
    times = np.arange(0.0, DAY_S, 1800.0)
    for scenario in ("Constant", "Dynamic", "HighlyDynamic"):
        assert (rate_at(flat.points[f"PriceElectricPower{scenario}"][0], times) == 0.3).all()
    monday = DAY_S + np.array([6.99, 7.0, 21.99, 22.0]) * 3600
    assert rate_at(read_rates().points["PriceElectricPowerDynamic"][0], monday).tolist() == [0.105, 0.2, 0.2, 0.105]
    with pytest.raises(InvalidConfig, match="highly_dynamic"):
        read_rates({"hihgly_dynamic": 0.5})
    with pytest.raises(InvalidConfig, match="no fuel"):
        read_rates({"gaz": 0.5})
    for wrong, nearest in (("dynamc", "dynamic"), ("Dynamic", "dynamic"), ("highly-dynamic", "highly_dynamic")):
        with pytest.raises(InvalidConfig, match=f"no fuel '{wrong}'; did you mean '{nearest}'"):
            read_rates({wrong: 0.5})


@pytest.mark.parametrize("names", [("constant", "gas"), ("electricity", "gas"), ("constant", "dynamic")])
def test_boptest_forecasts__prices_in_two_currencies_are_refused(names):
    euro, dollar = names
    prices = {euro: {"value": 300, "unit": "EUR/MWh"}, dollar: {"value": 0.05, "unit": "USD/kWh"}}
    with pytest.raises(InvalidConfig, match=r"in EUR and .* in USD; prices in one currency expected"):
        read_rates(prices)
