"""A district with one agent for each of its plants, as a PettingZoo environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, cast

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.agent_parts import AgentPart, indices_of
from zenostat.agent_sdk.envs.agents_env import AgentRewards, AgentsEnv, RewardFunctionOfAgents, RewardsOfAgents
from zenostat.agent_sdk.envs.district_env import RENDER_MODES, DistrictEnv
from zenostat.agent_sdk.envs.episode_state import unrewarded_entries
from zenostat.agent_sdk.rewards import AnyReward, BoundReward, read_reward
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Manifest


class DistrictAgentsEnv(AgentsEnv):
    """A district with an agent for each plant that has actions; all agents act simultaneously on one `DistrictEnv`.

    An agent has the name of its plant, such as that of a building, and its actions. It observes the time features, the
    points of its plant, and `shared` ones.

    Args:
        file: Of the district.
        shared: Names of further observations that all agents get, such as `feeder.transformer_loading`.
        reward: With `shared`, each agent gets the district's reward. Or a reward for each agent, by its name (kinds
            with parameters, whose points are those of the district), or a function, see `AgentRewards`.
        district_reward: The district's reward; as `reward` of `DistrictEnv`.
        env_arguments: All other arguments of `DistrictEnv`.

    Raises:
        InvalidConfig: The district has no actions; the rewards are not those of its agents; and as for `DistrictEnv`.
    """

    metadata = {"render_modes": [*RENDER_MODES], "name": "zenostat_district_v1", "is_parallelizable": True}  # noqa: RUF012

    env: DistrictEnv

    def __init__(
        self,
        file: str | Path | None = None,
        *,
        shared: Sequence[str] = (),
        reward: str | Mapping[str, AnyReward] | AgentRewards = "shared",
        district_reward: AnyReward | None = arguments.FROM_SCENARIO,
        **env_arguments: Any,
    ) -> None:
        if not callable(reward) and not isinstance(reward, Mapping) and reward != "shared":
            raise InvalidConfig(
                f"reward = {reward!r}; 'shared', a reward for each agent by its name, or a function of (values, begin) "
                "expected"
            )
        arguments.check_arguments(env_arguments, DistrictEnv)
        if reward != "shared" and district_reward == arguments.FROM_SCENARIO:
            district_reward = arguments.FROM_SCENARIO_IF_ANY  # the agents are paid others
        env = DistrictEnv(file, reward=district_reward, **env_arguments)
        try:
            agents = divide(env.manifest, shared, env.observation_names)
            super().__init__(env, agents, _rewards(reward, env.manifest, agents))
        except BaseException:
            env.close()
            raise


def divide(manifest: Manifest, shared: Sequence[str], observation_names: Sequence[str]) -> dict[str, AgentPart]:
    """Return the agents by name, in the order of their first actions.

    Args:
        manifest: Of the district's node.
        shared: Names of observations that all agents get.
        observation_names: Names of the district's observation.

    Raises:
        InvalidConfig: There are no actions, or `shared` has an unknown name.
    """
    shared_indices, task = indices_of(shared, observation_names), manifest.task
    by_name = {action.name: action for action in task.actions}
    dimensions = [discrete.actions for discrete in task.discrete_actions] or [(a.name,) for a in task.actions]
    plants = [_plant(names[0]) for names in dimensions]
    if not plants:
        raise InvalidConfig(f"no plant of {manifest.node!r} has an action, since connections feed all actuators")
    agents = {}
    for plant in dict.fromkeys(plants):
        places = [place for place, other in enumerate(plants) if other == plant]
        actions = [name for place in places for name in dimensions[place]]
        actuators = {actuator for name in actions for actuator in by_name[name].actuators}
        agents[plant] = AgentPart(
            actions=tuple(actions),
            action_indices=places,
            actuator_indices=[i for i, actuator in enumerate(manifest.actuators) if actuator.name in actuators],
            observation_indices=[
                i
                for i, name in enumerate(observation_names)
                if i < len(task.time) or i in shared_indices or _plant(name) == plant
            ],
        )
    return agents


def _plant(name: str) -> str:
    """Return the plant of a point or action."""
    return name.partition(".")[0]


def _rewards(
    reward: str | Mapping[str, AnyReward] | Callable[..., Any], manifest: Manifest, agents: Mapping[str, AgentPart]
) -> RewardsOfAgents | None:
    if isinstance(reward, Mapping):
        return RewardByAgent(reward, manifest, agents)
    if callable(reward):
        return RewardFunctionOfAgents(cast("AgentRewards", reward), manifest, agents)
    return None


class RewardByAgent:
    """A reward for each agent, each with a state of its own.

    Args:
        rewards: By the names of the agents.
        manifest: Of the district's node.
        agents: The agents.

    Raises:
        InvalidConfig: A reward is missing or invalid, or no agent has its name.
    """

    def __init__(self, rewards: Mapping[str, AnyReward], manifest: Manifest, agents: Mapping[str, AgentPart]) -> None:
        errors = [f"no agent {name!r}; {did_you_mean(str(name), agents)}" for name in rewards if name not in agents]
        errors += [f"no reward of {name!r}" for name in agents if name not in rewards]
        self._bound: dict[str, BoundReward] = {}
        self._unrewarded: dict[str, dict[str, float]] | None = None
        for name in agents:
            try:
                if name in rewards:
                    self._bound[name] = read_reward(rewards[name]).bind(manifest)
            except InvalidConfig as error:
                errors.append(f"of {name!r}: {error}")
        if errors:
            raise InvalidConfig(f"reward: {'; '.join(errors)}")

    def reset(self) -> None:
        """Reset the state of all rewards."""
        for bound in self._bound.values():
            bound.reset()

    def unrewarded(self, values: Floats, begin: datetime) -> dict[str, dict[str, float]]:
        """Return the terms of each agent's reward in the info of a reset, which are NaN."""
        if self._unrewarded is None:
            self._unrewarded = {
                name: unrewarded_entries(bound, values, begin)["reward_terms"] for name, bound in self._bound.items()
            }
        return {name: dict(terms) for name, terms in self._unrewarded.items()}

    def __call__(self, values: Floats, begin: datetime, reward: float) -> dict[str, dict[str, float]]:  # noqa: ARG002
        """Return the terms of each agent's reward."""
        return {
            name: {term: float(value) for term, value in bound(values, begin).terms.items()}
            for name, bound in self._bound.items()
        }
