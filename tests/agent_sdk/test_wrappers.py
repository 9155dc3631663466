"""Wrappers on a building without EnergyPlus, by hand-computed values."""

from __future__ import annotations

import copy
import csv
import json
import math
import sys
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import (
    FlattenObservation,
    FrameStackObservation,
    NormalizeObservation,
    NormalizeReward,
    RescaleAction,
    TimeAwareObservation,
    TimeLimit,
    TransformObservation,
)
from support.fakes import NAMES, FakeBuilding

from zenostat import wrappers as w
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.agent_sdk.time_series import HourlySeries
from zenostat.agent_sdk.wrappers.base import Infos
from zenostat.agent_sdk.wrappers.incremental import rounded
from zenostat.agent_sdk.wrappers.observation import cyclic
from zenostat.agent_sdk.wrappers.weather_forecast import ErrorModel, error_path
from zenostat.topics.errors import InvalidAction, InvalidConfig, UnknownName

MIDDLE = np.array([20.0, 26.0], np.float32)
DRY, WIND = "dry_bulb_temperature", "wind_direction"

PRICE = {"hourly": list(range(8760)), "unit": "EUR/MWh"}

CHAINS: dict[str, list[dict[str, Any]]] = {
    "CyclicTime": [{"wrapper": "CyclicTime"}],
    "PreviousObservation": [{"wrapper": "PreviousObservation", "names": ["core", "electricity"]}],
    "WeatherForecast": [
        {"wrapper": "WeatherForecast", "columns": [DRY, "relative_humidity", WIND], "n": 3, "spacing_h": 0.5}
    ],
    "WeatherForecast with errors": [
        {"wrapper": "WeatherForecast", "columns": [DRY, "relative_humidity"],
         "errors": {DRY: 2.0, "relative_humidity": {"sigma": 80.0, "tau_h": 4.0}}}
    ],
    "TimeSeriesObservation": [{"wrapper": "TimeSeriesObservation", "signals": {"price": PRICE}, "hours": [0, 2]}],
    "SetpointDifference": [{"wrapper": "SetpointDifference", "pairs": {"core_excess": ["core", "core_setpoint"]}}],
    "ReducedObservation": [{"wrapper": "ReducedObservation", "keep": ["humidity", "core"]}],
    "IncrementalAction": [
        {"wrapper": "IncrementalAction", "increments": {"cool": [1.0, 0.25]}, "initial": {"cool": 26.0}}
    ],
    "DiscreteIncrementalAction": [
        {"wrapper": "DiscreteIncrementalAction", "steps": {"cool": 0.5}, "initial": {"heat": 20.0, "cool": 26.0}}
    ],
    "ChangingContext": [
        {"wrapper": "ChangingContext", "schedule": {"07:00": {"occupants": 1.0}, "18:00": {"occupants": 0.25}}}
    ],
    "RewardVector": [{"wrapper": "RewardVector", "terms": ["comfort", "energy"]}],
    "NumericInfos": [{"wrapper": "NumericInfos"}],
    "many": [
        {"wrapper": "CyclicTime", "fields": ["hour"], "replace": False},
        {"wrapper": "SetpointDifference", "pairs": {"excess": ["core", "core_setpoint"]}},
        {"wrapper": "PreviousObservation", "names": ["excess"]},
        {"wrapper": "WeatherForecast", "columns": [DRY], "errors": {DRY: 1.0}},
        {"wrapper": "ReducedObservation", "keep": ["previous_excess", "hour_sin", f"{DRY}_in_5h"]},
        {"wrapper": "IncrementalAction", "increments": {"heat": 0.5}, "initial": {"heat": 20.0}},
        {"wrapper": "NormalizeReward", "gamma": 0.9},
    ],
}  # fmt: skip
each_chain = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)


def fake(**arguments: Any) -> FakeBuilding:
    return FakeBuilding(**{"steps_per_hour": 1, **arguments})


def fakes(count: int = 2, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any) -> SyncVectorEnv[Any, Any]:
    return SyncVectorEnv([lambda: fake(**arguments)] * count, autoreset_mode=mode)


def named(env: Any, observation: Any) -> dict[str, float]:
    return dict(zip(w.names_of(env), np.asarray(observation).tolist(), strict=True))


def episode(env: Any, act: Callable[[], Any], seed: int | None = 0) -> list[tuple[Any, ...]]:
    """All that comes out of an episode; sample 0 has None for its reward."""
    observation, info = env.reset(seed=seed)
    steps: list[tuple[Any, ...]] = [(observation, None, False, info)]
    while not steps[-1][2]:
        observation, reward, _, truncated, info = env.step(act())
        steps.append((observation, reward, truncated, info))
    return steps


# What holds for all


@each_chain
@pytest.mark.filterwarnings("ignore:.*Box (observation|action) space (minimum|maximum) value is (-)?infinity.*")
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space.*")
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version.*")
@pytest.mark.filterwarnings("ignore:.*The reward returned by `step.*")
@pytest.mark.filterwarnings("ignore:.*Not able to test alternative render modes.*")
def test_gymnasiums_checker_passes(chain: list[dict[str, Any]]) -> None:
    fixed = [one for one in chain if one["wrapper"] != "NormalizeReward"]  # statistics go on over a reset
    check_env(w.apply_wrappers(fake(), fixed))


@pytest.mark.slow
@each_chain
def test_observations_lie_in_their_space_for_a_year(chain: list[dict[str, Any]]) -> None:
    env = w.apply_wrappers(fake(begin="2016-01-01T00:00:00", days=366), chain)
    env.action_space.seed(1)
    for observation, _, _, _ in episode(env, env.action_space.sample):
        assert observation.dtype == np.float32
        assert env.observation_space.contains(observation)
    assert len(w.names_of(env)) == env.observation_space.shape[0]


@each_chain
def test_an_episode_is_the_same_to_the_bit_with_the_same_seed(chain: list[dict[str, Any]]) -> None:
    env = w.apply_wrappers(fake(), chain)
    seen = []
    for seed in (3, 3, 4):
        env.action_space.seed(1)
        seen.append([observation.tobytes() for observation, *_ in episode(env, env.action_space.sample, seed)])
    assert seen[0] == seen[1]
    if "observation" not in str(chain) and "Action" not in str(chain[0]["wrapper"]):
        assert seen[1] != seen[2]


@each_chain
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_vector_is_equal_to_its_slots(chain: list[dict[str, Any]], mode: AutoresetMode) -> None:
    """Through the end of an episode and into the next, for which there is no seed."""
    if chain[-1]["wrapper"] == "NormalizeReward":
        chain = chain[:-1]  # statistics of all slots together
    many = w.apply_wrappers(fakes(2, mode), chain)
    singles = [w.apply_wrappers(fake(), chain) for _ in range(2)]
    many.action_space.seed(5)
    starts = [env.reset(seed=9 + slot) for slot, env in enumerate(singles)]
    rows, infos = many.reset(seed=9)
    assert many.observation_space.contains(rows)
    assert rows.tobytes() == np.stack([observation for observation, _ in starts]).tobytes()
    over = [False, False]
    for _ in range(30):
        actions = many.action_space.sample()
        if mode is AutoresetMode.DISABLED and any(over):
            rows, infos = many.reset(options={"reset_mask": np.array(over)})
            assert rows.tobytes() == np.stack([env.reset()[0] for env in singles]).tobytes()
            over = [False, False]
        rows, rewards, _, truncated, infos = many.step(actions)
        for slot, env in enumerate(singles):
            if over[slot] and mode is AutoresetMode.NEXT_STEP:
                observation, info = env.reset()
                reward, ended = 0.0 * np.asarray(rewards[slot]), False
            else:
                observation, reward, _, ended, info = env.step(actions[slot])
            last = observation
            if ended and mode is AutoresetMode.SAME_STEP:
                assert infos["final_obs"][slot].tobytes() == last.tobytes()
                final = infos["final_info"]
                observation = env.reset()[0]
            else:
                final = infos
            assert rows[slot].tobytes() == observation.tobytes()
            assert np.array_equal(rewards[slot], reward)
            assert truncated[slot] == ended
            over[slot] = ended and mode is not AutoresetMode.SAME_STEP
            for name, value in info.get("dropped", {}).items():
                assert final["dropped"][name][slot] == value
                assert final["dropped"][f"_{name}"][slot]
    many.close()


def test_a_reset_of_some_slots_leaves_the_others() -> None:
    many = w.apply_wrappers(fakes(2, AutoresetMode.DISABLED), CHAINS["PreviousObservation"])
    many.reset(seed=1)
    actions = np.stack([MIDDLE, MIDDLE])
    before, *_ = many.step(actions)
    asked = {"reset_mask": np.array([True, False])}
    rows, _ = many.reset(options=asked)
    assert list(asked) == ["reset_mask"], "the caller's options are his own"
    assert rows[1].tobytes() == before[1].tobytes()
    assert rows[0, -2:].tolist() == [23.0, 0.0]
    after, *_ = many.step(actions)
    assert after[:, -2].tolist() == [23.0, 24.5], "one step ago: 23, and 23 + (26 - 23) / 2"


def test_a_reset_at_an_episodes_end_is_no_autoreset() -> None:
    many = w.PreviousObservation(fakes(2), ["core"])
    actions = np.stack([MIDDLE, MIDDLE])
    many.reset(seed=1)
    for _ in range(24):
        many.step(actions)
    many.reset()
    seen = [many.step(actions)[0][:, -1].tolist() for _ in range(2)]
    assert seen == [[23.0, 23.0], [24.5, 24.5]]


def test_infos_of_a_vector_are_read_by_their_masks() -> None:
    terms = {"energy": np.array([1.0, 2.0]), "_energy": np.array([True, False]), "_own": np.array([3.0, 4.0])}
    infos = Infos({"reward_terms": terms, "step": np.array([5, 6]), "_step": np.array([False, True])}, [1, 0])
    assert [infos.get(row, "step") for row in (0, 1)] == [6, None]
    assert [infos.get(row, "reward_terms") for row in (0, 1)] == [{"_own": 4.0}, {"energy": 1.0, "_own": 3.0}]
    assert infos.get(0, "time") is None


@each_chain
def test_chains_are_data(chain: list[dict[str, Any]]) -> None:
    env = w.apply_wrappers(TimeLimit(fake(), 500), chain)
    assert w.wrappers_of(env) == chain == json.loads(json.dumps(w.wrappers_of(env)))
    again = w.apply_wrappers(fake(), w.wrappers_of(env))
    assert again.observation_space == env.observation_space
    ours = [one for one in chain if one["wrapper"] != "NormalizeReward"]
    assert w.wrappers_of(w.apply_wrappers(fakes(), ours)) == ours


def test_what_was_wrapped_by_hand_is_data_too() -> None:
    env = w.CyclicTime(
        FrameStackObservation(RescaleAction(fake(), np.float32(-1.0), np.array([1, 2], np.float32)), 3).env, ("hour",)
    )
    rescaled = {"wrapper": "RescaleAction", "min_action": -1.0, "max_action": [1, 2]}
    assert w.wrappers_of(env) == [rescaled, {"wrapper": "CyclicTime", "fields": ["hour"]}]
    stack = {"wrapper": "FrameStackObservation", "stack_size": 3}
    assert w.wrappers_of(FrameStackObservation(fake(), 3)) == [stack]
    assert w.wrappers_of(w.CyclicTime(fake())) == [{"wrapper": "CyclicTime"}]  # made without arguments
    price = HourlySeries(hourly=tuple(range(8760)), unit="g/kWh")
    (wrapper,) = w.wrappers_of(w.TimeSeriesObservation(fake(), {"carbon": price}))
    assert w.apply_wrappers(fake(), [wrapper]).reset()[0][-1] == 24 * (31 + 28 + 31 + 30 + 31 + 30 + 2)


@pytest.mark.parametrize(
    ("chain", "text"),
    [
        ([{"wrapper": "CyclicTim"}], r"wrappers\[0\]: there is no wrapper 'CyclicTim'; did you mean 'CyclicTime'"),
        ([{"wrapper": "os.system"}], "there is no wrapper"),
        (["CyclicTime"], r"wrappers\[0\]: 'CyclicTime' is not a wrapper; write"),
        ([{"wrapper": "CyclicTime", "field": ["hour"]}], "CyclicTime has no argument 'field'; did you mean 'fields'"),
        ([{"wrapper": "PreviousObservation"}], "missing a required argument: 'names'"),
        ([{"wrapper": "RescaleAction", "min_action": 0}], "RescaleAction: .*'max_action'"),
        (
            [{"wrapper": "RewardVector", "terms": ["energy"]}, {"wrapper": "NormalizeReward"}],
            r"wrappers\[1\]: NormalizeReward needs a scalar reward; apply it before RewardVector",
        ),
        (
            [{"wrapper": "NormalizeObservation"}, *CHAINS["SetpointDifference"]],
            "SetpointDifference needs values in their units; apply it before NormalizeObservation",
        ),
        (
            [{"wrapper": "FrameStackObservation", "stack_size": 2}, {"wrapper": "CyclicTime"}],
            "after FrameStackObservation values have no names; apply it after the wrappers that need them",
        ),
        (
            [{"wrapper": "RescaleAction", "min_action": -1, "max_action": 1}, *CHAINS["IncrementalAction"]],
            "IncrementalAction changes values in their units; apply it before RescaleAction",
        ),
        (
            [*CHAINS["DiscreteIncrementalAction"], *CHAINS["IncrementalAction"]],
            "apply it before DiscreteIncrementalAction",
        ),
    ],
)
def test_chains_that_cannot_be(chain: list[Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        w.apply_wrappers(fake(), chain)


@pytest.mark.parametrize("low", [-1, -1.0, [-1.0, -0.5]])
def test_bounds_of_gymnasiums_wrappers_are_plain_numbers(low: Any) -> None:
    chain = [{"wrapper": "RescaleAction", "min_action": low, "max_action": 1.0}]
    for bare in (fake(), fakes()):
        env = w.apply_wrappers(bare, chain)
        assert env.action_space.dtype == np.float32
        assert np.broadcast_to(env.action_space.low, (2, 2))[1].tolist() == np.broadcast_to(low, 2).tolist()
        assert w.wrappers_of(env) == chain


def test_a_wrapper_without_a_vector_form_and_one_that_is_no_data() -> None:
    with pytest.raises(InvalidConfig, match="FrameStackObservation has no vector form; wrap each environment"):
        w.apply_wrappers(fakes(), [{"wrapper": "FrameStackObservation", "stack_size": 2}])
    plain = fake()
    lambdas = TransformObservation(plain, lambda o: o, plain.observation_space)
    with pytest.raises(InvalidConfig, match="TransformObservation cannot be written as data"):
        w.wrappers_of(lambdas)
    with pytest.raises(InvalidConfig, match="ChangingContext: schedule: function cannot be written as data"):
        w.wrappers_of(w.ChangingContext(fake(), lambda time, random: {}))


# Names


def test_names_at_every_level() -> None:
    inner = w.PreviousObservation(fake(), ["core"])
    outer = w.ReducedObservation(NormalizeObservation(inner), ["previous_core", "hour"])
    assert inner.observation_names == (*NAMES, "previous_core")
    assert outer.get_wrapper_attr("observation_names") == ("previous_core", "hour")
    assert w.names_of(outer.env) == inner.observation_names
    assert w.names_of(outer) == w.names_of(NormalizeReward(outer)) == ("previous_core", "hour")
    assert outer.observation_dict([1.0, 2.0]) == {"previous_core": 1.0, "hour": 2.0}
    assert w.names_of(w.IncrementalAction(inner, {"cool": 1}, {"cool": 26})) == inner.observation_names
    assert w.names_of(TimeAwareObservation(TimeLimit(fake(), 99))) == (*NAMES, "time")
    assert w.names_of(FlattenObservation(inner)) == inner.observation_names
    assert w.names_of(gym.wrappers.vector.NormalizeObservation(w.CyclicTime(fakes(), ["hour"])))[-1] == "hour_cos"
    with pytest.raises(InvalidConfig, match="after FrameStackObservation values have no names"):
        w.names_of(FlattenObservation(FrameStackObservation(inner, 2)))

    class Strange(gym.ObservationWrapper[Any, Any, Any]):
        def observation(self, observation: Any) -> Any:
            return observation[::-1]

    with pytest.raises(InvalidConfig, match="after Strange values have no names; give its class `observation_names`"):
        w.names_of(Strange(inner))


def test_action_names() -> None:
    assert w.action_names_of(w.CyclicTime(fake())) == ("heat", "cool")
    moved = w.apply_wrappers(fake(), CHAINS["DiscreteIncrementalAction"])
    assert w.action_names_of(w.CyclicTime(moved)) == ("cool",)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda env: w.PreviousObservation(env, ["cor"]),
        lambda env: w.ReducedObservation(env, ["core", "cor"]),
        lambda env: w.SetpointDifference(env, {"excess": ("cor", "core_setpoint")}),
    ],
)
def test_a_name_that_is_not_there_has_near_names(wrong: Callable[[Any], Any]) -> None:
    with pytest.raises(InvalidConfig, match="no observation 'cor'; did you mean 'core'"):
        wrong(fake())


def test_a_name_that_is_there_already() -> None:
    with pytest.raises(InvalidConfig, match="the observation already has 'core'"):
        w.SetpointDifference(fake(), {"core": ("core", "core_setpoint")})
    with pytest.raises(InvalidConfig, match="'core' is listed twice"):
        w.ReducedObservation(fake(), ["core", "core"])


# Observations


def test_cyclic_time_by_hand() -> None:
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


def test_cyclic_works_on_any_leading_shape() -> None:
    parts = np.array([[[0.25, 0.0]], [[0.5, 0.75]]])
    assert cyclic(parts) == pytest.approx(np.array([[[1.0, 0, 0, 1]], [[0, -1, -1, 0]]]), abs=1e-12)


def test_previous_observation_begins_anew() -> None:
    env = w.PreviousObservation(fake(), ["core"])
    for _ in range(2):
        env.reset(seed=1)
        seen = [named(env, env.step(MIDDLE)[0]) for _ in range(3)]
        assert [values["core"] for values in seen] == [24.5, 25.25, 25.625]
        assert [values["previous_core"] for values in seen] == [23.0, 24.5, 25.25]


def test_setpoint_difference_and_reduced_observation() -> None:
    env = w.SetpointDifference(fake(), {"excess": ["core", "core_setpoint"]})
    assert named(env, env.reset(seed=1)[0])["excess"] == 23.0 - 26.0
    few = w.ReducedObservation(env, ["excess", "hour"])
    observation, *_, info = few.step(MIDDLE)
    assert observation.tolist() == [24.5 - 26.0, 0.0]
    assert few.observation_space.high.tolist() == [np.inf, 23.0]
    assert sorted(info["dropped"]) == sorted(set(NAMES) - {"hour"})
    assert (info["dropped"]["core"], info["dropped"]["minutes"]) == (24.5, 60.0)


def test_the_forecast_is_the_weather_that_comes() -> None:
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


def test_the_forecast_is_linear_between_rows_and_holds_beyond_them() -> None:
    env = w.WeatherForecast(fake(steps_per_hour=4), [DRY, WIND], n=2, spacing_h=0.5)
    observation, _ = env.reset(seed=1)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    rows = bare.series[DRY]
    seen = named(env, observation)
    assert seen[f"{DRY}_in_0.5h"] == seen[f"{DRY}_in_1h"] == np.float32(rows[0]), "before the first row"
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


def test_what_a_forecast_cannot_be() -> None:
    with pytest.raises(UnknownName, match="no weather column 'dry'"):
        w.WeatherForecast(fake(), ["dry"]).reset()
    with pytest.raises(InvalidConfig, match="no values of 'snow_depth'"):
        w.WeatherForecast(fake(), ["snow_depth"]).reset()
    with pytest.raises(InvalidConfig, match="no column 'x'"):
        w.WeatherForecast(fake(), [DRY], errors={"x": 1.0})
    with pytest.raises(InvalidConfig, match="an error is sigma"):
        w.WeatherForecast(fake(), [DRY], errors={DRY: {"sigma": -1.0}})
    with pytest.raises(InvalidConfig, match="n and spacing_h above 0"):
        w.WeatherForecast(fake(), [DRY], n=0)


def test_errors_by_hand() -> None:
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


def test_errors_have_a_mean_limits_and_ranges() -> None:
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


def test_two_forecasts_of_a_chain_err_differently_and_a_seed_rules_both() -> None:
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


def test_signals_now_and_ahead() -> None:
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


# Actions


def test_incremental_action_by_hand() -> None:
    env = w.IncrementalAction(fake(), {"cool": [1.0, 0.25]}, {"cool": 29.0})
    assert (env.action_space.low.tolist(), env.action_space.high.tolist()) == ([15.0, -1.0], [22.5, 1.0])
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for _ in range(2):
        env.reset(seed=1)
        for increment in (0.3, 0.9, 1.0, -0.1, -0.2):
            env.step(np.array([18.0, increment], np.float32))
        assert bare.commands == [[18.0, value] for value in (29.25, 30.0, 30.0, 30.0, 29.75)]
    assert env.get_state() == {"slots": [{"values": [29.75]}]}


def test_rounding_is_half_to_even_and_none_without_a_step() -> None:
    most, steps = np.array([1.0, 1.0]), np.array([0.25, 0.0])
    assert rounded(np.array([[0.125, 0.125], [0.375, -0.3]]), steps, most).tolist() == [[0.0, 0.125], [0.5, -0.3]]


def test_rounding_does_not_exceed_the_largest_increment() -> None:
    # 0.6 is 1.5 steps of 0.4: 2 steps would be 0.8
    steps = np.array([0.4, 0.3])
    increments = rounded(np.array([[0.6, 0.6], [-0.6, -0.6]]), steps, np.array([0.6, 0.6]))
    assert increments.tolist() == [[0.4, 0.6], [-0.4, -0.6]]


def test_a_seed_may_be_a_numpy_integer() -> None:
    one, other = (w.PreviousObservation(FakeVectorEnv(2), ["outdoor_temperature"]) for _ in range(2))
    np.testing.assert_array_equal(one.reset(seed=np.int64(3))[0], other.reset(seed=3)[0])


def test_what_two_reductions_dropped_stands_in_the_info_together() -> None:
    def reduced(env: Any) -> Any:
        names = env.unwrapped.manifest.names
        return w.ReducedObservation(w.ReducedObservation(env, names[:3]), names[:1])

    one, many = reduced(FakeEnv()), reduced(FakeVectorEnv(1))
    dropped, rows = one.reset(seed=1)[1]["dropped"], many.reset(seed=1)[1]["dropped"]
    assert set(dropped) == {*one.unwrapped.manifest.names[1:]}
    assert dropped == {name: rows[name][0] for name in dropped}


@pytest.mark.parametrize("action", [[18.0, 1.5], [14.0, 0.0], [18.0, np.nan], [0.0]])
def test_an_increment_out_of_the_space_changes_nothing(action: list[float]) -> None:
    env = w.IncrementalAction(fake(), {"cool": 1.0}, {"cool": 29.0})
    env.reset()
    with pytest.raises(InvalidAction, match=r"IncrementalAction: action .* is not in Box"):
        env.step(np.array(action, np.float32))
    assert env.get_state() == {"slots": [{"values": [29.0]}]}
    assert env.unwrapped.commands == []  # type: ignore[attr-defined]


def test_several_step_sizes_are_sinergyms_default_of_seventeen_choices() -> None:
    steps = [0.5, 1.0, 1.5, 2.0]
    env = w.DiscreteIncrementalAction(fake(), {"heat": steps, "cool": steps}, {"heat": 19.0, "cool": 26.0})
    assert env.action_space == gym.spaces.Discrete(17)
    moves = [0.0, *steps, *(-step for step in steps)]
    for number in range(17):
        env.reset(seed=0)
        effective = env.step(number)[4]["effective"]
        heat = moves[number] if number < 9 else 0.0
        cool = moves[number - 8] if number >= 9 else 0.0
        assert list(effective)[:2] == pytest.approx([19.0 + heat, 26.0 + cool])


def test_discrete_incremental_action_by_hand() -> None:
    env = w.DiscreteIncrementalAction(fake(), {"cool": 0.5, "heat": 2.0}, {"heat": 20.0, "cool": 29.5})
    assert env.action_space == gym.spaces.Discrete(5)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for _ in range(2):
        env.reset(seed=1)
        for number in (1, 1, 2, 3, 3, 4, 0):
            env.step(number)
        heats, cools = [20.0, 20.0, 20.0, 22.0, 22.5, 20.5, 20.5], [30.0, 30.0, 29.5, 29.5, 29.5, 29.5, 29.5]
        assert bare.commands == [list(pair) for pair in zip(heats, cools, strict=True)]
    with pytest.raises(InvalidAction, match=r"action 5 is not in Discrete\(5\)"):
        env.step(5)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda env: w.IncrementalAction(env, {"cool": 1}, {"heat": 20}), "have to name the same actions"),
        (lambda env: w.IncrementalAction(env, {"coo": 1}, {"coo": 20}), "no action 'coo'; did you mean 'cool'"),
        (
            lambda env: w.IncrementalAction(env, {"cool": 1}, {"cool": 20}),
            "cool starts at 20, outside its bounds 22.5 to 30",
        ),
        (lambda env: w.IncrementalAction(env, {"cool": [1, 2]}, {"cool": 25}), "its step not above the increment"),
        (
            lambda env: w.DiscreteIncrementalAction(env, {"cool": 1}, {"cool": 25}),
            "initial also needs a value for heat",
        ),
        (
            lambda env: w.DiscreteIncrementalAction(env, {"cool": 0}, {"cool": 25, "heat": 20}),
            "a step above 0, or several different ones",
        ),
        (
            lambda env: w.DiscreteIncrementalAction(env, {"cool": [1, 1]}, {"cool": 25, "heat": 20}),
            "a step above 0, or several different ones",
        ),
    ],
)
def test_increments_that_cannot_be(wrong: Callable[[Any], Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        wrong(fake())


# Reward, context


def test_reward_vector__has_the_requested_order() -> None:
    env = w.RewardVector(fake(), ["comfort", "energy"])
    env.reset(seed=1)
    _, reward, _, _, _ = env.step(MIDDLE)
    assert reward.dtype == np.float64
    assert reward.tolist() == [-0.5, -4.0]
    assert env.reward_space.shape == (env.reward_dim,) == (2,)
    assert env.reward_space.contains(reward)
    wrong = w.RewardVector(fake(), ["comfor"])
    wrong.reset()
    with pytest.raises(InvalidConfig, match="no reward term 'comfor'; did you mean 'comfort'"):
        wrong.step(MIDDLE)


@pytest.mark.parametrize(
    "schedule",
    [
        {"07:00": {"occupants": 1.0}, "18:30": {"occupants": 0.25}},
        {"07-03 07:00": {"occupants": 1.0}, "07-03 18:30": {"occupants": 0.25}},
        lambda time, random: {
            "occupants": 1.0 if timedelta(hours=7) <= time - datetime(2017, 7, 3) < timedelta(hours=18.5) else 0.25
        },
    ],
)
def test_context_follows_its_schedule(schedule: Any) -> None:
    env = w.ChangingContext(fake(steps_per_hour=2), schedule)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for _ in range(2):
        steps = episode(env, lambda: MIDDLE)
        assert bare.contexts == [(0, {"occupants": 0.25}), (14, {"occupants": 1.0}), (37, {"occupants": 0.25})]
        effective = [info["effective"][2] for *_, info in steps[1:]]
        assert effective == [0.25] * 14 + [1.0] * 23 + [0.25] * 11


def test_random_context__depends_on_the_seed() -> None:
    env = w.ChangingContext(fake(), lambda time, random: {"occupants": float(random.random())})
    seen = [[info["effective"][2] for *_, info in episode(env, lambda: MIDDLE, seed)[1:]] for seed in (1, 1, 2)]
    assert seen[0] == seen[1] != seen[2]
    assert len(set(seen[0])) == 24


def test_context_that_cannot_be() -> None:
    with pytest.raises(InvalidConfig, match="'7:00' is not a time; write '07:30'"):
        w.ChangingContext(fake(), {"7:00": {}})
    with pytest.raises(InvalidConfig, match="or all like '07-01 07:30'"):
        w.ChangingContext(fake(), {"07:00": {}, "07-01 07:00": {}})
    with pytest.raises(InvalidConfig, match="'02-30 07:00' is not a time"):
        w.ChangingContext(fake(), {"02-30 07:00": {}})
    env = w.ChangingContext(fake(), {"00:00": {"cool": 25.0}})
    with pytest.raises(InvalidAction, match="'cool' is not an actuator outside the actions"):
        env.reset()


def test_context__set_after_the_reset_replaces_that_of_a_table() -> None:
    """Sinergym does so: its `reset(options={"initial_context": …})` replaces the configured one."""
    env = w.ChangingContext(fake(steps_per_hour=1), {"00:00": {"occupants": 0.5}, "03:00": {"occupants": 0.75}})
    for own in (0.25, None, 0.125):
        env.reset()
        if own is not None:
            env.unwrapped.set_context({"occupants": own})  # type: ignore[attr-defined]
        effective = [env.step(MIDDLE)[4]["effective"][2] for _ in range(5)]
        assert effective == [own or 0.5] * 3 + [0.75] * 2


# Logs


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_log_has_n_rows_with_n_steps(tmp_path: Path) -> None:
    env = w.EpisodeLog(w.ReducedObservation(fake(), ["core", "hour"]), tmp_path / "log")
    steps = episode(env, lambda: MIDDLE)
    rows = rows_of(tmp_path / "log" / "episode-000001.csv")
    assert list(rows[0]) == [
        "time", "observation.core", "observation.hour", "action.heat", "action.cool", "effective.heat",
        "effective.cool", "effective.occupants", "reward", "reward.energy", "reward.comfort", "metric.joules",
    ]  # fmt: skip
    assert [row["time"] for row in rows] == [info["time"] for *_, info in steps[1:]]
    assert [float(row["observation.core"]) for row in rows] == [float(o[0]) for o, *_ in steps[1:]]
    assert [float(row["reward"]) for row in rows] == [reward for _, reward, *_ in steps[1:]]
    values = [float(rows[0][name]) for name in list(rows[0])[1:]]
    assert values == [24.5, 0.0, 20.0, 26.0, 20.0, 26.0, 0.0, -4.5, -4.0, -0.5, 4000.0]


def test_files_of_a_log_have_their_names_when_they_are_whole(tmp_path: Path) -> None:
    env = w.EpisodeLog(fake(), tmp_path)
    env.reset()
    assert list(tmp_path.iterdir()) == [], "sample 0 is no row"
    env.step(MIDDLE)
    assert [file.name for file in tmp_path.iterdir()] == [".episode-000001.csv"]
    env.reset()
    assert [file.name for file in tmp_path.iterdir()] == ["episode-000001-left.csv"]
    episode(env, lambda: MIDDLE)
    env.reset()
    env.step(MIDDLE)
    env.close()
    env.close()
    whole = {"episode-000001-left.csv": 1, "episode-000002.csv": 24, "episode-000003-left.csv": 1}
    assert {file.name: len(rows_of(file)) for file in tmp_path.iterdir()} == whole
    again = w.EpisodeLog(fake(), tmp_path)
    episode(again, lambda: MIDDLE)
    assert len(rows_of(tmp_path / "episode-000004.csv")) == 24


def test_a_log_of_a_vector_has_a_file_a_slot_and_episode(tmp_path: Path) -> None:
    many = w.EpisodeLog(fakes(2), tmp_path)
    many.reset(seed=1)
    for _ in range(24 + 1 + 3):
        many.step(np.stack([MIDDLE, MIDDLE]))
    many.close()
    assert {file.name: len(rows_of(file)) for file in tmp_path.iterdir()} == {
        f"slot-0{slot}-episode-00000{name}.csv": count for slot in (0, 1) for name, count in (("1", 24), ("2-left", 3))
    }


def test_parquet_has_the_same_as_csv(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    env = w.EpisodeLog(w.EpisodeLog(fake(), tmp_path / "one"), tmp_path / "two", "parquet")
    episode(env, lambda: MIDDLE)
    table = parquet.read_table(tmp_path / "two" / "episode-000001.parquet").to_pylist()
    rows = rows_of(tmp_path / "one" / "episode-000001.csv")
    assert [{name: str(value) for name, value in row.items()} for row in table] == rows


def test_a_log_without_its_extra_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("pyarrow", "tensorboardX", "wandb"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InvalidConfig, match=r"EpisodeLog needs pyarrow .*pip install -e '\S+\[parquet\]'"):
        w.EpisodeLog(fake(), tmp_path, "parquet")
    with pytest.raises(InvalidConfig, match=r"pip install -e '\S+\[tensorboard\]'"):
        w.TensorBoardLog(fake(), tmp_path)
    with pytest.raises(InvalidConfig, match=r"pip install -e '\S+\[wandb\]'"):
        w.WeightsAndBiasesLog(fake(), "office")
    with pytest.raises(InvalidConfig, match="EpisodeLog logs a scalar reward; apply it before RewardVector"):
        w.EpisodeLog(w.RewardVector(fake(), ["energy"]), tmp_path)


class Board:
    """Stands for TensorBoard's writer."""

    def __init__(self, folder: str) -> None:
        self.folder, self.scalars, self.closed = folder, list[tuple[str, float, int]](), 0

    def add_scalar(self, name: str, value: float, step: int) -> None:
        self.scalars.append((name, value, step))

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize("vectors", [False, True])
def test_means_of_episodes_and_of_n_steps(monkeypatch: pytest.MonkeyPatch, vectors: bool) -> None:
    boards: list[Board] = []

    class Module:
        @staticmethod
        def SummaryWriter(folder: str) -> Board:  # noqa: N802
            boards.append(Board(folder))
            return boards[-1]

    monkeypatch.setitem(sys.modules, "tensorboardX", Module)  # type: ignore[arg-type]
    env: Any = w.TensorBoardLog(fakes(1) if vectors else fake(), "here", every=10)
    action = MIDDLE[None] if vectors else MIDDLE
    env.reset(seed=1)
    rewards, cores = [], []
    for _ in range(24):
        observation, reward, *_ = env.step(action)
        rewards.append(float(np.ravel(reward)[0]))
        cores.append(float(np.ravel(observation)[5]))
    (board,) = boards
    logged = {(name, step): value for name, value, step in board.scalars}
    assert {step for name, step in logged if name.startswith("steps/")} == {10, 20}
    assert logged["steps/reward", 20] == pytest.approx(np.mean(rewards[10:20]))
    assert logged["episode/reward", 24] == pytest.approx(np.mean(rewards))
    assert logged["episode/return", 24] == pytest.approx(np.sum(rewards))
    assert logged["episode/steps", 24] == 24
    assert logged["episode/reward.energy", 24] == pytest.approx(-4.0)
    assert logged["episode/metric.joules", 24] == pytest.approx(4000.0)
    assert logged["episode/observation.core", 24] == pytest.approx(np.mean(cores))
    env.reset()
    for _ in range(24):
        env.step(action)
    assert [value for name, value, step in board.scalars if name == "episode/steps"] == [24, 24]
    env.close()
    env.close()
    assert (board.folder, board.closed) == ("here", 1)


def test_tensorboards_own_files(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    env = w.TensorBoardLog(fake(), tmp_path)
    episode(env, lambda: MIDDLE)
    env.close()
    (file,) = tmp_path.iterdir()
    assert b"episode/return" in file.read_bytes()


@pytest.mark.slow
def test_weights_and_biases_offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_SILENT", "true")
    (tmp_path / "model.txt").write_text("weights")
    env = w.WeightsAndBiasesLog(
        fake(),
        "office",
        folder=tmp_path,
        every=5,
        group="summer",
        tags=["a"],
        entity="us",
        artifacts=[tmp_path / "model.txt"],
    )
    run = env._logic._run
    assert (run.group, run.tags, run.entity) == ("summer", ("a",), "us")
    episode(env, lambda: MIDDLE)
    env.close()
    assert list(tmp_path.rglob("*.wandb"))


# State


def trained(env: Any) -> Any:
    env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(30):
        *_, truncated, _ = env.step(env.action_space.sample())
        if not env.unwrapped.__class__.__name__.endswith("VectorEnv") and truncated:
            env.reset()
    return env


@pytest.mark.parametrize("vectors", [False, True])
@each_chain
def test_a_chain_goes_on_where_it_was(chain: list[dict[str, Any]], vectors: bool, tmp_path: Path) -> None:
    def make() -> Any:
        bare = fakes() if vectors else fake()
        return w.apply_wrappers(bare, [*chain, {"wrapper": "NormalizeObservation"}])

    first, second = trained(make()), make()
    w.save_wrappers(first, tmp_path / "state.yaml")
    w.restore_wrappers(second, tmp_path / "state.yaml")
    w.save_wrappers(second, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == (tmp_path / "state.yaml").read_text()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["again.yaml", "state.yaml"]
    actions = [first.action_space.sample() for _ in range(20)]
    second.reset(seed=3)
    w.restore_wrappers(second, tmp_path / "state.yaml")
    for env in (first, second):
        bases = env.unwrapped.envs if vectors else [env.unwrapped]
        for base in bases:
            base.np_random = np.random.default_rng(5)
    ends = []
    for env in (first, second):
        outputs = [env.reset()[0].tobytes()]
        for action in actions:
            observation, reward, *_ = env.step(action)
            outputs += [observation.tobytes(), np.asarray(reward).tobytes()]
        ends.append(outputs)
    assert ends[0] == ends[1]


def test_statistics_of_a_vector_serve_one_environment(tmp_path: Path) -> None:
    chain = [*CHAINS["PreviousObservation"], {"wrapper": "NormalizeObservation"}]
    many = trained(w.apply_wrappers(fakes(3), chain))
    w.save_wrappers(many, tmp_path / "state.yaml")
    one = w.apply_wrappers(fake(), chain)
    w.restore_wrappers(one, tmp_path / "state.yaml")
    assert one.obs_rms.mean.tolist() == many.obs_rms.mean.tolist()
    assert one.obs_rms.count == many.obs_rms.count > 90
    slots = SyncVectorEnv([lambda: NormalizeObservation(fake())] * 2)
    trained(slots)
    w.save_wrappers(slots, tmp_path / "slots.yaml")
    fresh = SyncVectorEnv([lambda: NormalizeObservation(fake())] * 2)
    w.restore_wrappers(fresh, tmp_path / "slots.yaml")
    assert fresh.envs[1].obs_rms.mean.tolist() == slots.envs[1].obs_rms.mean.tolist()  # type: ignore[attr-defined]


def test_a_state_of_another_chain_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "state.yaml"
    w.save_wrappers(trained(NormalizeObservation(fake())), path)
    other = NormalizeObservation(w.PreviousObservation(fake(), ["core"]))
    with pytest.raises(
        InvalidConfig, match="has the wrappers NormalizeObservation; this chain has NormalizeObservation, Prev"
    ):
        w.restore_wrappers(other, path)
    longer = NormalizeObservation(w.CyclicTime(fake()))
    before = longer.obs_rms.mean.tolist()
    path.write_text(path.read_text().replace("wrappers:", "wrappers:\n", 1))
    with pytest.raises(InvalidConfig, match="this chain has NormalizeObservation, CyclicTime"):
        w.restore_wrappers(longer, path)
    few = NormalizeObservation(TransformObservation(fake(), lambda o: o[:2], gym.spaces.Box(-np.inf, np.inf, (2,))))
    with pytest.raises(InvalidConfig, match=r"does not fit: .*shape \(2,\), not \(9,\)"):
        w.restore_wrappers(few, path)
    assert (longer.obs_rms.mean.tolist(), few.obs_rms.mean.tolist()) == (before, [0.0, 0.0])
    one, two = (NormalizeReward(w.PreviousObservation(fake(), names)) for names in (["core"], ["core", "hour"]))
    w.save_wrappers(trained(one), path)
    with pytest.raises(InvalidConfig, match="does not fit: not a state of PreviousObservation"):
        w.restore_wrappers(two, path)
    assert two.return_rms.count < 1, "what had been taken over was given back"
    with pytest.raises(InvalidConfig, match="there is no file"):
        w.restore_wrappers(few, tmp_path / "none.yaml")


def test_help_shows_what_a_wrapper_takes() -> None:
    import inspect

    assert str(inspect.signature(w.PreviousObservation)).startswith("(env, names: ")
    assert "fields" in (w.CyclicTime.__doc__ or "")
    assert [*inspect.signature(w.WeatherForecast).parameters] == ["env", "columns", "n", "spacing_h", "errors"]


def test_one_class_wraps_single_and_vector_environments() -> None:
    one, many = w.CyclicTime(fake(), ["hour"]), w.CyclicTime(fakes(2), ["hour"])
    assert isinstance(one, w.CyclicTime)
    assert isinstance(one, gym.Wrapper)
    assert not isinstance(one, gym.vector.VectorEnv)
    assert isinstance(many, w.CyclicTime)
    assert isinstance(many, gym.vector.VectorWrapper)
    assert not isinstance(many, gym.Env)
    assert type(one).__name__ == type(many).__name__ == "CyclicTime"
    assert type(one) is type(w.CyclicTime(fake())), "one class for each kind of environment, not one for each wrapper"
    assert isinstance(w.CyclicTime(env=fakes(1)), gym.vector.VectorWrapper)
    bases = (w.BuildingWrapper, w.MeansLog)
    ours = [kind for name in w.__all__ if isinstance(kind := getattr(w, name), type) and kind not in bases]
    assert len(ours) == 14
    assert all(issubclass(kind, w.BuildingWrapper) for kind in ours)


def test_a_subclass_of_a_wrapper_wraps_both_and_overrides_both() -> None:
    class Closed(w.CyclicTime):
        def close(self, **more: Any) -> None:
            closed.append(self.env)
            super().close(**more)

    closed: list[Any] = []
    for env in (fake(), fakes(2)):
        wrapped = Closed(env, fields=["hour"])
        assert isinstance(wrapped, gym.vector.VectorWrapper) == isinstance(env, gym.vector.VectorEnv)
        wrapped.close()
        assert closed.pop() is env


def test_a_wrapper_can_be_copied() -> None:
    for env in (fake(), fakes(2)):
        wrapped = w.PreviousObservation(env, ["core"])
        assert type(copy.copy(wrapped)) is type(wrapped)


def test_an_environment_that_is_no_building() -> None:
    cart = gym.make("CartPole-v1")
    with pytest.raises(
        InvalidConfig, match="has no 'observation_names'; wrap an environment with an id under zenostat/"
    ):
        w.PreviousObservation(cart, ["x"])
    seen: Mapping[str, Any] = vars(w)
    assert "eval" not in seen


def test_numeric_infos__leave_numbers_in_gymnasiums_form() -> None:
    day = {"zones": 1, "steps_per_hour": 1, "begin": "07-03", "end": "07-03"}
    plain, inner = (FakeVectorEnv(2, autoreset_mode=AutoresetMode.SAME_STEP, **day) for _ in range(2))
    vector = w.NumericInfos(inner)
    _, infos = vector.reset(seed=0)
    plain.reset(seed=0)
    assert all(np.asarray(value).dtype.kind in "biuf" for value in infos.values())
    assert {"effective", "_effective", "step", "reward_terms.energy"} <= infos.keys()
    assert not infos.keys() & {"action", "time", "reward_terms", "value_source", "weather"}
    ended = False
    while not ended:
        action = plain.action_space.sample()
        *_, before = plain.step(action)
        _, _, terminated, truncated, infos = vector.step(action)
        ended = bool((terminated | truncated).all())
        assert np.array_equal(infos["reward_terms.energy"], before["reward_terms"]["energy"], equal_nan=True)
    assert np.array_equal(infos["final_obs"][1], before["final_obs"][1])
    assert np.array_equal(infos["final_info"]["effective"], before["final_info"]["effective"])
    assert "time" not in infos["final_info"]
