"""Actuators outside the actions, which wrappers of a scenario set in episodes of any controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.wrappers.serialization import apply_wrappers

_CONTEXT = "ChangingContext"
"""The wrapper that sets actuators by a timetable, such as Sinergym's `initial_context`; it changes no action."""


def context_wrappers(wrappers: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return those of some wrappers, as data, that set actuators outside the actions."""
    return [wrapper for wrapper in wrappers if wrapper.get("wrapper") == _CONTEXT]


def within_context(env: BuildingEnv, further: Sequence[Mapping[str, Any]] = ()) -> gym.Env[Any, Any]:
    """Return an environment within those of its scenario's wrappers that set actuators outside the actions.

    Rules then act in the same building as policies that learn within all of the scenario's wrappers.

    Args:
        env: the environment.
        further: wrappers as data, besides those of the scenario; others than those of actuators are left out.
    """
    within: gym.Env[Any, Any] = apply_wrappers(env, context_wrappers([*env.manifest.task.wrappers, *further]))
    return within
