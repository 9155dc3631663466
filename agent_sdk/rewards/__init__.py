"""Rewards: frozen objects that name the points they need and work on arrays of any leading shape."""

from agent_sdk.rewards.base import BoundReward, Reward
from agent_sdk.rewards.linear import LinearReward

__all__ = ["BoundReward", "LinearReward", "Reward"]
