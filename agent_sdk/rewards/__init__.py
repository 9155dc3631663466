"""Rewards: frozen configurations that are bound to the points of a node and evaluate arrays of any leading shape."""

from __future__ import annotations

from zenostat.agent_sdk.rewards.base import BoundReward, Outcome, Reward
from zenostat.agent_sdk.rewards.carbon import CarbonReward
from zenostat.agent_sdk.rewards.config import RewardConfig
from zenostat.agent_sdk.rewards.custom import RewardFunction, from_function
from zenostat.agent_sdk.rewards.district import DistrictReward
from zenostat.agent_sdk.rewards.energy_cost import EnergyCostReward, TariffReward
from zenostat.agent_sdk.rewards.exponential import ExponentialReward
from zenostat.agent_sdk.rewards.hourly import HourlyReward
from zenostat.agent_sdk.rewards.linear import LinearReward
from zenostat.agent_sdk.rewards.multi_zone import MultiZoneReward
from zenostat.agent_sdk.rewards.normalized import NormalizedReward
from zenostat.agent_sdk.rewards.occupied import OccupiedReward
from zenostat.agent_sdk.rewards.occupied_cost import OccupiedCostReward
from zenostat.agent_sdk.rewards.peak import PeakReward
from zenostat.agent_sdk.rewards.reward_reader import REWARDS, AnyReward, read_reward
from zenostat.agent_sdk.rewards.thermal_sensation import ThermalSensationReward

__all__ = [
    "REWARDS",
    "AnyReward",
    "BoundReward",
    "CarbonReward",
    "DistrictReward",
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
