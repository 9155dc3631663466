"""A model that was trained behind VecNormalize sees normalized observations wherever it acts, or is refused."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from zenostat.agent_sdk.testing import FakeEnv
from zenostat.lab.evaluate import evaluate, run_episode
from zenostat.topics.errors import InvalidConfig, UsageError

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from zenostat.agent_sdk.controllers import Agent
from zenostat.lab.training import EvaluationCallback, PolicyController, evaluate_model, load_policy
from zenostat.lab.training.episode_recorder import EpisodeRecorder

DAY: dict[str, Any] = {"zones": 2, "begin": "07-03", "steps_per_hour": 1}
KINDS: dict[str, tuple[Any, dict[str, Any]]] = {
    "ppo": (PPO, {"n_steps": 24, "batch_size": 24, "n_epochs": 1}),
    "sac": (SAC, {"learning_starts": 20, "batch_size": 8, "buffer_size": 100}),
}


def fake() -> FakeEnv:
    return FakeEnv(**DAY)


def trained(kind: str, path: Path, *, normalized: bool = True, callback: Any = None, **options: Any) -> Any:
    algorithm, parameters = KINDS[kind]
    envs: Any = DummyVecEnv([fake])
    env = VecNormalize(envs, **options) if normalized else envs
    model = algorithm("MlpPolicy", env, **parameters, policy_kwargs={"net_arch": [8]}, seed=0, device="cpu")
    model.learn(48, callback=callback)
    model.save(path)
    return model


def played(policy: Any) -> float | None:
    with fake() as env:
        agent = Agent(policy(env.manifest))
        return run_episode(env, lambda _: agent.action(env.sample), seed=1)[0].reward


@pytest.mark.parametrize("kind", KINDS)
def test_training__normalization_beside_a_model_is_loaded(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    model = trained(kind, path)
    with fake() as env:
        (expected,) = evaluate_model(model, env, seed=1)
    with pytest.raises(InvalidConfig, match=r"trained behind VecNormalize.*missing.*model\.vecnormalize\.pkl expected"):
        load_policy(f"{kind}:{path}")
    model.get_vec_normalize_env().save(str(tmp_path / "model.vecnormalize.pkl"))
    assert played(load_policy(f"{kind}:{path}")) == expected.reward
    assert played(lambda manifest: PolicyController(manifest, model)) == expected.reward


def test_training__normalization_of_rewards_alone_leaves_observations_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    model = trained("ppo", path, norm_obs=False)
    with fake() as env:
        (expected,) = evaluate_model(model, env, seed=1)
    model.get_vec_normalize_env().save(str(tmp_path / "model.vecnormalize.pkl"))
    assert played(load_policy(f"ppo:{path}")) == expected.reward


@pytest.mark.parametrize("kind", KINDS)
def test_training__model_of_raw_observations_needs_none(kind: str, tmp_path: Path) -> None:
    model = trained(kind, tmp_path / "model.zip", normalized=False)
    with fake() as env:
        (expected,) = evaluate_model(model, env, seed=1)
    assert played(load_policy(f"{kind}:{tmp_path / 'model.zip'}")) == expected.reward


def test_training__model_that_was_loaded_without_its_normalization_is_refused(tmp_path: Path) -> None:
    trained("ppo", tmp_path / "model.zip")
    alone = PPO.load(tmp_path / "model.zip", device="cpu")
    with fake() as env, pytest.raises(InvalidConfig, match="loaded without its normalization"):
        evaluate_model(alone, env)
    with fake() as env, pytest.raises(InvalidConfig, match="loaded without its normalization"):
        PolicyController(env.manifest, alone)


def test_training__callback_marks_its_models_and_drops_a_former_normalization(tmp_path: Path) -> None:
    best, beside = tmp_path / "best.zip", tmp_path / "best.vecnormalize.pkl"
    for normalized in (True, False):
        with EvaluationCallback(fake, every=24, best_model_path=best) as callback:
            trained("ppo", tmp_path / "last.zip", normalized=normalized, callback=callback)
        assert beside.is_file() == normalized
        model = PPO.load(best, device="cpu")
        assert model.observations_normalized is normalized
    beside.write_bytes(b"no pickle")
    with pytest.raises(InvalidConfig, match="is not a saved VecNormalize"):
        load_policy(f"ppo:{best}")


def test_training__evaluate_refuses_before_it_simulates(tmp_path: Path) -> None:
    trained("ppo", tmp_path / "model.zip")
    with pytest.raises(InvalidConfig, match="its normalization is missing"):
        evaluate(
            {"building": "office-small", "weather": "USA_CO_Denver"}, ["baseline", f"ppo:{tmp_path / 'model.zip'}"]
        )


def test_training__statistics_of_other_observations_are_refused(tmp_path: Path) -> None:
    trained("ppo", tmp_path / "model.zip")
    other = VecNormalize(DummyVecEnv([lambda: FakeEnv(**{**DAY, "zones": 3})]))
    other.reset()
    other.save(str(tmp_path / "model.vecnormalize.pkl"))
    with pytest.raises(InvalidConfig, match=r"normalizes observations of shape \(\d+,\)"):
        load_policy(f"ppo:{tmp_path / 'model.zip'}")
    assert np.isfinite(other.obs_rms.mean).all()


class Dropped(gym.ObservationWrapper[Any, Any, Any]):
    """A building whose second observation is lost."""

    def observation(self, observation: Any) -> Any:
        """Replace it by NaN."""
        return np.where(np.arange(len(observation)) == 1, np.nan, observation)


def test_training__observation_that_is_no_number_is_named() -> None:
    envs = DummyVecEnv([lambda: Dropped(fake())])
    names = fake().observation_names
    for known, text in ((names, names[1]), ((), "number 1")):
        with pytest.raises(UsageError, match=f"the observation {text} is nan: training needs finite numbers"):
            EpisodeRecorder(envs, known).reset()
