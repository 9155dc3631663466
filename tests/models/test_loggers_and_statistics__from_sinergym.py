"""Compatibility with code of Sinergym's users: their loggers, statistics of observations, noise, rewards."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from zenostat import wrappers as w
from zenostat.agent_sdk.testing.fake_env import FakeEnv
from zenostat.agent_sdk.wrappers import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import StepBatch
from zenostat.agent_sdk.wrappers.metric_loggers import MeansLog
from zenostat.models.weather.noise import ornstein_uhlenbeck
from zenostat.topics.errors import InvalidConfig


class RowCore(MeansLog):
    """A row for each episode, with a metric of its own."""

    def __init__(self, view: Any, rows: list[dict[str, float]]) -> None:
        super().__init__(view, every=10**9)
        self.rows = rows

    def values(self, row: int, step: StepBatch) -> dict[str, float]:
        return super().values(row, step) | {"largest_action": float(np.max(step.actions[row]))}

    def write(self, values: Mapping[str, float], step: int) -> None:
        self.rows.append({"steps_so_far": step, **values})


class RowLog(BuildingWrapper):
    logic = RowCore


def test_loggers_and_statistics__logger_of_ones_own_has_a_row_for_each_episode() -> None:
    rows: list[dict[str, float]] = []
    env = RowLog(FakeEnv(), rows)
    returns, largest = [], []
    for seed in range(2):
        env.reset(seed=seed)
        env.action_space.seed(seed)
        total, most, ended = 0.0, [], False
        while not ended:
            action = env.action_space.sample()
            _, reward, _, ended, _ = env.step(action)
            total, most = total + reward, [*most, float(np.max(action))]
        returns.append(total)
        largest.append(np.mean(most))
    env.close()
    assert [row["episode/return"] for row in rows] == pytest.approx(returns)
    assert [row["episode/largest_action"] for row in rows] == pytest.approx(largest)


def test_loggers_and_statistics__statistics_that_sinergym_saved_normalize_observations(tmp_path: Path) -> None:
    env = gym.wrappers.NormalizeObservation(FakeEnv())
    size = env.observation_space.shape[0]
    mean, var = np.arange(size, dtype=float), np.arange(1, size + 1, dtype=float)
    for name, numbers in (("mean", mean), ("var", var), ("count", np.array([500.0]))):
        np.savetxt(tmp_path / f"{name}.txt", numbers)
    w.restore_normalization(env, tmp_path)
    env.update_running_mean = False
    normalized = env.reset(seed=1)[0]
    plain = FakeEnv().reset(seed=1)[0]
    assert normalized == pytest.approx((plain - mean) / np.sqrt(var + 1e-8), rel=1e-5)
    assert env.obs_rms.count == 500.0


def test_loggers_and_statistics__statistics_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match="has no NormalizeObservation"):
        w.restore_normalization(FakeEnv(), tmp_path)
    env = gym.wrappers.NormalizeObservation(FakeEnv())
    with pytest.raises(InvalidConfig, match=r"mean\.txt: one number per line expected"):
        w.restore_normalization(env, tmp_path)
    np.savetxt(tmp_path / "mean.txt", [1.0, 2.0])
    with pytest.raises(InvalidConfig, match=r"mean\.txt: \d+ numbers expected, got 2"):
        w.restore_normalization(env, tmp_path)
    size = len(w.names_of(env))
    for name, numbers in (("mean", np.zeros(size)), ("var", np.full(size, -1.0)), ("count", [0.0])):
        np.savetxt(tmp_path / f"{name}.txt", numbers)
    with pytest.raises(InvalidConfig, match=r"var\.txt: -1 is no variance"):
        w.restore_normalization(env, tmp_path)
    np.savetxt(tmp_path / "var.txt", np.full(size, np.nan))
    with pytest.raises(InvalidConfig, match=r"var\.txt: finite numbers expected, got nan"):
        w.restore_normalization(env, tmp_path)
    np.savetxt(tmp_path / "var.txt", np.ones(size))
    with pytest.raises(InvalidConfig, match=r"count\.txt: 0 is no number of observations"):
        w.restore_normalization(env, tmp_path)
    (tmp_path / "count.txt").unlink()
    vector = gym.wrappers.vector.NormalizeObservation(gym.make_vec("zenostat/Fake-v1", 2))
    w.restore_normalization(vector, tmp_path)
    assert vector.obs_rms.var.tolist() == [1.0] * size


@pytest.mark.parametrize(("tau_h", "percent"), [(24.0, 1), (2.0, 15), (1.0, 41)])
def test_loggers_and_statistics__deviation_of_sinergyms_noise_is_what_the_page_states(
    tau_h: float, percent: int
) -> None:
    """Its Euler step of an hour, from its variance in the stationary state; ours has sigma."""
    keep, kick = 1.0 - 1.0 / tau_h, np.sqrt(2.0 / tau_h)
    euler = kick / np.sqrt(1.0 - keep**2)
    assert euler == pytest.approx(1.0 / np.sqrt(1.0 - 1.0 / (2.0 * tau_h)))
    assert round(100.0 * (euler - 1.0)) == percent
    ours = ornstein_uhlenbeck(np.random.Generator(np.random.PCG64(1)), 400_000, 1.0, 0.0, tau_h)
    assert np.std(ours) == pytest.approx(1.0, abs=0.02)
    page = (Path(__file__).parents[2] / "docs" / "from-sinergym.md").read_text()
    assert f"{percent} % " in page


def test_loggers_and_statistics__normalized_reward_whose_maxima_stay_is_sinergyms() -> None:
    """Its penalties are negative and its maxima positive, so the maxima never move."""
    fixed = {"kind": "normalized", "moving": False, "max_power_w": 8.0, "max_degrees": 12.0, "weight": 0.5}
    env = FakeEnv(reward=fixed)
    env.reset(seed=1)
    env.action_space.seed(1)
    rewards = []
    for _ in range(20):
        _, reward, _, _, info = env.step(env.action_space.sample())
        power_w, degrees = info["reward_metrics"]["power_w"], info["reward_metrics"]["degrees_outside"]
        assert reward == pytest.approx(0.5 * -power_w / 8.0 + 0.5 * -degrees / 12.0)
        rewards.append(reward)
    assert min(rewards) < -10.0  # far from 0 to -1, where ours lies
