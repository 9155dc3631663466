"""Export trained policies of stable-baselines3 as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.sac.policies import SACPolicy

from zenostat.agent_sdk.controllers import training_folder
from zenostat.agent_sdk.controllers.network_policy import Arrays, NetworkPolicy
from zenostat.agent_sdk.controllers.policy_loader import load_model
from zenostat.topics.errors import InvalidConfig

_ACTIVATIONS: dict[type[torch.nn.Module], str] = {torch.nn.Tanh: "tanh", torch.nn.ReLU: "relu"}


def export_policy(folder: str | Path, record: Mapping[str, Any] | None = None) -> NetworkPolicy:
    """Return the policy of a training's folder as arrays, with its normalization and wrappers; `save` writes it.

    Args:
        folder: folder of a finished training of PPO, A2C or SAC with continuous actions and a policy for vectors.
        record: how it was made, as a JSON value, for users.

    Raises:
        InvalidConfig: the policy has another form; or see `load_policy`.
    """
    folder = Path(folder).expanduser()
    algorithm = str(training_folder.read_training_fields(folder).get("algorithm"))
    file = training_folder.model_file(folder)
    model, normalization = load_model(file, algorithm)
    wrappers, states = training_folder.read_wrappers(folder, file)
    layers, squashed = _layers(model, str(folder))
    names, arrays = _arrays(layers, str(folder))
    for kind in ("observation", "action"):
        space = getattr(model, f"{kind}_space")
        arrays |= {f"{kind}_low": space.low, f"{kind}_high": space.high}
    settings: dict[str, float] = {}
    if normalization is not None and normalization.norm_obs:
        arrays |= _statistics(normalization)
        settings = {"clip_observations": normalization.clip_obs, "epsilon": normalization.epsilon}
    return NetworkPolicy(
        names, squashed, arrays, wrappers=tuple(wrappers), states=tuple(states), record=dict(record or {}), **settings
    )


def _statistics(normalization: VecNormalize) -> Arrays:
    statistics: Any = normalization.obs_rms
    return {"mean": np.array(statistics.mean), "variance": np.array(statistics.var)}


def _layers(model: BaseAlgorithm, what: str) -> tuple[list[torch.nn.Module], bool]:
    """Return the layers from observation to action, and whether a tanh follows that is not among them."""
    policy: Any = model.policy
    if hasattr(policy, "lstm_actor"):
        raise InvalidConfig(f"{what}: a recurrent policy cannot be exported, as its memory is no layer of this form")
    if isinstance(policy, ActorCriticPolicy) and not policy.squash_output:
        extractor, layers, squashed = policy.pi_features_extractor, [*policy.mlp_extractor.policy_net], False
        layers.append(policy.action_net)
    elif isinstance(policy, SACPolicy) and not policy.actor.use_sde:
        actor = policy.actor
        extractor, layers, squashed = actor.features_extractor, [*actor.latent_pi, actor.mu], True
    elif isinstance(policy, ActorCriticPolicy | SACPolicy):
        text = "with squashed means of state-dependent exploration (use_sde)"
        raise InvalidConfig(f"{what}: a policy {text} cannot be exported")
    else:
        raise InvalidConfig(f"{what}: only policies of PPO, A2C and SAC can be exported, not {type(policy).__name__}")
    if not isinstance(extractor, FlattenExtractor) or type(model.action_space).__name__ != "Box":
        raise InvalidConfig(f"{what}: only policies of vectors with continuous actions can be exported")
    return layers, squashed


def _arrays(layers: list[torch.nn.Module], what: str) -> tuple[tuple[str, ...], Arrays]:
    names: list[str] = []
    arrays = Arrays()
    for layer in layers:
        if isinstance(layer, torch.nn.Linear):
            index = names.count("linear")
            arrays[f"weight_{index}"] = layer.weight.detach().numpy()
            arrays[f"bias_{index}"] = layer.bias.detach().numpy()
            names.append("linear")
        elif type(layer) in _ACTIVATIONS:
            names.append(_ACTIVATIONS[type(layer)])
        else:
            raise InvalidConfig(f"{what}: a layer {type(layer).__name__} cannot be exported; tanh and ReLU can")
    return tuple(names), arrays
