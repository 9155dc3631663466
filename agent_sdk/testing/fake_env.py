"""Gymnasium environment of a fake building."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import Reward
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.fake_link import FakeLink


class FakeEnv(BuildingEnv):
    """`BuildingEnv` without EnergyPlus or another process: `gym.make("zenostat/Fake-v1", zones=5)`.

    It is the code of `BuildingEnv` on a `FakeBuilding`, with the same spaces, info, episodes, rewards, context and
    weather.

    Args:
        zones: number of zones, or the zones.
        reward: an object of `zenostat.rewards`, a kind, or a kind with its parameters; None: always 0.0; default:
            the linear reward.
        render_mode: None or `rgb_array`.
        building: further arguments of `FakeBuilding`.

    Raises:
        InvalidConfig: an argument is invalid.
    """

    metadata = {**BuildingEnv.metadata, "render_modes": ["rgb_array"]}  # noqa: RUF012  # Gymnasium's own form

    def __init__(
        self,
        zones: Any = 3,
        *,
        reward: Reward | Mapping[str, Any] | str | None = arguments.FROM_SCENARIO,
        render_mode: str | None = None,
        **building: Any,
    ) -> None:
        arguments.check_arguments(building, FakeBuilding)
        link = FakeLink(FakeBuilding(zones, **building))
        super().__init__(reward=reward, render_mode=render_mode, link=link)
