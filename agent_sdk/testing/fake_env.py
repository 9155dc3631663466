"""The Gymnasium environment on a fake building."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from agent_sdk.envs import arguments
from agent_sdk.envs.building_env import BuildingEnv
from agent_sdk.rewards import Reward
from agent_sdk.testing.fake_building import FakeBuilding
from agent_sdk.testing.fake_link import FakeLink
from topics.errors import InvalidConfig


class FakeEnv(BuildingEnv):
    """`BuildingEnv` without EnergyPlus and without another process: `gym.make("zenostat/Fake-v1", zones=5)`.

    Spaces, info, episodes, rewards, context and weather are those of `BuildingEnv`; it is the same code on a
    `FakeBuilding`.

    Args:
        zones: how many, or each of them.
        reward: an object of `agent_sdk.rewards`, or a kind or a kind with its parameters; None gives 0.0; left out,
            the linear one.
        render_mode: None or `rgb_array`.
        building: all else that `FakeBuilding` takes.

    Raises:
        InvalidConfig: what cannot be.
    """

    def __init__(
        self,
        zones: Any = 3,
        *,
        reward: Reward | Mapping[str, Any] | str | None = arguments.FROM_SCENARIO,
        render_mode: str | None = None,
        **building: Any,
    ) -> None:
        if render_mode == "rerun":
            raise InvalidConfig("render_mode 'rerun' shows a bus, which a fake building has none of; take 'rgb_array'")
        link = FakeLink(FakeBuilding(zones, **building))
        super().__init__(reward=reward, render_mode=render_mode, link=link)
