"""Rewards: frozen objects that name the points they need and work on arrays of any leading shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from pydantic import ValidationError

from agent_sdk.rewards.base import BoundReward, Outcome, Reward
from agent_sdk.rewards.carbon import CarbonReward
from agent_sdk.rewards.config import RewardConfig
from agent_sdk.rewards.custom import RewardFunction, from_function, made
from agent_sdk.rewards.energy_cost import EnergyCostReward, TariffReward
from agent_sdk.rewards.exponential import ExponentialReward
from agent_sdk.rewards.hourly import HourlyReward
from agent_sdk.rewards.linear import LinearReward
from agent_sdk.rewards.multi_zone import MultiZoneReward
from agent_sdk.rewards.normalized import NormalizedReward
from agent_sdk.rewards.occupied import OccupiedReward
from agent_sdk.rewards.peak import PeakReward
from agent_sdk.rewards.thermal_sensation import ThermalSensationReward
from topics.codec import describe_validation_errors
from topics.errors import InvalidConfig, did_you_mean

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
    "thermal_sensation": ThermalSensationReward,
}
"""By the `kind` that a scenario names."""

AnyReward = Reward | RewardFunction | type | Mapping[str, Any] | str
"""What `read_reward` takes."""


def read_reward(given: AnyReward) -> Reward:
    """What a user or a scenario names, as a reward.

    Args:
        given: a kind alone, or one with its parameters (`{"kind": "linear", "weight": 0.3}`); an object that can be
            bound, which is taken as it is; a function or a class of the user's, see `from_function`.

    Raises:
        InvalidConfig: no such kind, or parameters that cannot be, all faults at once; or nothing of all that.
    """
    if isinstance(given, str | Mapping):
        return _read(given)
    if hasattr(given, "bind"):
        return cast("Reward", made(given) if isinstance(given, type) else given)
    if callable(given):
        return from_function(given)
    raise InvalidConfig(
        f"reward: a kind ({', '.join(REWARDS)}), a kind with its parameters, an object that can be bound or a function "
        f"of (values, begin) expected, got {given!r}"
    )


def _read(given: Mapping[str, Any] | str) -> Reward:
    parameters = {"kind": given} if isinstance(given, str) else dict(given)
    kind = parameters.get("kind")
    if kind is None:
        raise InvalidConfig(f"reward: its kind is missing; there are: {', '.join(REWARDS)}")
    if not isinstance(kind, str) or kind not in REWARDS:
        raise InvalidConfig(f"reward: there is no kind {kind!r}; {did_you_mean(str(kind), REWARDS)}")
    try:
        return REWARDS[kind].model_validate(parameters)
    except ValidationError as error:
        raise InvalidConfig(f"reward: {describe_validation_errors(error, REWARDS[kind].model_fields)}") from None
