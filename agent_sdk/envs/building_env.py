"""A building on the bus as a Gymnasium environment."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Any, Unpack, overload

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from zenostat.agent_sdk.envs import arguments, spaces
from zenostat.agent_sdk.envs.action_values import Actions, as_array
from zenostat.agent_sdk.envs.branch_env import BranchVectorEnv, branch_request, open_branch
from zenostat.agent_sdk.envs.connection import NOT_STARTED, RENDER_MODES, ConnectedEnv, Link, NodeConnection, one_caller
from zenostat.agent_sdk.envs.episode_state import EpisodeState, require_episode
from zenostat.agent_sdk.envs.infos import SampleInfos
from zenostat.agent_sdk.envs.rendering import EpisodeRenderer
from zenostat.agent_sdk.envs.snapshot import Snapshot, checked, from_options, take
from zenostat.agent_sdk.envs.time_features import time_features
from zenostat.agent_sdk.envs.trial_actions import trial_of_actions
from zenostat.agent_sdk.envs.vector_env import check_count
from zenostat.agent_sdk.envs.vector_infos import Infos
from zenostat.agent_sdk.rewards import AnyReward, Reward
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EpisodeChanged, UsageError
from zenostat.topics.messages import WeatherSeries
from zenostat.topics.points import observed_indices
from zenostat.topics.scenario_fields import OtherArguments, expand_arguments
from zenostat.topics.seed_validation import check_seed

Observation = NDArray[np.float32]


class BuildingEnv(ConnectedEnv, gym.Env[Observation, Any]):
    """One building, one agent; `gym.make("zenostat/5zone-hot-continuous-v1")` and all others under `zenostat/`.

    Without `connect` it starts a local node on a private unix socket and ends it on `close()`; with `connect` and
    `node` it controls a node that runs elsewhere and adopts that node's scenario.

    Observation: float32, shape (time fields + observed sensors + observed meters,), in the order of the manifest.
    Action: float32, shape (actions,), within each action's bounds, or an index for each discrete action. An episode of
    N timesteps has N steps; the last one is `truncated`. A violated limit of the scenario (`terminate`) makes the step
    `terminated`, and `info["terminated_by"]` describes it.

    `scenario`, `file` or `config`, or `building` and `weather`, define the simulation; every other argument overrides
    the corresponding setting.

    Args:
        building, weather, node_arguments: The simulation and the settings of a local node, each described in
            `zenostat.topics.scenario_fields` and in the table of docs/environments.md.
        reward: An object of `zenostat.rewards`, a kind, a kind with its parameters, or a function or class of your
            own (`zenostat.rewards.from_function`). None gives 0.0; left out, the scenario's reward.
        connect: Endpoint of a bus.
        keys: For a bus over TLS, the folder of certificates created by `zenostat keys init`, whose certificate
            `trainer` is used, or another certificate of a controller and operator (`FOLDER/NAME.pem`).
        node: The node's name on that bus.
        priority: Priority of this agent's commands, 1 (highest) to 16.
        affinity: See `zenostat.bridge.runtime.affinity`.
        render_mode: With `rgb_array`, `render()` returns a picture of the last day (needs matplotlib); `rerun` opens
            a live view.
        link: Source of samples and destination of commands instead of a node; see `zenostat.testing`.

    Attributes:
        manifest: The node's manifest; the reward of its task is the one that this environment pays.
        reward: The reward; None if there is none.
        wrappers: The wrappers of `zenostat.wrappers` around this environment that have a state.

    Raises:
        UsageError, BusError, SimulatorError: See `zenostat.topics.errors`; everything that was started is closed again.

    Warns:
        UserWarning: Controls in the model conflict with the scenario's actuators, the model has no run period and
            none was chosen, or a plant has no reward.
    """

    metadata = {"render_modes": [*RENDER_MODES], "render_fps": 4}  # noqa: RUF012  # Gymnasium's own form

    @expand_arguments
    def __init__(
        self,
        building: str | Path | None = None,
        weather: str | Path | Sequence[str | Path] | None = None,
        *,
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        connect: str | None = None,
        node: str | None = None,
        priority: int = 10,
        affinity: Affinity | str = Affinity.SEPARATE_CORES,
        render_mode: str | None = None,
        keys: str | Path | None = None,
        link: Link | None = None,
        **node_arguments: Unpack[OtherArguments],
    ) -> None:
        arguments.check_arguments(node_arguments, BuildingEnv)
        settings = {"building": building, "weather": weather, **node_arguments}
        self._connect(
            settings, reward=reward, connect=connect, node=node, priority=priority, affinity=affinity,
            render_mode=render_mode, keys=keys, link=link,
        )  # fmt: skip

    def _connect(
        self, settings: Mapping[str, Any], *, priority: int, render_mode: str | None, **connection_arguments: Any
    ) -> None:
        """Connect to a node, which is started with the settings that are not None; called by the constructor alone."""
        present = {name: value for name, value in settings.items() if value is not None}
        connection = NodeConnection(present, priority=priority, render_mode=render_mode, **connection_arguments)
        with ExitStack() as undo:
            undo.callback(connection.abandon)
            self._open(connection, priority, render_mode)
            undo.pop_all()
        self._connection.warn(stacklevel=4)

    def _open(self, connection: NodeConnection, priority: int, render_mode: str | None) -> None:
        """Create spaces, reward and state from the manifest of the connected node."""
        self._connection = connection
        manifest = self.manifest = connection.manifest
        self.observation_space = spaces.observation_space(manifest)
        self._actions = Actions(manifest)
        self.action_space = self._actions.space
        self.reward = connection.reward
        self._state: EpisodeState[dict[int, float | None]] = EpisodeState.of(manifest, self.reward, {})
        self.wrappers = self._state.wrappers
        self._renderer = EpisodeRenderer(manifest, self.reward) if render_mode == "rgb_array" else None
        self._history = self._renderer.histories[0] if self._renderer is not None else None
        if render_mode == "rerun":
            connection.open_monitor()
        self.render_mode, self._priority = render_mode, priority
        self._timestep = manifest.timestep
        self._time, self._observed_indices = manifest.task.time, observed_indices(manifest)

        self._sample: SampleView | None = None
        self._scheduled: dict[int, Floats] = {}
        self._ended = self._busy = False
        self._pending: tuple[ArrayLike, Floats] | None = None
        self._infos = SampleInfos(has_limits=self._state.limits is not None)

    @property
    def link(self) -> Link:
        """The link to the node; the bus of a local node is connected on first use."""
        link: Link = self._connection.link
        return link

    @one_caller
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; return sample 0, the state after warm-up, and its info.

        The seed determines which weather is drawn, and its noise; without a seed, the sequence of the last seed
        continues. `info["weather"]` names the weather, and `info["engine_start"]` how the engine reached its first
        sample.

        If the node injects faults, observations contain them; reward and limits use the fault-free values, which are
        in `info["fault_free_values"]`.

        `options={"snapshot": snap}` returns to a snapshot instead: to its sample, and to the state of reward and
        limits.

        If the local node has ended, another one is started. After a lost connection the actuators are claimed again.

        Raises:
            InvalidConfig: Unknown option; a snapshot that is closed, of another node, or of a node that has ended; a
                seed that is not an integer from 0 to 2**64 - 1.
            EngineDied, ForkFailed: The snapshot's engine failed; the running episode continues.
            NodeNotFound: A node that runs elsewhere is not on the bus.
            NodeLost: That node was restarted with other points.
            UsageError: Another thread is in `step` or `reset`.

        Warns:
            UserWarning: Another node was started, or the recording has stopped, with the reason.
        """
        seed = None if seed is None else check_seed(seed)
        super().reset(seed=seed)
        self._connection.check_open()
        self._connection.restart_if_ended()
        self._connection.check_recording(stacklevel=3)
        self.manifest = self._connection.manifest
        snapshot, self._pending = from_options(options or {}, self.manifest), None
        if snapshot is None:
            sample = self._sample = self._connection.reset(seed=seed)
            self._state.reset()
            self._state.context = {}
        else:
            sample = self._sample = self._forkable_link().reset(seed=seed, snapshot=snapshot.name)
            self._state.restore(snapshot.env_state)
        self.manifest, self._ended, self._scheduled = self._connection.manifest, False, {}
        (start,) = self.link.accepted.episode_starts
        self._infos.start_episode(start)
        values, now, info = sample.values, sample.time, self._infos.of_sample(sample, self.link)
        info["action"] = np.full(len(self.manifest.actuators), np.nan)
        info |= self._state.unrewarded(sample.fault_free_values, now)
        if self._history is not None:
            self._history.start(now, values, info["effective"], info.get("reward_terms", {}))
        return self._observed(values, now - self._timestep if sample.step else now, now), info

    def snapshot(self) -> Snapshot:
        """Take a snapshot of the episode, to return to with `reset(options={"snapshot": snap})` any number of times.

        Raises:
            EpisodeChanged: No episode is running.
            RequestRejected: The node has its maximum of snapshots and branches, or this is a branch.
            ForkFailed: The system has no memory for a fork; the episode continues.
        """
        return take(self._forkable_link(), self._running_sample(), self._state)

    @overload
    def branch(
        self, *, snapshot: Snapshot | None = None, relinquished: bool = False, forecast_error: Sequence[float] = ()
    ) -> BuildingEnv: ...

    @overload
    def branch(
        self, *, slots: int, snapshot: Snapshot | None = None, relinquished: bool = False,
        forecast_error: Sequence[float] = (),
    ) -> BranchVectorEnv: ...  # fmt: skip

    def branch(
        self, *, slots: int | None = None, snapshot: Snapshot | None = None, relinquished: bool = False,
        forecast_error: Sequence[float] = (),
    ) -> BuildingEnv | BranchVectorEnv:  # fmt: skip
        """Create an environment that continues from the current sample independently of this one.

        The branch is a node of its own on the bus and ends with `close()`, or with this environment. It has a single
        episode, cannot be reset, and has no pictures: its `render` returns None.
        `with env.unwrapped.branch() as b: b.step(action)`.

        Args:
            slots: Number of copies, 1 to 256, which step together as a vector environment with `plan`; None: one copy,
                as a single environment.
            snapshot: Continue from this snapshot instead.
            relinquished: Drop all commands so far; the baseline control is in effect until a step commands.
            forecast_error: Added to the outdoor temperature in the branch's timesteps, K, -50 to 50; the last one
                stays. The other weather is that of the episode.

        Raises:
            EpisodeChanged, RequestRejected, ForkFailed: As for `snapshot`.
            InvalidConfig: Not a snapshot of this environment, or a number of slots or an error out of range.
        """
        link = self._forkable_link()
        snapshot = None if snapshot is None else checked(snapshot, self.manifest, "snapshot")
        sample = self._running_sample() if snapshot is None else snapshot.sample
        name = snapshot.name if snapshot is not None else ""
        request = branch_request(link.name, name, slots, forecast_error, relinquished=relinquished)
        start = self._infos.episode_start
        with ExitStack() as undo:
            branch_link = open_branch(link, request, self._priority, undo)
            state = self._state.capture() if snapshot is None else snapshot.env_state
            reward = copy.deepcopy(self.reward)  # a reward of the user's may have a state
            if slots is not None:
                return BranchVectorEnv(branch_link, reward, sample, state, start, undo, self._scheduled)
            return self._continue_at(branch_link, sample, reward, state, start, undo)

    def plan(
        self, actions: ArrayLike, *, snapshot: Snapshot | None = None, forecast_error: Sequence[float] = ()
    ) -> Floats:
        """Simulate sequences of actions in branches, and return the rewards, shape (sequences, timesteps).

        Args:
            actions: Elements of the action space, shape (sequences, timesteps, *action shape), 1 to 256 sequences. A
                sequence ends with its episode: further rewards are 0.
            snapshot: As for `branch`.
            forecast_error: As for `branch`.

        Raises:
            InvalidAction: Wrong shape, or an action that `step` would reject.
            EpisodeChanged, RequestRejected, ForkFailed, SimulatorError: As for `branch` and `step`.
        """
        count = check_count(len(np.atleast_1d(as_array(actions, None))), "sequences")
        with self.branch(slots=count, snapshot=snapshot, forecast_error=forecast_error) as branches:
            return branches.plan(actions)

    def try_step(self, actions: ArrayLike) -> list[SampleView]:
        """Return the sample that would follow each of several alternative actions; the episode stays where it is.

        `step` with the same action gives the same sample, to the bit.

        Args:
            actions: 1 to 256 elements of the action space, shape (alternatives, *action shape).

        Raises:
            InvalidAction: Wrong shape, or an action that `step` would reject; nothing was simulated.
            SimulatorError: A copy of the building failed, under one of the actions; the episode can continue.
            EpisodeChanged, RequestRejected, ForkFailed: As for `branch`.
        """
        alternatives = as_array(actions, None)
        return [sample for (sample,) in self.try_steps(alternatives[:, None] if alternatives.ndim else alternatives)]

    def try_steps(self, actions: ArrayLike) -> list[list[SampleView]]:
        """Return the samples that would follow each of several sequences of actions; see `try_step`.

        Args:
            actions: Shape (alternatives, timesteps, *action shape); at most 2,000 timesteps in all.

        Returns:
            Of each alternative, a sample for each timestep, at most until the end of the run period.
        """
        link, sample = self._forkable_link(), self._running_sample()
        pending, programs = self._state.context, self._state.context_programs()

        def context_at(timestep: int) -> dict[int, float | None]:
            context = {} if timestep else dict(pending)
            for program in programs:
                context |= self._actions.context(program(sample.time + timestep * self._timestep))
            return context

        return link.trial(trial_of_actions(self._actions, actions, sample, context_at))

    @classmethod
    def _continue_at(
        cls, link: ControllerLink, sample: SampleView, reward: Reward | None, state: Mapping[str, Any], start: Infos,
        undo: ExitStack,
    ) -> BuildingEnv:  # fmt: skip
        """Create an environment in the middle of an episode that began with `start`; it takes over `undo`."""
        env = BuildingEnv(link=link, reward=reward)
        env._sample = link.set_current(sample.message)
        env._infos.episode_start = start
        env._state.restore(state)
        env._state.programs = copy.deepcopy(state["programs"])
        env._connection.push_exit(undo.pop_all())
        return env

    def _running_sample(self) -> SampleView:
        if self._sample is None or self._ended:
            raise EpisodeChanged("no episode is running; call reset() first")
        return self._sample

    @one_caller
    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate one timestep under `action`.

        `info` has `time` and `step` of the sample; for each actuator its commanded value (`action`), its effective
        value (`effective`, NaN where the plant does not report it) and its value source (`value_source`: "agent" is
        this environment, "" the baseline control); `reward_terms`, whose sum is the reward, and `reward_metrics`; the
        node's counts of `late` and `rejected` messages; and at the episode's end `output_dir`, the folder of
        EnergyPlus's output files, if they are kept.

        Raises:
            InvalidAction: Wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, RequestRejected, EpisodeChanged: See `ControllerLink.receive`.
            EpisodeChanged: Also after a step that Ctrl-C interrupted, since the node has simulated its timestep; a
                reset starts anew.
            UsageError: Another thread is in `step` or `reset`.
        """
        self.step_async(action)
        return self.step_wait()

    def step_async(self, action: ArrayLike) -> None:
        """Send the command of one timestep; `step_wait` waits for its sample, and others can be sent in between.

        Raises:
            InvalidAction, EpisodeChanged: As for `step`; nothing was sent.
            UsageError: The previous timestep still waits for `step_wait`.
        """
        previous = self._sample
        if previous is None or self._ended or self._connection.closed:
            self._connection.check_open()
            raise EpisodeChanged("the episode is over; call reset()" if previous else NOT_STARTED)
        if self._pending is not None:
            raise UsageError("step_async() was called already; call step_wait() next")
        if self._state.programs:
            self._state.apply_programs(previous.time, self.set_context)
        values, operations = self._actions.command(action, previous.fault_free_values, self._state.context)
        self.link.send(values, operations)
        self._pending = action, self._actions.commanded(values, operations)

    def step_wait(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Wait for the sample of the timestep that `step_async` began; return and raise what `step` does."""
        if self._pending is None:
            raise UsageError("no timestep was begun; call step_async() before step_wait()")
        (action, commanded), self._pending = self._pending, None
        link = self.link
        sample = self._sample = link.receive()
        infos, state, reward, violation = self._infos, self._state, 0.0, ""
        values, end, info = sample.values, sample.time, infos.of_sample(sample, link)
        begin = end - self._timestep
        fault_free = sample.fault_free_values if sample.message.fault_free_values else values
        info["action"] = commanded
        if state.reward is not None:
            total, info["reward_terms"], info["reward_metrics"] = state.reward(fault_free, begin)
            reward = float(total)
        if state.limits is not None:
            violation = state.limits.violated(fault_free)
            info["terminated_by"] = violation
        truncated = sample.truncated
        self._ended = truncated or bool(violation)
        if self._ended and infos.output_dir:
            info["output_dir"] = infos.output_dir
        if self._history is not None:
            self._history.add(end, values, info["effective"], action, reward, info.get("reward_terms", {}))
        return self._observed(values, begin, end), reward, bool(violation), truncated, info

    def render(self) -> Any:
        """Return a picture of the last day with `rgb_array`, shape (640, 960, 3), uint8; None with `rerun`.

        It shows what the agent observes: with injected faults, the faulty values.

        Raises `EpisodeChanged` before the first reset.
        """
        return self._renderer.picture() if self._renderer is not None else None

    @property
    def sample(self) -> SampleView:
        """The latest sample; `EpisodeChanged` before the first reset."""
        if self._sample is None:
            raise EpisodeChanged("call reset() first")
        return self._sample

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Set actuators that belong to no action, from the next step until the next call; None relinquishes one.

        A reset clears it.

        Raises:
            InvalidAction: Unknown actuator, one that an action sets, or a value out of bounds.
            EpisodeChanged: Before the first reset.
        """
        require_episode(self._sample)
        self._state.context |= self._actions.context(values)

    def renew_reward(self) -> None:
        """Let the reward forget what it has kept of earlier episodes, such as the maxima of `normalized`."""
        if self.reward is not None:
            self._state.reward = self.reward.bind(self.manifest)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of this episode's weather file, noise included; `UnknownName` lists the columns."""
        return self.link.weather(columns)

    def _observed(self, values: Floats, begin: datetime, end: datetime) -> Observation:
        if self._observed_indices is not None:
            values = values[self._observed_indices]
        if not self._time:
            return values.astype(np.float32)
        return np.concatenate([time_features(self._time, begin, end), values], dtype=np.float32, casting="same_kind")

    def close(self) -> None:
        """Disconnect from the node, and end it if it is local; idempotent."""
        self._connection.close()
