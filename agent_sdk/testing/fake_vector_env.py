"""Vector environment of fake buildings."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.rewards import AnyReward
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.fake_link import FakeLink
from zenostat.topics.errors import InvalidConfig


class FakeVectorEnv(BuildingVectorEnv):
    """`BuildingVectorEnv` without EnergyPlus: `gym.make_vec("zenostat/Fake-v1", num_envs=8, zones=5)`.

    Args:
        num_envs: number of environments.
        zones: number of zones of each building, or the zones.
        reward, render_mode: see `FakeEnv`.
        autoreset_mode: see `BuildingVectorEnv`.
        building: further arguments of `FakeBuilding`.

    Raises:
        InvalidConfig: an argument is invalid.
    """

    def __init__(
        self,
        num_envs: int = 1,
        zones: Any = 3,
        *,
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **building: Any,
    ) -> None:
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise InvalidConfig(f"num_envs = {num_envs!r}; at least 1 expected")
        arguments.check_arguments(building, FakeBuilding)
        link = FakeLink([FakeBuilding(zones, **building) for _ in range(num_envs)])
        super().__init__(num_envs, reward=reward, render_mode=render_mode, autoreset_mode=autoreset_mode, link=link)
        self.metadata["render_modes"] = ["rgb_array"]
