"""Noise on the weather: the process against its theory, and hours that can be.

Statistics are compared as z-scores over independent paths with a fixed seed. |z| < 4 holds with a probability
of 0.99994 for each comparison; a factor of 1.2 in a standard deviation gives |z| of 12 and more here.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from support.examples import examples
from support.weather_files import DRY_BULB, STEPS_PER_HOUR, run

from zenostat.models.catalog import find_weather
from zenostat.models.run_period import date
from zenostat.models.weather.epw import Weather, read, write
from zenostat.models.weather.noise import ColumnNoise, NoisyWeather, ornstein_uhlenbeck, resolve_columns, with_noise
from zenostat.models.weather.psychrometrics import clear_sky_infrared, dew_point, relative_humidity, saturation_pressure
from zenostat.topics.errors import InvalidConfig, UnknownName

DENVER = find_weather("USA_CO_Denver").path
Z = 4.0
PATHS = 4000


@pytest.fixture(scope="module")
def denver() -> Weather:
    return read(DENVER)


def noised(weather: Weather, seed: int = 1, **columns: ColumnNoise) -> NoisyWeather:
    return with_noise(weather, columns, np.random.default_rng(seed))


def after(weather: Weather, done: NoisyWeather, name: str) -> NDArray[np.float64]:
    return done.columns.get(name, weather.column(name))


# The process


def paths(n: int, sigma: float, mu: float, tau_h: float, dt_h: float, seed: int = 7) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.array([ornstein_uhlenbeck(rng, n, sigma, mu, tau_h, dt_h) for _ in range(PATHS)])


PROCESSES = [(1.0, 0.0, 24.0, 1.0), (2.5, -1.5, 3.0, 1.0), (0.3, 10.0, 0.5, 1.0), (4.0, 0.0, 24.0, 0.25)]


@pytest.mark.parametrize(("sigma", "mu", "tau_h", "dt_h"), PROCESSES)
def test_weather_noise__process_from_zero_grows_into_the_stationary_one(
    sigma: float, mu: float, tau_h: float, dt_h: float
) -> None:
    """After k steps its mean is mu (1 - a^k), its variance sigma^2 (1 - a^2k), for a = exp(-dt/tau)."""
    rng = np.random.default_rng(7)
    x = np.array([ornstein_uhlenbeck(rng, 300, sigma, mu, tau_h, dt_h, from_zero=True) for _ in range(PATHS)])
    for k in (1, 2, 10, 63, 64, 300):
        mean = mu * (1 - math.exp(-k * dt_h / tau_h))
        deviation = sigma * math.sqrt(1 - math.exp(-2 * k * dt_h / tau_h))
        z_mean = (x[:, k - 1].mean() - mean) / (deviation / math.sqrt(PATHS))
        z_variance = (x[:, k - 1].var(ddof=1) / deviation**2 - 1) * math.sqrt((PATHS - 1) / 2)
        assert abs(z_mean) < Z
        assert abs(z_variance) < Z


def test_weather_noise__process_from_zero_without_deviation_is_the_growing_mean() -> None:
    values = ornstein_uhlenbeck(np.random.default_rng(1), 48, 0.0, 2.0, 24.0, from_zero=True)
    assert values == pytest.approx([2.0 * (1 - math.exp(-k / 24.0)) for k in range(1, 49)])


@pytest.mark.parametrize(("sigma", "mu", "tau_h", "dt_h"), PROCESSES)
def test_weather_noise__mean_and_deviation_are_stationary_from_the_first_value(
    sigma: float, mu: float, tau_h: float, dt_h: float
) -> None:
    x = paths(100, sigma, mu, tau_h, dt_h)
    for k in (0, 1, 10, 63, 64, 99):
        z_mean = (x[:, k].mean() - mu) / (sigma / math.sqrt(PATHS))
        z_variance = (x[:, k].var(ddof=1) / sigma**2 - 1) * math.sqrt((PATHS - 1) / 2)
        assert abs(z_mean) < Z
        assert abs(z_variance) < Z


@pytest.mark.parametrize(("sigma", "mu", "tau_h", "dt_h"), PROCESSES)
def test_weather_noise__correlation_falls_with_the_lag_by_the_time_constant(
    sigma: float, mu: float, tau_h: float, dt_h: float
) -> None:
    x = paths(100, sigma, mu, tau_h, dt_h)
    for first in (0, 17):
        for lag in (1, 2, 5, 24, 72):
            r = np.corrcoef(x[:, first], x[:, first + lag])[0, 1]
            z = (math.atanh(r) - math.atanh(math.exp(-lag * dt_h / tau_h))) * math.sqrt(PATHS - 3)  # Fisher's z
            assert abs(z) < Z, f"lag {lag}"


@given(st.integers(0, 2**32), st.integers(1, 400), st.floats(0.01, 1e4), st.floats(0.05, 2.0))
def test_weather_noise__doubling_is_the_recursion(seed: int, n: int, tau_h: float, dt_h: float) -> None:
    # Gillespie's update, one step after the other, with the same normal numbers.
    sigma, mu = 2.0, 3.0
    shocks = np.random.default_rng(seed).standard_normal(n)
    a = math.exp(-dt_h / tau_h)
    x = [mu + sigma * shocks[0]]
    for shock in shocks[1:]:
        x.append(mu + (x[-1] - mu) * a + sigma * math.sqrt(1 - a * a) * shock)
    drawn = ornstein_uhlenbeck(np.random.default_rng(seed), n, sigma, mu, tau_h, dt_h)
    np.testing.assert_allclose(drawn, x, rtol=0, atol=1e-6)


def test_weather_noise__generator_gives_the_same_bits() -> None:
    one, two = (ornstein_uhlenbeck(np.random.default_rng(5), 8760, 2.5, 0.0, 24.0) for _ in range(2))
    assert one.tobytes() == two.tobytes()
    assert ornstein_uhlenbeck(np.random.default_rng(6), 8760, 2.5, 0.0, 24.0).tobytes() != one.tobytes()


def test_weather_noise__no_values_are_no_values() -> None:
    assert ornstein_uhlenbeck(np.random.default_rng(0), 0, 1.0, 0.0, 24.0).shape == (0,)


# What can be asked for


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"sigma": -1}, "at least 0"),
        ({"sigma": (-1, 2)}, "at least 0"),
        ({"sigma": 1, "tau_h": 0}, "more than 0 h"),
        ({"sigma": 1, "tau_h": (0, 24)}, "more than 0 h"),
        ({"sigma": (3, 2)}, r"lower limit first: \[2, 3\]"),
        ({"sigma": 1, "mu": [5, -5]}, "lower limit first"),
        ({"sigma": 1, "mu": [1, 2, 3]}, "number or a range of two numbers"),
        ({"sigma": "much"}, "number or a range of two numbers"),
        ({"sigma": 1, "low": 5, "high": 5}, r"low 5 is not below high 5"),
        ({"sigma": float("nan")}, "finite"),
        ({"sigma": 1, "mu": (0, float("inf"))}, "finite"),
        ({"sigma": 1, "tau": 3}, "not permitted"),
        ({}, "required"),
    ],
)
def test_weather_noise__settings_that_cannot_be_are_refused(fields: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        ColumnNoise.model_validate(fields)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (["relative_humidity", "Dew Point Temperature"], "contradict each other"),
        (["global_horizontal_radiation", "direct_normal_radiation"], "contradict each other"),
        (["diffuse_horizontal_radiation", "global_horizontal_radiation"], "contradict each other"),
        (["dry_bulb_temperature", "Dry Bulb"], "dry_bulb_temperature twice, the second time as 'Dry Bulb'"),
        (["extraterrestrial_horizontal_radiation"], "cannot have noise: it depends only on place and date"),
    ],
)
def test_weather_noise__columns_that_cannot_be_together_are_refused(columns: list[str], words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        resolve_columns({name: ColumnNoise(sigma=1) for name in columns})


def test_weather_noise__unknown_column_and_limits_outside_the_physical_ones_are_refused() -> None:
    with pytest.raises(UnknownName, match="did you mean 'wind_speed'"):
        resolve_columns({"wind_sped": ColumnNoise(sigma=1)})
    with pytest.raises(InvalidConfig, match="exclude all of 0 to 100"):
        resolve_columns({"relative_humidity": ColumnNoise(sigma=1, low=100)})


# What is drawn


def test_weather_noise__range_is_drawn_uniformly_for_each_episode(denver: Weather) -> None:
    rng = np.random.default_rng(3)
    asked = {"dry_bulb": ColumnNoise(sigma=(1.0, 3.0), mu=(-1.0, 0.5), tau_h=(12.0, 48.0))}
    drawn, scaled = [], []
    for _ in range(400):
        done = with_noise(denver, asked, rng)
        parameters = done.parameters["dry_bulb_temperature"]
        drawn.append([parameters["sigma"], parameters["mu"], parameters["tau_h"]])
        first = done.columns["dry_bulb_temperature"][0] - denver.column("dry_bulb")[0]
        scaled.append((first - parameters["mu"]) / parameters["sigma"])
    for values, (low, high) in zip(np.array(drawn).T, [(1.0, 3.0), (-1.0, 0.5), (12.0, 48.0)], strict=True):
        assert low <= values.min() < values.max() <= high
        unit = (values - low) / (high - low)
        n = len(unit)
        # A uniform number has mean 1/2 and variance 1/12; the variance of its squared distance from 1/2 is 1/180.
        assert abs(unit.mean() - 1 / 2) / math.sqrt(1 / 12 / n) < Z
        assert abs(((unit - 1 / 2) ** 2).mean() - 1 / 12) / math.sqrt(1 / 180 / n) < Z
    # With its own parameters taken out, each episode's first value is a standard normal number.
    assert abs(np.mean(scaled)) * math.sqrt(len(scaled)) < Z
    assert abs(np.var(scaled, ddof=1) - 1) * math.sqrt((len(scaled) - 1) / 2) < Z


@pytest.mark.parametrize(("sigma", "mu", "tau_h"), [(2.5, 0.0, 24.0), (1.0, 2.0, 6.0)])
def test_noise__has_the_configured_mean_and_deviation_in_a_year(
    denver: Weather, sigma: float, mu: float, tau_h: float
) -> None:
    # Dry bulb is far from its limits, so the difference is the noise. Values correlate: a mean over n of them
    # has the variance sigma^2 (1 + a) / (1 - a) / n, and one of their squares 2 sigma^4 (1 + a^2) / (1 - a^2) / n.
    done = noised(denver, dry_bulb=ColumnNoise(sigma=sigma, mu=mu, tau_h=tau_h))
    noise, n, a = done.columns["dry_bulb_temperature"] - denver.column("dry_bulb"), len(denver), math.exp(-1 / tau_h)
    assert abs(noise.mean() - mu) / math.sqrt(sigma**2 * (1 + a) / (1 - a) / n) < Z
    assert abs(((noise - mu) ** 2).mean() - sigma**2) / math.sqrt(2 * sigma**4 * (1 + a * a) / (1 - a * a) / n) < Z
    r = np.corrcoef(noise[:-6], noise[6:])[0, 1]
    assert abs(r - a**6) < 0.05


def same(one: NoisyWeather, two: NoisyWeather) -> bool:
    return one.parameters == two.parameters and {n: v.tobytes() for n, v in one.columns.items()} == {
        n: v.tobytes() for n, v in two.columns.items()
    }


SEVERAL = {
    "wind_speed": ColumnNoise(sigma=(1.0, 2.0)),
    "Relative Humidity": ColumnNoise(sigma=10.0),
    "dry_bulb": ColumnNoise(sigma=2.5, tau_h=(12.0, 48.0)),
}


def test_weather_noise__seed_gives_the_same_weather_however_the_settings_are_written(denver: Weather) -> None:
    first = with_noise(denver, SEVERAL, np.random.default_rng(11))
    again = with_noise(denver, SEVERAL, np.random.default_rng(11))
    turned = with_noise(denver, dict(reversed(SEVERAL.items())), np.random.default_rng(11))
    spelled = {"rh": SEVERAL["Relative Humidity"], "Wind Speed": SEVERAL["wind_speed"], "DRYBULB": SEVERAL["dry_bulb"]}
    assert same(first, again)
    assert same(first, turned)
    assert list(first.parameters) == list(turned.parameters)
    assert same(first, with_noise(denver, spelled, np.random.default_rng(11)))
    assert not same(first, with_noise(denver, SEVERAL, np.random.default_rng(12)))


def test_weather_noise__episodes_of_one_generator_differ(denver: Weather) -> None:
    rng = np.random.default_rng(11)
    assert not same(with_noise(denver, SEVERAL, rng), with_noise(denver, SEVERAL, rng))


@pytest.mark.parametrize(
    ("name", "sigma", "dry_bulb_sigma"),
    [("wind_speed", 1.0, 1.0), ("horizontal_infrared_radiation_intensity", 5.0, 3.0)],
)
def test_weather_noise__noise_on_one_more_column_leaves_that_of_the_others(
    denver: Weather, name: str, sigma: float, dry_bulb_sigma: float
) -> None:
    few = noised(denver, **{name: ColumnNoise(sigma=sigma)})
    more = noised(denver, **{name: ColumnNoise(sigma=sigma), "dry_bulb": ColumnNoise(sigma=dry_bulb_sigma)})
    assert few.columns[name].tobytes() == more.columns[name].tobytes()


def test_weather_noise__no_noise_is_no_change(denver: Weather, folder: Path) -> None:
    done = noised(
        denver,
        dry_bulb=ColumnNoise(sigma=0),
        rh=ColumnNoise(sigma=(0, 0), mu=0, high=50),
        wind_direction=ColumnNoise(sigma=0),
    )
    assert done.columns == {}
    assert done.parameters["dry_bulb_temperature"] == {"sigma": 0.0, "mu": 0.0, "tau_h": 24.0}
    write(denver, folder / "out.epw", done.columns)
    assert (folder / "out.epw").read_bytes() == DENVER.read_bytes()


# Moisture


@pytest.mark.parametrize(
    ("celsius", "pascal"),
    # Saturation over water of the steam tables (IAPWS); the fit is good to 0.4 % from -40 to 50 C.
    [(0.01, 611.66), (10.0, 1228.2), (20.0, 2339.3), (30.0, 4246.9), (40.0, 7384.9)],
)
def test_weather_noise__saturation_pressure_is_that_of_the_steam_tables(celsius: float, pascal: float) -> None:
    assert saturation_pressure(np.array([celsius]))[0] == pytest.approx(pascal, rel=0.004)


@given(st.floats(-60.0, 60.0), st.floats(1.0, 100.0))
def test_weather_noise__dew_point_and_humidity_are_each_others_inverse(dry_bulb: float, humidity: float) -> None:
    dry = np.array([dry_bulb])
    dew = dew_point(dry, np.array([humidity]))
    assert dew[0] <= dry_bulb + 1e-9
    if dew[0] > -69.8:
        assert relative_humidity(dry, dew)[0] == pytest.approx(humidity, rel=1e-9)


def test_weather_noise__dew_point_of_dry_air_stays_within_the_dictionary() -> None:
    assert dew_point(np.array([20.0]), np.array([0.0]))[0] == pytest.approx(-69.9)


def test_weather_noise__clear_sky_infrared_is_the_engineering_references_example() -> None:
    # 293 K and 283 K give 340.6 W/m2; the text rounds ln(283/273) to 0.036.
    assert clear_sky_infrared(np.array([293 - 273.15]), np.array([283 - 273.15]))[0] == pytest.approx(340.6, abs=0.3)


def test_weather_noise__warmer_air_keeps_its_moisture(denver: Weather) -> None:
    done = noised(denver, dry_bulb=ColumnNoise(sigma=0, mu=2.0))
    dry, dew = denver.column("dry_bulb"), denver.column("dew_point")
    np.testing.assert_allclose(done.columns["dry_bulb_temperature"], dry + 2.0, atol=5e-5)
    assert "dew_point_temperature" not in done.columns
    # By hand, line 21: 4.0 C and dew point -2.0 C become 6.0 C: 100 e(-2.0) / e(6.0) = 100 * 527.5 / 934.7
    # (of the tables; the fit may be off by 0.4 %).
    assert done.columns["relative_humidity"][12] == pytest.approx(56.4, rel=0.004)
    ratio = clear_sky_infrared(dry + 2.0, dew) / clear_sky_infrared(dry, dew)
    infrared = done.columns["horizontal_infrared_radiation_intensity"]
    np.testing.assert_allclose(infrared, denver.column("horizontal_infrared_radiation_intensity") * ratio, atol=5e-5)


def test_weather_noise__colder_air_loses_what_it_cannot_hold(denver: Weather) -> None:
    done = noised(denver, dry_bulb=ColumnNoise(sigma=0, mu=-10.0))
    dry, dew = after(denver, done, "dry_bulb_temperature"), after(denver, done, "dew_point_temperature")
    wet = denver.column("dew_point") > denver.column("dry_bulb") - 10.0
    assert wet.any()
    assert not wet.all()
    assert np.array_equal(dew[wet], dry[wet])
    assert np.array_equal(dew[~wet], denver.column("dew_point")[~wet])
    assert (done.columns["relative_humidity"][wet] == 100.0).all()


@pytest.mark.parametrize("column", ["relative_humidity", "dew_point_temperature"])
def test_weather_noise__humidity_and_dew_point_follow_each_other(denver: Weather, column: str) -> None:
    done = noised(denver, **{column: ColumnNoise(sigma=5.0)})
    assert "dry_bulb_temperature" not in done.columns
    dry, dew = denver.column("dry_bulb"), after(denver, done, "dew_point_temperature")
    inside = dew > -69
    np.testing.assert_allclose(
        relative_humidity(dry, dew)[inside], after(denver, done, "relative_humidity")[inside], atol=2e-3
    )


# Sun


def without_extraterrestrial(folder: Path) -> Weather:
    """Set the extraterrestrial radiation to 0 in all rows, as in some files."""
    path = folder / "zero.epw"
    zeros = np.zeros(8760)
    names = ("extraterrestrial_horizontal_radiation", "extraterrestrial_direct_normal_radiation")
    write(read(DENVER), path, dict.fromkeys(names, zeros))
    return read(path)


def cosine(weather: Weather) -> NDArray[np.float64]:
    normal = weather.column("extraterrestrial_direct_normal_radiation")
    return weather.column("extraterrestrial_horizontal_radiation") / np.where(normal > 0, normal, 1)


def test_weather_noise__global_is_direct_and_diffuse_together(denver: Weather) -> None:
    done = noised(
        denver, direct_normal_radiation=ColumnNoise(sigma=80.0), diffuse_horizontal_radiation=ColumnNoise(sigma=30.0)
    )
    sun = denver.column("extraterrestrial_horizontal_radiation") > 0
    direct, diffuse = done.columns["direct_normal_radiation"], done.columns["diffuse_horizontal_radiation"]
    total = diffuse + direct * cosine(denver)
    np.testing.assert_allclose(done.columns["global_horizontal_radiation"][sun], total[sun], atol=2e-4)


def test_weather_noise__direct_and_diffuse_share_what_global_gains(denver: Weather) -> None:
    # The file's own three do not quite add up; their share and what was left over are scaled alike.
    done = noised(denver, global_horizontal_radiation=ColumnNoise(sigma=40.0))
    before, now = denver.column("global_horizontal_radiation"), done.columns["global_horizontal_radiation"]
    light = (before > 0) & (denver.column("extraterrestrial_horizontal_radiation") > 0)
    ratio = now[light] / before[light]
    diffuse = done.columns["diffuse_horizontal_radiation"][light]
    direct = done.columns["direct_normal_radiation"][light]
    np.testing.assert_allclose(
        diffuse, denver.column("diffuse_horizontal_radiation")[light] * ratio, rtol=1e-6, atol=0.01
    )
    most = denver.column("extraterrestrial_direct_normal_radiation")[light]
    expected = np.minimum(denver.column("direct_normal_radiation")[light] * ratio, most)
    np.testing.assert_allclose(direct, expected, rtol=1e-6, atol=0.01)
    dawn = (before == 0) & (denver.column("extraterrestrial_horizontal_radiation") > 0)
    assert np.array_equal(done.columns["diffuse_horizontal_radiation"][dawn], now[dawn])


def test_weather_noise__file_that_does_not_state_where_the_sun_is_stays_dark_at_night(folder: Path) -> None:
    weather = without_extraterrestrial(folder)
    done = noised(
        weather, direct_normal_radiation=ColumnNoise(sigma=50.0), diffuse_horizontal_radiation=ColumnNoise(sigma=50.0)
    )
    names = ("global_horizontal_radiation", "direct_normal_radiation", "diffuse_horizontal_radiation")
    dark = np.logical_and.reduce([weather.column(name) == 0 for name in names])
    assert dark.sum() > 3500
    assert all((done.columns[name][dark] == 0).all() for name in names)
    beam = weather.column("direct_normal_radiation") > 100
    implied = (weather.column(names[0]) - weather.column(names[2])) / np.where(beam, weather.column(names[1]), 1)
    total = done.columns[names[2]] + done.columns[names[1]] * np.clip(implied, 0, 1)
    np.testing.assert_allclose(done.columns[names[0]][beam], total[beam], atol=2e-4)


# Missing values


def test_weather_noise__missing_values_stay_missing_to_the_byte(folder: Path, denver: Weather) -> None:
    gaps = {}
    for name, missing in {
        "dry_bulb_temperature": 99.9,
        "dew_point_temperature": 99.9,
        "relative_humidity": 999.0,
        "wind_direction": 999.0,
        "wind_speed": 999.0,
        "horizontal_infrared_radiation_intensity": 9999.0,
        "direct_normal_radiation": 9999.0,
    }.items():
        gaps[name] = denver.column(name).copy()
        gaps[name][len(gaps) :: 20] = missing
    write(denver, folder / "gaps.epw", gaps)
    weather = read(folder / "gaps.epw")
    asked = ("dry_bulb_temperature", "relative_humidity", "wind_direction", "wind_speed", "direct_normal_radiation")
    done = noised(weather, **{name: ColumnNoise(sigma=3.0) for name in asked})
    write(weather, folder / "out.epw", done.columns)
    written = read(folder / "out.epw")
    for k, name in enumerate(gaps, 1):
        assert np.array_equal(written.column(name)[k::20], gaps[name][k::20])
        changed = written.column(name) != weather.column(name)
        assert changed[k + 10 :: 20].any()  # where nothing is missing


# Properties

PARAMETERS = st.tuples(st.floats(0.0, 30.0), st.floats(-20.0, 20.0), st.floats(0.1, 1000.0))
COLUMN_SETS = st.sampled_from(
    [
        ("dry_bulb_temperature",),
        ("relative_humidity",),
        ("dew_point_temperature",),
        ("dry_bulb_temperature", "relative_humidity"),
        ("dry_bulb_temperature", "dew_point_temperature", "direct_normal_radiation"),
        ("global_horizontal_radiation", "wind_speed", "wind_direction"),
        ("direct_normal_radiation", "diffuse_horizontal_radiation", "total_sky_cover", "opaque_sky_cover"),
        ("diffuse_horizontal_radiation", "atmospheric_station_pressure", "horizontal_infrared_radiation_intensity"),
    ]
)


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(COLUMN_SETS, PARAMETERS, st.floats(0.1, 100.0), st.integers(0, 2**32))
def test_weather_noise__hours_stay_possible(
    denver: Weather, columns: tuple[str, ...], parameters: tuple[float, float, float], scale: float, seed: int
) -> None:
    sigma, mu, tau_h = parameters
    noise = ColumnNoise(sigma=sigma * scale, mu=mu * scale, tau_h=tau_h)
    done = noised(denver, seed, **dict.fromkeys(columns, noise))
    now = {name: after(denver, done, name) for name in (*done.columns, "dry_bulb_temperature", "dew_point_temperature")}
    assert set(done.columns) <= {
        *columns,
        "dew_point_temperature",
        "relative_humidity",
        "horizontal_infrared_radiation_intensity",
        "global_horizontal_radiation",
        "direct_normal_radiation",
        "diffuse_horizontal_radiation",
    }
    assert (now["dew_point_temperature"] <= now["dry_bulb_temperature"]).all()
    limits = {
        "dry_bulb_temperature": (-70, 70),
        "dew_point_temperature": (-70, 70),
        "relative_humidity": (0, 100),
        "wind_speed": (0, 40),
        "wind_direction": (0, 360),
        "total_sky_cover": (0, 10),
        "opaque_sky_cover": (0, 10),
        "atmospheric_station_pressure": (31_000, 120_000),
        "horizontal_infrared_radiation_intensity": (0, math.inf),
    }
    for name, (low, high) in limits.items():
        if name in done.columns:
            assert low <= done.columns[name].min()
            assert done.columns[name].max() <= high
    night = denver.column("extraterrestrial_horizontal_radiation") == 0
    for name in ("global_horizontal_radiation", "direct_normal_radiation", "diffuse_horizontal_radiation"):
        if name in done.columns:
            assert done.columns[name].min() >= 0
            assert np.array_equal(done.columns[name][night], denver.column(name)[night])
    if "direct_normal_radiation" in done.columns:
        most = denver.column("extraterrestrial_direct_normal_radiation")
        assert (done.columns["direct_normal_radiation"] <= most)[~night].all()


@settings(max_examples=examples(20), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(0.0, 49.0), st.floats(51.0, 100.0), st.integers(0, 2**32))
def test_noise__respects_configured_limits(denver: Weather, low: float, high: float, seed: int) -> None:
    done = noised(denver, seed, relative_humidity=ColumnNoise(sigma=40.0, low=low, high=high))
    humidity = done.columns["relative_humidity"]
    assert low - 5e-5 <= humidity.min()
    assert humidity.max() <= high + 5e-5
    assert np.isclose(humidity, low, atol=1e-4).any()
    assert np.isclose(humidity, high, atol=1e-4).any()


def test_weather_noise__wind_direction_goes_round(denver: Weather) -> None:
    done = noised(denver, wind_direction=ColumnNoise(sigma=0, mu=100.0))
    turned = done.columns["wind_direction"]
    np.testing.assert_allclose(turned, (denver.column("wind_direction") + 100.0) % 360.0, atol=1e-4)
    assert turned.max() < 360.0


# The real thing


def test_weather_noise__weather_that_was_written_is_what_energyplus_simulates(denver: Weather, folder: Path) -> None:
    done = noised(
        denver,
        4,
        dry_bulb=ColumnNoise(sigma=2.5),
        rh=ColumnNoise(sigma=10.0, low=5, high=95),
        wind_speed=ColumnNoise(sigma=1),
    )
    write(denver, folder / "noisy.epw", done.columns)
    # Infrared, moisture and the like as EnergyPlus has them; at whole hours it does not interpolate.
    names = [DRY_BULB, "Site Wind Speed", "Site Horizontal Infrared Radiation Rate per Area"]
    names += ["Site Outdoor Air Dewpoint Temperature"]
    ran = run(folder / "run", folder / "noisy.epw", date(2017, 7, 3), date(2017, 7, 9), variables=names)
    assert ran.code == 0
    assert "** Severe  **" not in ran.errors
    hours = slice((31 + 28 + 31 + 30 + 31 + 30 + 2) * 24, (31 + 28 + 31 + 30 + 31 + 30 + 9) * 24)
    values = ran.values[0][STEPS_PER_HOUR - 1 :: STEPS_PER_HOUR]
    assert np.array_equal(values[:, 0], done.columns["dry_bulb_temperature"][hours])
    assert np.array_equal(values[:, 1], done.columns["wind_speed"][hours])
    np.testing.assert_allclose(values[:, 2], done.columns["horizontal_infrared_radiation_intensity"][hours], atol=1e-3)
    # EnergyPlus's own psychrometrics see the same dew point in our relative humidity.
    assert np.abs(values[:, 3] - done.columns["dew_point_temperature"][hours]).max() < 0.1
