"""Rewards: frozen objects that name the points they need and work on arrays of any leading shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from agent_sdk.rewards.base import BoundReward, Reward
from agent_sdk.rewards.linear import LinearReward
from topics.codec import explain
from topics.errors import InvalidConfig, near

__all__ = ["REWARDS", "BoundReward", "LinearReward", "Reward", "read_reward"]

REWARDS: dict[str, type[LinearReward]] = {"linear": LinearReward}
"""By the `kind` that a scenario names."""


def read_reward(given: Mapping[str, Any] | str) -> Reward:
    """The reward of a scenario: its kind alone, or `{"kind": "linear", "weight": 0.3}`.

    Raises:
        InvalidConfig: no such kind, or parameters that cannot be; all faults at once.
    """
    parameters = {"kind": given} if isinstance(given, str) else dict(given)
    kind = parameters.get("kind")
    if not isinstance(kind, str) or kind not in REWARDS:
        raise InvalidConfig(f"reward: there is no kind {kind!r}; {near(str(kind), REWARDS)}")
    try:
        return REWARDS[kind].model_validate(parameters)
    except ValidationError as error:
        raise InvalidConfig(f"reward: {explain(error)}") from None
