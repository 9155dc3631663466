"""Several engines of one node as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Unpack, cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from zenostat.agent_sdk.envs import arguments, spaces
from zenostat.agent_sdk.envs.action_values import Actions
from zenostat.agent_sdk.envs.connection import (
    NOT_STARTED,
    RENDER_MODES,
    ConnectedEnv,
    NodeConnection,
    VectorLink,
    one_caller,
)
from zenostat.agent_sdk.envs.episode_state import EpisodeState, require_episode
from zenostat.agent_sdk.envs.infos import VectorSampleInfos
from zenostat.agent_sdk.envs.rendering import EpisodeRenderer
from zenostat.agent_sdk.envs.slot_access import Seeds, Slot, SlotAccess, seeds_of, slots_of
from zenostat.agent_sdk.envs.snapshot import Snapshot, from_options, take
from zenostat.agent_sdk.envs.vector_infos import Infos, masked, merge, select
from zenostat.agent_sdk.envs.vector_sample import VectorSample
from zenostat.agent_sdk.rewards import AnyReward
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EpisodeChanged, InvalidConfig, did_you_mean
from zenostat.topics.messages import WeatherSeries
from zenostat.topics.points import observed_indices
from zenostat.topics.scenario_fields import NodeArguments, expand_arguments

Observations = NDArray[np.float32]
Flags = NDArray[np.bool_]
StepResult = tuple[Observations, Floats, Flags, Flags, Infos]

MAX_SLOTS = 256


class BuildingVectorEnv(SlotAccess, ConnectedEnv, VectorEnv[Observations, Any, NDArray[Any]]):
    """One node with an engine for each environment; `gym.make_vec("zenostat/5zone-hot-continuous-v1", num_envs=8)`.

    All engines simulate their timestep at the same time; a step is one command to the node and one sample back. Slot i
    gives the same results as a single environment with its seed: an int seeds slot i with `seed + i`, a list each slot
    with its own seed.

    Args:
        num_envs: Number of slots, 1 to 256. A node on a bus must have as many slots.
        autoreset_mode: With `NextStep`, a slot whose episode has ended starts a new one at the next step, whose action
            it ignores; with `SameStep` at once, with the last observation and info in `final_obs` and `final_info`;
            with `Disabled` only by `reset(options={"reset_mask": …})`.
        reward, connect, node, priority, affinity, render_mode, keys, link: See `BuildingEnv`. A reward of your own
            gets an array for each point and a list of times, with an entry for each slot.
        node_arguments: The simulation, as for `BuildingEnv`.

    Attributes:
        manifest: The node's manifest; the reward of its task is the one that this environment pays.
        reward: The reward; None if there is none.
        wrappers: The wrappers of `zenostat.wrappers` around this environment that have a state.
        envs: The slots, as `Slot` objects.

    Raises:
        UsageError, BusError, SimulatorError: See `zenostat.topics.errors`; everything that was started is closed again.

    Warns:
        UserWarning: Controls in the model conflict with the scenario's actuators, the model has no run period and
            none was chosen, or a plant has no reward.
    """

    closed = True  # until construction ends, because Gymnasium before 1.4 closes an environment when it is deleted

    @expand_arguments
    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        connect: str | None = None,
        node: str | None = None,
        priority: int = 10,
        affinity: Affinity | str = Affinity.SEPARATE_CORES,
        render_mode: str | None = None,
        keys: str | Path | None = None,
        link: VectorLink | None = None,
        **node_arguments: Unpack[NodeArguments],
    ) -> None:
        self.num_envs, self.autoreset_mode = check_count(num_envs), check_mode(autoreset_mode)
        num_envs = self.num_envs
        arguments.check_arguments(node_arguments, BuildingVectorEnv)
        self._connection = NodeConnection(
            {name: value for name, value in node_arguments.items() if value is not None},
            reward=reward, connect=connect, node=node, priority=priority, affinity=affinity, render_mode=render_mode,
            keys=keys, link=link, slots=self.num_envs,
        )  # fmt: skip
        with ExitStack() as undo:
            undo.callback(self._connection.abandon)
            manifest = self.manifest = self._connection.manifest
            self._actions = Actions(manifest)
            self.single_action_space = self._actions.space
            self.single_observation_space = spaces.observation_space(manifest)
            self.action_space = batch_space(self.single_action_space, num_envs)
            self.observation_space = batch_space(self.single_observation_space, num_envs)
            self.reward = self._connection.reward
            self._state: EpisodeState[list[dict[int, float | None]]] = EpisodeState.of(
                manifest, self.reward, [{} for _ in range(num_envs)], num_envs
            )
            self.wrappers = self._state.wrappers
            self._renderer = EpisodeRenderer(manifest, self.reward, num_envs) if render_mode == "rgb_array" else None
            if render_mode == "rerun":
                self._connection.open_monitor()
            undo.pop_all()
        self.render_mode = render_mode
        self.metadata = {"render_modes": [*RENDER_MODES], "render_fps": 4, "autoreset_mode": self.autoreset_mode}
        self.envs = tuple(Slot(self, number) for number in range(num_envs))
        self._timestep, self._observed_indices = manifest.timestep, observed_indices(manifest)
        self._sample: VectorSample | None = None
        self._busy = False
        self._observations = np.zeros(self.observation_space.shape or (), np.float32)
        self._done, self._all_slots = np.zeros(num_envs, np.bool_), np.ones(num_envs, np.bool_)
        self._infos = VectorSampleInfos(num_envs, has_limits=self._state.limits is not None)
        self.closed = False
        self._connection.warn(stacklevel=3)

    # Episodes

    @one_caller
    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start an episode in each slot, or in those of `options={"reset_mask": …}`, a bool array of shape (slots,).

        Seeds and infos are those of `BuildingEnv.reset`. The observations of the other slots are their latest ones.

        `options={"snapshot": snap}` returns to a `snapshot()` instead, in all slots.

        Raises:
            InvalidConfig: Unknown option, invalid mask or seeds; a snapshot that is closed, of another node, or of a
                node that has ended.
            EngineDied, ForkFailed: An engine of the snapshot failed; the running episodes continue.
            NodeNotFound, NodeLost, UsageError: As for `BuildingEnv.reset`.

        Warns:
            UserWarning: The local node had ended and another one was started, or the recording has stopped, with the
                reason.
        """
        options = options or {}
        self._connection.check_open()
        if self._connection.restart_if_ended():
            self.manifest, self._sample = self._connection.manifest, None
        self._connection.check_recording(stacklevel=3)
        snapshot = from_options(options, self.manifest, ["reset_mask"])
        if snapshot is not None and "reset_mask" in options:
            raise InvalidConfig("a snapshot contains all slots; leave out reset_mask")
        slots = slots_of(options, self.num_envs)
        seeds = seeds_of(seed, slots, self.num_envs)
        if self._sample is None and len(slots) < self.num_envs:
            raise EpisodeChanged("call reset() for all slots first")
        if isinstance(seed, int):
            super().reset(seed=seed)
        infos = self._start_episodes(slots, seeds, snapshot)
        return self._observations.copy(), infos

    def _start_episodes(
        self, slots: list[int], seeds: list[int | None] | None = None, snapshot: Snapshot | None = None
    ) -> Infos:
        """Start new episodes in these slots, or return to a snapshot; update the observations and return the infos."""
        is_all = len(slots) == self.num_envs
        if snapshot is None:  # if returning to a snapshot fails, the running episodes continue
            self._sample = None
        seed = seeds[0] if seeds and self.num_envs == 1 else seeds
        link = self.link
        name = snapshot.name if snapshot is not None else ""
        sample = VectorSample(link.reset(seed=seed, slots=None if is_all else slots, snapshot=name))
        self.manifest = self._connection.adopt(link.manifest)
        self._state.reset(None if is_all else slots)
        ends, steps = sample.times, sample.message.step
        begins = [end - self._timestep if step else end for end, step in zip(ends, steps, strict=True)]
        self._observations[slots] = sample.observed(begins, ends, self._observed_indices)[slots]
        for slot in slots:
            self._done[slot], self._state.context[slot] = False, {}
        if snapshot is not None:
            self._state.restore(snapshot.env_state)
        self._sample = sample
        chosen = self._infos.start_episodes(slots, link.accepted.episode_starts, self._add_info)
        entries = self._infos.of_sample(sample, link)
        entries["action"] = np.full((self.num_envs, len(self.manifest.actuators)), np.nan)
        entries |= self._state.unrewarded(sample.fault_free_values, ends)
        if self._renderer is not None:
            self._renderer.start(slots, ends, sample.values, entries)
        return select(masked(entries, self._all_slots) | self._infos.episode_start, chosen)

    def snapshot(self) -> Snapshot:
        """Take a snapshot of all slots, to return to with `reset(options={"snapshot": snap})` any number of times.

        Raises:
            EpisodeChanged: A slot's episode has ended, or none has started.
            RequestRejected: The node has its maximum of snapshots and branches.
            ForkFailed: The system has no memory for a fork; the episodes continue.
        """
        link = self._forkable_link()
        if self._sample is None or self._done.any():
            raise EpisodeChanged("call reset() first: each slot must be in an episode")
        return take(link, self._sample.sample, self._state)

    def slot_sample(self, slot: int) -> SampleView:
        """Return the latest sample of a slot; its episode's first one where it has just reset itself.

        Raises:
            EpisodeChanged: No episode has started.
        """
        if self._sample is None:
            raise EpisodeChanged("call reset() first")
        return self._sample.sample.of_slot(slot)

    # Timesteps

    @one_caller
    def step(self, actions: ArrayLike) -> StepResult:
        """Simulate one timestep of each slot; with `NextStep`, slots whose episode has ended start a new one instead.

        Infos are those of `BuildingEnv.step`, in Gymnasium's form for vectors.

        Raises:
            InvalidAction: Wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, RequestRejected, EpisodeChanged: See `ControllerLink.receive`.
            UsageError: Another thread is in `step` or `reset`.
        """
        restarting = self._restarting_slots()
        commanded, operations = self._command(actions, restarting)
        ended = self._sample
        start_infos = self._start_episodes(restarting) if restarting else {}
        if len(restarting) == self.num_envs:
            none = np.zeros(self.num_envs, np.bool_)
            return self._observations.copy(), np.zeros(self.num_envs), none, none.copy(), start_infos
        link = self.link
        link.send(commanded if self.num_envs > 1 else commanded[0], operations, still=restarting)
        sample = self._sample = VectorSample(link.receive())
        entries = self._infos.of_sample(sample, link)
        entries["action"] = self._actions.commanded(commanded, operations)
        rewards, terminated, truncated, infos = self._outcome(sample, entries, restarting, ended)
        if self._renderer is not None:
            advanced = [slot for slot in range(self.num_envs) if slot not in restarting]
            self._renderer.add(advanced, sample.times, sample.values, entries, actions, rewards)
        done = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if done.any():
                infos = self._restart(done, infos)
        else:
            self._done = done
            infos = merge(infos, start_infos) if start_infos else infos
        return self._observations.copy(), rewards, terminated, truncated, infos

    def _restarting_slots(self) -> list[int]:
        """Return the slots that start a new episode in this step."""
        if self._sample is None or self.closed:
            self._connection.check_open()
            raise EpisodeChanged(NOT_STARTED)
        done: list[int] = np.flatnonzero(self._done).tolist() if self._done.any() else []
        check_restart(self.autoreset_mode, done)
        return done

    def _outcome(
        self, sample: VectorSample, entries: Infos, restarted: list[int], ended: VectorSample | None
    ) -> tuple[Floats, Flags, Flags, Infos]:
        """Update the observations; return rewards, terminated, truncated and infos of the slots that have advanced.

        `ended` has the last samples of the episodes before those that have `restarted`.
        """
        count, ends = self.num_envs, sample.times
        if ends.count(ends[0]) == count:
            begins = [ends[0] - self._timestep] * count
        else:
            begins = [end - self._timestep for end in ends]
        rewards = np.zeros(count)
        state, values = self._state, sample.fault_free_values
        if state.reward is not None:
            # A reward that keeps maxima for all episodes has seen the last sample; a first one is never rewarded.
            values_of, begins_of = values, begins
            if restarted and ended is not None:
                values_of, begins_of = values.copy(), list(begins)
                values_of[restarted] = ended.fault_free_values[restarted]
                for slot in restarted:
                    begins_of[slot] = ended.times[slot] - self._timestep
            rewards[:], entries["reward_terms"], entries["reward_metrics"] = state.reward(values_of, begins_of)
        violations = state.limits.violated_slots(values) if state.limits is not None else {}
        observations, live = sample.observed(begins, ends, self._observed_indices), self._all_slots.copy()
        terminated, truncated = np.zeros(count, np.bool_), sample.truncated
        self._infos.add_ends(entries, violations, truncated)
        infos = masked(entries, live) | select(self._infos.episode_start, self._all_slots)
        if restarted:
            self._state.reset(restarted)  # these slots are still at sample 0
            live[restarted], observations[restarted] = False, self._observations[restarted]
            rewards[restarted] = 0.0
            infos = select(infos, live.copy())
        self._observations = observations
        if violations:
            terminated[[slot for slot in violations if live[slot]]] = True
        return rewards, terminated, truncated, infos

    def _restart(self, done: Flags, infos: Infos) -> Infos:
        """Start new episodes in slots that have ended; return infos that include their final ones."""
        last = np.full(self.num_envs, None, object)
        slots = np.flatnonzero(done).tolist()
        for slot in slots:
            last[slot] = self._observations[slot].copy()
        final, infos = select(infos, done), select(infos, ~done)
        infos = merge(infos, self._start_episodes(slots))
        return infos | {"final_obs": last, "_final_obs": done, "final_info": final, "_final_info": done.copy()}

    # Commands

    def _command(self, actions: ArrayLike, unread: Sequence[int]) -> tuple[Floats, bytes | None]:
        assert self._sample is not None
        values = self._actions.rows(actions, self.num_envs, unread)
        return values, self._actions.complete(values, self._sample.fault_free_values, self._state.context)

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Set actuators that belong to no action in all slots; see `BuildingEnv.set_context`.

        `envs[i].set_context` does it in slot i.
        """
        for slot in range(self.num_envs):
            self.set_slot_context(slot, values)

    def set_slot_context(self, slot: int, values: Mapping[str, float | None]) -> None:
        """Set actuators that belong to no action in one slot; see `BuildingEnv.set_context`."""
        require_episode(self._sample)
        self._state.context[slot] |= self._actions.context(values)

    # Access to slots

    @property
    def link(self) -> VectorLink:
        """The link to the node; the bus of a local node is connected on first use."""
        return cast("VectorLink", self._connection.link)

    def slot_weather(self, slot: int, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of the weather file of a slot's episode; see `BuildingEnv.weather`."""
        return self.link.weather(columns, slot) if slot else self.link.weather(columns)

    def render(self) -> tuple[Any, ...]:
        """Return the result of `BuildingEnv.render` for each slot."""
        return tuple(map(self.render_slot, range(self.num_envs)))

    def render_slot(self, slot: int) -> Any:
        """Return the result of `BuildingEnv.render` for one slot."""
        return self._renderer.picture(slot) if self._renderer is not None else None

    def close_extras(self, **_: Any) -> None:
        """Disconnect from the node, and end it if it is local."""
        self._connection.close()


def check_count(count: int, name: str = "num_envs") -> int:
    """Return a number of slots that is valid; `InvalidConfig` for any other."""
    if not isinstance(count, int | np.integer) or not 1 <= count <= MAX_SLOTS:
        raise InvalidConfig(f"{name} = {count!r}; a whole number from 1 to {MAX_SLOTS} expected")
    return int(count)


def check_restart(mode: AutoresetMode, ended: Sequence[int]) -> None:
    """Raise `EpisodeChanged` if the episode is over in slots that a step does not reset."""
    if ended and mode is AutoresetMode.DISABLED:
        raise EpisodeChanged(
            f"the episode is over in slots {', '.join(map(str, ended))}; call reset(options={{'reset_mask': …}})"
        )


def check_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return an autoreset mode; `InvalidConfig` lists the modes."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = did_you_mean(str(mode).replace("_", ""), [mode.value for mode in AutoresetMode])
        raise InvalidConfig(f"autoreset_mode {mode!r}; {known}") from None
