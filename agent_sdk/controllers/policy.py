"""A trained model of stable-baselines3 as a controller."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.controllers.predictor import Predictor, describe_difference
from zenostat.agent_sdk.envs import spaces
from zenostat.agent_sdk.envs.action_values import Actions, named_values
from zenostat.agent_sdk.envs.time_features import time_features
from zenostat.agent_sdk.vec_normalization import normalization_of
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Manifest
from zenostat.topics.points import observed_indices

with requires_extra("train", "training", "stable-baselines3"):
    import stable_baselines3 as sb3
    import torch
    from sb3_contrib import RecurrentPPO
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "a2c": sb3.A2C,
    "ddpg": sb3.DDPG,
    "dqn": sb3.DQN,
    "ppo": sb3.PPO,
    "recurrent-ppo": RecurrentPPO,
    "sac": sb3.SAC,
    "td3": sb3.TD3,
}
"""Algorithms by the prefix of a model's file: `ppo:model.zip`."""


@contextmanager
def preserve_random_state() -> Iterator[None]:
    """Restore the global random generators of Python, NumPy and torch on exit."""
    python, numpy = random.getstate(), np.random.get_state()
    with torch.random.fork_rng(devices=[]):  # without exploration, other devices draw no random numbers
        try:
            yield
        finally:
            random.setstate(python)
            np.random.set_state(numpy)


class PolicyController(Controller):
    """A trained model as a controller.

    Args:
        manifest: The node's manifest.
        model: A model of stable-baselines3, or any object with its `predict`, `observation_space` and `action_space`.
        normalization: Normalization of its observations; left out, that of the model's environment, if it has one.

    Raises:
        ControllerMismatch: It was trained on other observations or actions than the node's, or takes action masks.
        InvalidConfig: It was trained behind a `VecNormalize` that is missing.
    """

    def __init__(self, manifest: Manifest, model: BaseAlgorithm, normalization: VecNormalize | None = None) -> None:
        super().__init__(manifest)
        self._actions = Actions(manifest)
        for kind, trained, current in (
            ("observations", model.observation_space, spaces.observation_space(manifest)),
            ("actions", model.action_space, self._actions.space),
        ):
            if trained != current:
                names = _dimension_names(manifest, kind)
                raise ControllerMismatch(
                    f"the model was trained on other {kind} than those of {manifest.node!r}: "
                    f"{describe_difference(trained, current, names)}; use the scenario of its training; for a "
                    "model trained behind wrappers, save_wrappers(env, 'model.wrappers.yaml') beside model.zip"
                )
        self._normalization = normalization if normalization is not None else normalization_of(model)
        self._model, self._predictor = model, Predictor(model)
        self._timestep = manifest.timestep
        self._observed = observed_indices(manifest)

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the state of a recurrent model."""
        self._predictor = Predictor(self._model)

    def act(self, sample: SampleView) -> Values:
        """Return the model's action without exploration."""
        values, fields = sample.values, self.manifest.task.time
        if self._observed is not None:
            values = values[self._observed]
        if fields:
            begin = sample.time - self._timestep if sample.step else sample.time
            values = np.concatenate([time_features(fields, begin, sample.time), values])
        observation: Any = values.astype(np.float32)
        if self._normalization is not None:
            observation = self._normalization.normalize_obs(observation)
        values, operations = self._actions.command(self._predictor.action(observation), sample.fault_free_values, {})
        return named_values(self.manifest, values, operations)


def _dimension_names(manifest: Manifest, kind: str) -> list[str]:
    """Return the names of the dimensions of a node's observations or actions."""
    task = manifest.task
    return (
        [*task.time, *manifest.observed_names] if kind == "observations" else [action.name for action in task.actions]
    )
