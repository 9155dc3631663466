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

from zenostat.agent_sdk.wrappers import IncrementalAction, ResidualAction, wrappers_of
from zenostat.agent_sdk.wrappers.names import attribute, layers
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

_RESCALED = (gym.wrappers.RescaleAction, gym.wrappers.vector.RescaleAction)
_CLIPPED = (gym.wrappers.ClipAction, gym.wrappers.vector.ClipAction)
_NEAR_BOUND = 0.999
"""Largest part of a bound with which a policy whose output passes a tanh can begin, and still learn."""


def zero_actions(env: Any, option: str) -> NDArray[np.float32]:
    """Return the action of a single or vector environment that is an offset of zero, shape (actions,).

    Args:
        env: environment whose actions are offsets, with any wrappers around it.
        option: field of the training file, for errors.

    Raises:
        InvalidConfig: the actions are no offsets, zero is not one of them, or a wrapper changes their meaning.
    """
    manifest: Manifest = attribute(env, "manifest")
    chain = [*layers(env)]
    residual = next((place for place, layer in enumerate(chain) if isinstance(layer, ResidualAction)), None)
    absolute = [action.name for action in manifest.task.actions if not action.relative]
    if absolute and residual is None:
        raise InvalidConfig(
            f"{option}: the action {absolute[0]!r} is no offset, so zero is not the building's own control; use "
            "relative actions or ResidualAction"
        )
    space = _action_space(env)
    if not isinstance(space, gym.spaces.Box):
        raise InvalidConfig(f"{option} needs continuous actions, not {space}")
    place = len(chain) - 1 if residual is None else residual
    inner = _action_space(chain[place])
    zeros = np.zeros(inner.shape, np.float32)
    for layer in reversed(chain[:place]):  # from the offsets outwards
        outer = _action_space(layer)
        if isinstance(layer, _RESCALED):
            share = (zeros.astype(np.float64) - inner.low) / (inner.high.astype(np.float64) - inner.low)
            zeros = (outer.low + (outer.high.astype(np.float64) - outer.low) * share).astype(np.float32)
        elif isinstance(layer, IncrementalAction):
            _check_increments(layer, option)  # and increments of zero keep the offsets at zero
        elif outer != inner and not isinstance(layer, _CLIPPED):
            raise InvalidConfig(
                f"{option}: {type(layer).__name__} changes what an action is, and none of its actions is known to be "
                "an offset of zero; remove it"
            )
        inner = outer
    if zeros not in space:
        raise InvalidConfig(f"{option}: an offset of zero is not in {space}")
    return zeros


def _check_increments(layer: Any, option: str) -> None:
    """Raise `InvalidConfig` if offsets begin with another value than zero."""
    for name, value in wrappers_of(layer)[-1]["initial"].items():
        if value != 0.0:
            raise InvalidConfig(
                f"{option}: {type(layer).__name__} begins with an offset of {value:g} for {name}; let it begin with 0"
            )


def _action_space(env: Any) -> Any:
    """Return the action space of a single environment, or of one slot of a vector environment."""
    return getattr(env, "single_action_space", env.action_space)


def begin_at(model: Any, actions: NDArray[np.float32]) -> None:
    """Set the output layer of a policy of stable-baselines3 so that it outputs one action for each observation.

    Args:
        model: an algorithm with continuous actions that has not learned yet.
        actions: the action, shape (actions,).

    Raises:
        InvalidConfig: the policy's outputs pass a tanh, and the action is at a bound, which a tanh does not reach.
    """
    import torch

    policy = model.policy
    if hasattr(policy, "action_net"):  # ppo, a2c: the mean of a Gaussian distribution
        outputs, means = [policy.action_net], actions
    else:  # sac, td3, ddpg, tqc: scaled to the bounds, before or after a tanh
        low, high = model.action_space.low, model.action_space.high
        shares = 2.0 * (actions.astype(np.float64) - low) / (high.astype(np.float64) - low) - 1.0
        if (np.abs(shares) > _NEAR_BOUND).any():
            raise InvalidConfig(
                f"zero_start: zero is at a bound of the actions, {low.tolist()} to {high.tolist()}, which the tanh of "
                f"{type(model).__name__}'s policy does not reach; use bounds on both sides of zero, or ppo"
            )
        means = np.arctanh(shares)
        actors = [policy.actor, *([policy.actor_target] if hasattr(policy, "actor_target") else [])]
        outputs = [_last_linear(actor.mu) for actor in actors]
    with torch.no_grad():
        for output in outputs:
            output.weight.zero_()
            output.bias.copy_(torch.as_tensor(means, dtype=output.bias.dtype))


def _last_linear(layer: Any) -> Any:
    import torch

    return [module for module in layer.modules() if isinstance(module, torch.nn.Linear)][-1]
