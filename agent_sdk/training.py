"""Beside stable-baselines3: evaluation during a training that leaves it alone, and its models as controllers."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

import gymnasium as gym
import numpy as np

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers import Controller, Values
from agent_sdk.envs import spaces
from agent_sdk.envs.actions import Actions
from agent_sdk.envs.time_features import time_features
from agent_sdk.evaluation.evaluate import Maker, run_episode
from agent_sdk.evaluation.metrics import EpisodeMetrics
from agent_sdk.vec_normalization import beside_model, load_normalization, mark_normalized, normalization_of
from agent_sdk.wrappers import restore_wrappers, save_wrappers
from topics import yaml12
from topics.atomic_file import atomic_file
from topics.errors import InvalidConfig, UnknownName, did_you_mean
from topics.extras import install_command
from topics.messages import CommandOp, Manifest

try:
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise InvalidConfig(f"training needs stable-baselines3 ({error}): {install_command('train')}") from None

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "a2c": sb3.A2C,
    "ddpg": sb3.DDPG,
    "dqn": sb3.DQN,
    "ppo": sb3.PPO,
    "sac": sb3.SAC,
    "td3": sb3.TD3,
}
"""By the name that stands before a model's file: `ppo:model.zip`."""

MakeEnv = Callable[[], gym.Env[Any, Any]]
"""Makes an environment for evaluation, wrapped as those of the training."""


class EvaluationCallback(BaseCallback):
    """Evaluates the model every so many steps of training, in an environment of its own.

        model.learn(100_000, callback=EvaluationCallback(make_env, every=10_000, best_model_path="best.zip"))

    Neither the training's environments nor any random state are touched: with it and without it the same seed gives
    the same weights. What the training's wrappers and its `VecNormalize` have learnt is copied for each evaluation.
    The means over the episodes of all metrics of `EpisodeMetrics` go to the model's logger, as `eval/reward`.

    Args:
        make_env: makes the environment when it is first needed. It is closed when the training ends; `with` closes
            it also if that ends by an exception.
        every: training steps, counted over all environments, from one evaluation to the next.
        episodes: of an evaluation.
        seed: of its first episode; the others have the next ones. Each evaluation has the same.
        best_model_path: file (.zip) for the model with the greatest mean reward. `VecNormalize` goes beside it as
            `.vecnormalize.pkl`, what wrappers have learnt as `.wrappers.yaml`, where there are any.

    Attributes:
        results: step of the training to the evaluation's episodes.
        best_reward: the greatest mean reward of an evaluation; None before the first.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        every: int,
        episodes: int = 1,
        seed: int = 0,
        best_model_path: str | Path | None = None,
    ) -> None:
        super().__init__()
        if every < 1 or episodes < 1:
            raise InvalidConfig(f"every={every}, episodes={episodes}: numbers of at least 1 expected")
        path = None if best_model_path is None else Path(best_model_path)
        if path is not None and (path.suffix != ".zip" or not path.absolute().parent.is_dir()):
            raise InvalidConfig(f"best_model_path={str(path)!r}: a file .zip in a folder that exists expected")
        self._make_env, self._every, self._episodes, self._seed = make_env, every, episodes, seed
        self._path = path
        self._env: gym.Env[Any, Any] | None = None
        self._due = 0
        self.results: dict[int, tuple[EpisodeMetrics, ...]] = {}
        self.best_reward: float | None = None

    def __enter__(self) -> EvaluationCallback:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes its environment; twice is fine, and another evaluation makes a new one."""
        env, self._env = self._env, None
        if env is not None:
            env.close()

    def _on_training_start(self) -> None:
        mark_normalized(self.model)
        self._due = self.num_timesteps + self._every

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._due:
            self._due += self._every * (1 + (self.num_timesteps - self._due) // self._every)
            with _random_state_kept():
                self._evaluate()
        return True

    def _on_training_end(self) -> None:
        self.close()

    def _evaluate(self) -> None:
        env = self._own_env()
        learnt = _copy_learnt(self.training_env, env)
        results = evaluate_model(self.model, env, episodes=self._episodes, seed=self._seed)
        self.results[self.num_timesteps] = results
        rewards = [result.reward for result in results]
        if None in rewards:
            raise InvalidConfig("the evaluation's environment has no reward; leave out reward=None in make_env")
        self._log(results)
        mean = float(np.mean(np.array(rewards, np.float64)))
        if self.best_reward is None or mean > self.best_reward:
            self.best_reward = mean
            self._save(learnt)

    def _own_env(self) -> gym.Env[Any, Any]:
        if self._env is None:
            env = self._make_env()
            if any(env.unwrapped is other.unwrapped for other in getattr(self.training_env.unwrapped, "envs", [])):
                raise InvalidConfig("make_env gave an environment of the training; let it make a new one at each call")
            self._env = env
        return self._env

    def _log(self, results: tuple[EpisodeMetrics, ...]) -> None:
        metrics = [result.metrics() for result in results]
        for name in metrics[0]:
            values = [one.get(name) for one in metrics]
            if None not in values:
                self.logger.record(f"eval/{name}", float(np.mean(np.array(values, np.float64))))
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)

    def _save(self, learnt: str) -> None:
        if self._path is None:
            return
        with atomic_file(self._path) as temporary:
            self.model.save(temporary)
        normalising = self.model.get_vec_normalize_env()
        beside, wrappers = beside_model(self._path), self._path.with_suffix(".wrappers.yaml")
        if normalising is not None:
            normalising.save(str(beside))
        else:
            beside.unlink(missing_ok=True)  # a former training's
        if learnt:
            wrappers.write_text(learnt, encoding="utf-8")
        else:
            wrappers.unlink(missing_ok=True)


def evaluate_model(
    model: BaseAlgorithm, env: gym.Env[Any, Any], *, episodes: int = 1, seed: int = 0
) -> tuple[EpisodeMetrics, ...]:
    """Episodes of a model, without exploration, in an environment that is wrapped as those of its training.

    The observations go through the model's `VecNormalize` if it has one, which learns nothing of them. Episode k is
    reset with `seed + k`.

    Raises:
        InvalidConfig: the model was trained behind a `VecNormalize` that it was loaded without.
    """
    normalising = normalization_of(model)
    results = []
    for number in range(episodes):
        memory = _Memory(model)

        def act(observation: Any, memory: _Memory = memory) -> Any:
            return memory.action(observation if normalising is None else normalising.normalize_obs(observation))

        results.append(run_episode(env, act, seed=seed + number)[0])
    return tuple(results)


class _Memory:
    """A model's predictions through an episode, with the state of one that is recurrent."""

    def __init__(self, model: BaseAlgorithm) -> None:
        self._model = model
        self._state: Any = None
        self._first = np.array([True])

    def action(self, observation: Any) -> Any:
        answer, self._state = self._model.predict(
            observation, state=self._state, episode_start=self._first, deterministic=True
        )
        self._first = np.array([False])
        return answer


def _copy_learnt(training: Any, env: gym.Env[Any, Any]) -> str:
    """Has the wrappers of `env` go on from those of the training's first environment; what they have learnt, as text.

    Environments in other processes are not reached: use `VecNormalize` there.
    """
    base = training.unwrapped  # of slots, the vector environment has the wrappers
    envs = getattr(base, "envs", None) or [env for env in [getattr(base, "env", None)] if env is not None]
    if not envs:
        return ""
    with TemporaryDirectory(prefix="zenostat-") as folder:
        path = Path(folder) / "learnt.yaml"
        save_wrappers(envs[0], path)
        text = path.read_text(encoding="utf-8")
        if not yaml12.parse(text, str(path))["wrappers"]:
            return ""
        restore_wrappers(env, path)
    return text


@contextmanager
def _random_state_kept() -> Iterator[None]:
    """Afterwards the global generators of Python, NumPy and torch stand where they stood."""
    python, numpy = random.getstate(), np.random.get_state()
    with torch.random.fork_rng(devices=[]):  # without exploration nothing is drawn on other devices
        try:
            yield
        finally:
            random.setstate(python)
            np.random.set_state(numpy)


class PolicyController(Controller):
    """A trained model as a controller.

    Args:
        manifest: of the node.
        model: of stable-baselines3, or anything else with its `predict`, `observation_space` and `action_space`.
        normalization: of its observations; left out, that of the environment that the model is on, if it has one.

    Raises:
        InvalidConfig: it was trained on other observations or actions than the node's, or behind a `VecNormalize` that
            is not there.
    """

    def __init__(self, manifest: Manifest, model: BaseAlgorithm, normalization: VecNormalize | None = None) -> None:
        super().__init__(manifest)
        self._actions = Actions(manifest)
        for what, trained, here in (
            ("observations", model.observation_space, spaces.observation_space(manifest)),
            ("actions", model.action_space, self._actions.space),
        ):
            if trained != here:
                names = _dimensions(manifest, what)
                raise InvalidConfig(
                    f"the model was trained on other {what} than those of {manifest.node!r}: "
                    f"{_difference(trained, here, names)}; use the scenario of its training; a model trained behind "
                    "wrappers is evaluated by agent_sdk.training.evaluate_model"
                )
        self._normalization = normalization if normalization is not None else normalization_of(model)
        self._model, self._memory = model, _Memory(model)
        self._step = timedelta(hours=1 / manifest.steps_per_hour)

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """A recurrent model forgets."""
        self._memory = _Memory(self._model)

    def act(self, sample: SampleView) -> Values:
        """What the model does without exploration."""
        values, fields = sample.values, self.manifest.task.time
        if fields:
            begin = sample.time - self._step if sample.step else sample.time
            values = np.concatenate([time_features(fields, begin, sample.time), values])
        observation: Any = values.astype(np.float32)
        if self._normalization is not None:
            observation = self._normalization.normalize_obs(observation)
        chosen = self._actions.values(self._memory.action(observation))
        kinds = self._actions.operations or bytes([CommandOp.SET] * len(chosen))
        named = zip(self.manifest.actuators, chosen.tolist(), kinds, strict=True)
        return {actuator.name: value for actuator, value, kind in named if kind == CommandOp.SET}


def _dimensions(manifest: Manifest, what: str) -> list[str]:
    """The names of the dimensions of a node's observations or actions."""
    task = manifest.task
    return [*task.time, *manifest.names] if what == "observations" else [action.name for action in task.actions]


def _difference(trained: gym.Space[Any], here: gym.Space[Any], names: Sequence[str]) -> str:
    """How two spaces differ: by the names whose bounds do, if both have as many dimensions."""
    if not (isinstance(trained, gym.spaces.Box) and isinstance(here, gym.spaces.Box)):
        return f"{trained}, here {here}"
    if trained.shape != here.shape or len(names) != here.low.size:
        return f"{trained.low.size} of them, here {here.low.size}: {', '.join(names)}"
    before, now = (np.stack([box.low.ravel(), box.high.ravel()], 1) for box in (trained, here))
    rows = zip(names, before.tolist(), now.tolist(), strict=True)
    return "; ".join(f"{name} was {a[0]:g} to {a[1]:g}, here {b[0]:g} to {b[1]:g}" for name, a, b in rows if a != b)


def load_policy(path: str | Path, algorithm: str | type[BaseAlgorithm] | None = None) -> Maker:
    """A trained model as a controller: called with a node's manifest, as a class of a controller is.

    The normalization of a model that was trained behind `VecNormalize` is loaded with it: `model.vecnormalize.pkl`
    beside `model.zip`, where `EvaluationCallback` puts it and `VecNormalize.save` can.

    Both files hold pickled Python objects, which may run anything when they are read: load what you trust.

    Args:
        path: what `model.save` wrote; or, with the algorithm before it, `ppo:model.zip`.
        algorithm: one of `ALGORITHMS`, or a class, as `sb3_contrib.RecurrentPPO`.

    Raises:
        UnknownName: no such file or algorithm.
        InvalidConfig: the file is no model of that algorithm; its normalization is missing or does not fit.
    """
    name, colon, rest = str(path).partition(":")
    if algorithm is None:
        if not colon:
            raise InvalidConfig(f"say which algorithm trained {path}: one of {', '.join(ALGORITHMS)}, as ppo:{path}")
        algorithm, path = name, rest
    path = Path(path).expanduser()
    if isinstance(algorithm, str):
        if algorithm.casefold() not in ALGORITHMS:
            raise UnknownName(f"no algorithm {algorithm!r}; {did_you_mean(algorithm, ALGORITHMS)}")
        algorithm = ALGORITHMS[algorithm.casefold()]
    if not path.is_file():
        raise UnknownName(f"there is no file {path.absolute()} to take a model from")
    try:
        with _random_state_kept():  # a model that was made with a seed seeds everything when it is loaded
            model = algorithm.load(path, device="cpu")
    except Exception as fault:
        raise InvalidConfig(
            f"{path} is no model of {algorithm.__name__}, or of another version: {type(fault).__name__}: {fault}"
        ) from fault

    normalization = load_normalization(model, path)

    def policy(manifest: Manifest) -> PolicyController:
        return PolicyController(manifest, model, normalization)

    return policy
