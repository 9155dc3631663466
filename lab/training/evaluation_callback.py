"""Evaluate a model of stable-baselines3 during its training, without affecting the training."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import gymnasium as gym
import numpy as np
from typing_extensions import override

from zenostat.agent_sdk.controllers.policy import preserve_random_state
from zenostat.agent_sdk.controllers.predictor import Predictor, describe_difference
from zenostat.agent_sdk.controllers.training_folder import normalization_path, wrappers_path
from zenostat.agent_sdk.vec_normalization import mark_normalized, normalization_of
from zenostat.agent_sdk.wrappers import save_wrappers
from zenostat.agent_sdk.wrappers.checkpoint import LOGS, frozen_statistics, set_wrapper_states, without_logs
from zenostat.agent_sdk.wrappers.names import attribute, layers
from zenostat.bridge.runtime.scratch import scratch_folder
from zenostat.lab.evaluate import run_episode
from zenostat.lab.training.paired_reward import SCALED
from zenostat.metrics.episode_metrics import EpisodeMetrics
from zenostat.topics import yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

with requires_extra("train", "training", "stable-baselines3"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback

MakeEnv = Callable[[], gym.Env[Any, Any]]
"""Makes an environment for evaluation, within the same wrappers as those of the training."""


class EvaluationCallback(BaseCallback):
    """Evaluates the model at regular intervals of its training, in an environment of its own.

        model.learn(100_000, callback=EvaluationCallback(make_env, every=10_000, best_model_path="best.zip"))

    It changes neither the training's environments nor any random state: the same seed gives the same weights with and
    without it. What the training's wrappers and its `VecNormalize` have learnt is copied for each evaluation. The means
    over the episodes of all metrics of `EpisodeMetrics` are logged with the model's logger, as `eval/reward`.

    Args:
        make_env: Makes the environment when it is first needed. It is closed when the training ends; a `with` statement
            also closes it after an exception.
        every: Training steps, counted over all environments, between evaluations, at multiples of this number.
        every_episodes: Finished episodes of the training between evaluations, instead of `every`.
        episodes: Number of episodes of an evaluation.
        seed: Seed of the first episode; episode k has `seed + k`, the same in each evaluation.
        at_start: Also evaluate before the first training step, so that the best model may be the one that the training
            begins with: where actions are offsets to a rule, nearly the rule itself.
        best_model_path: File (.zip) for the model with the highest mean reward. Its `VecNormalize` is saved beside it
            as `.vecnormalize.pkl`, and what its wrappers have learnt as `.wrappers.yaml`, if there are any.
        on_evaluation: Called after each evaluation with the training step and the metrics of its episodes.

    Attributes:
        results: Metrics of the episodes by training step of the evaluation.
        best_reward: The highest mean reward of an evaluation; None before the first.
        training_episodes: Number of the training's episodes that have ended.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        every: int | None = None,
        episodes: int = 1,
        seed: int = 0,
        best_model_path: str | Path | None = None,
        *,
        every_episodes: int | None = None,
        at_start: bool = False,
        on_evaluation: Callable[[int, tuple[EpisodeMetrics, ...]], None] | None = None,
    ) -> None:
        super().__init__()
        if not callable(make_env):
            raise InvalidConfig(f"make_env={make_env!r}; a function that makes the environment expected")
        if (every is None) == (every_episodes is None):
            raise InvalidConfig("the interval of evaluations: either every (steps) or every_episodes expected")
        interval = every if every is not None else every_episodes
        if interval is None or interval < 1 or episodes < 1:
            raise InvalidConfig(f"every={interval}, episodes={episodes}: numbers of at least 1 expected")
        path = None if best_model_path is None else Path(best_model_path)
        if path is not None and (path.suffix != ".zip" or not path.absolute().parent.is_dir()):
            raise InvalidConfig(f"best_model_path={str(path)!r}: a .zip file in an existing folder expected")
        self._make_env, self._interval, self._episodes, self._seed = make_env, interval, episodes, seed
        self._counts_episodes, self._on_evaluation = every is None, on_evaluation
        self._path, self._at_start = path, at_start
        self._env: gym.Env[Any, Any] | None = None
        self._due = 0
        self.training_episodes = 0
        self.results: dict[int, tuple[EpisodeMetrics, ...]] = {}
        self.best_reward: float | None = None

    def __enter__(self) -> EvaluationCallback:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the environment; idempotent. The next evaluation makes a new one."""
        env, self._env = self._env, None
        if env is not None:
            env.close()

    def _on_training_start(self) -> None:
        mark_normalized(self.model)
        self._set_due()
        if self._at_start and self.num_timesteps == 0 and self.best_reward is None:  # not resumed after it
            self._evaluate()

    def _on_step(self) -> bool:
        dones = self.locals.get("dones")
        if dones is None and self._counts_episodes:
            raise InvalidConfig(f"{type(self.model).__name__} does not report the ends of episodes: use every= instead")
        self.training_episodes += int(np.count_nonzero(dones)) if dones is not None else 0
        if self._count() >= self._due:
            self._set_due()
            self._evaluate()
        return True

    def _count(self) -> int:
        return self.training_episodes if self._counts_episodes else self.num_timesteps

    def _set_due(self) -> None:
        """Evaluate next at a multiple of the interval, so that a resumed training evaluates at the same steps."""
        self._due = (self._count() // self._interval + 1) * self._interval

    def _on_training_end(self) -> None:
        self.close()

    @preserve_random_state()
    def _evaluate(self) -> None:
        env = self._evaluation_env()
        wrapper_text = _copy_wrapper_state(self.training_env, env)
        results = evaluate_model(self.model, env, episodes=self._episodes, seed=self._seed)
        self.results[self.num_timesteps] = results
        rewards = [result.reward for result in results]
        if None in rewards:
            raise InvalidConfig("the evaluation environment has no reward; remove reward=None from make_env")
        self._log(results)
        if self._on_evaluation is not None:
            self._on_evaluation(self.num_timesteps, results)
        mean = float(np.mean(np.array(rewards, np.float64)))
        if self.best_reward is None or mean > self.best_reward:
            self.best_reward = mean
            self._save(wrapper_text)

    def _evaluation_env(self) -> gym.Env[Any, Any]:
        if self._env is None:
            env = self._make_env()
            _check_environment(self.model, env)
            if any(env.unwrapped is other.unwrapped for other in getattr(self.training_env.unwrapped, "envs", [])):
                raise InvalidConfig("make_env returned an environment of the training; it must make a new one")
            self._env = env
        return self._env

    def _log(self, results: tuple[EpisodeMetrics, ...]) -> None:
        metrics = [result.metrics() for result in results]
        for name in metrics[0]:
            values = [episode.get(name) for episode in metrics]
            if None not in values:
                self.logger.record(f"eval/{name}", float(np.mean(np.array(values, np.float64))))
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)

    def _save(self, wrapper_text: str) -> None:
        if self._path is None:
            return
        normalization = self.model.get_vec_normalize_env()
        normalization_file, wrappers_file = normalization_path(self._path), wrappers_path(self._path)
        if normalization is not None:
            with atomic_file(normalization_file) as temporary:
                normalization.save(str(temporary))
        else:
            normalization_file.unlink(missing_ok=True)  # of an earlier training
        if wrapper_text:
            with atomic_file(wrappers_file) as temporary:
                temporary.write_text(wrapper_text, encoding="utf-8")
        else:
            wrappers_file.unlink(missing_ok=True)
        with atomic_file(self._path) as temporary:  # last: a model that is there has what it needs
            self.model.save(temporary)


def evaluate_model(
    model: BaseAlgorithm, env: gym.Env[Any, Any], *, episodes: int = 1, seed: int = 0
) -> tuple[EpisodeMetrics, ...]:
    """Run episodes of a model without exploration, in an environment within the same wrappers as in its training.

    Where a wrapper pays another reward than the building's, `reward` of the metrics is the sum of what the environment
    returns, and the terms are the building's. `NormalizeReward` and `ClipReward` only help to learn: with one of them,
    it is the building's.

    Observations pass through the model's `VecNormalize` if it has one. Neither that nor Gymnasium's running statistics
    around `env` learn from them. A model that takes action masks, such as sb3-contrib's `MaskablePPO`, gets those of
    the environment's method `action_masks`. Episode k is reset with `seed + k`. The reward has forgotten earlier
    evaluations.

    Raises:
        InvalidConfig: The model was trained behind a `VecNormalize` but loaded without it; the environment is not a
            single one of a building, has other observations or actions than the model, or lacks `action_masks` that
            the model takes; `episodes` is below 1.
    """
    if episodes < 1:
        raise InvalidConfig(f"episodes={episodes}; a number of at least 1 expected")
    _check_environment(model, env)
    normalization = normalization_of(model)
    if callable(renew := getattr(env.unwrapped, "renew_reward", None)):  # an environment of the user's own has none
        renew()
    results = []
    for number in range(episodes):
        predictor = Predictor(model, env)

        def act(observation: Any, predictor: Predictor = predictor) -> Any:
            return predictor.action(observation if normalization is None else normalization.normalize_obs(observation))

        counted = _RewardSum(env)
        with frozen_statistics(env):
            result = run_episode(counted, act, seed=seed + number)[0]
        results.append(replace(result, reward=counted.total) if counted.differs_from(result.reward) else result)
    return tuple(results)


class _RewardSum(gym.Wrapper[Any, Any, Any, Any]):
    """Sums the rewards that an environment returns.

    Attributes:
        total: the sum.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.total = 0.0

    @override
    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        result = self.env.step(action)
        reward: Any = result[1]
        self.total += float(reward) if np.ndim(reward) == 0 else math.nan
        return result

    def differs_from(self, reward: float | None) -> bool:
        """Return whether a wrapper pays another reward than the building's, apart from one that scales it."""
        if reward is None or not math.isfinite(self.total) or {type(layer).__name__ for layer in layers(self)} & SCALED:
            return False
        return not math.isclose(self.total, reward, rel_tol=1e-6, abs_tol=1e-9)


def _check_environment(model: BaseAlgorithm, env: Any) -> None:
    """Raise `InvalidConfig` if a model cannot be evaluated in an environment."""
    if not isinstance(env, gym.Env):
        raise InvalidConfig(f"an evaluation needs a single environment, of gymnasium.make, and got {env!r}")
    attribute(env, "manifest")
    for kind in ("observation", "action"):
        trained, current = getattr(model, f"{kind}_space"), getattr(env, f"{kind}_space")
        forms = [(type(space), space.shape, getattr(space, "n", None)) for space in (trained, current)]
        if forms[0] != forms[1]:
            raise InvalidConfig(
                f"the model was trained on other {kind}s than those of the evaluation: "
                f"{describe_difference(trained, current)}; apply the wrappers of its training"
            )


def _copy_wrapper_state(training: Any, env: gym.Env[Any, Any]) -> str:
    """Copy what the wrappers of the training's first environment have learnt to those of `env`; return it as text.

    Environments in other processes cannot be read: use `VecNormalize` there. The wrappers are then those of `env`.
    """
    base = training.unwrapped  # the wrappers of slots are around the vector environment
    envs = getattr(base, "envs", None) or [env for env in [getattr(base, "env", None)] if env is not None]
    with scratch_folder() as folder:
        path = folder / "learnt.yaml"
        save_wrappers(envs[0] if envs else env, path)
        text = path.read_text(encoding="utf-8")
    content = yaml12.parse(text, str(path))
    if envs and (states := content["wrappers"]):
        logs = any(type(layer).__name__ in LOGS for layer in layers(env))  # an evaluation need not log
        set_wrapper_states(env, states if logs else without_logs(states), "the training's wrappers")
    return text if content != {"wrappers": []} else ""
