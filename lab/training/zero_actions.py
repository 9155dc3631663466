"""Actions of zero where actions are offsets, and policies that begin with them.

A policy whose output layer has no weights yet outputs its bias alone, for any observation. With the bias of offsets of
zero it begins with the building's own control, or with the rule, and learns from there (T. Silver, K. Allen,
J. Tenenbaum, L. Kaelbling, "Residual Policy Learning", arXiv:1812.06298, 2018).
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.wrappers import ResidualAction
from zenostat.agent_sdk.wrappers.names import attribute, layers
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

_RESCALED = (gym.wrappers.RescaleAction, gym.wrappers.vector.RescaleAction)


def zero_actions(env: Any, option: str) -> NDArray[np.float32]:
    """Return the action of a single or vector environment that is an offset of zero, shape (actions,).

    Args:
        env: environment whose actions are offsets, `RescaleAction` outermost if it has that.
        option: field of the training file, for errors.

    Raises:
        InvalidConfig: the actions are no offsets, or zero is not one of them.
    """
    manifest: Manifest = attribute(env, "manifest")
    is_residual = any(isinstance(layer, ResidualAction) for layer in layers(env))
    absolute = [action.name for action in manifest.task.actions if not action.relative]
    if absolute and not is_residual:
        raise InvalidConfig(
            f"{option}: the action {absolute[0]!r} is no offset, so zero is not the building's own control; use "
            "relative actions or ResidualAction"
        )
    space = getattr(env, "single_action_space", env.action_space)
    if not isinstance(space, gym.spaces.Box):
        raise InvalidConfig(f"{option} needs continuous actions, not {space}")
    zeros = np.zeros(space.shape, np.float32)
    if isinstance(env, _RESCALED):
        inner: Any = getattr(env.env, "single_action_space", env.env.action_space)
        zeros = space.low + (space.high - space.low) * ((zeros - inner.low) / (inner.high - inner.low))
    if zeros not in space:
        raise InvalidConfig(f"{option}: an offset of zero is not in {space}")
    return zeros


def begin_at(model: Any, actions: NDArray[np.float32]) -> None:
    """Set the output layer of a policy of stable-baselines3 so that it outputs one action for each observation.

    Args:
        model: an algorithm with continuous actions that has not learned yet.
        actions: the action, shape (actions,).
    """
    import torch

    policy = model.policy
    if hasattr(policy, "action_net"):  # ppo, a2c: the mean of a Gaussian distribution
        outputs, means = [policy.action_net], actions
    else:  # sac, td3, ddpg, tqc: scaled to the bounds, before or after a tanh
        low, high = model.action_space.low, model.action_space.high
        means = np.arctanh(np.clip(2.0 * (actions - low) / (high - low) - 1.0, -0.999, 0.999))
        actors = [policy.actor, *([policy.actor_target] if hasattr(policy, "actor_target") else [])]
        outputs = [_last_linear(actor.mu) for actor in actors]
    with torch.no_grad():
        for output in outputs:
            output.weight.zero_()
            output.bias.copy_(torch.as_tensor(means, dtype=output.bias.dtype))


def _last_linear(layer: Any) -> Any:
    import torch

    return [module for module in layer.modules() if isinstance(module, torch.nn.Linear)][-1]
