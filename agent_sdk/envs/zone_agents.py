"""A building whose zones decide for themselves, as a PettingZoo environment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space
from numpy.typing import ArrayLike, NDArray

from agent_sdk.envs import arguments
from agent_sdk.envs.actions import as_array
from agent_sdk.envs.building_env import BuildingEnv, Observation
from agent_sdk.envs.connection import AGENT, BUSY
from agent_sdk.envs.space_names import by_name
from agent_sdk.rewards import AnyReward, BoundReward, read_reward
from agent_sdk.rewards.linear import WeightedReward
from agent_sdk.rewards.selectors import temperatures
from topics.errors import EpisodeChanged, InvalidAction, InvalidConfig, UsageError, did_you_mean
from topics.extras import install_command
from topics.keys import safe_name
from topics.messages import Action, Manifest

try:
    from pettingzoo import ParallelEnv
except ImportError:
    raise InvalidConfig(f"agents for zones need PettingZoo: {install_command('multi-agent')}") from None

BUILDING = "building"
"""The agent of all actions that belong to no single zone."""

ZoneRewards = Callable[[Mapping[str, float], datetime], Mapping[str, float]]
"""`(values, begin)`: values by the names of sensors and meters, and when the timestep began; a reward by agent."""

_THERMOSTAT = "zone temperature control"
_EVERYWHERE = "environment"


class ZonesEnv(ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """One building, an agent for each of its zones; all of them act at once, on one `BuildingEnv`.

    An agent has the actions that set the thermostat of its zone, and is called as the zone (`core_zn`). Actions that
    belong to no zone, or to several, are those of one more agent, `building`, the last one.

    Observation of an agent: float32, the values of the whole building's observation that concern it, in that order:
    time fields, sensors of outdoors (key `Environment`) and of its zone (by key), and `shared` ones. `building`
    observes everything. Action: float32, shape (its actions,), within their bounds, or a number for each discrete
    choice. All agents live as long as the episode: they are truncated, or terminated, together.

    Args:
        building: as for `BuildingEnv`, as are all others that are not named here.
        weather: as for `BuildingEnv`.
        control: `zone` where the node is this environment's own; see `BuildingEnv`.
        shared: names of what all agents observe besides (`observation_names` of the building).
        reward: `shared`: each agent gets the whole building's reward. `own`: an agent gets the comfort term of its own
            zone and an equal share of all else (power, and zones without an agent), so that the rewards of all agents
            add up to the building's; for rewards that are a sum over zones: `linear`, `exponential`, `hourly`,
            `occupied`. Or a function, see `ZoneRewards`.
        building_reward: the whole building's; as `reward` of `BuildingEnv`.
        given: all else, as for `BuildingEnv`.

    Attributes:
        env: the building's environment.
        possible_agents: all agents' names; `agents` are those of the running episode.
        state_space: of `state()`, the whole building's observation.

    Raises:
        InvalidConfig: no action belongs to a zone, a discrete choice of several zones at once, a reward that cannot be
            divided; and what `BuildingEnv` raises.
    """

    metadata = {"render_modes": ["rgb_array", "rerun"], "name": "zenostat_zones_v1", "is_parallelizable": True}  # noqa: RUF012

    def __init__(
        self,
        building: Any = None,
        weather: Any = None,
        *,
        control: str | None = None,
        shared: Sequence[str] = (),
        reward: str | ZoneRewards = "shared",
        building_reward: AnyReward | None = arguments.FROM_SCENARIO,
        **given: Any,
    ) -> None:
        if not callable(reward) and reward not in ("shared", "own"):
            raise InvalidConfig(f"reward = {reward!r}; 'shared', 'own' or a function of (values, begin) expected")
        if control is None and not {"connect", "link"} & set(given):
            control = "zone"
        plain = building_reward is None or isinstance(building_reward, str | Mapping)
        whole: Any = building_reward if plain else read_reward(cast("AnyReward", building_reward))
        self.env = BuildingEnv(building, weather, control=control, reward=whole, **given)
        try:
            self._agents = _agents(self.env.manifest, _named(shared, self.env.observation_names))
            self._shares = _Shares(self._agents, self.env.manifest, building_reward) if reward == "own" else None
        except InvalidConfig:
            self.env.close()
            raise
        self._function = reward if callable(reward) else None
        self.render_mode = self.env.render_mode
        self.possible_agents = list(self._agents)
        self.agents: list[str] = []
        self.state_space = self.env.observation_space
        self.observation_spaces = {name: self._observed(agent) for name, agent in self._agents.items()}
        self.action_spaces = {name: self._decided(agent) for name, agent in self._agents.items()}
        self._timestep = timedelta(hours=1 / self.env.manifest.steps_per_hour)
        self._busy = False
        self._state: Observation = np.zeros(0, np.float32)

    def _observed(self, agent: _Agent) -> Box[np.float32]:
        whole = self.state_space
        assert isinstance(whole, Box)
        return Box(whole.low[agent.observed], whole.high[agent.observed], dtype=np.float32)

    def _decided(self, agent: _Agent) -> Space[Any]:
        whole = self.env.action_space
        if isinstance(whole, Box):
            return Box(whole.low[agent.decided], whole.high[agent.decided], dtype=np.float32)
        choices = self.env.manifest.task.discrete_actions
        counts = [len(choices[place].values) for place in agent.decided]
        return Discrete(counts[0]) if len(counts) == 1 else MultiDiscrete(counts)

    @property
    def unwrapped(self) -> ZonesEnv:
        """Itself."""
        return self

    def observation_space(self, agent: str) -> Space[Any]:
        """Always the same object."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """Always the same object."""
        return self.action_spaces[self._known(agent)]

    def observation_names(self, agent: str) -> tuple[str, ...]:
        """Names of the values that an agent observes."""
        names = self.env.observation_names
        return tuple(names[place] for place in self._agents[self._known(agent)].observed)

    def action_names(self, agent: str) -> tuple[str, ...]:
        """Names of an agent's actions; of what its choices set where they are discrete."""
        return self._agents[self._known(agent)].actions

    def actuator_names(self, agent: str) -> tuple[str, ...]:
        """Names of the actuators that an agent sets, in the order of `infos[agent]["applied"]`."""
        actuators = self.env.manifest.actuators
        return tuple(actuators[place].name for place in self._agents[self._known(agent)].actuators)

    def observation_dict(self, agent: str, observation: ArrayLike) -> dict[str, float]:
        """An agent's observation by name, in the units that the manifest says."""
        return by_name(self.observation_names(agent), observation, f"observation_dict of {agent}")

    def _known(self, agent: str) -> str:
        if agent not in self._agents:
            raise InvalidConfig(f"no agent {agent!r}; {did_you_mean(str(agent), self._agents)}")
        return agent

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Starts an episode; see `BuildingEnv.reset`. There are no options; PettingZoo's own checks hand in some."""
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(BUSY)
        try:
            return self._reset(seed)
        finally:
            self._busy = False

    def _reset(self, seed: int | None) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        whole, info = self.env.reset(seed=seed)
        self.agents = self.possible_agents[:]
        if self._shares is not None:
            self._shares.reset()
        return self._parts(whole), self._infos(info)

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Simulates one timestep under the actions of all agents.

        `infos` has for each agent what `BuildingEnv.step` gives, with `effective`, `action` and `value_source` (its
        own name where it is the source) for its own actuators alone, and the terms of its own reward as `reward_terms`.

        Raises:
            InvalidAction: an agent's action is missing, of the wrong shape or out of bounds, or somebody else acts;
                nothing was simulated.
            EpisodeChanged: the episode is over; and what `BuildingEnv.step` raises.
        """
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(BUSY)
        try:
            return self._step(actions)
        finally:
            self._busy = False

    def _step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        if not self.agents:
            raise EpisodeChanged("no agent is there; call reset() first")
        whole, reward, terminated, truncated, info = self.env.step(self._joined(actions))
        rewards, terms = self._rewards(reward, info)
        infos = self._infos(info)
        for name, own in terms.items():
            infos[name]["reward_terms"] = own
        ended, cut = dict.fromkeys(self.agents, terminated), dict.fromkeys(self.agents, truncated)
        if terminated or truncated:
            self.agents = []
        return self._parts(whole), rewards, ended, cut, infos

    def _joined(self, actions: Mapping[str, ArrayLike]) -> Any:
        """The whole building's action."""
        missing, strange = [a for a in self.agents if a not in actions], [a for a in actions if a not in self.agents]
        if missing or strange:
            faults = [f"no action of {', '.join(map(repr, missing))}"] if missing else []
            faults += [f"no agent {name!r}; {did_you_mean(str(name), self.agents)}" for name in strange]
            raise InvalidAction("; ".join(faults))
        space = self.env.action_space
        continuous = isinstance(space, Box)
        joined: NDArray[Any] = np.zeros(
            sum(len(a.decided) for a in self._agents.values()), float if continuous else int
        )
        for name, agent in self._agents.items():
            joined[agent.decided] = self._own(name, agent, actions[name], continuous=continuous)
        return int(joined[0]) if isinstance(space, Discrete) else joined

    def _own(self, name: str, agent: _Agent, action: ArrayLike, *, continuous: bool) -> NDArray[Any]:
        try:
            own = as_array(action, np.float64 if continuous else None)
        except InvalidAction as error:
            raise InvalidAction(f"agent {name!r}: {error}") from None
        own = own if continuous else np.atleast_1d(own)
        if own.shape != (len(agent.decided),) or not (continuous or np.issubdtype(own.dtype, np.integer)):
            expected = f"{self.action_spaces[name]} expected: {', '.join(agent.actions)}"
            raise InvalidAction(f"agent {name!r}: action {action!r}; {expected}")
        return own

    def _rewards(self, whole: float, info: dict[str, Any]) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Each agent's reward, and its terms."""
        if self._shares is None and self._function is None:
            terms = dict.fromkeys(self.agents, info.get("reward_terms", {}))
            return dict.fromkeys(self.agents, whole), {name: dict(own) for name, own in terms.items()}
        sample = self.env.sample
        values, begin = sample.fault_free_values, sample.time - self._timestep
        if self._shares is not None:
            terms = self._shares(values, begin, whole)
        else:
            assert self._function is not None
            given = self._function(dict(zip(self.env.manifest.names, values.tolist(), strict=True)), begin)
            if not isinstance(given, Mapping) or set(given) != set(self.agents):
                raise InvalidConfig(
                    f"reward: it gave {given!r}; a reward for each of {', '.join(self.agents)} expected"
                )
            terms = {name: {"reward": float(given[name])} for name in self.agents}
        return {name: sum(own.values()) for name, own in terms.items()}, terms

    def _parts(self, whole: Observation) -> dict[str, Observation]:
        self._state = whole
        return {name: whole[agent.observed] for name, agent in self._agents.items()}

    def _infos(self, info: dict[str, Any]) -> dict[str, dict[str, Any]]:
        common = {key: value for key, value in info.items() if key not in ("effective", "action", "value_source")}
        infos = {}
        for name, agent in self._agents.items():
            own = {"effective": info["effective"][agent.actuators]}
            if "action" in info:
                own["action"] = info["action"][agent.actuators]
            sources = [info["value_source"][place] for place in agent.actuators]
            # The name on the bus has numbers in it that no seed rules.
            infos[name] = {**common, **own, "value_source": tuple(name if who == AGENT else who for who in sources)}
        return infos

    def state(self) -> Observation:
        """The whole building's observation, float32.

        Raises:
            EpisodeChanged: before the first reset.
        """
        if not self._state.size:
            raise EpisodeChanged("call reset() first")
        return self._state.copy()

    def render(self) -> Any:
        """See `BuildingEnv.render`."""
        return self.env.render()

    def close(self) -> None:
        """Ends the building's environment; twice is fine."""
        self.env.close()


@dataclass(frozen=True)
class _Agent:
    """One agent.

    Attributes:
        zone: key of its zone; empty for that of the building.
        actions: names of its actions.
        decided: places of its actions in the whole action (of its choices, where it is discrete).
        actuators: places of the actuators that it sets.
        observed: places of what it observes in the whole observation.
    """

    zone: str
    actions: tuple[str, ...]
    decided: list[int]
    actuators: list[int]
    observed: list[int]


def _agents(manifest: Manifest, shared: set[int]) -> dict[str, _Agent]:
    """By name, in the order of their first actions; that of the building last."""
    task = manifest.task
    by_name = {action.name: action for action in task.actions}
    dimensions = [[by_name[name] for name in c.actions] for c in task.discrete_actions] or [
        [action] for action in task.actions
    ]
    keys = {a.name: a.key for a in manifest.actuators if a.component_type.casefold() == _THERMOSTAT}
    zones = [_zone(members, keys) for members in dimensions]
    order = [*dict.fromkeys(zone for zone in zones if zone), *([""] if "" in zones else [])]
    if order in ([], [""]):
        raise InvalidConfig(
            f"no action of node {manifest.node!r} belongs to one zone alone; control='zone' gives each zone its own, "
            "unless the scenario names its actions"
        )
    names, found = _names(order), {}
    for zone in order:
        decided = [place for place, of in enumerate(zones) if of == zone]
        actions = [action for place in decided for action in dimensions[place]]
        wanted = {name for action in actions for name in action.actuators}
        actuators = [place for place, actuator in enumerate(manifest.actuators) if actuator.name in wanted]
        found[names[zone]] = _Agent(
            zone, tuple(a.name for a in actions), decided, actuators, _observed(manifest, zone, shared)
        )
    return found


def _zone(members: Sequence[Action], keys: Mapping[str, str]) -> str:
    """The key of the one zone whose thermostat these actions set; empty if there is none."""
    folded = {keys.get(name, "").casefold() for action in members for name in action.actuators}
    return keys.get(members[0].actuators[0], "") if len(folded) == 1 else ""


def _names(zones: Iterable[str]) -> dict[str, str]:
    """A safe name for each zone, each another."""
    names = {"": BUILDING}
    for zone in zones:
        name = base = safe_name(zone)
        number = 2
        while zone and name in names.values():
            name, number = f"{base}_{number}", number + 1
        names.setdefault(zone, name)
    return names


def _observed(manifest: Manifest, zone: str, shared: set[int]) -> list[int]:
    first = len(manifest.task.time)
    count = first + len(manifest.names)
    if not zone:
        return list(range(count))
    own = (_EVERYWHERE, zone.casefold())
    near_by = {first + place for place, sensor in enumerate(manifest.sensors) if sensor.key.casefold() in own}
    return [place for place in range(count) if place < first or place in near_by or place in shared]


def _named(shared: Sequence[str], names: Sequence[str]) -> set[int]:
    for name in [shared] if isinstance(shared, str) else shared:
        if name not in names:
            raise InvalidConfig(f"shared: nothing that is observed is called {name!r}; {did_you_mean(name, names)}")
    return {names.index(name) for name in ([shared] if isinstance(shared, str) else shared)}


class _Shares:
    """Divides the building's reward: to each agent the comfort of its zone, and an equal share of all else."""

    def __init__(self, agents: Mapping[str, _Agent], manifest: Manifest, given: AnyReward | None) -> None:
        wanted = manifest.task.reward if given == arguments.FROM_SCENARIO else given
        reward = None if wanted is None else read_reward(wanted)
        if not isinstance(reward, WeightedReward):
            raise InvalidConfig(
                f"reward='own' divides rewards that are a sum over zones (linear, exponential, hourly, occupied), and "
                f"{'there is no reward' if reward is None else f'{type(reward).__name__} is not'}; give "
                "building_reward='linear', or a function as reward"
            )
        self._comfort: dict[str, BoundReward | None] = {}
        counted = [manifest.sensors[place] for place in temperatures(reward.kind, reward.temperatures, manifest)]
        for name, agent in agents.items():
            own = tuple(s.name for s in counted if agent.zone and s.key.casefold() == agent.zone.casefold())
            self._comfort[name] = _bound(reward.model_copy(update={"temperatures": own}), manifest) if own else None

    def reset(self) -> None:
        """An episode begins."""
        for bound in self._comfort.values():
            if bound is not None:
                bound.reset()

    def __call__(self, values: NDArray[np.float64], begin: datetime, whole: float) -> dict[str, dict[str, float]]:
        """The terms of each agent's reward; all of them add up to `whole`."""
        comforts = {
            name: 0.0 if bound is None else float(bound(values, begin).terms["comfort"])
            for name, bound in self._comfort.items()
        }
        share = (whole - sum(comforts.values())) / len(comforts)
        return {name: {"share": share, "comfort": comfort} for name, comfort in comforts.items()}


def _bound(reward: WeightedReward, manifest: Manifest) -> BoundReward | None:
    try:
        return reward.bind(manifest)
    except InvalidConfig:  # the whole reward was bound: it leaves this zone out (nobody is ever there)
        return None
