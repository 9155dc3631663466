"""The rewards that a scenario can name, and how they are read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from zenostat.agent_sdk.rewards.base import Reward
from zenostat.agent_sdk.rewards.carbon import CarbonReward
from zenostat.agent_sdk.rewards.config import RewardConfig
from zenostat.agent_sdk.rewards.custom import RewardFunction, class_of, from_function, instantiate
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
from zenostat.agent_sdk.rewards.thermal_sensation import ThermalSensationReward
from zenostat.topics.codec import validated
from zenostat.topics.errors import InvalidConfig, did_you_mean

REWARDS: dict[str, type[RewardConfig]] = {
    "linear": LinearReward,
    "exponential": ExponentialReward,
    "hourly": HourlyReward,
    "normalized": NormalizedReward,
    "multi_zone": MultiZoneReward,
    "energy_cost": EnergyCostReward,
    "tariff": TariffReward,
    "carbon": CarbonReward,
    "peak": PeakReward,
    "occupied": OccupiedReward,
    "occupied_cost": OccupiedCostReward,
    "thermal_sensation": ThermalSensationReward,
    "district": DistrictReward,
}
"""Reward classes by the `kind` that a scenario names."""

CUSTOM = "custom"
"""Kind of a reward that is code of the user's, in a manifest."""

AnyReward = Reward | RewardFunction | type | Mapping[str, Any] | str
"""Anything that `read_reward` accepts."""


def read_reward(reward: AnyReward) -> Reward:
    """Return the reward that a user or a scenario specifies.

    Args:
        reward: a kind, alone or with its parameters (`{"kind": "linear", "weight": 0.3}`); an object with `bind`, which
            is returned unchanged; or a custom function or class, see `from_function`.

    Raises:
        InvalidConfig: there is no such kind, its parameters are invalid (the error lists all of them), or `reward` is
            none of these.
    """
    if isinstance(reward, str | Mapping):
        return _read_config(reward)
    kind = class_of(reward)
    if hasattr(kind or reward, "bind"):
        return cast("Reward", reward if kind is None else instantiate(reward))
    if callable(reward):
        return from_function(reward)
    raise InvalidConfig(
        f"reward: a kind ({', '.join(REWARDS)}), a kind with its parameters, an object with bind(manifest) or a "
        f"function of (values, begin) expected, got {reward!r}"
    )


def _read_config(config: Mapping[str, Any] | str) -> Reward:
    parameters = {"kind": config} if isinstance(config, str) else dict(config)
    kind = parameters.get("kind")
    if kind is None:
        raise InvalidConfig(f"reward: kind is missing; there are: {', '.join(REWARDS)}")
    if kind == CUSTOM:
        raise InvalidConfig(
            f"reward: {parameters.get('name', 'custom')} is code of the program that used it, which data does not "
            "contain; pass it as reward=, or name a kind"
        )
    if not isinstance(kind, str) or kind not in REWARDS:
        raise InvalidConfig(f"reward: there is no kind {kind!r}; {did_you_mean(str(kind), REWARDS)}")
    return validated(REWARDS[kind], parameters, "reward")
