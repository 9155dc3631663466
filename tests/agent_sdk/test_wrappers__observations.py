"""Wrappers of observations."""

import math
from collections.abc import Callable
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from support.fakes import NAMES, FakeBuilding
from support.wrapped_fakes import DRY, MIDDLE, WIND, episode, fake, named

from zenostat import wrappers as w
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.wrappers.observation import cyclic
from zenostat.agent_sdk.wrappers.weather_forecast import ErrorModel, error_path
from zenostat.topics.errors import InvalidConfig, UnknownName


def test_wrappers__cyclic_time_by_hand() -> None:
    """3 July 2017 is a Monday, day 184 of 365."""
    env = w.CyclicTime(fake(steps_per_hour=4))
    steps = episode(env, lambda: MIDDLE)
    first, after = named(env, steps[0][0]), named(env, steps[26][0])
    assert set(first) == {n for n in NAMES if n not in ("month", "day_of_week", "hour", "minutes")} | {
        f"{field}_{of}" for field in ("hour", "day_of_week", "day_of_year") for of in ("sin", "cos")
    }
    assert (first["hour_sin"], first["hour_cos"]) == (0.0, 1.0)
    assert steps[26][3]["time"] == "2017-07-03T06:30:00"
    turn = 2 * math.pi * 6.25 / 24  # the timestep began at 6:15
    assert after["hour_sin"] == pytest.approx(math.sin(turn), abs=1e-6)
    assert after["hour_cos"] == pytest.approx(math.cos(turn), abs=1e-6)
    assert after["day_of_week_sin"] == pytest.approx(math.sin(2 * math.pi / 7), abs=1e-6)
    assert after["day_of_year_cos"] == pytest.approx(math.cos(2 * math.pi * 183 / 365), abs=1e-6)
    last = named(env, steps[-1][0])
    assert steps[-1][3]["time"] == "2017-07-04T00:00:00"
    assert last["day_of_week_sin"] == after["day_of_week_sin"], "the last timestep began on Monday"
    with pytest.raises(InvalidConfig, match="no field 'month'"):
        w.CyclicTime(fake(), ["month"])


def test_wrappers__cyclic_works_on_any_leading_shape() -> None:
    parts = np.array([[[0.25, 0.0]], [[0.5, 0.75]]])
    assert cyclic(parts) == pytest.approx(np.array([[[1.0, 0, 0, 1]], [[0, -1, -1, 0]]]), abs=1e-12)


def test_wrappers__previous_observation_begins_anew() -> None:
    env = w.PreviousObservation(fake(), ["core"])
    for _ in range(2):
        env.reset(seed=1)
        seen = [named(env, env.step(MIDDLE)[0]) for _ in range(3)]
        assert [values["core"] for values in seen] == [24.5, 25.25, 25.625]
        assert [values["previous_core"] for values in seen] == [23.0, 24.5, 25.25]


def test_wrappers__metric_observation_is_the_peak_so_far() -> None:
    env = w.MetricObservation(FakeEnv(zones=1, steps_per_hour=1, reward={"kind": "peak"}), ["peak_kw"])
    for _ in range(2):
        steps = episode(env, env.action_space.sample)
        seen = [named(env, observation)["peak_kw"] for observation, *_ in steps]
        assert seen[0] == 0.0
        assert seen[1:] == [np.float32(info["reward_metrics"]["peak_kw"]) for *_, info in steps[1:]]
        assert seen == sorted(seen)
        assert seen[-1] > 0.0


def test_wrappers__metric_that_the_reward_lacks_is_named() -> None:
    env = w.MetricObservation(fake(), ["peak_kw"])
    env.reset(seed=0)
    with pytest.raises(InvalidConfig, match="the reward has no metric 'peak_kw'"):
        env.step(MIDDLE)


def test_wrappers__setpoint_difference_and_reduced_observation() -> None:
    env = w.SetpointDifference(fake(), {"excess": ["core", "core_setpoint"]})
    assert named(env, env.reset(seed=1)[0])["excess"] == 23.0 - 26.0
    few = w.ReducedObservation(env, ["excess", "hour"])
    observation, *_, info = few.step(MIDDLE)
    assert observation.tolist() == [24.5 - 26.0, 0.0]
    assert few.observation_space.high.tolist() == [np.inf, 23.0]
    assert sorted(info["dropped"]) == sorted(set(NAMES) - {"hour"})
    assert (info["dropped"]["core"], info["dropped"]["minutes"]) == (24.5, 60.0)


def test_wrappers__forecast_is_the_upcoming_weather() -> None:
    env = w.WeatherForecast(fake(), [DRY], n=4, spacing_h=1.0)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for seed in (1, 2):
        steps = episode(env, lambda: MIDDLE, seed)
        table = [named(env, observation) for observation, *_ in steps]
        for at in range(len(table) - 4):
            for ahead in range(1, 5):
                assert table[at][f"{DRY}_in_{ahead}h"] == table[at + ahead]["outdoor"]
        assert table[-1][f"{DRY}_in_4h"] == np.float32(bare.series[DRY][27]), "beyond the episode's end"
    assert bare.asked == [[DRY], [DRY]], "once an episode, after its reset"


def test_wrappers__forecast_is_linear_between_rows_and_holds_beyond_them() -> None:
    env = w.WeatherForecast(fake(steps_per_hour=4), [DRY, WIND], n=2, spacing_h=0.5)
    observation, _ = env.reset(seed=1)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    rows = bare.series[DRY]
    seen = named(env, observation)
    assert seen[f"{DRY}_in_0.5h"] == pytest.approx(0.5 * rows[23] + 0.5 * rows[0], rel=1e-6), "begins as the day ends"
    assert seen[f"{DRY}_in_1h"] == np.float32(rows[0])
    for _ in range(3):
        observation, *_ = env.step(MIDDLE)
    seen = named(env, observation)
    assert seen[f"{DRY}_in_0.5h"] == pytest.approx(0.75 * rows[0] + 0.25 * rows[1], rel=1e-6)
    assert seen[f"{WIND}_in_1h"] == 52.5
    for _ in range(4 * 10):
        observation, *_ = env.step(MIDDLE)
    assert named(env, observation)[f"{WIND}_in_0.5h"] == pytest.approx(337.5, abs=1e-4), "over north, from 330 to 0"
    far = w.WeatherForecast(fake(), [DRY], n=1, spacing_h=1000.0)
    assert far.reset(seed=1)[0][-1] == np.float32(far.unwrapped.series[DRY][-1])  # type: ignore[attr-defined]


def test_wrappers__what_a_forecast_cannot_be() -> None:
    with pytest.raises(UnknownName, match="no weather column 'dry'"):
        w.WeatherForecast(fake(), ["dry"]).reset()
    with pytest.raises(InvalidConfig, match="no values of 'snow_depth'"):
        w.WeatherForecast(fake(), ["snow_depth"]).reset()
    with pytest.raises(InvalidConfig, match="no column 'x'"):
        w.WeatherForecast(fake(), [DRY], errors={"x": 1.0})
    with pytest.raises(InvalidConfig, match="an error is sigma"):
        w.WeatherForecast(fake(), [DRY], errors={DRY: {"sigma": -1.0}})
    for wrong in ({"sigma": 1e308}, {"sigma": 1.0, "mu": [-1e10, 0.0]}):
        with pytest.raises(InvalidConfig, match=r"sigma and mu up to 1e\+09; got"):
            w.WeatherForecast(fake(), [DRY], errors={DRY: wrong})
    with pytest.raises(InvalidConfig, match=r"errors: {column: error} expected, got 3"):
        w.WeatherForecast(fake(), [DRY], errors=3)  # type: ignore[arg-type]
    with pytest.raises(InvalidConfig, match=r"n = 1\.5; a whole number"):
        w.WeatherForecast(fake(), [DRY], n=1.5)  # type: ignore[arg-type]
    with pytest.raises(InvalidConfig, match="n = '6'; a whole number"):
        w.WeatherForecast(fake(), [DRY], n="6")  # type: ignore[arg-type]
    with pytest.raises(InvalidConfig, match="spacing_h = '1'; a number of hours"):
        w.WeatherForecast(fake(), [DRY], spacing_h="1")  # type: ignore[arg-type]
    with pytest.raises(InvalidConfig, match="n and spacing_h above 0"):
        w.WeatherForecast(fake(), [DRY], n=0)


def test_wrappers__errors_by_hand() -> None:
    """Four standard deviations, each from a formula."""
    one = error_path(np.array([1.0, -2.0]), np.array([6.0, 24.0]), ErrorModel(3.0))
    assert one == pytest.approx([1.5, 1.5 - 2 * 3 * math.sqrt(0.75)])
    phi = math.exp(-6 / 12)
    two = error_path(np.array([1.0, 1.0]), np.array([6.0, 12.0]), ErrorModel(3.0, 12.0))
    spread = 3 * math.sqrt(1 - phi**2)
    assert two == pytest.approx([spread, phi * spread + spread])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "deviation"),
    [
        (2.0, lambda h: 2.0 * math.sqrt(h / 24)),
        ({"sigma": 2.0, "tau_h": 6.0}, lambda h: 2.0 * math.sqrt(1 - math.exp(-h / 3.0))),
    ],
)
def test_forecast_errors__grow_with_the_horizon(error: Any, deviation: Callable[[float], float]) -> None:
    """A year of forecasts; the standard error of a deviation from 8,760 paths is below 1 %."""
    forecast = {"columns": [DRY], "n": 2, "spacing_h": 12.0}
    right, wrong = (w.WeatherForecast(fake(days=365), **forecast, errors=e) for e in (None, {DRY: error}))
    difference = np.array([
        b[0][-2:].astype(float) - a[0][-2:]
        for a, b in zip(episode(right, lambda: MIDDLE), episode(wrong, lambda: MIDDLE), strict=True)
    ])  # fmt: skip
    assert difference.std(axis=0) == pytest.approx([deviation(12.0), deviation(24.0)], rel=0.04)
    assert np.abs(difference.mean(axis=0)).max() < 0.1


def test_wrappers__errors_have_a_mean_limits_and_ranges() -> None:
    """Without a spread the error is its mean: that of a day ahead, or the one that it ends at."""
    truth = w.WeatherForecast(fake(), ["dry_bulb_temperature"], n=3, spacing_h=12.0)
    drifting = w.WeatherForecast(
        fake(), ["dry_bulb_temperature"], 3, 12.0, {"dry_bulb_temperature": {"sigma": 0, "mu": 2}}
    )
    biased = w.WeatherForecast(
        fake(), ["dry_bulb_temperature"], 3, 12.0, {"dry_bulb_temperature": {"sigma": 0, "mu": -2, "tau_h": 12}}
    )
    seen, drifted, low = (env.reset(seed=1)[0][-3:] for env in (truth, drifting, biased))
    assert drifted - seen == pytest.approx([1.0, 2.0, 3.0], abs=1e-5)
    assert low - seen == pytest.approx(-2 * (1 - np.exp([-1.0, -2.0, -3.0])), abs=1e-5)
    limited = {"sigma": [1.0, 5.0], "mu": [3.0, 4.0], "tau_h": [1.0, 2.0], "low": -2.0, "high": 60.0}
    env = w.WeatherForecast(fake(), ["dry_bulb_temperature"], 3, 12.0, {"dry_bulb_temperature": limited})
    first, again, other = (env.reset(seed=seed)[0][-3:] for seed in (1, 1, 2))
    assert not np.array_equal(first, other)
    assert np.array_equal(first, again)
    assert env.observation_space.low[-1] == -2.0
    assert env.observation_space.high[-1] == 60.0
    capped = w.WeatherForecast(
        fake(), ["dry_bulb_temperature"], 3, 12.0, {"dry_bulb_temperature": limited | {"high": 1.0}}
    )
    assert max(capped.reset(seed=1)[0][-3:]) <= 1.0 < max(first)


def test_wrappers__two_forecasts_of_a_chain_err_differently_and_a_seed_rules_both() -> None:
    one = w.WeatherForecast(fake(), [DRY], n=1, errors={DRY: 1.0})
    two = w.WeatherForecast(
        w.PreviousObservation(one, ["core"]), ["relative_humidity"], n=1, errors={"relative_humidity": 1.0}
    )
    bare: FakeBuilding = two.unwrapped  # type: ignore[assignment]
    errors = []
    for seed in (7, 7, 8, None):
        observation = two.reset(seed=seed)[0]
        seen = named(two, observation)
        ahead = {name: seen[f"{name}_in_1h"] - bare.outdoor(name, 1.0) for name in (DRY, "relative_humidity")}
        errors.append(tuple(ahead.values()))
    assert errors[0] == errors[1]
    assert len({error[0] for error in errors}) == 3
    assert errors[0][0] != pytest.approx(errors[0][1], abs=1e-4)


def test_wrappers__signals_now_and_ahead() -> None:
    class Clock:
        def at(self, begin: datetime) -> float:
            return begin.day * 100 + begin.hour

    table = {"table": [{"value": 0.3, "hours": [8, 20]}], "otherwise": 0.1, "unit": "EUR/kWh"}
    env = w.TimeSeriesObservation(fake(), {"price": table, "clock": Clock(), "fee": 2}, hours=[0, 3])
    assert w.names_of(env)[-6:] == ("price", "price_in_3h", "clock", "clock_in_3h", "fee", "fee_in_3h")
    steps = episode(env, lambda: MIDDLE)
    signals = [observation[-6:].tolist() for observation, *_ in steps]
    small, large = np.float32(0.1), np.float32(0.3)
    assert signals[0] == [small, small, 300, 303, 2, 2]
    assert signals[5] == [small, large, 305, 308, 2, 2], "the timestep that the next action rules begins at 5:00"
    assert signals[22] == [small, small, 322, 401, 2, 2]
    with pytest.raises(InvalidConfig, match=r"TimeSeriesObservation: price: .*a time series expected"):
        w.TimeSeriesObservation(fake(), {"price": "cheap"})
    with pytest.raises(InvalidConfig, match="numbers from 0 on"):
        w.TimeSeriesObservation(fake(), {"price": 1}, hours=[-1])
    for hours in ([1e12], [np.nan], "12", ["1"], 5, []):
        with pytest.raises(InvalidConfig, match="numbers from 0 on, at most a year"):
            w.TimeSeriesObservation(fake(), {"price": 1}, hours=hours)  # type: ignore[arg-type]
    with pytest.raises(InvalidConfig, match="each of the hours once"):
        w.TimeSeriesObservation(fake(), {"price": 1}, hours=[1, 1.0])
    with pytest.raises(InvalidConfig, match="price: a finite number expected, got nan"):
        w.TimeSeriesObservation(fake(), {"price": float("nan")})
