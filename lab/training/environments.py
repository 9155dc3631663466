"""Environments of a training: wrappers, slots, normalization, and the scenario as a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor, VecNormalize

from zenostat.agent_sdk.envs.arguments import check_agent_fields, of_scenario
from zenostat.agent_sdk.envs.sb3_vec_env import as_sb3
from zenostat.agent_sdk.wrappers import action_names_of, apply_wrappers, wrappers_of
from zenostat.agent_sdk.wrappers.checkpoint import LOGS
from zenostat.agent_sdk.wrappers.names import attribute, reject_wrappers
from zenostat.agent_sdk.wrappers.serialization import check_wrappers
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.lab.scenario_env import add_monitoring, pop_env_id
from zenostat.lab.training.config import TrainingConfig
from zenostat.lab.training.episode_recorder import EpisodeRecorder
from zenostat.lab.training.horizon import discount
from zenostat.lab.training.paired_reward import paired
from zenostat.topics import yaml12
from zenostat.topics.errors import ErrorCollector, InvalidConfig
from zenostat.topics.messages import Manifest

_BUILDING = "zenostat/Building-v1"
RESCALED = {"wrapper": "RescaleAction", "min_action": -1.0, "max_action": 1.0}
"""The wrapper of `normalization: {actions: true}`."""


def check_environment(config: TrainingConfig) -> None:
    """Check what can be checked of a training's environments before anything starts.

    Raises:
        UnknownName: there is no such scenario.
        InvalidConfig: wrappers or a reward of the training or its scenario are invalid.
    """
    errors = ErrorCollector()
    errors.collect(lambda: check_wrappers(config.wrappers))
    arguments = config.evaluation.arguments if config.evaluation else {}
    for where, chosen in (("arguments", config.arguments), ("evaluation.arguments", arguments)):
        if "reward" in chosen and chosen["reward"] is None:
            errors.errors.append(InvalidConfig(f"{where}.reward: a training needs a reward, and this is none"))
    scenarios = [config.scenario, (config.evaluation and config.evaluation.scenario) or config.scenario]
    for scenario in dict.fromkeys(scenarios):
        errors.collect(partial(pop_env_id, of_scenario(scenario)))
        errors.collect(partial(check_agent_fields, scenario))
    errors.raise_if_any()


def make_env(config: TrainingConfig, *, for_evaluation: bool = False) -> gym.Env[Any, Any]:
    """Make one environment of a training within its wrappers.

    One for evaluations has none that write logs, and also measures what metrics need, as `evaluate` does.
    """
    arguments = config.environment(for_evaluation=for_evaluation)
    if for_evaluation and is_building(arguments):
        add_monitoring(arguments)
    env: gym.Env[Any, Any] = _wrapped(
        gym.make(pop_env_id(arguments), **arguments), config, for_evaluation=for_evaluation
    )
    return env


def is_building(arguments: Mapping[str, Any]) -> bool:
    """Return whether the arguments of `gym.make` are those of a building, rather than an environment of the user's."""
    return bool(gym.spec(pop_env_id(dict(arguments))).entry_point == gym.spec(_BUILDING).entry_point)


def make_slots(config: TrainingConfig) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Make the vector environment of a training within its wrappers."""
    arguments = config.environment()
    mode: Any = gym.VectorizeMode.VECTOR_ENTRY_POINT
    env_id = pop_env_id(arguments)
    env: gym.vector.VectorEnv[Any, Any, Any] = _wrapped(
        gym.make_vec(env_id, config.slots, mode, autoreset_mode="SameStep", **arguments), config
    )
    return env


def _wrapped(env: Any, config: TrainingConfig, *, for_evaluation: bool = False) -> Any:
    try:
        wrappers = [entry for entry in config.wrappers if not (for_evaluation and entry["wrapper"] in LOGS)]
        env = apply_wrappers(env, wrappers)
        space = getattr(env, "single_action_space", env.action_space)
        if config.normalization and config.normalization.actions and isinstance(space, gym.spaces.Box):
            env = apply_wrappers(env, [RESCALED])
    except BaseException:
        env.close()
        raise
    return env


class TrainingEnv:
    """The environment of a training, as the layers that stable-baselines3 sees.

    Attributes:
        env: single or vector environment of Gymnasium, within the training's wrappers.
        stepped: the same, or with its reference (`paired_reward`).
        recorder: records what a checkpoint needs to return to the running episodes.
        monitor: records rewards and lengths of episodes.
        normalization: scales observations and rewards; None if neither is scaled.
        outermost: the layer for the algorithm.
    """

    def __init__(self, config: TrainingConfig) -> None:
        make: Callable[[TrainingConfig], Any] = make_env if config.slots == 1 else make_slots
        with ExitStack() as undo:
            self.env = self.stepped = make(config)
            undo.callback(self.env.close)
            self._reference: Any = None
            reject_wrappers(self.env, ["RewardVector"], "a training needs one reward; remove {}")
            if config.evaluation:
                text = "{} leaves out of the infos what evaluations need; remove it, or set evaluation: false"
                reject_wrappers(self.env, ["NumericInfos"], text)
            if config.paired_reward:
                self._reference = make(config)
                undo.callback(self._reference.close)
                self.stepped = paired(self.env, self._reference)
            base: VecEnv = DummyVecEnv([lambda: self.stepped]) if config.slots == 1 else as_sb3(self.stepped)
            self.recorder = EpisodeRecorder(base, attribute(self.env, "observation_names"))
            self.monitor = VecMonitor(self.recorder)
            self.normalization = _normalization(config, self.monitor)
            self.outermost: VecEnv = self.normalization or self.monitor
            undo.pop_all()

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions."""
        return action_names_of(self.env)

    @property
    def episode(self) -> tuple[float, int]:
        """Length of a timestep, s, and timesteps of an episode."""
        manifest: Manifest = attribute(self.env, "manifest")
        return manifest.step_s, manifest.steps

    def scenario(self) -> str:
        """Return the scenario with all wrappers as the text of a scenario file; "" without a node."""
        link = getattr(self.env.unwrapped, "link", None)
        if not isinstance(link, ControllerLink):
            return ""
        fields = yaml12.parse(link.scenario(), "the node's scenario")
        return yaml12.dump({**fields, "wrappers": self.wrappers()})

    def wrappers(self) -> list[dict[str, Any]]:
        """Return all wrappers as data, innermost first."""
        return wrappers_of(self.env)

    def close(self) -> None:
        """Close the environment, and its reference if it has one; idempotent."""
        for env in self.both:
            env.close()

    @property
    def both(self) -> list[Any]:
        """The environment, and its reference if it has one."""
        return [env for env in (self.env, self._reference) if env is not None]


def _normalization(config: TrainingConfig, env: VecEnv) -> VecNormalize | None:
    settings = config.normalization
    if not settings or not (settings.observations or settings.rewards):
        return None
    if settings.observations and not isinstance(env.observation_space, gym.spaces.Box):
        raise InvalidConfig(f"normalization.observations: a Box is needed, got {env.observation_space}")
    return VecNormalize(
        env, norm_obs=settings.observations, norm_reward=settings.rewards, clip_obs=settings.clip_observations,
        clip_reward=settings.clip_rewards, gamma=discount(config),
    )  # fmt: skip


def simulated_state(env: Any) -> bytes:
    """Return the values of the current samples of a single or vector environment, without any wrapper."""
    base = env.unwrapped
    sample = getattr(base, "_sample", None)
    message = getattr(getattr(sample, "sample", sample), "message", None)
    return b"" if message is None else message.values + np.array(message.step, np.int64).tobytes()
