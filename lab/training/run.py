"""Run a training from its configuration: `train`."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from zenostat.agent_sdk.controllers import training_folder
from zenostat.agent_sdk.vec_normalization import mark_normalized
from zenostat.lab.training import folder as files
from zenostat.lab.training.checkpoint import (
    Checkpoint,
    capture,
    checkpoints,
    last_checkpoint,
    restore_action_noise,
    restore_environment,
    restore_model,
    restore_random_states,
    wrapper_state,
)
from zenostat.lab.training.config import EVALUATIONS, TrainingConfig
from zenostat.lab.training.curve import LearningCurve, reference_rewards
from zenostat.lab.training.environments import TrainingEnv, check_environment, make_env
from zenostat.lab.training.evaluation_callback import EvaluationCallback
from zenostat.lab.training.horizon import discount, horizon_warning, scale_warning
from zenostat.lab.training.logs import check_logs, make_logger
from zenostat.lab.training.parameters import check_action_space, check_algorithm, make_model
from zenostat.lab.training.references import OnReferences, check_references, evaluate_references
from zenostat.lab.training.zero_actions import begin_at, zero_actions
from zenostat.metrics.episode_metrics import EpisodeMetrics
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import ErrorCollector, InvalidConfig
from zenostat.topics.file_lock import locked

_CAPTURE_S = 5.0
"""Seconds between two captures of an on-policy training for the case that it is stopped within a rollout."""


@dataclass(frozen=True)
class TrainingStatus:
    """State of a running training, for a progress bar.

    Attributes:
        step, steps: training steps so far, and in all.
        episodes: number of training episodes that have ended.
        reward: mean reward of the last hundred of them; None before the first.
        evaluation: mean reward of the last evaluation; None before the first.
    """

    step: int
    steps: int
    episodes: int
    reward: float | None
    evaluation: float | None


@dataclass(frozen=True)
class TrainingResult:
    """Result of a training.

    Attributes:
        folder: its folder.
        step: number of training steps; of a training that was stopped, those of its checkpoint.
        finished: whether it did all its steps.
        best_reward: highest mean reward of an evaluation; None without evaluations.
    """

    folder: Path
    step: int
    finished: bool
    best_reward: float | None


Progress = Callable[[TrainingStatus], None]
OnEvaluation = Callable[[int, tuple[EpisodeMetrics, ...]], None]


def check_training(config: TrainingConfig, *, resume: bool = False) -> None:
    """Check all that can be checked before anything starts, and report all errors.

    Raises:
        InvalidConfig, UnknownName: see `check_algorithm`, `check_environment` and `check_logs`; or the folder already
            has a training, or with `resume` another one or none.
    """
    errors = ErrorCollector()
    errors.collect(lambda: check_algorithm(config))
    errors.collect(lambda: check_environment(config))
    errors.collect(lambda: check_logs(config))
    errors.collect(lambda: check_references(config))
    errors.collect(lambda: _check_folder(config, resume=resume))
    errors.raise_if_any()


def _check_folder(config: TrainingConfig, *, resume: bool) -> None:
    folder = config.folder
    if resume:
        files.check_same(files.read_folder(folder), config, folder)
    elif training_folder.is_training(folder):
        raise InvalidConfig(f"{folder} already has a training: resume it, or choose another output folder")
    elif folder.exists() and not folder.is_dir():
        raise InvalidConfig(f"{folder} is not a folder: choose another output folder")


def train(
    config: TrainingConfig,
    *,
    resume: bool = False,
    progress: Progress | None = None,
    on_evaluation: OnEvaluation | None = None,
    on_references: OnReferences | None = None,
    stop: threading.Event | None = None,
) -> TrainingResult:
    """Train, and write model, normalization, wrappers, scenario, versions, curve and logs to the training's folder.

    The same configuration gives the same weights, to the bit, as stable-baselines3 with the same environment and
    arguments: evaluations, checkpoints and logs do not affect the training.

    Args:
        config: the training.
        resume: continue from the last checkpoint in its folder that can be read. The result equals, to the bit, that of
            a training that was not interrupted, on the same machine with the same versions. `steps` may differ.
        progress: called at each step.
        on_evaluation: called after each evaluation, with the training step and the metrics of its episodes.
        on_references: called before the training, with the mean reward of an evaluation episode by reference.
        stop: when it is set, a checkpoint is written and the training ends.

    Raises:
        InvalidConfig, UnknownName: see `check_training`; the algorithm cannot have the scenario's actions; or a
            checkpoint does not fit.
        BusError, SimulatorError: see `BuildingEnv`; the last checkpoint can be resumed.
    """
    check_training(config, resume=resume)
    folder = config.folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # a name that the system does not accept
        raise InvalidConfig(f"output: cannot create the folder {str(folder)[:200]!r}: {error}") from None
    with ExitStack() as stack:
        stack.callback(_remove_if_empty, folder)
        stack.enter_context(locked(folder / training_folder.LOCK, f"{folder}: another process is training there"))
        run = _Run(config, folder, stack, on_evaluation, on_references)
        return run.train(progress, stop or threading.Event(), resume=resume)


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


class _Run:
    """A training with its open environments and files, which `stack` closes."""

    def __init__(
        self,
        config: TrainingConfig,
        folder: Path,
        stack: ExitStack,
        on_evaluation: OnEvaluation | None,
        on_references: OnReferences | None,
    ) -> None:
        self._config, self._folder, self._stack = config, folder, stack
        self._on_evaluation, self._on_references = on_evaluation, on_references
        self._last_evaluation: float | None = None

    def train(self, progress: Progress | None, stop: threading.Event, *, resume: bool) -> TrainingResult:
        config, folder, stack = self._config, self._folder, self._stack
        checkpoint = last_checkpoint(folder / training_folder.CHECKPOINTS) if resume else None
        if checkpoint is not None and config.steps < min(checkpoint.step, files.read_folder(folder).steps):
            raise InvalidConfig(f"{folder} has {checkpoint.step} steps already; steps={config.steps} would be fewer")
        if config.threads is not None:
            stack.callback(torch.set_num_threads, torch.get_num_threads())
            torch.set_num_threads(config.threads)
        env = TrainingEnv(config)
        stack.callback(env.close)
        check_action_space(config, env.outermost.action_space, env.action_names)
        if text := horizon_warning(discount(config), *env.episode):
            warnings.warn(text, stacklevel=3)
        model = make_model(config, env.outermost)
        mark_normalized(model)
        if config.zero_start:
            begin_at(model, zero_actions(env.env, "zero_start"))
        if resume:
            files.check_same_scenario(folder, env.wrappers(), env.scenario())
        files.create(folder, config, env.wrappers(), env.scenario())
        begin = 0 if checkpoint is None else checkpoint.step
        model.set_logger(make_logger(config, folder, begin))
        stack.callback(model.logger.close)
        self._curve = LearningCurve(folder, None if checkpoint is None else begin)
        stack.callback(self._curve.close)
        if checkpoint is not None:
            restore_environment(checkpoint, env, config.seed)
            restore_model(checkpoint, model)
        else:
            evaluate_references(config, folder)
        if self._on_references is not None and (rewards := reference_rewards(folder)):
            self._on_references(rewards)
        evaluation = self._evaluation_callback()
        callback = _TrainingCallback(
            env, evaluation, self._curve, folder / training_folder.CHECKPOINTS, config, stop, checkpoint
        )
        callback.report = None if progress is None else partial(self._report, progress)
        if begin < config.steps:
            both = CallbackList([callback] if evaluation is None else [evaluation, callback])
            model.learn(config.steps - begin, callback=both, reset_num_timesteps=checkpoint is None)
        best = None if evaluation is None else evaluation.best_reward
        if callback.stopped_at is not None:
            return TrainingResult(folder, callback.stopped_at, finished=False, best_reward=best)
        _save_model(model, env, folder / training_folder.MODEL)
        return TrainingResult(folder, model.num_timesteps, finished=True, best_reward=best)

    def _evaluation_callback(self) -> EvaluationCallback | None:
        settings = self._config.evaluation
        if not settings:
            return None
        return self._stack.enter_context(
            EvaluationCallback(
                partial(make_env, self._config, for_evaluation=True),
                every=self._config.evaluation_steps,
                every_episodes=settings.every_episodes,
                at_start=settings.at_start,
                episodes=settings.episodes,
                seed=settings.seed,
                best_model_path=self._folder / training_folder.BEST,
                on_evaluation=partial(self._evaluated, settings.seed),
            )
        )

    def _evaluated(self, seed: int, step: int, results: tuple[EpisodeMetrics, ...]) -> None:
        rewards = [result.reward for result in results if result.reward is not None]
        self._last_evaluation = float(np.mean(rewards)) if rewards else None
        self._curve.add_evaluation(step, seed, results)
        if self._on_evaluation is not None:
            self._on_evaluation(step, results)

    def _report(self, progress: Progress, step: int) -> None:
        curve = self._curve
        progress(
            TrainingStatus(step, self._config.steps, len(curve.episodes.rows), curve.mean_reward, self._last_evaluation)
        )


class _TrainingCallback(BaseCallback):  # type: ignore[misc,unused-ignore]  # without types where it is not installed
    """Records episodes, writes checkpoints, and stops the training when it is asked to.

    Attributes:
        stopped_at: step of the checkpoint with which the training was stopped; None if it was not.
        report: called with the training step at each step.
    """

    def __init__(
        self,
        env: TrainingEnv,
        evaluation: EvaluationCallback | None,
        curve: LearningCurve,
        folder: Path,
        config: TrainingConfig,
        stop: threading.Event,
        resumed: Checkpoint | None,
    ) -> None:
        super().__init__()
        self._env, self._evaluation, self._curve, self._folder, self._stop = env, evaluation, curve, folder, stop
        self._interval = config.checkpoint_steps or max(config.steps // EVALUATIONS, 1)
        self._gamma = discount(config)
        self._checks_scale = resumed is None and not (config.normalization and config.normalization.rewards)
        self._resumed, self._captured = resumed, float("-inf")
        self._latest: Checkpoint | None = None
        self._due = 0
        self.stopped_at: int | None = None
        self.report: Callable[[int], None] | None = None
        if resumed is not None and evaluation is not None:
            counters = resumed.state["counters"]
            evaluation.best_reward, evaluation.training_episodes = counters["best_reward"], counters["episodes"]

    def _on_training_start(self) -> None:
        self._due = (self.num_timesteps // self._interval + 1) * self._interval
        if self._resumed is None:
            return
        restore_action_noise(self._resumed, self.model)
        if self._resumed.state["counters"]["between"] == "trainings":
            restore_random_states(self._resumed, self.model, self._env)
            self._resumed = None

    def _on_rollout_start(self) -> None:
        if self._resumed is not None:
            restore_random_states(self._resumed, self.model, self._env)
            self._resumed = None
        is_on_policy = isinstance(self.model, OnPolicyAlgorithm)
        if is_on_policy and time.monotonic() - self._captured >= _CAPTURE_S:
            self._latest, self._captured = self._capture("rollouts"), time.monotonic()
        if self.num_timesteps >= self._due:
            self._due = (self.num_timesteps // self._interval + 1) * self._interval
            self._capture("rollouts").write(self._folder)
        elif self._stop.is_set() and not is_on_policy:
            self._latest = self._capture("rollouts")

    def _capture(self, between: str) -> Checkpoint:
        evaluation = self._evaluation
        counters = {
            "between": between,
            "best_reward": None if evaluation is None else evaluation.best_reward,
            "episodes": 0 if evaluation is None else evaluation.training_episodes,
        }
        return capture(self.model, self._env, counters)

    def _on_step(self) -> bool:
        self._curve.add_episodes(self.num_timesteps, self.locals["infos"])
        if self._checks_scale:
            self._check_scale(self.locals["infos"])
        if self.report is not None:
            self.report(self.num_timesteps)
        if self._stop.is_set() and self._latest is not None:
            saved = checkpoints(self._folder)
            newest = int(saved[-1].name.rpartition("-")[2]) if saved else -1
            if self._latest.step > newest:
                self._latest.write(self._folder)
            self.stopped_at = max(newest, self._latest.step)
            return False
        return True

    def _check_scale(self, infos: Sequence[Mapping[str, Any]]) -> None:
        """Warn once, at the end of the first episode, if its rewards are too large or too small."""
        for episode in (info["episode"] for info in infos if "episode" in info):
            self._checks_scale = False
            if text := scale_warning(self._gamma, float(episode["r"]), int(episode["l"])):
                warnings.warn(text, stacklevel=2)
            return

    def _on_training_end(self) -> None:
        if self.stopped_at is None:
            self._capture("trainings").write(self._folder)


def _save_model(model: BaseAlgorithm, env: TrainingEnv, path: Path) -> None:
    """Write the model with what its observations need, as `EvaluationCallback` does for the best one."""
    if env.normalization is not None:
        with atomic_file(training_folder.normalization_path(path)) as temporary:
            env.normalization.save(str(temporary))
    if text := wrapper_state(env.env):
        with atomic_file(training_folder.wrappers_path(path)) as temporary:
            temporary.write_text(text, encoding="utf-8")
    with atomic_file(path) as temporary:
        model.save(temporary)


def resume_training(folder: Path, steps: int | None = None) -> TrainingConfig:
    """Return the configuration with which the training of a folder is resumed.

    Args:
        folder: the folder.
        steps: number of training steps in all, if it should be another one.
    """
    config = files.read_folder(folder).model_copy(update={"output": str(folder)})
    return config if steps is None else config.model_copy(update={"steps": steps})
