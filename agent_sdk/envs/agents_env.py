"""A Gymnasium environment whose actions and observations are divided among several agents, for PettingZoo."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any, Protocol

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space
from numpy.typing import ArrayLike, NDArray

from zenostat.agent_sdk.envs.action_values import as_array
from zenostat.agent_sdk.envs.agent_parts import AgentPart
from zenostat.agent_sdk.envs.building_env import BuildingEnv, Observation
from zenostat.agent_sdk.envs.connection import AGENT, BUSY
from zenostat.agent_sdk.envs.space_names import by_name
from zenostat.agent_sdk.rewards.custom import NamedValues, finite_term
from zenostat.bridge.client.thread_guard import one_thread
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EpisodeChanged, InvalidAction, InvalidConfig, did_you_mean
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Manifest

with requires_extra("multi-agent", "an environment of several agents", "PettingZoo"):
    from pettingzoo import ParallelEnv

AgentRewards = Callable[[Mapping[str, float], datetime], Mapping[str, float]]
"""`(values, begin)` to a reward by agent; values by name of sensor or meter, and the timestep's beginning."""


class RewardsOfAgents(Protocol):
    """Rewards of several agents, instead of the environment's for each of them."""

    def reset(self) -> None:
        """Reset the state for a new episode."""

    def unrewarded(self, values: Floats, begin: datetime) -> dict[str, dict[str, float]]:
        """Return the terms of each agent in the info of a reset: NaN under the names of those of a step."""

    def __call__(self, values: Floats, begin: datetime, reward: float) -> dict[str, dict[str, float]]:
        """Return the terms of each agent's reward.

        Args:
            values: of the sample, fault-free.
            begin: beginning of the timestep.
            reward: of the whole environment.
        """


class RewardFunctionOfAgents:
    """Rewards that a function of the user's returns; see `AgentRewards`."""

    def __init__(self, function: AgentRewards, manifest: Manifest, agents: Mapping[str, AgentPart]) -> None:
        self._function, self._named_values, self._agents = function, NamedValues(manifest), [*agents]

    def reset(self) -> None:
        """Do nothing: a function has no state."""

    def unrewarded(self, values: Floats, begin: datetime) -> dict[str, dict[str, float]]:  # noqa: ARG002
        """Return NaN as each agent's only term."""
        return {name: {"reward": math.nan} for name in self._agents}

    def __call__(self, values: Floats, begin: datetime, reward: float) -> dict[str, dict[str, float]]:  # noqa: ARG002
        """Return the reward of each agent as its only term."""
        rewards = self._function(self._named_values(values.tolist()), begin)
        if not isinstance(rewards, Mapping) or set(rewards) != set(self._agents):
            raise InvalidConfig(
                f"reward: the function returned {rewards!r}; a reward for each of {', '.join(self._agents)} expected"
            )
        return {name: {"reward": finite_term(self._function, name, rewards[name])} for name in self._agents}


class AgentsEnv(ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """An environment with several agents, which all act simultaneously on one `BuildingEnv`.

    Action of an agent: float32, shape (its actions,), within their bounds, or an index for each discrete action. All
    agents live as long as the episode: they are truncated, or terminated, together.

    Args:
        env: The environment; closed with this one.
        agents: The parts of the agents, by their names.
        rewards: Of the agents; None: each gets the environment's reward.

    Attributes:
        env: The environment.
        possible_agents: Names of all agents; `agents` are those of the running episode.
        state_space: Space of `state()`, the environment's observation.
    """

    def __init__(
        self, env: BuildingEnv, agents: Mapping[str, AgentPart], rewards: RewardsOfAgents | None = None
    ) -> None:
        self.env, self._agents, self._rewards_of_agents = env, agents, rewards
        self.render_mode = env.render_mode
        self.possible_agents = list(agents)
        self.agents: list[str] = []
        self.state_space = env.observation_space
        self.observation_spaces = {name: self._observation_space(agent) for name, agent in agents.items()}
        self.action_spaces = {name: self._action_space(agent) for name, agent in agents.items()}
        self._timestep = env.manifest.timestep
        self._busy = False
        self._state: Observation = np.zeros(0, np.float32)

    def _observation_space(self, agent: AgentPart) -> Box[np.float32]:
        space = self.state_space
        assert isinstance(space, Box)
        return Box(space.low[agent.observation_indices], space.high[agent.observation_indices], dtype=np.float32)

    def _action_space(self, agent: AgentPart) -> Space[Any]:
        space = self.env.action_space
        if isinstance(space, Box):
            return Box(space.low[agent.action_indices], space.high[agent.action_indices], dtype=np.float32)
        discrete_actions = self.env.manifest.task.discrete_actions
        counts = [len(discrete_actions[index].values) for index in agent.action_indices]
        return Discrete(counts[0]) if len(counts) == 1 else MultiDiscrete(counts)

    def observation_space(self, agent: str) -> Space[Any]:
        """Return an agent's observation space, always the same object."""
        return self.observation_spaces[self._check_agent(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """Return an agent's action space, always the same object."""
        return self.action_spaces[self._check_agent(agent)]

    def observation_names(self, agent: str) -> tuple[str, ...]:
        """Return the names of the values that an agent observes."""
        names = self.env.observation_names
        return tuple(names[index] for index in self._agents[self._check_agent(agent)].observation_indices)

    def action_names(self, agent: str) -> tuple[str, ...]:
        """Return the names of an agent's actions; if they are discrete, those of the actions that its choices set."""
        return self._agents[self._check_agent(agent)].actions

    def actuator_names(self, agent: str) -> tuple[str, ...]:
        """Return the names of the actuators that an agent sets, in the order of `infos[agent]["effective"]`."""
        actuators = self.env.manifest.actuators
        return tuple(actuators[index].name for index in self._agents[self._check_agent(agent)].actuator_indices)

    def observation_dict(self, agent: str, observation: ArrayLike) -> dict[str, float]:
        """Return an agent's observation by name, in the units of the manifest."""
        return by_name(self.observation_names(agent), observation, f"observation_dict of {agent}")

    def _check_agent(self, agent: str) -> str:
        if agent not in self._agents:
            raise InvalidConfig(f"no agent {agent!r}; {did_you_mean(str(agent), self._agents)}")
        return agent

    @one_thread(BUSY)
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode, or return to a snapshot of `env`; see `BuildingEnv.reset`.

        Rewards of agents with a state of their own begin anew at a snapshot. Other options than `snapshot` are ignored,
        because PettingZoo's own checks pass some.
        """
        known = {name: value for name, value in (options or {}).items() if name == "snapshot"}
        observation, info = self.env.reset(seed=seed, options=known)
        self.agents = self.possible_agents[:]
        infos = self._split_info(info)
        if self._rewards_of_agents is not None:
            self._rewards_of_agents.reset()
            sample = self.env.sample
            for name, terms in self._rewards_of_agents.unrewarded(sample.fault_free_values, sample.time).items():
                infos[name]["reward_terms"] = terms
        return self._split(observation), infos

    @one_thread(BUSY)
    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Simulate one timestep under the actions of all agents.

        The info of each agent is that of `BuildingEnv.step`, with `effective`, `action` and `value_source` (the agent's
        own name where it is the source) only for its own actuators, and the terms of its own reward as `reward_terms`.

        Raises:
            InvalidAction: An action is missing, of the wrong shape, out of bounds, or of an unknown agent; nothing was
                simulated.
            EpisodeChanged: The episode is over; and as for `BuildingEnv.step`.
        """
        if not self.agents:
            raise EpisodeChanged("the episode is over or has not started; call reset() first")
        observation, reward, terminated, truncated, info = self.env.step(self._join(actions))
        rewards, terms = self._rewards(reward)
        infos = self._split_info(info)
        for name, own_terms in terms.items():
            infos[name]["reward_terms"] = own_terms
        all_terminated, all_truncated = dict.fromkeys(self.agents, terminated), dict.fromkeys(self.agents, truncated)
        if terminated or truncated:
            self.agents = []
        return self._split(observation), rewards, all_terminated, all_truncated, infos

    def _join(self, actions: Mapping[str, ArrayLike]) -> Any:
        """Return the environment's action."""
        if not isinstance(actions, Mapping):
            raise InvalidAction(f"actions {actions!r}; the action of each agent by its name expected")
        missing, unknown = [a for a in self.agents if a not in actions], [a for a in actions if a not in self.agents]
        if missing or unknown:
            errors = [f"no action of {', '.join(map(repr, missing))}"] if missing else []
            errors += [f"no agent {name!r}; {did_you_mean(str(name), self.agents)}" for name in unknown]
            raise InvalidAction("; ".join(errors))
        space = self.env.action_space
        continuous = isinstance(space, Box)
        count = sum(len(agent.action_indices) for agent in self._agents.values())
        joined: NDArray[Any] = np.zeros(count, float if continuous else int)
        for name, agent in self._agents.items():
            joined[agent.action_indices] = self._check_action(name, agent, actions[name], continuous=continuous)
        return int(joined[0]) if isinstance(space, Discrete) else joined

    def _check_action(self, name: str, agent: AgentPart, action: ArrayLike, *, continuous: bool) -> NDArray[Any]:
        try:
            values = as_array(action, np.float64 if continuous else None)
        except InvalidAction as error:
            raise InvalidAction(f"agent {name!r}: {error}") from None
        values = values if continuous else np.atleast_1d(values)
        if values.shape != (len(agent.action_indices),) or not (continuous or np.issubdtype(values.dtype, np.integer)):
            expected = f"{self.action_spaces[name]} expected: {', '.join(agent.actions)}"
            raise InvalidAction(f"agent {name!r}: action {action!r}; {expected}")
        return values

    def _rewards(self, reward: float) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Return each agent's reward, and its terms where they are not those of the environment."""
        if self._rewards_of_agents is None:
            return dict.fromkeys(self.agents, reward), {}
        sample = self.env.sample
        terms = self._rewards_of_agents(sample.fault_free_values, sample.time - self._timestep, reward)
        return {name: sum(own_terms.values()) for name, own_terms in terms.items()}, terms

    def _split(self, observation: Observation) -> dict[str, Observation]:
        self._state = observation
        return {name: observation[agent.observation_indices] for name, agent in self._agents.items()}

    def _split_info(self, info: dict[str, Any]) -> dict[str, dict[str, Any]]:
        common = {key: value for key, value in info.items() if key not in ("effective", "action", "value_source")}
        infos = {}
        for name, agent in self._agents.items():
            own = {key: info[key][agent.actuator_indices] for key in ("effective", "action")}
            sources = [info["value_source"][index] for index in agent.actuator_indices]
            value_source = tuple(name if source == AGENT else source for source in sources)
            infos[name] = {**common, **own, "value_source": value_source}
        return infos

    def state(self) -> Observation:
        """Return the environment's observation, float32.

        Raises:
            EpisodeChanged: Before the first reset.
        """
        if not self._state.size:
            raise EpisodeChanged("call reset() first")
        return self._state.copy()

    def render(self) -> Any:
        """Return a picture of the last day; see `BuildingEnv.render`."""
        return self.env.render()

    def close(self) -> None:
        """Close the environment; idempotent."""
        self.env.close()
