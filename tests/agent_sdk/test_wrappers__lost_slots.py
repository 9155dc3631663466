"""Wrappers around a fleet one of whose nodes is lost: its slot keeps its observation, the others go on."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from zenostat import wrappers as w
from zenostat.agent_sdk.envs.vector_infos import merge, select
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv

_LOST = np.array([False, True])
_BACK = 5


class Losing(FakeVectorEnv):
    """Slot 1 is lost in steps 3 and 4, and starts a new episode in step 5, as a `FleetVectorEnv` shows it."""

    count = 0

    def step(self, actions: Any) -> Any:
        self.count += 1
        observations, rewards, terminated, truncated, infos = super().step(actions)
        if self.count in (3, 4):
            error = {"error": np.array([None, "NodeLost: gone"], object), "_error": _LOST}
            infos, truncated = merge(select(infos, ~_LOST), error), truncated | _LOST
            rewards = np.where(_LOST, 0.0, rewards)
        if self.count == _BACK:
            observations, start = self.reset(options={"reset_mask": _LOST.copy()})
            infos, rewards = merge(select(infos, ~_LOST), start), np.where(_LOST, 0.0, rewards)
        return observations, rewards, terminated, truncated, infos


def test_lost_slot__keeps_its_observation_until_it_begins_anew(tmp_path: Path) -> None:
    def wrapped(env: Any) -> Any:
        env = w.CyclicTime(env)
        env = w.WeatherForecast(env, ["dry_bulb_temperature"], n=2)
        env = w.TimeSeriesObservation(env, {"price": 0.3})
        env = w.MetricObservation(env, ["power_w"])
        env = w.EpisodeLog(env, tmp_path)
        return w.RewardVector(env, ["energy", "comfort"])

    env = wrapped(Losing(2, 1, steps_per_hour=1, autoreset_mode=AutoresetMode.NEXT_STEP))
    action = env.action_space.sample()
    first, _ = env.reset(seed=0)
    steps = [env.step(action) for _ in range(8)]
    rows = np.array([observations for observations, *_ in steps])
    assert np.array_equal(rows[2, 1], rows[1, 1])
    assert np.array_equal(rows[3, 1], rows[1, 1])
    assert np.isfinite(rows).all()
    assert [tuple(rewards[1]) == (0.0, 0.0) for _, rewards, *_ in steps[2:5]] == [True] * 3
    hours = w.names_of(env).index("hour_sin")
    assert rows[_BACK - 1, 1, hours] == first[1, hours]
    env.close()
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "slot-00-episode-000001-left.csv", "slot-01-episode-000001-left.csv", "slot-01-episode-000002-left.csv",
    ]  # fmt: skip


@pytest.mark.parametrize("lost_at_the_reset", [True, False])
def test_lost_slot__with_same_step_the_last_observation_is_that_of_the_wrapper(lost_at_the_reset: bool) -> None:
    class Ending(FakeVectorEnv):
        def step(self, actions: Any) -> Any:
            observations, rewards, terminated, truncated, infos = super().step(actions)
            error = {"error": np.array([None, "NodeLost: gone"], object), "_error": _LOST}
            last = np.array([None, observations[1].copy()], object)
            ended = {"final_obs": last, "_final_obs": _LOST, "final_info": error, "_final_info": _LOST}
            if lost_at_the_reset:
                infos = merge(select(infos, ~_LOST), error)
            return observations, rewards, terminated, truncated | _LOST, infos | ended

    env = w.CyclicTime(Ending(2, 1, steps_per_hour=1, autoreset_mode=AutoresetMode.SAME_STEP))
    first, _ = env.reset(seed=0)
    observations, *_, infos = env.step(env.action_space.sample())
    assert np.array_equal(infos["final_obs"][1], first[1])
    assert observations.shape == first.shape
    assert np.array_equal(observations[1], first[1]) == lost_at_the_reset
