"""Several engines of one node as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from agent_sdk.bus.local_node import LocalNode
from agent_sdk.bus.snapshot import Snapshot, asked_for, forking, take
from agent_sdk.envs import arguments, spaces
from agent_sdk.envs.actions import Actions
from agent_sdk.envs.connection import AGENT, BUSY, RENDER_MODES, NodeConnection
from agent_sdk.envs.episode_state import EpisodeState
from agent_sdk.envs.rendering import RollingHistory
from agent_sdk.envs.space_names import SpaceNames
from agent_sdk.envs.termination import TerminationLimits
from agent_sdk.envs.vector_infos import Infos, masked, merge, select
from agent_sdk.envs.vector_sample import VectorLink, VectorSample, timestep
from agent_sdk.envs.vector_slot import Seeds, Slot, seeds_of, slots_of
from agent_sdk.rewards import AnyReward
from agent_sdk.wrappers import apply_wrappers
from bridge.runtime.affinity import Affinity
from topics.errors import BusError, EpisodeChanged, InvalidConfig, UsageError
from topics.messages import CommandOp, WeatherSeries

Observations = NDArray[np.float32]
Flags = NDArray[np.bool_]
Stepped = tuple[Observations, NDArray[np.float64], Flags, Flags, Infos]

MOST = 256
"""Slots of a node."""


class BuildingVectorEnv(SpaceNames, VectorEnv[Observations, Any, NDArray[Any]]):
    """One node with an engine for each environment; `gym.make_vec("zenostat/5zone-hot-continuous-v1", num_envs=8)`.

    All engines simulate their timestep at the same time, and a step is one frame there and one back. Slot i is what
    a single environment with its seed gives: an int seeds slot i with `seed + i`, a list each with its own.

    Args:
        num_envs: how many, 1 to 256. A node on a bus must have as many slots.
        autoreset_mode: `NextStep`: a slot whose episode has ended begins anew at the next step, whose action it does
            not read; `SameStep`: at once, the end's observation and info standing in `final_obs` and `final_info`;
            `Disabled`: only by `reset(options={"reset_mask": …})`.
        reward, connect, node, priority, affinity, render_mode, link: see `BuildingEnv`. A reward of your own gets an
            array for each point and a list of times, with an entry a slot.
        given: what is simulated, as `BuildingEnv` takes it.

    Raises:
        UsageError, BusError, SimulatorError: see `topics.errors`; nothing is left behind.

    Warns:
        UserWarning: something in the model works against the scenario's actuators.
    """

    closed = True  # until it is built: Gymnasium before 1.4 closes whatever it deletes

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
        **given: Any,
    ) -> None:
        self.num_envs, self.autoreset_mode = _count(num_envs), _mode(autoreset_mode)
        self._hold = NodeConnection(
            {name: value for name, value in _known(given).items() if value is not None},
            reward=reward, connect=connect, node=node, priority=priority, affinity=affinity, render_mode=render_mode,
            keys=keys, link=link, slots=self.num_envs,
        )  # fmt: skip
        with ExitStack() as undo:
            undo.callback(self._hold.abandon)
            manifest = self.manifest = self._hold.manifest
            self._actions = Actions(manifest)
            self.single_action_space = self._actions.space
            self.single_observation_space = spaces.observation_space(manifest)
            self.action_space = batch_space(self.single_action_space, num_envs)
            self.observation_space = batch_space(self.single_observation_space, num_envs)
            self.reward = self._hold.reward
            self._memory: EpisodeState[list[dict[int, float | None]]] = EpisodeState(
                self.reward.bind(manifest) if self.reward is not None else None,
                TerminationLimits(manifest, num_envs) if manifest.task.terminate else None,
                [{} for _ in range(num_envs)],
            )
            self.wrappers = self._memory.wrappers
            self._histories = [RollingHistory(manifest) for _ in range(num_envs)] if render_mode == "rgb_array" else []
            if render_mode == "rerun":
                self._hold.open_monitor()
            undo.pop_all()
        self.render_mode = render_mode
        self.metadata = {"render_modes": [*RENDER_MODES], "render_fps": 4, "autoreset_mode": self.autoreset_mode}
        self.envs = tuple(Slot(self, number) for number in range(num_envs))
        self._timestep = timestep(manifest)
        self._operations = None if self._actions.operations is None else self._actions.operations * num_envs
        self._frame: VectorSample | None = None
        self._busy = False
        self._seen = np.zeros(self.observation_space.shape or (), np.float32)
        self._over, self._every = np.zeros(num_envs, np.bool_), np.ones(num_envs, np.bool_)
        self._begun: Infos = {}
        self._output_dir = [""] * num_envs
        self._sources: tuple[bytes, list[str]] = (b"", [])
        self._value_source: NDArray[np.object_] = np.empty(num_envs, object)
        self.closed = False
        self._hold.warn(stacklevel=3)

    # Episodes

    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Starts an episode in each slot, or in those of `options={"reset_mask": …}`, a bool array of shape (slots,).

        Seeds and infos are those of `BuildingEnv.reset`. The observations of the other slots are their latest.

        `options={"snapshot": snap}` goes back to a `snapshot()` instead, in all slots.

        Raises:
            InvalidConfig: other options, no such mask, no such seeds; a snapshot that is closed, of another node, or of
                a node that has ended.
            EngineDied, ForkFailed: an engine of the snapshot; the running episodes go on.
            NodeNotFound, NodeLost, UsageError: as of `BuildingEnv.reset`.

        Warns:
            UserWarning: the environment's own node had ended, and another one was started; why it had.
        """
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(BUSY)
        try:
            return self._reset(seed, options or {})
        except (EpisodeChanged, BusError):
            self._hold.check_open()
            raise
        finally:
            self._busy = False

    def _reset(self, seed: Seeds, options: dict[str, Any]) -> tuple[Observations, Infos]:
        self._hold.check_open()
        if self._hold.renew():
            self.manifest, self._frame = self._hold.manifest, None
        snapshot = asked_for(options, self.manifest, ["reset_mask"])
        if snapshot is not None and "reset_mask" in options:
            raise InvalidConfig("a snapshot is of all slots; leave out reset_mask")
        slots = slots_of(options, self.num_envs)
        seeds = seeds_of(seed, slots, self.num_envs)
        if self._frame is None and len(slots) < self.num_envs:
            raise EpisodeChanged("call reset() for all slots first")
        if isinstance(seed, int):
            super().reset(seed=seed)
        infos = self._begin(slots, seeds, snapshot)
        return self._seen.copy(), infos

    def _begin(
        self, slots: list[int], seeds: list[int | None] | None = None, snapshot: Snapshot | None = None
    ) -> Infos:
        """New episodes in these slots, or going back; their infos. The observations go to `_seen`."""
        whole = len(slots) == self.num_envs
        if snapshot is None:  # where a node cannot go back, its episodes go on
            self._frame = None
        first = seeds[0] if seeds and self.num_envs == 1 else seeds
        link = self.link
        to = snapshot.name if snapshot is not None else ""
        frame = VectorSample(link.reset(seed=first, slots=None if whole else slots, snapshot=to))
        self.manifest = link.manifest
        self._memory.reset(None if whole else slots)
        times = frame.times
        begins = [time - self._timestep if step else time for time, step in zip(times, frame.message.step, strict=True)]
        self._seen[slots] = frame.observed(begins, times)[slots]
        for slot in slots:
            self._over[slot], self._memory.context[slot] = False, {}
            if self._histories:
                self._histories[slot].clear()
                self._histories[slot].add(times[slot], frame.values[slot])
        if snapshot is not None:
            self._memory.restore(snapshot.env_state)
        self._frame = frame
        begun: Infos = {}
        for slot, how in zip(slots, link.accepted.episode_starts, strict=True):
            self._output_dir[slot] = how.output_dir
            told = {"weather": how.weather, "weather_noise": how.noise_parameters, "engine_start": how.engine_start}
            begun = self._add_info(begun, told, slot)
        these = np.zeros(self.num_envs, np.bool_)
        these[slots] = True
        self._begun = merge(select(self._begun, ~these), begun)
        blank = {"action": np.full((self.num_envs, len(self.manifest.actuators)), np.nan)}
        told = self._of_sample(frame) | blank | self._memory.unrewarded(frame.fault_free_values, times)
        return select(masked(told, self._every) | self._begun, these)

    def snapshot(self) -> Snapshot:
        """Keeps where all slots stand, to go back there by `reset(options={"snapshot": snap})` any number of times.

        Raises:
            EpisodeChanged: an episode is over, or none has begun.
            RequestRejected: there are as many snapshots and branches as the node allows.
            ForkFailed: the system has no memory for a fork; the episodes go on.
        """
        self._hold.check_open()
        link = forking(self.link)
        if self._frame is None or self._over.any():
            raise EpisodeChanged("call reset() first: each slot must be in an episode")
        return take(link, self._frame.sample, self._memory)

    # Timesteps

    def step(self, actions: ArrayLike) -> Stepped:
        """Simulates one timestep of each slot; in mode `NextStep` those that have ended begin anew instead.

        Infos are those of `BuildingEnv.step`, in Gymnasium's form for vectors.

        Raises:
            InvalidAction: wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, RequestRejected, EpisodeChanged: see `ControllerLink.receive`.
            UsageError: another thread is in `step` or `reset`.
        """
        busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
        if busy:
            raise UsageError(BUSY)
        try:
            return self._step(actions)
        except (EpisodeChanged, BusError):
            self._hold.check_open()
            raise
        finally:
            self._busy = False

    def _step(self, actions: ArrayLike) -> Stepped:
        again = self._ready()
        commanded, operations = self._command(actions, again)
        begun = self._begin(again) if again else {}
        if len(again) == self.num_envs:
            none = np.zeros(self.num_envs, np.bool_)
            return self._seen.copy(), np.zeros(self.num_envs), none, none.copy(), begun
        link = self.link
        link.send(commanded if self.num_envs > 1 else commanded[0], operations, still=again)
        frame = self._frame = VectorSample(link.receive())
        rewards, terminated, truncated, infos = self._outcome(frame, commanded, operations, again)
        ended = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if ended.any():
                infos = self._end(ended, infos)
        else:
            self._over = ended
            infos = merge(infos, begun) if begun else infos
        return self._seen.copy(), rewards, terminated, truncated, infos

    def _ready(self) -> list[int]:
        """The slots that begin anew with this step."""
        if self._frame is None or self.closed:
            self._hold.check_open()
            raise EpisodeChanged("call reset() before step()")
        again: list[int] = np.flatnonzero(self._over).tolist() if self._over.any() else []
        if again and self.autoreset_mode is AutoresetMode.DISABLED:
            raise EpisodeChanged(
                f"the episode is over in slots {', '.join(map(str, again))}; call reset(options={{'reset_mask': …}})"
            )
        return again

    def _outcome(
        self, frame: VectorSample, commanded: NDArray[np.float64], operations: bytes | None, again: list[int]
    ) -> tuple[NDArray[np.float64], Flags, Flags, Infos]:
        """Rewards, terminated, truncated and infos of the slots that have gone on; observations go to `_seen`."""
        count, ends = self.num_envs, frame.times
        if ends.count(ends[0]) == count:
            begins = [ends[0] - self._timestep] * count
        else:
            begins = [end - self._timestep for end in ends]
        told = self._of_sample(frame)
        told["action"] = self._actions.commanded(commanded, operations)
        rewards = np.zeros(count)
        memory = self._memory
        if memory.reward is not None:
            rewards[:], told["reward_terms"], told["reward_metrics"] = memory.reward(frame.fault_free_values, begins)
        broken = memory.limits.violated_slots(frame.fault_free_values) if memory.limits is not None else {}
        observed, live = frame.observed(begins, ends), self._every.copy()
        terminated, truncated = np.zeros(count, np.bool_), frame.truncated
        self._tell_ends(told, broken, truncated)
        infos = masked(told, live) | select(self._begun, self._every)
        if again:
            self._memory.reset(again)  # they are at sample 0 in this frame, and have gone nowhere
            live[again], observed[again] = False, self._seen[again]
            rewards[again] = 0.0
            infos = select(infos, live.copy())
        self._seen = observed
        for slot, history in enumerate(self._histories):
            if live[slot]:
                history.add(ends[slot], frame.values[slot])
        if broken:
            terminated[[slot for slot in broken if live[slot]]] = True
        return rewards, terminated, truncated, infos

    def _end(self, ended: Flags, infos: Infos) -> Infos:
        """Those that have ended begin anew; the infos with how they ended."""
        last = np.full(self.num_envs, None, object)
        slots = np.flatnonzero(ended).tolist()
        for slot in slots:
            last[slot] = self._seen[slot].copy()
        final, infos = select(infos, ended), select(infos, ~ended)
        infos = merge(infos, self._begin(slots))
        return infos | {"final_obs": last, "_final_obs": ended, "final_info": final, "_final_info": ended.copy()}

    # Infos

    def _of_sample(self, frame: VectorSample) -> Infos:
        """What a frame says of all slots."""
        wire = frame.message
        if (wire.source_index, wire.sources) != self._sources:
            me = self.link.name
            self._sources = (wire.source_index, wire.sources)
            self._value_source = frame.value_source([AGENT if who == me else who for who in wire.sources])
        told = {
            "time": np.array(wire.time, object),
            "step": np.array(wire.step),
            "effective": frame.effective,
            "value_source": self._value_source.copy(),
            "late": wire.late,
            "rejected": wire.rejected,
            **frame.baseline,
        }
        if wire.fault_free_values:
            told["fault_free_values"] = frame.fault_free_values
        if self._memory.limits is not None:
            told["terminated_by"] = np.full(self.num_envs, "", object)
        if any(self._output_dir):
            told["output_dir"] = np.full(self.num_envs, "", object)
        return told

    def _tell_ends(self, told: Infos, broken: Mapping[int, str], truncated: Flags) -> None:
        for slot, words in broken.items():
            told["terminated_by"][slot] = words
        if any(self._output_dir):
            for slot in {*broken, *np.flatnonzero(truncated).tolist()}:
                told["output_dir"][slot] = self._output_dir[slot]

    # Commands

    def _command(self, actions: ArrayLike, unread: Sequence[int]) -> tuple[NDArray[np.float64], bytes | None]:
        values, operations = self._actions.rows(actions, self.num_envs, unread), self._operations
        contexts = self._memory.context
        if any(contexts):
            assert operations is not None
            codes = np.frombuffer(operations, np.uint8).reshape(values.shape).copy()
            for slot, context in enumerate(contexts):
                for index, value in context.items():
                    codes[slot, index] = CommandOp.RELINQUISH if value is None else CommandOp.SET
                    values[slot, index] = 0.0 if value is None else value
                contexts[slot] = {}
            operations = codes.tobytes()
        return values, operations

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """`BuildingEnv.set_context` in all slots; `envs[i].set_context` does it in one."""
        for slot in range(self.num_envs):
            self.set_slot_context(slot, values)

    def set_slot_context(self, slot: int, values: Mapping[str, float | None]) -> None:
        """See `BuildingEnv.set_context`."""
        self._memory.context[slot] |= self._actions.context(values)

    # What can be asked

    @property
    def link(self) -> VectorLink:
        """The hold on the node."""
        return cast("VectorLink", self._hold.link)

    @property
    def local_node(self) -> LocalNode | None:
        """The node that was started; None if it runs elsewhere."""
        return self._hold.local_node

    def slot_weather(self, slot: int, columns: Sequence[str]) -> WeatherSeries:
        """See `BuildingEnv.weather`."""
        return self.link.weather(columns, slot) if slot else self.link.weather(columns)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """What a method (or an attribute) of each slot gives; see `Slot`."""
        found = [getattr(slot, name) for slot in self.envs]
        return tuple(one(*args, **kwargs) if callable(one) else one for one in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of each slot."""
        return tuple(getattr(slot, name) for slot in self.envs)

    def set_attr(self, name: str, values: Any) -> None:
        """Sets an attribute of each slot: from a list or tuple each its own, else all the same."""
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise InvalidConfig(f"{name}: {len(each)} values for {self.num_envs} slots")
        for slot, value in zip(self.envs, each, strict=True):
            setattr(slot, name, value)

    def render(self) -> tuple[Any, ...]:
        """For each slot what `BuildingEnv.render` gives."""
        return tuple(history.picture() for history in self._histories) or (None,) * self.num_envs

    def close_extras(self, **_: Any) -> None:
        """Lets go of the node, and ends it if it is this environment's own."""
        self._hold.close()


def make(num_envs: int = 1, **given: Any) -> VectorEnv[Any, Any, Any]:
    """The vector environment of a scenario, within the wrappers that it names; what `gym.make_vec` calls.

    Raises:
        UsageError, BusError, SimulatorError: see `BuildingVectorEnv`; nothing is left behind.
    """
    env = BuildingVectorEnv(num_envs, **given)
    try:
        wrapped: VectorEnv[Any, Any, Any] = apply_wrappers(env, env.manifest.task.wrappers)
    except BaseException:
        env.close()
        raise
    return wrapped


def _known(given: Mapping[str, Any]) -> Mapping[str, Any]:
    arguments.check_arguments(
        given, [*arguments.NODE_ARGUMENTS, *list(BuildingVectorEnv.__init__.__kwdefaults__ or {})]
    )
    return given


def _count(count: int) -> int:
    if not isinstance(count, int) or not 1 <= count <= MOST:
        raise InvalidConfig(f"num_envs = {count!r}; a number from 1 to {MOST} expected")
    return count


def _mode(given: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(given)
    except ValueError:
        modes = ", ".join(mode.value for mode in AutoresetMode)
        raise InvalidConfig(f"autoreset_mode {given!r}; there are: {modes}") from None
