"""A building with one agent for each zone, as a PettingZoo environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.agents_env import AgentRewards, AgentsEnv, RewardFunctionOfAgents, RewardsOfAgents
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.connection import RENDER_MODES
from zenostat.agent_sdk.envs.zone_partition import BUILDING, partition
from zenostat.agent_sdk.envs.zone_rewards import SharedReward
from zenostat.agent_sdk.rewards import AnyReward, read_reward
from zenostat.bridge.python_plant.shipped import PLANT_SETTINGS
from zenostat.topics.errors import InvalidConfig

__all__ = ["BUILDING", "ZoneRewards", "ZonesEnv"]

ZoneRewards = AgentRewards
"""`(values, begin)` to a reward by agent; values by name of sensor or meter, and the timestep's beginning."""


class ZonesEnv(AgentsEnv):
    """One building with an agent for each of its zones; all agents act simultaneously on one `BuildingEnv`.

    An agent has the actions that set the thermostat of its zone, and is named after the zone (`core_zn`). Actions that
    belong to no zone, or to several, are those of one more agent, `building`, which is the last one.

    Observation of an agent: float32, the values of the building's observation that concern it, in that order: time
    fields, outdoor sensors (key `Environment`), sensors of its zone (by key), and `shared` ones. `building` observes
    everything. Action: float32, shape (its actions,), within their bounds, or an index for each discrete action. All
    agents live as long as the episode: they are truncated, or terminated, together.

    Args:
        building, weather: As for `BuildingEnv`.
        control: As for `BuildingEnv`, but `zone` by default if the node is local.
        shared: Names of further observations that all agents get (`observation_names` of the building).
        reward: With `shared`, each agent gets the building's reward. With `own`, an agent gets the comfort term of its
            zone and an equal share of the rest (power, and zones without an agent), so that the rewards of all agents
            add up to the building's; only for rewards that are a sum over zones: `linear`, `exponential`, `hourly`,
            `occupied`. Or a function, see `ZoneRewards`.
        building_reward: The building's reward; as `reward` of `BuildingEnv`.
        env_arguments: All other arguments of `BuildingEnv`.

    Attributes:
        env: The building's environment.
        possible_agents: Names of all agents; `agents` are those of the running episode.
        state_space: Space of `state()`, the building's observation.

    Raises:
        InvalidConfig: No action belongs to a single zone, or the reward cannot be divided; and as for `BuildingEnv`.
    """

    metadata = {"render_modes": [*RENDER_MODES], "name": "zenostat_zones_v1", "is_parallelizable": True}  # noqa: RUF012

    def __init__(
        self,
        building: Any = None,
        weather: Any = None,
        *,
        control: str | None = None,
        shared: Sequence[str] = (),
        reward: str | ZoneRewards = "shared",
        building_reward: AnyReward | None = arguments.FROM_SCENARIO,
        **env_arguments: Any,
    ) -> None:
        if not callable(reward) and reward not in ("shared", "own"):
            raise InvalidConfig(f"reward = {reward!r}; 'shared', 'own' or a function of (values, begin) expected")
        if any(env_arguments.get(name) is not None for name in PLANT_SETTINGS):
            raise InvalidConfig("a plant of your own has no zones, so it has a single agent: zenostat/Plant-v1")
        if control is None and not {"connect", "link"} & set(env_arguments):
            control = "zone"
        is_data = building_reward is None or isinstance(building_reward, str | Mapping)
        env_reward: Any = building_reward if is_data else read_reward(cast("AnyReward", building_reward))
        env = BuildingEnv(building, weather, control=control, reward=env_reward, **env_arguments)
        try:
            agents = partition(env.manifest, shared, env.observation_names)
            rewards: RewardsOfAgents | None = None
            if callable(reward):
                rewards = RewardFunctionOfAgents(reward, env.manifest, agents)
            elif reward == "own":
                rewards = SharedReward(agents, env.manifest, building_reward)
            super().__init__(env, agents, rewards)
        except BaseException:
            env.close()
            raise
