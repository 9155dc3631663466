"""The data center of the paper on EnergyPlus: the identity of its reward, and which zone obeys the setpoints."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.data_packs import sinergym

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.controllers import Agent, load_controller
from zenostat.models import data_packs

DAY = {"begin": "07-21", "end": "07-21"}
RULE = str(Path(__file__).parents[2] / "examples" / "paper" / "rule.py") + ":DataCenterRule"


@pytest.fixture(scope="module")
def datacenter() -> Any:
    data_packs.add("sinergym-paper")
    with (
        pytest.warns(UserWarning, match=r"setpoint of zone 'East Zone' has no effect"),
        gym.make("zenostat/paper-datacenter-mixed-continuous-stochastic-v1", **DAY) as env,
    ):
        yield env


def run(env: Any, action: list[float]) -> list[tuple[dict[str, float], float, dict[str, Any]]]:
    env.reset(seed=0)
    steps = []
    for _ in range(96):
        observation, reward, _, truncated, info = env.step(np.array(action, np.float32))
        steps.append((env.unwrapped.observation_dict(observation), float(reward), info))
    assert truncated
    return steps


@pytest.mark.slow
def test_paper__reward_is_half_the_weighted_power_and_half_the_deviation_of_the_west_zone(datacenter: Any) -> None:
    assert datacenter.observation_space.shape == (28,)
    np.testing.assert_array_equal([datacenter.action_space.low, datacenter.action_space.high], [[15, 22], [22, 30]])
    warm = run(datacenter, [22.0, 30.0])
    for values, reward, _ in warm:
        west = values["west_zone_air_temperature"]
        deviation = max(18.0 - west, west - 27.0, 0.0)
        # The observation is float32, with a relative error of 6e-8.
        expected = -(0.5 * 5e-5 * values["HVAC_electricity_demand_rate"] + 0.5 * deviation)
        assert reward == pytest.approx(expected, rel=1e-5)
    assert max(values["west_zone_air_temperature"] for values, *_ in warm) > 27.5  # so that the deviation counts
    cool = run(datacenter, [15.0, 22.0])
    for (low, *_), (high, *_) in zip(cool[4:], warm[4:], strict=True):
        assert low["west_zone_air_temperature"] < high["west_zone_air_temperature"] - 2.0
        assert low["east_zone_air_temperature"] == pytest.approx(
            high["east_zone_air_temperature"], abs=0.2
        )  # heat through the wall


@pytest.mark.slow
def test_paper__both_zones_of_the_corrected_model_obey_the_setpoints() -> None:
    sinergym()
    with gym.make("zenostat/paper-datacenter_dx-mixed-continuous-v1", **DAY) as env:
        cool, warm = run(env, [15.0, 22.0]), run(env, [22.0, 30.0])
    for (low, *_), (high, *_) in zip(cool[4:], warm[4:], strict=True):
        for zone in ("west", "east"):
            assert low[f"{zone}_zone_air_temperature"] < high[f"{zone}_zone_air_temperature"] - 2.0


class Sample(SimpleNamespace):
    """A sample with values by name."""

    def __getitem__(self, name: str) -> float:
        return float(vars(self)[name])


@pytest.mark.parametrize(
    ("west", "east", "expected"),
    [
        (23.0, 27.8, (20.0, 23.0)),  # the mean is inside the band
        (18.0, 18.0, (20.0, 23.0)),  # the limits belong to it
        (26.0, 28.5, (19.0, 22.0)),  # above: both down by one kelvin
        (17.0, 18.5, (21.0, 24.0)),  # below: both up
    ],
)
def test_paper__rule_moves_both_setpoints_while_the_mean_is_outside_the_band(
    west: float, east: float, expected: tuple[float, float]
) -> None:
    bounds = {"heating_setpoint": (15.0, 22.0), "cooling_setpoint": (22.0, 30.0)}
    actuators = [SimpleNamespace(name=name, low=low, high=high) for name, (low, high) in bounds.items()]
    rule = load_controller(RULE)(SimpleNamespace(actuators=actuators))
    sample = Sample(
        west_zone_air_temperature=west,
        east_zone_air_temperature=east,
        west_zone_htg_setpoint=20.0,
        west_zone_clg_setpoint=23.0,
    )
    assert tuple(rule.act(sample).values()) == expected
    at_bounds = Sample(**{**vars(sample), "west_zone_htg_setpoint": 15.0, "west_zone_clg_setpoint": 22.0})
    if expected < (20.0, 23.0):
        assert tuple(rule.act(at_bounds).values()) == (15.0, 22.0)


@pytest.mark.slow
def test_paper__rule_keeps_the_buildings_own_setpoints_in_the_papers_environment(datacenter: Any) -> None:
    """The east zone stays near 27.8 degC and the west zone at 23: their mean is inside the band."""
    agent = Agent(load_controller(RULE)(datacenter.unwrapped.manifest))
    datacenter.reset(seed=0)
    for _ in range(8):
        action = agent.action(datacenter.unwrapped.sample)
        np.testing.assert_array_equal(action, np.array([20.0, 23.0], np.float32))
        datacenter.step(action)
