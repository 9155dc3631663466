"""An environment's connection to a node: a local one, one on a bus, or a replacement for a node."""

from __future__ import annotations

import copy
import warnings
import weakref
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NoReturn, Protocol

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.snapshot import require_node
from zenostat.agent_sdk.envs.space_names import SpaceNames
from zenostat.agent_sdk.rewards import AnyReward, Reward, read_reward
from zenostat.agent_sdk.rewards.manifest_data import reward_data, task_paying
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.bus import connect as connect_bus
from zenostat.bridge.client.connection import build
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.local_node import LocalNode, ignore_interrupts
from zenostat.bridge.client.node_arguments import for_node
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.client.thread_guard import one_thread
from zenostat.bridge.recording.file import next_recording
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.processes import Monitor
from zenostat.bridge.transport.access_control import RESETTING
from zenostat.bridge.transport.session import keys_folder
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BusError, EpisodeChanged, InvalidConfig, RequestRejected, UsageError
from zenostat.topics.messages import Ack, Claim, Manifest, RecordingState, RecordingStatus, WeatherSeries

NAME = "building"
AGENT = "agent"
"""The environment's name in its own `info["value_source"]`; its name on the bus differs from run to run."""
RENDER_MODES = ("rgb_array", "rerun")
NOT_STARTED = "call reset() before step(); an interrupted step ends its episode"
BUSY = "another thread is in step() or reset() of this environment; one thread at a time, or an environment for each"


class Link(Protocol):
    """The link of an environment: samples in, commands out."""

    manifest: Manifest
    accepted: Ack
    name: str

    def reset(self, *, seed: int | None = None) -> SampleView:
        """Start a new episode and return its sample 0."""

    def receive(self) -> SampleView:
        """Wait for the next sample."""

    def send(self, values: Floats, operations: bytes | None = None) -> None:
        """Answer the current sample with a value and a `CommandOp` byte for each actuator (None: all are set)."""

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of the weather of the current episode."""

    def close(self) -> None:
        """Disconnect; idempotent."""


class VectorLink(Protocol):
    """The link of a vector environment: samples of all slots in, commands for all slots out."""

    manifest: Manifest
    accepted: Ack
    name: str

    def reset(
        self, *, seed: int | list[int | None] | None = None, slots: list[int] | None = None, snapshot: str = ""
    ) -> SampleView:
        """Start new episodes in these slots, or in all; return the sample in which they are at sample 0."""

    def receive(self) -> SampleView:
        """Wait for the next sample."""

    def send(self, values: Floats, operations: bytes | None = None, *, still: Sequence[int] = ()) -> None:
        """Answer the current sample: shape (slots, actuators); slots in `still` do not advance."""

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return columns of the weather of a slot's current episode."""

    def close(self) -> None:
        """Disconnect; idempotent."""


@dataclass(frozen=True)
class _Target:
    """Address of the node, and the way to control it."""

    endpoint: str
    node: str
    priority: int
    placement: Affinity
    core: int | None = None
    local_node: int | None = None
    """The process id of a local node."""


class NodeConnection:
    """Connects to a node on a bus, or starts a local one, whose manifest is known before its bus is used.

    Args:
        node_arguments: The user's arguments for the node, by the names of
            `zenostat.topics.scenario_fields.NODE_ARGUMENTS`.
        reward, connect, node, priority, affinity, render_mode, keys, link: See `BuildingEnv`.
        slots: Number of the node's engines.

    Attributes:
        manifest: The node's manifest; the reward of its task is the one that the environment pays.
        local_node: The node that was started; None if it runs elsewhere.
        reward: The reward; None if there is none.
        closed: Whether it has been closed.

    Raises:
        UsageError, BusError, SimulatorError: See `zenostat.topics.errors`; everything that was started is closed again.
    """

    def __init__(
        self,
        node_arguments: Mapping[str, Any],
        *,
        reward: AnyReward | None,
        connect: str | None,
        node: str | None,
        priority: int,
        affinity: Affinity | str,
        render_mode: str | None,
        keys: str | Path | None = None,
        link: Any = None,
        slots: int = 1,
    ) -> None:
        self._close, self.closed, self._has_monitor = ExitStack(), False, False
        self._stopped_recording = ""
        self._adopted: Manifest | None = None
        self.local_node: LocalNode | None = None
        self._link, self._slots = link, slots
        self._bus: Bus | None = None
        self._target: _Target
        with ExitStack() as undo:
            undo.callback(self.abandon)
            if render_mode not in (None, "rgb_array") and link is not None:
                raise InvalidConfig(
                    f"render_mode {render_mode!r}; 'rgb_array' expected: without a node, there is no bus for "
                    "'rerun' to show"
                )
            if render_mode not in (None, *RENDER_MODES):
                raise InvalidConfig(f"render_mode {render_mode!r}; there are: {', '.join(RENDER_MODES)}")
            if affinity not in list(Affinity):
                raise InvalidConfig(f"affinity {affinity!r}; there are: {', '.join(Affinity)}")
            build(Claim, controller=NAME, priority=priority)
            if not isinstance(keys, str | PathLike | None):
                raise InvalidConfig(f"keys = {keys!r}; a folder, or a certificate in it, expected")
            self._keys = None if keys is None else Path(keys)
            if keys is not None and connect is None:
                raise InvalidConfig("keys= needs connect='tls/HOST:PORT'; a local node is not on a network")
            if link is not None:
                if node_arguments or connect:
                    raise InvalidConfig(
                        "link= has a building of its own and no bus; leave out the arguments that choose a building or "
                        "a bus"
                    )
                self._close.callback(link.close)
                self.manifest: Manifest = link.manifest
            elif connect is None:
                if render_mode == "rgb_array":  # pictures show more than most agents observe
                    node_arguments = {"monitoring": True, **node_arguments}
                self._start_local(node_arguments, reward, node or NAME, priority, Affinity(affinity))
            else:
                self._connect(node_arguments, connect, node, priority, Affinity(affinity))
            self._check_slots()
            chosen = self.manifest.task.reward if arguments.is_of_scenario(reward) else reward
            self.reward: Reward | None = None if chosen is None else read_reward(chosen)
            is_plant = (not self.manifest.versions.energyplus or "district" in node_arguments) and link is None
            self._is_without_reward = reward == arguments.FROM_SCENARIO and self.reward is None and is_plant
            self.adopt(self.manifest)
            undo.pop_all()

    def _start_local(
        self, node_arguments: Mapping[str, Any], reward: AnyReward | None, node: str, priority: int, placement: Affinity
    ) -> None:
        settings = for_node(node_arguments, node, self._slots)
        arguments.check_agent_settings(reward, settings, placement)
        if not arguments.is_of_scenario(reward):
            settings["environment_reward"] = reward_data(None if reward is None else read_reward(reward))
        self._settings = settings
        self._start(settings, node, priority, placement)

    def _connect(
        self, node_arguments: Mapping[str, Any], endpoint: str, node: str | None, priority: int, placement: Affinity
    ) -> None:
        if node_arguments:
            raise InvalidConfig(
                f"{', '.join(node_arguments)}: the node at {endpoint} has its own settings; leave these arguments out"
            )
        if not isinstance(endpoint, str) or isinstance(node, list | tuple):
            raise InvalidConfig("several endpoints or nodes make a vector: gymnasium.make_vec(…, num_envs=NODES)")
        if node is None:
            raise InvalidConfig(f"connect={endpoint!r} needs the node's name: node='office'")
        self._target = _Target(endpoint, node, priority, placement)
        self.manifest = self._connected_bus().manifest(node)
        self._check_slots()  # before the link claims actuators
        self.manifest = self.link.manifest

    def _start(self, settings: dict[str, Any], node: str, priority: int, placement: Affinity) -> None:
        local_node = LocalNode(settings, placement)
        self._close.callback(local_node.close)
        assert local_node.manifest is not None
        self.local_node, self.manifest = local_node, local_node.manifest
        self._target = _Target(local_node.endpoint, node, priority, placement, local_node.core, local_node.pid)

    def reset(self, *, seed: int | None) -> SampleView:
        """Start an episode, on a new node if the local one is just ending; see `ControllerLink.reset`."""
        try:
            sample: SampleView = self.link.reset(seed=seed)
        except BusError:
            if self.local_node is None or not self.local_node.has_ended() or not self.restart_if_ended():
                raise
            sample = self.link.reset(seed=seed)
        self.adopt(self.link.manifest)
        return sample

    def adopt(self, manifest: Manifest) -> Manifest:
        """Take over the node's manifest, with the reward that this environment pays; return it."""
        if manifest is not self._adopted:
            self._adopted = manifest
            task = task_paying(manifest.task, self.reward)
            self.manifest = manifest if task is manifest.task else manifest.model_copy(update={"task": task})
        return self.manifest

    def check_recording(self, stacklevel: int) -> None:
        """Warn if the recording that the user asked for has stopped; `stacklevel` is the caller's."""
        if self._is_recording():
            with suppress(BusError):
                self._warn_of_recording(self._connected_bus().status(self._target.node).recording, stacklevel + 1)

    def _is_recording(self) -> bool:
        return self.local_node is not None and self._bus is not None and self._settings.get("record") is not None

    def _warn_of_recording(self, status: RecordingStatus | None, stacklevel: int) -> None:
        if status is not None and status.state is RecordingState.STOPPED and status.path != self._stopped_recording:
            self._stopped_recording = status.path
            warnings.warn(
                f"the recording to {status.path} stopped: {status.reason}; what came later is not in it",
                stacklevel=stacklevel + 1,
            )

    def restart_if_ended(self) -> bool:
        """Start a new local node if the former one has ended, and warn; return whether it did.

        Raises:
            UsageError, BusError, SimulatorError: As when the environment was made; the call can be repeated.
        """
        local_node = self.local_node
        if local_node is None or self.closed:
            return False
        lost = isinstance(self._link, ControllerLink) and self._link.lost
        if not local_node.end and not (lost and local_node.has_ended()):
            return False
        cause, target = local_node.end, self._target
        self._close.close()
        self._link = self._bus = None
        settings = self._settings
        recorded = ""
        if (record := settings.get("record")) is not None:
            settings = {**settings, "record": str(next_recording(Path(record)))}  # that of the former node is kept
            recorded = f"; it records to {settings['record']}"
        self._start(settings, target.node, target.priority, target.placement)
        self.adopt(self.manifest)
        if self._has_monitor:
            self.open_monitor()
        warnings.warn(
            f"the environment's own node had ended ({cause}), and another one was started{recorded}; its snapshots are "
            "lost, and without a seed its weather is drawn anew",
            stacklevel=4,
        )
        return True

    def _check_slots(self) -> None:
        node, count = self.manifest.node, self.manifest.slots
        if count == self._slots:
            return
        if count > 1:
            raise InvalidConfig(
                f"node {node!r} has {count} slots, not {self._slots}: gymnasium.make_vec(…, num_envs={count})"
            )
        raise InvalidConfig(f"node {node!r} has a single slot, not {self._slots}: gymnasium.make(…), or num_envs=1")

    @property
    def link(self) -> Any:
        """The link to the node.

        The bus of a local node is connected on first use: until then this process has no threads of Zenoh's and may be
        forked, as Gymnasium's asynchronous vector environments do.
        """
        if self._link is None:
            bus, target = self._connected_bus(), self._target
            self._link = self._close.enter_context(bus.controller(target.node, name="env", priority=target.priority))
        return self._link

    def _connected_bus(self) -> Bus:
        if self._bus is None:
            target = self._target
            bus = connect_bus(
                target.endpoint,
                affinity=target.placement,
                core=target.core,
                local_node=target.local_node,
                keys=self._keys,
                role=RESETTING,
            )
            finalizer = weakref.finalize(
                self, _close_bus, bus, self.local_node
            )  # for an environment that is not closed
            finalizer.atexit = False
            self._close.callback(finalizer)
            self._bus = bus
        return self._bus

    def open_monitor(self) -> None:
        """Open a live view of the bus, which closes with the connection."""
        self._has_monitor = True
        self._close.callback(Monitor(self._target.endpoint, keys_folder(self._keys)).close)

    def warn(self, stacklevel: int) -> None:
        """Warn of what the node reports, and of a plant that pays nothing; `stacklevel` is the caller's."""
        building = self.manifest.building
        for warning in self.manifest.warnings:
            warnings.warn(f"{building}: {warning}", stacklevel=stacklevel + 1)
        if self._is_without_reward:
            warnings.warn(
                f"{building} has no reward, so every step pays 0.0; pass reward=, or reward=None if that is intended",
                stacklevel=stacklevel + 1,
            )

    def __deepcopy__(self, memo: dict[int, Any]) -> NodeConnection:
        """Copy the connection of a fake building; refuse those to a node."""
        if self._link is None or isinstance(self._link, ControllerLink):
            self.__reduce_ex__(4)
        copied = memo[id(self)] = object.__new__(type(self))
        copied.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return copied

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuse to be pickled."""
        raise UsageError(
            "an environment of a node cannot be copied or pickled, nor one of a fake building pickled: branch() "
            "continues from its sample in a copy, snapshot() keeps a state to return to, and zenostat.save_env "
            "describes it as a file to load"
        )

    def push_exit(self, exits: AbstractContextManager[object]) -> None:
        """Exit another context manager first when the connection closes."""
        self._close.push(exits)

    def check_open(self) -> None:
        """Raise `EpisodeChanged` if the environment is closed."""
        if self.closed:
            raise EpisodeChanged("the environment is closed; make another one") from None

    def abandon(self) -> None:
        """Close after an error or Ctrl-C; a second Ctrl-C does not interrupt it."""
        with ignore_interrupts():
            self.close()

    def close(self) -> None:
        """Disconnect from the node, and end it if it is local; idempotent. Warn if a recording is not complete."""
        try:
            if self.local_node is not None and self.local_node.is_suspended:
                self.local_node.close()  # the bus cannot be closed while the other side does not answer
            elif not self.closed:
                self._complete_recording()
        finally:
            self.closed = True
            self._close.close()

    def _complete_recording(self) -> None:
        self.check_recording(4)
        if self._is_recording():
            with suppress(BusError, RequestRejected):
                self._warn_of_recording(self._connected_bus().stop_recording(self._target.node), 4)


def _close_bus(bus: Bus, local_node: LocalNode | None) -> None:
    if local_node is not None and local_node.is_suspended:
        local_node.close()  # first, as in `NodeConnection.close`
    bus.close()


class ConnectedEnv(SpaceNames):
    """An environment, or a vector of them, that is connected to a node."""

    _connection: NodeConnection
    _sample: Any

    @property
    def local_node(self) -> LocalNode | None:
        """The local node; None if the node runs elsewhere."""
        return self._connection.local_node

    def leave_episode(self) -> None:
        """Require a reset after Ctrl-C: the node simulates the interrupted timestep, whose sample nobody receives."""
        self._sample = None

    def _forkable_link(self) -> ControllerLink:
        self._connection.check_open()
        return require_node(self._connection.link)


one_caller = one_thread(
    BUSY, explain=lambda self: self._connection.check_open(), interrupted=lambda self: self.leave_episode()
)
