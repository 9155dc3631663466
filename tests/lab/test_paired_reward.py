"""Paired rewards: the difference to the same episodes with zero actions, in single and vector environments."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.csv_files import csv_rows

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.testing import Climate
from zenostat.topics.errors import InvalidConfig

pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")

from support.trainings import check_resumed  # noqa: E402

from zenostat.lab.training import read_training  # noqa: E402
from zenostat.lab.training.checkpoint import capture, restore_environment  # noqa: E402
from zenostat.lab.training.environments import TrainingEnv  # noqa: E402
from zenostat.lab.training.parameters import make_model  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

DAY: dict[str, Any] = {"zones": 2, "begin": "07-03", "end": "07-03", "steps_per_hour": 1}
STEPS = 24
INCREMENTS = {
    "wrapper": "IncrementalAction",
    "increments": {"zone_1_cooling_setpoint": 0.5},
    "initial": {"zone_1_cooling_setpoint": 0.0},
}
RESIDUAL = {"wrapper": "ResidualAction", "controller": "fixed", "offset": 2.0}


def fields(output: Path, **changes: Any) -> dict[str, Any]:
    """A training of offsets to fixed setpoints, with noise on the weather."""
    return {
        "algorithm": "ppo", "scenario": "Fake-v1", "arguments": {**DAY, "climate": Climate(noise_k=2.0)},
        "wrappers": [RESIDUAL], "steps": 192, "seed": 3, "threads": 1, "evaluation": False, "paired_reward": True,
        "parameters": {"n_steps": 32, "batch_size": 32, "n_epochs": 2, "policy_kwargs": {"net_arch": [8]}},
        "output": str(output), **changes,
    }  # fmt: skip


def rewards(config: Any, action: float) -> list[list[float]]:
    """Rewards of the first two episodes with a constant action."""
    env = TrainingEnv(config)
    try:
        env.monitor.seed(config.seed)
        env.monitor.reset()
        return [env.monitor.step(actions(env, action))[1].tolist() for _ in range(2 * STEPS)]
    finally:
        env.close()


def actions(env: TrainingEnv, value: float) -> Any:
    return np.full((env.monitor.num_envs, *env.monitor.action_space.shape), value, np.float32)


@pytest.mark.parametrize("slots", [1, 3])
def test_paired_reward__is_the_difference_of_two_environments(slots: int, tmp_path: Path) -> None:
    config = read_training(fields(tmp_path, slots=slots, normalization={"actions": True}))
    alone = config.model_copy(update={"paired_reward": False})
    assert rewards(config, 0.0) == [[0.0] * slots] * (2 * STEPS)
    acted, still = (np.array(rewards(alone, value)) for value in (0.5, 0.0))
    difference = np.array(rewards(config, 0.5))
    assert difference == pytest.approx(acted - still, abs=1e-6)  # stable-baselines3's rewards are float32
    assert np.abs(difference).max() > 0.01
    assert not np.array_equal(still[:STEPS], still[STEPS:])  # the episodes differ in their weather


@pytest.mark.slow
@pytest.mark.parametrize("slots", [1, 2])
def test_paired_reward__resumed_training_equals_an_uninterrupted_one(slots: int, tmp_path: Path) -> None:
    check_resumed(lambda output: fields(output, slots=slots, checkpoint_steps=40), tmp_path)
    assert len(csv_rows(tmp_path / "cut" / "curve.csv")) == 192 // STEPS


@pytest.mark.parametrize("slots", [1, 2])
def test_paired_reward__wrappers_of_the_reference_are_restored_to_their_own_state(slots: int, tmp_path: Path) -> None:
    config = read_training(fields(tmp_path, slots=slots, wrappers=[RESIDUAL, INCREMENTS]))
    env, again = TrainingEnv(config), TrainingEnv(config)
    model = make_model(config, env.outermost)
    env.monitor.seed(config.seed)
    env.monitor.reset()
    for _ in range(14):
        env.monitor.step(actions(env, 1.0))
    restore_environment(capture(model, env, {}), again, config.seed)
    still = actions(env, 0.0)
    difference = [env.monitor.step(still)[1].tolist() for _ in range(8)]
    assert min(map(min, difference)) < -0.1  # the increments have moved the setpoint, the reference has not
    assert [again.monitor.step(still)[1].tolist() for _ in range(8)] == difference
    env.close()
    again.close()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"wrappers": []}, "is no offset.*relative actions or ResidualAction"),
        ({"arguments": {**DAY, "discrete": 5, "control": "building"}, "wrappers": []}, "is no offset"),
        ({"wrappers": [RESIDUAL, {"wrapper": "EpisodeLog", "folder": "log"}]}, "EpisodeLog would log"),
        ({"wrappers": [RESIDUAL, {"wrapper": "NormalizeReward"}]}, "NormalizeReward would scale"),
        ({"wrappers": [RESIDUAL, {"wrapper": "ClipReward", "min_reward": -1.0}]}, "ClipReward would scale"),
    ],
)
def test_paired_reward__actions_have_to_be_offsets(changes: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=f"paired_reward: .*{text}"):
        TrainingEnv(read_training(fields(tmp_path, **changes)))


def test_paired_reward__episodes_that_end_early_are_refused(tmp_path: Path) -> None:
    limit = {"points": ["zone_1_air_temperature"], "low": 19.0, "high": 26.0}
    config = read_training(fields(tmp_path, arguments={**DAY, "terminate": [limit]}))
    env = TrainingEnv(config)
    env.monitor.reset()
    with pytest.raises(InvalidConfig, match="did not end together"):
        [env.monitor.step(actions(env, 1.0)) for _ in range(STEPS)]
    env.close()


@pytest.mark.slow
@pytest.mark.process
def test_paired_reward__zero_offsets_to_the_building_s_own_control_have_none(scratch: Path) -> None:
    """On EnergyPlus, with weather noise: the reference follows the schedules."""
    arguments = {
        "building": "ref-small-office", "weather": "USA_CO_Denver", "begin": "07-03", "end": "07-03",
        "steps_per_hour": 4, "relative": 3.0, "weather_noise": {"dry_bulb_temperature": {"sigma": 2.0, "tau_h": 24.0}},
        "affinity": "off",
    }  # fmt: skip
    config = read_training(
        {"algorithm": "ppo", "scenario": "Building-v1", "arguments": arguments, "steps": 96, "slots": 2,
         "paired_reward": True, "output": str(scratch / "out")}
    )  # fmt: skip
    env = TrainingEnv(config)
    try:
        assert isinstance(env.env, gym.vector.VectorEnv)
        env.monitor.seed(config.seed)
        env.monitor.reset()
        offsets = actions(env, 0.0)
        assert all((env.monitor.step(offsets)[1] == 0.0).all() for _ in range(40))
        offsets[1] = 1.0
        differences = np.array([env.monitor.step(offsets)[1] for _ in range(40)])
        assert (differences[:, 0] == 0.0).all()
        assert np.abs(differences[:, 1]).max() > 0.0
    finally:
        env.close()
