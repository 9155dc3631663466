"""Warnings where discount factor, episode length and reward scale of a training do not fit together."""

from __future__ import annotations

import inspect
from math import inf

from zenostat.lab.training.config import TrainingConfig
from zenostat.lab.training.parameters import algorithm_class

SHORTEST_H = 1.0
"""Shortest time, in hours, that an agent should look ahead: buildings store heat for hours."""
USUAL_H = 12.0
"""Time ahead, in hours, of the discount factor that is suggested instead."""
MOST_EPISODES = 10
"""Number of episodes' lengths that a discount factor may look ahead: values beyond an episode's end are estimates."""
RETURNS = (0.01, 100.0)
"""Size of discounted returns that value functions of stable-baselines3's defaults learn without normalization."""


def discount(config: TrainingConfig) -> float:
    """Return the discount factor of a training, which is 0.99 by default in all algorithms."""
    parameters = inspect.signature(algorithm_class(config.algorithm).__init__).parameters
    return float(config.parameters.get("gamma", parameters["gamma"].default))


def horizon_steps(gamma: float) -> float:
    """Return the number of timesteps that a discount factor looks ahead: the sum of its powers, 1 / (1 - gamma)."""
    return inf if gamma >= 1.0 else 1.0 / (1.0 - gamma)


def horizon_warning(gamma: float, step_s: float, steps: int) -> str:
    """Return what is wrong with a discount factor for these episodes; empty if it fits.

    Args:
        gamma: discount factor, 0 to 1.
        step_s: length of a timestep, s.
        steps: timesteps of an episode.
    """
    horizon, step_h = horizon_steps(gamma), step_s / 3600.0
    if horizon > MOST_EPISODES * steps:
        return (
            f"parameters.gamma = {gamma:g} looks {horizon:.0f} timesteps ahead, but an episode has {steps}: choose at "
            f"most {max(1.0 - 1.0 / steps, 0.0):.4g}, or longer episodes"
        )
    if horizon * step_h < SHORTEST_H and steps * step_h > SHORTEST_H:
        suggested = 1.0 - step_h / min(USUAL_H, steps * step_h)
        return (
            f"parameters.gamma = {gamma:g} looks {horizon * 60.0 * step_h:.0f} minutes ahead with timesteps of "
            f"{step_s:g} s, but buildings store heat for hours; {suggested:.4g} looks "
            f"{min(USUAL_H, steps * step_h):g} h ahead"
        )
    return ""


def scale_warning(gamma: float, reward: float, steps: int) -> str:
    """Return what is wrong with the scale of rewards that are not normalized; empty if it fits.

    Args:
        gamma: discount factor, 0 to 1.
        reward: sum of the rewards of an episode.
        steps: its timesteps.
    """
    returns = abs(reward) / steps * min(horizon_steps(gamma), steps)
    if not reward or RETURNS[0] <= returns <= RETURNS[1]:
        return ""
    return (
        f"discounted returns are about {returns:.2g}, which value functions learn slowly: set normalization.rewards, "
        "or scale the reward so that they are about 1"
    )
