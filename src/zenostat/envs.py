"""Gymnasium environments, and views of them for stable-baselines3 and PettingZoo."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from zenostat.agent_sdk.envs.branch_env import BranchVectorEnv, Rollout
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.district_env import DistrictEnv
from zenostat.agent_sdk.envs.fleet_env import FleetVectorEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv

if TYPE_CHECKING:
    from zenostat.agent_sdk.envs.district_agents import DistrictAgentsEnv
    from zenostat.agent_sdk.envs.sb3_vec_env import as_sb3
    from zenostat.agent_sdk.envs.zone_agents import ZonesEnv

__all__ = [
    "BranchVectorEnv",
    "BuildingEnv",
    "BuildingVectorEnv",
    "DistrictAgentsEnv",
    "DistrictEnv",
    "FleetVectorEnv",
    "Rollout",
    "ZonesEnv",
    "as_sb3",
]

# Each needs an extra.
_MODULES = {"DistrictAgentsEnv": "district_agents", "ZonesEnv": "zone_agents", "as_sb3": "sb3_vec_env"}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"zenostat.agent_sdk.envs.{_MODULES[name]}"), name)
