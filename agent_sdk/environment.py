"""A building on the bus as a Gymnasium environment."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent_sdk import settings, spaces
from agent_sdk.actions import Actions
from agent_sdk.client import connect
from agent_sdk.clock import clock
from agent_sdk.launch import Monitor, OwnNode
from agent_sdk.limits import Limits
from agent_sdk.link import Link
from agent_sdk.render import History
from agent_sdk.rewards import AnyReward, Reward, read_reward
from agent_sdk.sample import SampleView
from bridge.affinity import Affinity
from topics.errors import EpisodeChanged, InvalidConfig
from topics.messages import Mask, WeatherSeries

Observation = NDArray[np.float32]
NAME = "building"
AGENT = "agent"
"""What an environment is called in its own `info["ruled_by"]`; its name on the bus differs from run to run."""


class BuildingEnv(gym.Env[Observation, Any]):
    """One building, one agent; `gym.make("zenostat/5zone-hot-continuous-v1")` and all others under `zenostat/`.

    Without `connect` it starts a node of its own over a private unix socket and ends it on `close()`; with
    `connect` and `node` it drives a node that runs elsewhere, whose scenario it takes over.

    Observation: float32, shape (time fields + sensors + meters,), in the order of the manifest. Action: float32,
    shape (actions,), within each action's bounds, or a number for each discrete choice. An episode of N timesteps
    has N steps; the last one is `truncated`. A limit of the scenario that is broken (`terminate`) makes the step
    `terminated`, and `info["terminated_by"]` says which.

    What is simulated comes from `scenario`, `file` or `config`, or from `building` and `weather`; each argument
    that is given goes before what those say.

    Args:
        building: short name, path to an IDF or epJSON, or any part of a listed name that fits only one.
        weather: short name, path to an EPW, or any part of a listed name that fits only one; or several of them.
        scenario: an id, as `zenostat scenarios` lists them.
        file: a scenario file (YAML).
        config: a Sinergym configuration (YAML), of which `variant` names the weather and form
            (`hot-continuous-stochastic`; its first one if left out).
        sensors: name to (variable, key) or (variable, key, reading); reading is "mean", "sum" or "instant".
        meters: name to EnergyPlus's meter.
        actuators: name to (component type, control type, key), or that with low and high. Empty: the
            building's own control. Each of the three left out: a sensible set found in the model.
        begin, end: first and last day, MM-DD or YYYY-MM-DD.
        steps_per_hour: timesteps an hour; None is the model's own.
        weather_order, variability, sizing, changes, time, reading, actions, control, discrete, terminate: as in a
            scenario file (`zenostat scenarios schema`).
        reward: an object of `agent_sdk.rewards`, or a kind or a kind with its parameters, or a function or class of
            your own (`agent_sdk.rewards.of_function`); None gives 0.0; left out, the scenario's.
        connect: endpoint of a bus.
        node: the node's name there.
        level: priority level that this agent commands at, 1 to 16.
        keep: folder in which EnergyPlus's own output files are kept, one folder an episode.
        affinity: see `bridge.affinity`.
        render_mode: `rgb_array`: `render()` gives a picture of the last day (needs matplotlib); `rerun`: a live
            view is opened beside the environment.
        link: what samples come from and commands go to, in place of a node: see `agent_sdk.testing`.

    Raises:
        UsageError, BusError, SimulatorError: see `topics.errors`; nothing is left behind.

    Warns:
        UserWarning: something in the model works against the scenario's actuators.
    """

    metadata = {"render_modes": ["rgb_array", "rerun"], "render_fps": 4}  # noqa: RUF012  # Gymnasium's own form

    def __init__(
        self,
        building: str | Path | None = None,
        weather: str | Path | Sequence[str | Path] | None = None,
        *,
        scenario: str | None = None,
        file: str | Path | None = None,
        config: str | Path | None = None,
        variant: str | None = None,
        sensors: Mapping[str, Sequence[str]] | None = None,
        meters: Mapping[str, str] | None = None,
        actuators: Mapping[str, Sequence[str | float]] | None = None,
        begin: str | None = None,
        end: str | None = None,
        steps_per_hour: int | None = None,
        weather_order: str | None = None,
        variability: Mapping[str, Any] | None = None,
        sizing: str | None = None,
        changes: Mapping[str, Any] | None = None,
        time: Sequence[str] | None = None,
        reading: str | None = None,
        actions: Mapping[str, Any] | None = None,
        control: str | None = None,
        discrete: int | Sequence[Any] | None = None,
        terminate: Sequence[Mapping[str, Any]] | None = None,
        reward: AnyReward | None = settings.OF_THE_SCENARIO,
        connect: str | None = None,
        node: str | None = None,
        level: int = 10,
        keep: str | Path | None = None,
        affinity: Affinity | str = Affinity.APART,
        render_mode: str | None = None,
        link: Link | None = None,
    ) -> None:
        here = locals()
        given = {name: here[name] for name in settings.OF_A_NODE if here[name] is not None}
        self._close, self._closed = ExitStack(), False
        with ExitStack() as undo:
            undo.callback(self.close)
            self._check_render(render_mode)
            self.own_node: OwnNode | None = None
            self._link = link
            if link is not None:
                if given or connect or render_mode == "rerun":
                    raise InvalidConfig(
                        "link= brings a building of its own, and is on no bus; leave out what else decides"
                    )
                self._close.callback(link.close)
                self.manifest = link.manifest
            else:
                self._find_node(given, reward, connect, node, level, Affinity(affinity))
            manifest = self.manifest
            self.observation_space = spaces.observation_space(manifest)
            self._actions = Actions(manifest)
            self.action_space = self._actions.space
            self.reward = self._rewarding(reward)
            self._reward = self.reward.bind(manifest) if self.reward is not None else None
            self._limits = Limits(manifest) if manifest.task.terminate else None
            self._history = History(manifest) if render_mode == "rgb_array" else None
            if render_mode == "rerun":
                self._close.callback(Monitor(self._way[0]).close)
            undo.pop_all()
        self.render_mode = render_mode
        self._timestep = timedelta(hours=1 / manifest.steps_per_hour)
        self._time = manifest.task.time
        self._values = self._actions.values
        self._sample: SampleView | None = None
        self._context: dict[int, float | None] = {}
        self._ended = False
        self._rulers: tuple[bytes, list[str]] = (b"", [])
        self._ruled_by: tuple[str, ...] = ()
        for warning in manifest.warnings:
            warnings.warn(f"{manifest.building}: {warning}", stacklevel=3)

    def _find_node(
        self,
        given: dict[str, Any],
        reward: AnyReward | None,
        endpoint: str | None,
        node: str | None,
        level: int,
        placement: Affinity,
    ) -> None:
        """Finds a node elsewhere, or starts one, which tells its manifest before anybody joins its bus."""
        if endpoint is None:
            wanted = settings.for_node(given, node or NAME)
            settings.check_reward(reward, wanted, placement)
            own = self.own_node = OwnNode(wanted, placement)
            self._close.callback(own.close)
            assert own.manifest is not None
            self.manifest = own.manifest
            self._way = (own.endpoint, node or NAME, level, placement, own.core)
            return
        if given:
            raise InvalidConfig(f"{', '.join(given)}: the node at {endpoint} has its own; leave out what it decides")
        if node is None:
            raise InvalidConfig(f"connect={endpoint!r} needs the node's name: node='office'")
        self._way = (endpoint, node, level, placement, None)
        self.manifest = self.link.manifest

    @property
    def link(self) -> Link:
        """The hold on the node.

        An own node's bus is joined when it is first needed: up to then this process has no threads of Zenoh's and may
        be forked, as Gymnasium's asynchronous vector environments do it.
        """
        if self._link is None:
            endpoint, node, level, placement, core = self._way
            bus = self._close.enter_context(connect(endpoint, affinity=placement, core=core))
            self._link = self._close.enter_context(bus.controller(node, name="env", level=level))
        return self._link

    def _check_render(self, mode: str | None) -> None:
        if mode is not None and mode not in self.metadata["render_modes"]:
            raise InvalidConfig(f"render_mode {mode!r}; there are: {', '.join(self.metadata['render_modes'])}")

    def _rewarding(self, reward: AnyReward | None) -> Reward | None:
        wanted = self.manifest.task.reward if reward == settings.OF_THE_SCENARIO else reward
        return None if wanted is None else read_reward(wanted)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode: sample 0, the state after warm-up, and its info.

        The seed rules which weather is drawn and its noise; without one, the next of the sequence that the last
        seed began. `info["weather"]` says which it is.
        """
        super().reset(seed=seed)
        self._check_open()
        if options:
            raise InvalidConfig(f"unknown reset options {sorted(options)}; there are none")
        self._context, self._ended = {}, False
        for remembers in (self._reward, self._limits):
            if remembers is not None:
                remembers.reset()
        sample = self._sample = self.link.reset(seed=seed)
        values, info = sample.values, self._info(sample)
        accepted = self.link.accepted
        info |= {"weather": accepted.weather, "weather_noise": accepted.drawn, "start": accepted.start}
        if self._history is not None:
            self._history.clear()
            self._history.add(sample.time, values)
        return self._observed(sample, values, sample.time), info

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulates one timestep under `action`.

        `info` has `time` and `step` of the sample; `action`: the value commanded for each actuator; `applied`: what
        each really was (NaN where EnergyPlus does not tell); `ruled_by`: who set it ("agent" is this environment, ""
        the building's own control); `reward_terms`, whose sum is the reward, and `reward_measures`; the node's counts
        of `late` and `rejected` messages; and at the episode's end `outputs`, the folder of EnergyPlus's files, if
        they are kept.

        Raises:
            InvalidAction: wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, Refused, EpisodeChanged: see `ControlLink.receive`.
        """
        previous = self._sample
        if previous is None or self._ended or self._closed:
            self._check_open()
            raise EpisodeChanged("the episode is over; call reset()" if previous else "call reset() before step()")
        commanded, mask = self._command(action)
        self.link.send(commanded, mask)
        sample = self._sample = self.link.receive()
        values, info, begin = sample.values, self._info(sample), sample.time - self._timestep
        info["action"] = commanded
        reward = 0.0
        if self._reward is not None:
            total, info["reward_terms"], info["reward_measures"] = self._reward(values, begin)
            reward = float(total)
        broken = self._limits.broken(values) if self._limits is not None else ""
        if broken:
            info["terminated_by"] = broken
        truncated = sample.truncated
        self._ended = truncated or bool(broken)
        if self._ended and self.link.accepted.outputs:
            info["outputs"] = self.link.accepted.outputs
        if self._history is not None:
            self._history.add(sample.time, values)
        return self._observed(sample, values, begin), reward, bool(broken), truncated, info

    def render(self) -> Any:
        """With `rgb_array` a picture of the last day, shape (640, 960, 3), uint8; with `rerun` nothing: it is live."""
        return self._history.picture() if self._history is not None else None

    @property
    def sample(self) -> SampleView:
        """The latest sample; a controller answers it.

        Raises:
            EpisodeChanged: before the first reset.
        """
        if self._sample is None:
            raise EpisodeChanged("call reset() first")
        return self._sample

    def _command(self, action: ArrayLike) -> tuple[NDArray[np.float64], bytes | None]:
        values, mask = self._values(action), self._actions.mask
        if self._context:
            assert mask is not None
            kinds = bytearray(mask)
            for index, value in self._context.items():
                kinds[index] = Mask.RELEASE if value is None else Mask.SET
                values[index] = 0.0 if value is None else value
            mask, self._context = bytes(kinds), {}
        return values, mask

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Sets actuators that are in no action, from the next step on until it is called again; None releases one.

        Raises:
            InvalidAction: an actuator that the node does not have, or that an action sets; a value out of bounds.
        """
        self._context |= self._actions.context(values)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Columns of the weather file that this episode reads, noise included; see `WeatherSeries`.

        Raises:
            UnknownName: no such column of an EPW.
        """
        return self.link.weather(columns)

    def _observed(self, sample: SampleView, values: NDArray[np.float64], begin: Any) -> Observation:
        if not self._time:
            return values.astype(np.float32)
        return np.concatenate([clock(self._time, begin, sample.time), values]).astype(np.float32)

    def _info(self, sample: SampleView) -> dict[str, Any]:
        wire = sample.wire
        if (wire.ruler, wire.rulers) != self._rulers:
            me = self.link.name
            self._rulers = (wire.ruler, wire.rulers)
            self._ruled_by = tuple(AGENT if who == me else who for who in sample.ruled_by.values())
        return {
            "time": wire.time[0],
            "step": sample.step,
            "applied": sample.applied,
            "ruled_by": self._ruled_by,
            "late": wire.late,
            "rejected": wire.rejected,
        }

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observation's values: time fields, sensors, meters."""
        return (*map(str, self.manifest.task.time), *self.manifest.names)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the action's dimensions; of what the choices set where it is discrete."""
        return tuple(self._actions.names)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The observation's values by name, in the unit that the manifest says."""
        values = np.asarray(observation).tolist()
        return dict(zip(self.observation_names, values, strict=True))

    def close(self) -> None:
        """Lets go of the node, and ends it if it is this environment's own; twice is fine."""
        self._closed = True
        self._close.close()

    def _check_open(self) -> None:
        if self._closed:
            raise EpisodeChanged("the environment is closed; make another one")
