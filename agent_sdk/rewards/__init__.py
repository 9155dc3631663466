"""Rewards: frozen configurations that are bound to the points of a node and evaluate arrays of any leading shape."""

from __future__ import annotations

from agent_sdk.rewards.base import BoundReward, Outcome, Reward
from agent_sdk.rewards.carbon import CarbonReward
from agent_sdk.rewards.config import RewardConfig
from agent_sdk.rewards.custom import RewardFunction, from_function
from agent_sdk.rewards.energy_cost import EnergyCostReward, TariffReward
from agent_sdk.rewards.exponential import ExponentialReward
from agent_sdk.rewards.hourly import HourlyReward
from agent_sdk.rewards.linear import LinearReward
from agent_sdk.rewards.multi_zone import MultiZoneReward
from agent_sdk.rewards.normalized import NormalizedReward
from agent_sdk.rewards.occupied import OccupiedReward
from agent_sdk.rewards.occupied_cost import OccupiedCostReward
from agent_sdk.rewards.peak import PeakReward
from agent_sdk.rewards.read import REWARDS, AnyReward, read_reward
from agent_sdk.rewards.thermal_sensation import ThermalSensationReward

__all__ = [
    "REWARDS",
    "AnyReward",
    "BoundReward",
    "CarbonReward",
    "EnergyCostReward",
    "ExponentialReward",
    "HourlyReward",
    "LinearReward",
    "MultiZoneReward",
    "NormalizedReward",
    "OccupiedCostReward",
    "OccupiedReward",
    "Outcome",
    "PeakReward",
    "Reward",
    "RewardConfig",
    "RewardFunction",
    "TariffReward",
    "ThermalSensationReward",
    "from_function",
    "read_reward",
]  # fmt: skip
