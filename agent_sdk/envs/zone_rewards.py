"""Divide a building's reward among its zones' agents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.zone_partition import ZoneAgent
from zenostat.agent_sdk.rewards import AnyReward, BoundReward, read_reward
from zenostat.agent_sdk.rewards.linear import WeightedReward
from zenostat.agent_sdk.rewards.selectors import temperatures
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest


class SharedReward:
    """Gives each agent the comfort term of its zone and an equal share of the rest of the building's reward.

    Args:
        agents: The agents by name.
        manifest: The node's manifest.
        building_reward: The building's reward, as `reward` of `BuildingEnv`.

    Raises:
        InvalidConfig: The building has no reward, or one that is not a sum over zones.
    """

    def __init__(self, agents: Mapping[str, ZoneAgent], manifest: Manifest, building_reward: AnyReward | None) -> None:
        chosen = manifest.task.reward if arguments.is_of_scenario(building_reward) else building_reward
        reward = None if chosen is None else read_reward(chosen)
        if not isinstance(reward, WeightedReward):
            raise InvalidConfig(
                f"reward='own' divides rewards that are a sum over zones (linear, exponential, hourly, occupied), but "
                f"{'there is no reward' if reward is None else f'{type(reward).__name__} is not one'}; use "
                "building_reward='linear', or a function as reward"
            )
        self._comfort: dict[str, BoundReward | None] = {}
        sensors = [manifest.sensors[index] for index in temperatures(reward.kind, reward.temperatures, manifest)]
        for name, agent in agents.items():
            names = tuple(s.name for s in sensors if agent.zone and s.key.casefold() == agent.zone.casefold())
            zone_reward = reward.model_copy(update={"temperatures": names})
            self._comfort[name] = _bind(zone_reward, manifest) if names else None

    def reset(self) -> None:
        """Reset the state for a new episode."""
        for bound in self._comfort.values():
            if bound is not None:
                bound.reset()

    def unrewarded(self, values: Floats, begin: datetime) -> dict[str, dict[str, float]]:  # noqa: ARG002
        """Return the terms of each agent's reward in the info of a reset, which are NaN."""
        return {name: {"share": math.nan, "comfort": math.nan} for name in self._comfort}

    def __call__(self, values: Floats, begin: datetime, reward: float) -> dict[str, dict[str, float]]:
        """Return the terms of each agent's reward; all of them add up to the building's `reward`."""
        comforts = {
            name: 0.0 if bound is None else float(bound(values, begin).terms["comfort"])
            for name, bound in self._comfort.items()
        }
        share = (reward - sum(comforts.values())) / len(comforts)
        return {name: {"share": share, "comfort": comfort} for name, comfort in comforts.items()}


def _bind(reward: WeightedReward, manifest: Manifest) -> BoundReward | None:
    try:
        return reward.bind(manifest)
    except InvalidConfig:  # the building's reward could be bound, so it ignores this zone (which is never occupied)
        return None
