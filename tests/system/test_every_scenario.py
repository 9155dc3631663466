"""Each of the pack's ids and one id of each bundled building, for two days under random actions."""

import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from support import data_packs as packs

import zenostat  # noqa: F401  # registers the environments
from zenostat.topics.scenario_ids import BUILDINGS, WEATHERS, pack_ids

DAYS = 2
PERIOD = {"begin": "01-15", "end": "01-16"}

# A weather for each building, a form for each: all sixteen weathers and all four forms occur.
FORMS = ("continuous", "discrete", "continuous-stochastic", "discrete-stochastic")
BUNDLED = [f"{b}-{WEATHERS[i % len(WEATHERS)]}-{FORMS[i % len(FORMS)]}-v1" for i, b in enumerate(BUILDINGS)]


SOME = {"datacenter_cw-chicago-discrete-stochastic-v1", "shop-cool-continuous-v1"}
"""Each kind of action: setpoints of the air and of chilled water, in both kinds of spaces."""


@pytest.fixture(scope="module", autouse=True)
def pack() -> Path:
    """The data pack, fetched if it is not there."""
    return packs.sinergym()


def test_every_scenario__each_id_of_the_short_list_exists() -> None:
    assert {*pack_ids(), *BUNDLED} >= SOME


@pytest.mark.parametrize(
    "name", [name if name in SOME else pytest.param(name, marks=pytest.mark.slow) for name in [*pack_ids(), *BUNDLED]]
)
def test_every_scenario__it_runs_two_days(name: str, scratch: Path) -> None:
    """Every step is taken; what is seen lies in its space, what was decided ruled, the reward is its terms' sum."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        env = gym.make(f"zenostat/{name}", affinity="off", **PERIOD)
    warned = " ".join(str(each.message) for each in caught)
    try:
        building = env.unwrapped
        env.action_space.seed(1)
        observation, info = env.reset(seed=1)
        assert bool(info["weather_noise"]) == ("stochastic" in name)
        manifest, steps, ended = building.manifest, 0, False
        while not ended:
            assert env.observation_space.contains(observation), building.observation_dict(observation)
            action = env.action_space.sample()
            observation, reward, terminated, ended, info = env.step(action)
            steps += 1
            assert not terminated
            assert reward == pytest.approx(sum(info["reward_terms"].values()))
            wanted = building._actions.values(action)
            for actuator, commanded, effective in zip(manifest.actuators, wanted, info["effective"], strict=True):
                assert effective == pytest.approx(commanded, abs=1e-9) or actuator.name in warned, actuator.name
        assert steps == DAYS * 24 * 3600 / manifest.step_s
        assert np.isfinite(observation).all()
    finally:
        env.close()
