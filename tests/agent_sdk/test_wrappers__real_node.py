"""Wrappers on a real node: what they tell of it, what they hand to it, what they keep of it."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.csv_files import csv_rows
from support.nodes import COOLING, SMALL

from zenostat import wrappers as w
from zenostat.topics.errors import InvalidAction

N = 96
DRY, HUMIDITY = "dry_bulb_temperature", "relative_humidity"
NOISE = {DRY: {"sigma": 3.0, "tau_h": 12.0}}


@pytest.fixture(scope="module")
def building() -> Iterator[gym.Env[Any, Any]]:
    """The cooling setpoint of the core is the agent's, that of another zone is context; the weather is noised."""
    points = [COOLING[f"{zone}_cooling_setpoint"] for zone in ("core_zn", "perimeter_zn_1")]
    env = gym.make(
        "zenostat/Building-v1",
        **SMALL,
        affinity="off",
        sensors={
            "outdoor": ("Site Outdoor Air Drybulb Temperature", "Environment", "instant"),
            "outdoor_humidity": ("Site Outdoor Air Relative Humidity", "Environment", "instant"),
            "core": ("Zone Air Temperature", "Core_ZN"),
            "core_setpoint": ("Zone Thermostat Cooling Setpoint Temperature", "Core_ZN"),
            "power": ("Facility Total HVAC Electricity Demand Rate", "Whole Building"),
        },
        actuators={"core_cooling": (*points[0], 22.0, 30.0), "side_cooling": (*points[1], 22.0, 30.0)},
        actions={"cooling": {"actuators": ["core_cooling"]}},
        weather_noise=NOISE,
    )
    yield env
    env.close()


def episode(env: gym.Env[Any, Any], seed: int, action: Any) -> list[tuple[dict[str, float], dict[str, Any]]]:
    """Each sample's observation by name, and its info."""
    observation, info = env.reset(seed=seed)
    names, truncated = w.names_of(env), False
    steps = [(dict(zip(names, observation.tolist(), strict=True)), info)]
    while not truncated:
        observation, _, _, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        steps.append((dict(zip(names, observation.tolist(), strict=True)), info))
    assert len(steps) == N + 1
    return steps


@pytest.mark.slow
def test_wrappers__forecast_has_upcoming_values(building: gym.Env[Any, Any]) -> None:
    """At whole hours, of the noised weather that this very episode reads, in two episodes of different weather."""
    env = w.WeatherForecast(building, [DRY], n=3)
    days = []
    for seed in (1, 2):
        seen = [values for values, _ in episode(env, seed, [26.0])]
        for at in range(0, N + 1 - 12, 4):
            for ahead in (1, 2, 3):
                assert seen[at][f"{DRY}_in_{ahead}h"] == pytest.approx(seen[at + 4 * ahead]["outdoor"], abs=2e-5)
        days.append([values["outdoor"] for values in seen])
    assert np.abs(np.subtract(*days)).max() > 0.5, "the noise is another with another seed"


@pytest.mark.slow
def test_wrappers__between_the_hours_the_forecast_has_upcoming_values(building: gym.Env[Any, Any]) -> None:
    env = w.WeatherForecast(building, [DRY], n=2, spacing_h=0.25)
    seen = [values for values, _ in episode(env, 1, [26.0])]
    for at in range(4, N - 1):
        for steps, hours in ((1, "0.25"), (2, "0.5")):
            assert seen[at][f"{DRY}_in_{hours}h"] == pytest.approx(seen[at + steps]["outdoor"], abs=2e-5)


@pytest.mark.slow
def test_wrappers__context_is_what_the_building_gets(building: gym.Env[Any, Any]) -> None:
    schedule = {"00:00": {"side_cooling": 29.0}, "09:00": {"side_cooling": 24.5}, "18:00": {"side_cooling": 29.0}}
    env = w.ChangingContext(building, schedule)
    for seed in (1, 1):
        effective = [info["effective"].tolist() for _, info in episode(env, seed, [26.0])[1:]]
        assert effective == [[26.0, 29.0]] * 36 + [[26.0, 24.5]] * 36 + [[26.0, 29.0]] * 24


@pytest.mark.slow
def test_wrappers__increments_are_what_the_building_gets(building: gym.Env[Any, Any]) -> None:
    env = w.SetpointDifference(
        w.IncrementalAction(building, {"cooling": [1.0, 0.5]}, {"cooling": 26.0}), {"excess": ["core", "core_setpoint"]}
    )
    for _ in range(2):
        seen = episode(env, 1, [0.4])
        assert [info["effective"][0] for _, info in seen[1:10]] == [26.5, 27, 27.5, 28, 28.5, 29, 29.5, 30, 30]
        values = seen[5][0]
        assert values["core_setpoint"] == 28.5
        assert values["excess"] == np.float32(values["core"]) - np.float32(28.5)


@pytest.mark.slow
def test_episode_log__has_effective_values_and_reward_terms_of_a_node(
    building: gym.Env[Any, Any], tmp_path: Path
) -> None:
    env = w.EpisodeLog(w.CyclicTime(building), tmp_path)
    seen = episode(env, 1, [26.0])[1:]
    (file,) = tmp_path.iterdir()
    for row, (values, info) in zip(csv_rows(file), seen, strict=True):
        assert row["time"] == info["time"]
        assert {name: float(row[f"observation.{name}"]) for name in values} == values
        assert float(row["effective.core_cooling"]) == info["effective"][0] == 26.0
        terms = {name: float(row[f"reward.{name}"]) for name in info["reward_terms"]}
        assert terms == info["reward_terms"]
        assert float(row["reward"]) == pytest.approx(sum(terms.values()))


@pytest.mark.slow
def test_wrappers__chain_as_data_around_a_scenario(building: gym.Env[Any, Any]) -> None:
    chain: list[dict[str, Any]] = [
        {"wrapper": "WeatherForecast", "columns": [DRY, HUMIDITY], "n": 2, "errors": {DRY: 1.0}},
        {"wrapper": "ReducedObservation", "keep": ["core", f"{HUMIDITY}_in_1h"]},
        {"wrapper": "RewardVector", "terms": ["comfort", "energy"]},
    ]
    env = w.apply_wrappers(building, chain)
    assert w.wrappers_of(env) == chain
    env.reset(seed=1)
    observation, reward, _, _, info = env.step([26.0])
    assert observation.shape == reward.shape == (2,)
    assert reward.tolist() == [info["reward_terms"]["comfort"], info["reward_terms"]["energy"]]
    assert set(info["dropped"]) >= {"outdoor", "power", f"{DRY}_in_2h"}


def draw_context(_: datetime, random: np.random.Generator) -> dict[str, float | None]:
    return {"side_cooling": float(random.uniform(23.0, 29.0))}


HOURS = {f"{hour:02}:00": {"side_cooling": 23.0 if hour % 2 else 29.0} for hour in range(24)}


@pytest.mark.slow
@pytest.mark.parametrize("schedule", [HOURS, draw_context], ids=["table", "function"])
def test_branches__continue_the_schedule_of_the_context(building: gym.Env[Any, Any], schedule: Any) -> None:
    outer = {f"{hour:02}:00": {"side_cooling": 24.0 + hour / 24.0} for hour in range(24)}
    env, base = w.ChangingContext(w.ChangingContext(building, schedule), outer), building.unwrapped
    action = np.array([26.0], np.float32)
    env.reset(seed=1)
    for _ in range(3):
        env.step(action)
    plan = np.tile(action, (2, 8, 1))
    with pytest.raises(InvalidAction):  # such a timestep is not simulated, and its context not drawn again
        env.step(2.0 * action)
    with base.snapshot() as snapshot:  # type: ignore[attr-defined]
        planned, tried = base.plan(plan)[1], base.try_steps(plan)[1]  # type: ignore[attr-defined]
        with base.branch() as branch, base.branch(slots=2) as branches:  # type: ignore[attr-defined]
            for copied, refused in ((branch, 2.0 * action), (branches, 2.0 * plan[:, 0])):
                with pytest.raises(InvalidAction):
                    copied.step(refused)
            single = [branch.step(action)[4]["effective"].tolist() for _ in range(8)]
            stepped = [branches.step(plan[:, 0])[4]["effective"][1].tolist() for _ in range(8)]
        steps = [env.step(action) for _ in range(8)]
        effective = [info["effective"].tolist() for *_, info in steps]
        assert len({side for _, side in effective}) > 1
        assert single == stepped == effective
        assert [sample.effective.tolist() for sample in tried] == effective
        assert planned.tolist() == [reward for _, reward, *_ in steps]
        for _ in range(2):  # a branch of a snapshot leaves its schedule as it was
            assert base.plan(plan, snapshot=snapshot)[1].tolist() == planned.tolist()  # type: ignore[attr-defined]
