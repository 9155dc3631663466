"""A building on the bus as a Gymnasium environment."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray
from zenoh import ZError

from agent_sdk.bus.bus import Bus
from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.bus.local_node import LocalNode
from agent_sdk.bus.sample import SampleView
from agent_sdk.bus.snapshot import Snapshot, asked_for, forking, take
from agent_sdk.envs import arguments, spaces
from agent_sdk.envs.actions import Actions
from agent_sdk.envs.connection import AGENT, BUSY, RENDER_MODES, NodeConnection
from agent_sdk.envs.episode_state import EpisodeState
from agent_sdk.envs.rendering import RollingHistory
from agent_sdk.envs.space_names import SpaceNames
from agent_sdk.envs.termination import TerminationLimits
from agent_sdk.envs.time_features import time_features
from agent_sdk.envs.vector_sample import Link
from agent_sdk.rewards import AnyReward
from bridge.runtime.affinity import Affinity
from topics.errors import BusError, EpisodeChanged, InvalidConfig, UsageError
from topics.messages import CommandOp, CreateBranch, WeatherSeries
from topics.seeds import check_seed

Observation = NDArray[np.float32]


def _stop(bus: Bus, node: str) -> None:
    with suppress(BusError, ZError):  # it has ended with its parent, or the bus has been left
        bus.stop(node)


class BuildingEnv(SpaceNames, gym.Env[Observation, Any]):
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
        sensors: name to (variable, key) or (variable, key, aggregation); aggregation is "mean", "sum" or
                "instant".
        meters: name to EnergyPlus's meter.
        actuators: name to (component type, control type, key), or that with low and high. Empty: the
            building's own control. Each of the three left out: a sensible set found in the model.
        begin, end: first and last day, MM-DD or YYYY-MM-DD.
        steps_per_hour: timesteps an hour; None is the model's own.
        weather_order, weather_noise, sizing, edits, time, aggregation, actions, control, discrete, terminate: as in
            a scenario file (`zenostat scenarios schema`).
        reward: an object of `agent_sdk.rewards`, or a kind or a kind with its parameters, or a function or class of
            your own (`agent_sdk.rewards.from_function`); None gives 0.0; left out, the scenario's.
        connect: endpoint of a bus.
        keys: for a bus over TLS, the folder of certificates that `zenostat keys init` made.
        node: the node's name there.
        priority: priority level that this agent commands at, 1 to 16.
        output_dir: folder in which EnergyPlus's own output files are kept, one folder an episode.
        keep_last: how many finished episodes' files are kept there beside the running one's; None is all.
        baseline: run the building under its own control beside the episode: `info["baseline"]` has its points,
            `info["baseline_effective"]` what that control set the actuators to.
        faults: a file of faults that the node injects (YAML); see docs/faults.md.
        branches: how many snapshots and branches there may be at a time; 64 if left out.
        unresponsive_s: how long an engine may neither answer nor use processor time, before it is killed and the
            episode fails; 10 if left out.
        affinity: see `bridge.runtime.affinity`.
        render_mode: `rgb_array`: `render()` gives a picture of the last day (needs matplotlib); `rerun`: a live
            view is opened beside the environment.
        link: what samples come from and commands go to, in place of a node: see `agent_sdk.testing`.

    Raises:
        UsageError, BusError, SimulatorError: see `topics.errors`; nothing is left behind.

    Warns:
        UserWarning: something in the model works against the scenario's actuators.
    """

    metadata = {"render_modes": [*RENDER_MODES], "render_fps": 4}  # noqa: RUF012  # Gymnasium's own form

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
        weather_noise: Mapping[str, Any] | None = None,
        sizing: str | None = None,
        edits: Mapping[str, Any] | None = None,
        time: Sequence[str] | None = None,
        aggregation: str | None = None,
        actions: Mapping[str, Any] | None = None,
        control: str | None = None,
        discrete: int | Sequence[Any] | None = None,
        terminate: Sequence[Mapping[str, Any]] | None = None,
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        connect: str | None = None,
        node: str | None = None,
        priority: int = 10,
        output_dir: str | Path | None = None,
        keep_last: int | None = None,
        baseline: bool | None = None,
        branches: int | None = None,
        unresponsive_s: float | None = None,
        faults: str | Path | None = None,
        affinity: Affinity | str = Affinity.SEPARATE_CORES,
        render_mode: str | None = None,
        keys: str | Path | None = None,
        link: Link | None = None,
    ) -> None:
        here = locals()
        given = {name: here[name] for name in arguments.NODE_ARGUMENTS if here[name] is not None}
        self._hold = NodeConnection(
            given,
            reward=reward,
            connect=connect,
            node=node,
            priority=priority,
            affinity=affinity,
            render_mode=render_mode,
            keys=keys,
            link=link,
        )
        with ExitStack() as undo:
            undo.callback(self._hold.abandon)
            manifest = self.manifest = self._hold.manifest
            self.observation_space = spaces.observation_space(manifest)
            self._actions = Actions(manifest)
            self.action_space = self._actions.space
            self.reward = self._hold.reward
            self._memory: EpisodeState[dict[int, float | None]] = EpisodeState(
                self.reward.bind(manifest) if self.reward is not None else None,
                TerminationLimits(manifest) if manifest.task.terminate else None,
                {},
            )
            self.wrappers = self._memory.wrappers
            self._history = RollingHistory(manifest) if render_mode == "rgb_array" else None
            if render_mode == "rerun":
                self._hold.open_monitor()
            undo.pop_all()
        self.render_mode, self._priority = render_mode, priority
        self._timestep = timedelta(hours=1 / manifest.steps_per_hour)
        self._time = manifest.task.time
        self._values = self._actions.values
        self._sample: SampleView | None = None
        self._ended = self._busy = False
        self._begun: dict[str, Any] = {"weather": "", "weather_noise": {}, "engine_start": ""}
        self._output_dir = ""
        self._sources: tuple[bytes, list[str]] = (b"", [])
        self._value_source: tuple[str, ...] = ()
        self._hold.warn(stacklevel=3)

    @property
    def link(self) -> Link:
        """The hold on the node; an own node's bus is joined when it is first needed."""
        link: Link = self._hold.link
        return link

    @property
    def local_node(self) -> LocalNode | None:
        """The node that was started; None if it runs elsewhere."""
        return self._hold.local_node

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode: sample 0, the state after warm-up, and its info.

        The seed rules which weather is drawn and its noise; without one, the next of the sequence that the last
        seed began. `info["weather"]` says which it is, and `info["engine_start"]` how its engine came to its first
        sample.

        Where the node injects faults, observations have them; the reward and the limits go by the truth, which is
        `info["fault_free_values"]`.

        `options={"snapshot": snap}` goes back to a snapshot instead: its sample, and what the reward and the limits
        remembered there.

        Where the environment's own node has ended, another one is started. After a lost link the node is claimed
        again.

        Raises:
            InvalidConfig: an unknown option; a snapshot that is closed, of another node, or of a node that has ended;
                a seed that is no whole number from 0 to 2**64 - 1.
            EngineDied, ForkFailed: the snapshot's engine; the running episode goes on.
            NodeNotFound: a node that runs elsewhere is gone.
            NodeLost: that node was restarted with other points.
            UsageError: another thread is in `step` or `reset`.

        Warns:
            UserWarning: why another node was started.
        """
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(BUSY)
        try:
            return self._reset(None if seed is None else check_seed(seed), options or {})
        except (EpisodeChanged, BusError):
            self._hold.check_open()
            raise
        finally:
            self._busy = False

    def _reset(self, seed: int | None, options: dict[str, Any]) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        self._hold.check_open()
        self._hold.renew()
        snapshot = self._asked(options)
        if snapshot is None:
            sample = self._sample = self._hold.reset(seed=seed)
            self._memory.reset()
            self._memory.context = {}
        else:
            sample = self._sample = self._forking().reset(seed=seed, snapshot=snapshot.name)
            self._memory.restore(snapshot.env_state)
        self.manifest, self._ended = self._hold.manifest, False
        (begun,) = self.link.accepted.episode_starts
        self._output_dir = begun.output_dir
        self._begun = {
            "weather": begun.weather,
            "weather_noise": begun.noise_parameters,
            "engine_start": begun.engine_start,
        }
        values, now, info = sample.values, sample.time, self._info(sample)
        info["action"] = np.full(len(self.manifest.actuators), np.nan)
        info |= self._memory.unrewarded(sample.fault_free_values, now)
        if self._history is not None:
            self._history.clear()
            self._history.add(now, values)
        return self._observed(values, now - self._timestep if sample.step else now, now), info

    def _asked(self, options: Mapping[str, Any]) -> Snapshot | None:
        self.manifest = self._hold.manifest
        if self.manifest.branch_of:
            raise InvalidConfig("a branch has no sample 0 of its own; close it and make another one")
        return asked_for(options, self.manifest)

    def snapshot(self) -> Snapshot:
        """Keeps where the episode stands, to go back there by `reset(options={"snapshot": snap})` any number of times.

        Raises:
            EpisodeChanged: no episode runs.
            RequestRejected: there are as many snapshots and branches as the node allows, or this is a branch.
            ForkFailed: the system has no memory for a fork; the episode goes on.
        """
        return take(self._forking(), self._running(), self._memory)

    def branch(self, *, snapshot: Snapshot | None = None, relinquished: bool = False) -> BuildingEnv:
        """Another environment that goes on from this very step on its own, while this one goes on.

        It is a node of its own on the bus and ends with `close()`, or with this environment. It has one episode: it
        cannot be reset. `with env.unwrapped.branch() as b: b.step(action)`.

        Args:
            snapshot: begin there instead.
            relinquished: drop all commands so far; the baseline control is in effect until a step commands.

        Raises:
            as for `snapshot`.
        """
        link, sample = self._forking(), self._running() if snapshot is None else snapshot.sample
        if snapshot is not None:
            snapshot.check(self.manifest)
        with ExitStack() as undo:
            asked = CreateBranch(
                controller=link.name, snapshot=snapshot.name if snapshot is not None else "", relinquished=relinquished
            )
            name = link.bus.branch(link.manifest.node, asked)
            undo.callback(_stop, link.bus, name)
            hold = undo.enter_context(link.bus.controller(name, name="env", priority=self._priority))
            branch = BuildingEnv(link=hold, reward=copy.deepcopy(self.reward))  # it may be an object with a memory
            branch._sample = hold.set_current(sample.message)
            branch._begun = self._begun
            branch._memory.restore(self._memory.state() if snapshot is None else snapshot.env_state)
            branch._hold.push_exit(undo.pop_all())
        return branch

    def _forking(self) -> ControllerLink:
        self._hold.check_open()
        return forking(self.link)

    def _running(self) -> SampleView:
        if self._sample is None or self._ended:
            raise EpisodeChanged("no episode runs; call reset() first")
        return self._sample

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulates one timestep under `action`.

        `info` has `time` and `step` of the sample; `action`: the value commanded for each actuator; `effective`: its
        effective value (NaN where EnergyPlus does not tell); `value_source`: who set it ("agent" is this environment,
        "" the baseline control); `reward_terms`, whose sum is the reward, and `reward_metrics`; the node's counts
        of `late` and `rejected` messages; and at the episode's end `output_dir`, the folder of EnergyPlus's files, if
        they are kept.

        Raises:
            InvalidAction: wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, RequestRejected, EpisodeChanged: see `ControllerLink.receive`.
            UsageError: another thread is in `step` or `reset`.
        """
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(BUSY)
        try:
            return self._step(action)
        except (EpisodeChanged, BusError):
            self._hold.check_open()
            raise
        finally:
            self._busy = False

    def _step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        previous = self._sample
        if previous is None or self._ended or self._hold.closed:
            self._hold.check_open()
            raise EpisodeChanged("the episode is over; call reset()" if previous else "call reset() before step()")
        commanded, operations = self._command(action)
        link = self.link
        link.send(commanded, operations)
        sample = self._sample = link.receive()
        values, end, info = sample.values, sample.time, self._info(sample)
        begin = end - self._timestep
        truth = sample.fault_free_values if sample.message.fault_free_values else values
        info["action"] = self._actions.commanded(commanded, operations)
        memory, reward = self._memory, 0.0
        if memory.reward is not None:
            total, info["reward_terms"], info["reward_metrics"] = memory.reward(truth, begin)
            reward = float(total)
        broken = ""
        if memory.limits is not None:
            broken = memory.limits.violated(truth)
            info["terminated_by"] = broken
        truncated = sample.truncated
        self._ended = truncated or bool(broken)
        if self._ended and self._output_dir:
            info["output_dir"] = self._output_dir
        if self._history is not None:
            self._history.add(end, values)
        return self._observed(values, begin, end), reward, bool(broken), truncated, info

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
        values, operations = self._values(action), self._actions.operations
        if self._memory.context:
            assert operations is not None
            codes = bytearray(operations)
            for index, value in self._memory.context.items():
                codes[index] = CommandOp.RELINQUISH if value is None else CommandOp.SET
                values[index] = 0.0 if value is None else value
            operations, self._memory.context = bytes(codes), {}
        return values, operations

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Sets actuators that are in no action, from the next step on until it is called again; None releases one.

        Raises:
            InvalidAction: an actuator that the node does not have, or that an action sets; a value out of bounds.
        """
        self._memory.context |= self._actions.context(values)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Columns of the weather file that this episode reads, noise included; see `WeatherSeries`.

        Raises:
            UnknownName: no such column of an EPW.
        """
        return self.link.weather(columns)

    def _observed(self, values: NDArray[np.float64], begin: datetime, end: datetime) -> Observation:
        if not self._time:
            return values.astype(np.float32)
        return np.concatenate([time_features(self._time, begin, end), values], dtype=np.float32, casting="same_kind")

    def _info(self, sample: SampleView) -> dict[str, Any]:
        wire = sample.message
        if (wire.source_index, wire.sources) != self._sources:
            me = self.link.name
            self._sources = (wire.source_index, wire.sources)
            self._value_source = tuple(AGENT if who == me else who for who in sample.value_source.values())
        info = {
            "time": wire.time[0],
            "step": wire.step[0],
            "effective": sample.effective,
            "value_source": self._value_source,
            "late": wire.late,
            "rejected": wire.rejected,
            **self._begun,
            "weather_noise": dict(self._begun["weather_noise"]),
        }
        if self._memory.limits is not None:
            info["terminated_by"] = ""
        if self._output_dir:
            info["output_dir"] = ""
        if wire.fault_free_values:
            info["fault_free_values"] = sample.fault_free_values
        if wire.baseline:
            info |= {"baseline": sample.baseline, "baseline_effective": sample.baseline_effective}
        return info

    def close(self) -> None:
        """Lets go of the node, and ends it if it is this environment's own; twice is fine."""
        self._hold.close()
