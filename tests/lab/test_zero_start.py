"""Policies that begin with offsets of zero: they do what the rule does, whatever they observe, and then learn."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.csv_files import csv_rows

pytest.importorskip("stable_baselines3", reason="the extra `train` is not installed")

from test_paired_reward import fields

from zenostat.lab.training import read_training, train
from zenostat.lab.training.environments import TrainingEnv, make_env
from zenostat.lab.training.parameters import make_model
from zenostat.lab.training.zero_actions import begin_at, zero_actions
from zenostat.topics.errors import InvalidConfig

pytestmark = pytest.mark.usefixtures("one_torch_thread")

SMALL = {"policy_kwargs": {"net_arch": [8]}}


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "sac", "td3", "ddpg"])
@pytest.mark.parametrize("is_rescaled", [False, True])
@pytest.mark.parametrize("offset", [2.0, {"zone_1_cooling_setpoint": 2.0}], ids=["all", "one"])
def test_zero_start__first_actions_are_zero(algorithm: str, is_rescaled: bool, offset: Any, tmp_path: Path) -> None:
    wrappers = [{"wrapper": "ResidualAction", "controller": "fixed", "offset": offset}]
    changes: dict[str, Any] = {
        "wrappers": wrappers,
        "parameters": SMALL,
        "paired_reward": False,
        "normalization": {"actions": is_rescaled},
    }
    config = read_training(fields(tmp_path, algorithm=algorithm, **changes))
    env = TrainingEnv(config)
    model = make_model(config, env.outermost)
    zeros = zero_actions(env.env, "zero_start")
    begin_at(model, zeros)
    observations = np.random.default_rng(0).normal(0.0, 3.0, (50, *env.outermost.observation_space.shape))
    chosen, _ = model.predict(observations.astype(np.float32), deterministic=True)
    assert np.array_equal(chosen, np.zeros_like(chosen))
    assert np.array_equal(zeros, np.zeros_like(zeros))
    env.close()


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "td3"])
def test_begin_at__any_action(algorithm: str, tmp_path: Path) -> None:
    config = read_training(fields(tmp_path, algorithm=algorithm, parameters=SMALL, paired_reward=False))
    env = TrainingEnv(config)
    model, action = make_model(config, env.outermost), np.full(env.outermost.action_space.shape, -0.5, np.float32)
    begin_at(model, action)
    observation = np.ones((1, *env.outermost.observation_space.shape), np.float32)
    assert model.predict(observation, deterministic=True)[0][0] == pytest.approx(action, abs=1e-6)
    env.close()


def test_zero_start__evaluation_before_the_first_step_is_that_of_the_rule(tmp_path: Path) -> None:
    evaluation = {"every_steps": 64, "at_start": True, "episodes": 2, "seed": 7, "references": []}
    config = read_training(fields(tmp_path, evaluation=evaluation, zero_start=True, steps=64))
    train(config)
    evaluated = [float(row["reward"]) for row in csv_rows(tmp_path / "evaluations.csv") if row["step"] == "0"]
    env = make_env(config, for_evaluation=True)
    for seed, reward in zip((7, 8), evaluated, strict=True):
        env.reset(seed=seed)
        rewards, ended = [], False
        while not ended:
            *_, ended, info = env.step(np.zeros(env.action_space.shape, np.float32))
            rewards.append(info["reward_terms"])
        assert reward == pytest.approx(sum(sum(terms.values()) for terms in rewards))
    env.close()


def test_zero_start__actions_have_to_be_offsets(tmp_path: Path) -> None:
    config = read_training(fields(tmp_path, wrappers=[], paired_reward=False, zero_start=True))
    with pytest.raises(InvalidConfig, match=r"zero_start: .*is no offset.*relative actions or ResidualAction"):
        train(config)


RESIDUAL = {"wrapper": "ResidualAction", "controller": "fixed", "offset": 2.0}
SCALED = {"wrapper": "RescaleAction", "min_action": -1.0, "max_action": 3.0}
MOVED = {
    "wrapper": "IncrementalAction",
    "increments": {"zone_1_cooling_setpoint": 0.5},
    "initial": {"zone_1_cooling_setpoint": 0.0},
}


@pytest.mark.parametrize("slots", [1, 2])
@pytest.mark.parametrize("wrappers", [[SCALED, {"wrapper": "CyclicTime"}], [MOVED, SCALED]])
def test_zero_actions__are_offsets_of_zero_behind_any_wrappers(
    wrappers: list[dict[str, Any]], slots: int, tmp_path: Path
) -> None:
    settings = {"paired_reward": False, "normalization": False, "slots": slots}
    behind = TrainingEnv(read_training(fields(tmp_path / "a", wrappers=[RESIDUAL, *wrappers], **settings)))
    rule = TrainingEnv(read_training(fields(tmp_path / "b", wrappers=[RESIDUAL], **settings)))
    zeros, rewards = zero_actions(behind.env, "zero_start"), []
    assert zeros.any()
    for env, action in ((behind, zeros), (rule, np.zeros_like(zeros))):
        env.monitor.seed(3)
        env.monitor.reset()
        rewards.append([env.monitor.step(np.tile(action, (slots, 1)))[1].tolist() for _ in range(30)])
        env.close()
    assert rewards[0] == rewards[1]


@pytest.mark.parametrize(
    ("wrappers", "text"),
    [
        ([{**MOVED, "initial": {"zone_1_cooling_setpoint": 1.0}}], "begins with an offset of 1 for zone_1_cooling"),
        ([{"wrapper": "DiscretizeAction", "bins": 3}], "needs continuous actions"),
    ],
)
def test_zero_actions__refuse_wrappers_whose_zero_is_another(
    wrappers: list[dict[str, Any]], text: str, tmp_path: Path
) -> None:
    changes = {"wrappers": [RESIDUAL, *wrappers], "paired_reward": False, "normalization": False}
    env = TrainingEnv(read_training(fields(tmp_path, algorithm="ppo", **changes)))
    with pytest.raises(InvalidConfig, match=f"zero_start.*{text}"):
        zero_actions(env.env, "zero_start")
    env.close()


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_begin_at__bound_is_no_action_of_a_tanh(algorithm: str, tmp_path: Path) -> None:
    config = read_training(fields(tmp_path, algorithm=algorithm, parameters=SMALL, paired_reward=False))
    env = TrainingEnv(config)
    model = make_model(config, env.outermost)
    bound = model.action_space.low.copy()
    if algorithm == "ppo":
        begin_at(model, bound)
    else:
        with pytest.raises(InvalidConfig, match=r"zero is at a bound of the actions.*the tanh of SAC's policy"):
            begin_at(model, bound)
    env.close()
