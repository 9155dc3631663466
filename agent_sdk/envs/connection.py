"""An environment's hold on a node: one of its own, one on a bus, or what stands in for one."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

from agent_sdk.bus.bus import Bus
from agent_sdk.bus.bus import connect as join
from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.bus.local_node import LocalNode, Monitor, ignore_interrupts
from agent_sdk.bus.sample import SampleView
from agent_sdk.envs import arguments
from agent_sdk.rewards import AnyReward, Reward, read_reward
from bridge.runtime.affinity import Affinity
from topics.errors import BusError, EpisodeChanged, InvalidConfig
from topics.messages import Manifest

NAME = "building"
AGENT = "agent"
"""What an environment is called in its own `info["value_source"]`; its name on the bus differs from run to run."""
RENDER_MODES = ("rgb_array", "rerun")
BUSY = "another thread is in step() or reset() of this environment; one thread at a time, or an environment for each"
_REAPED_S = 1.0
"""How soon after its last message a killed process has ended."""


class NodeConnection:
    """Finds a node elsewhere, or starts one, which tells its manifest before anybody joins its bus.

    Args:
        given: what the user decided of the node, by the names of `arguments.NODE_ARGUMENTS`.
        reward, connect, node, priority, affinity, render_mode, keys, link: see `BuildingEnv`.
        slots: how many engines the node has.

    Attributes:
        manifest: what the node is.
        local_node: the node that was started; None if it runs elsewhere.
        reward: what rewards; None if nothing does.

    Raises:
        UsageError, BusError, SimulatorError: see `topics.errors`; nothing is left behind.
    """

    def __init__(
        self,
        given: Mapping[str, Any],
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
        self._close, self.closed, self._watched = ExitStack(), False, False
        self.local_node: LocalNode | None = None
        self._link, self._slots = link, slots
        self._keys = None if keys is None else Path(keys)
        self._bus: Bus | None = None
        self._way: tuple[str, str, int, Affinity, int | None]
        with ExitStack() as undo:
            undo.callback(self.abandon)
            _check_render(render_mode)
            if keys is not None and connect is None:
                raise InvalidConfig("keys= go with connect='tls/HOST:PORT': a node of one's own is on no network")
            if link is not None:
                if given or connect or render_mode == "rerun":
                    raise InvalidConfig(
                        "link= brings a building of its own, and is on no bus; leave out what else decides"
                    )
                self._close.callback(link.close)
                self.manifest: Manifest = link.manifest
            else:
                self._find_node(given, reward, connect, node, priority, Affinity(affinity))
            self._check_slots()
            wanted = self.manifest.task.reward if reward == arguments.FROM_SCENARIO else reward
            self.reward: Reward | None = None if wanted is None else read_reward(wanted)
            undo.pop_all()

    def _find_node(
        self,
        given: Mapping[str, Any],
        reward: AnyReward | None,
        endpoint: str | None,
        node: str | None,
        priority: int,
        placement: Affinity,
    ) -> None:
        if endpoint is None:
            wanted = arguments.for_node(given, node or NAME, self._slots)
            if reward != arguments.FROM_SCENARIO:
                wanted["own_reward"] = True
            arguments.check_reward(reward, wanted, placement)
            self._start(wanted, node or NAME, priority, placement)
            return
        if given:
            raise InvalidConfig(f"{', '.join(given)}: the node at {endpoint} has its own; leave out what it decides")
        if node is None:
            raise InvalidConfig(f"connect={endpoint!r} needs the node's name: node='office'")
        self._way = (endpoint, node, priority, placement, None)
        self.manifest = self._joined().manifest(node)
        self._check_slots()  # before anything is claimed
        self.manifest = self.link.manifest

    def _start(self, wanted: dict[str, Any], node: str, priority: int, placement: Affinity) -> None:
        own = LocalNode(wanted, placement)
        self._close.callback(own.close)
        assert own.manifest is not None
        self.local_node, self.manifest, self._wanted = own, own.manifest, wanted
        self._way = (own.endpoint, node, priority, placement, own.core)

    def reset(self, *, seed: int | None) -> SampleView:
        """Starts an episode, on another node if the environment's own ends just now; see `ControllerLink.reset`."""
        try:
            sample: SampleView = self.link.reset(seed=seed)
        except BusError:
            if self.local_node is None or not self._has_ended(self.local_node) or not self.renew():
                raise
            sample = self.link.reset(seed=seed)
        self.manifest = self.link.manifest
        return sample

    def _has_ended(self, own: LocalNode) -> bool:
        deadline = time.monotonic() + _REAPED_S
        while not own.end and time.monotonic() < deadline:
            time.sleep(0.01)
        return bool(own.end)

    def renew(self) -> bool:
        """Starts another node where the environment's own has ended, and warns; whether it did.

        Raises:
            UsageError, BusError, SimulatorError: as when the environment was made; it can be tried again.
        """
        own = self.local_node
        if own is None or self.closed:
            return False
        lost = isinstance(self._link, ControllerLink) and self._link.lost
        if not own.end and not (lost and self._has_ended(own)):  # a killed process is off the bus before it has ended
            return False
        how = own.end
        _, node, priority, placement, _ = self._way
        self._close.close()
        self._link = self._bus = None
        self._start(self._wanted, node, priority, placement)
        if self._watched:
            self.open_monitor()
        warnings.warn(
            f"the environment's own node had ended ({how}), and another one was started; its snapshots are gone, and "
            "without a seed its weather is drawn anew",
            stacklevel=4,
        )
        return True

    def _check_slots(self) -> None:
        node, there = self.manifest.node, self.manifest.slots
        if there == self._slots:
            return
        if there > 1:
            raise InvalidConfig(
                f"node {node!r} has {there} slots, not {self._slots}: gymnasium.make_vec(…, num_envs={there})"
            )
        raise InvalidConfig(f"node {node!r} has a single slot, not {self._slots}: gymnasium.make(…), or num_envs=1")

    @property
    def link(self) -> Any:
        """The control of the node.

        An own node's bus is joined when it is first needed: up to then this process has no threads of Zenoh's and may
        be forked, as Gymnasium's asynchronous vector environments do it.
        """
        if self._link is None:
            _, node, priority, _, _ = self._way
            self._link = self._close.enter_context(self._joined().controller(node, name="env", priority=priority))
        return self._link

    def _joined(self) -> Bus:
        if self._bus is None:
            endpoint, _, _, placement, core = self._way
            self._bus = self._close.enter_context(join(endpoint, affinity=placement, core=core, keys=self._keys))
        return self._bus

    def open_monitor(self) -> None:
        """Opens a live view of the bus, which ends with the hold."""
        self._watched = True
        self._close.callback(Monitor(self._way[0], self._keys).close)

    def warn(self, stacklevel: int) -> None:
        """Says what in the model works against the scenario's actuators; `stacklevel` as of the caller."""
        for warning in self.manifest.warnings:
            warnings.warn(f"{self.manifest.building}: {warning}", stacklevel=stacklevel + 1)

    def push_exit(self, what: AbstractContextManager[object]) -> None:
        """Has something else that was entered end with the hold, before all else."""
        self._close.push(what)

    def check_open(self) -> None:
        """Refuses to go on with an environment that was closed."""
        if self.closed:
            raise EpisodeChanged("the environment is closed; make another one") from None

    def abandon(self) -> None:
        """Closes what an error or Ctrl-C left half made; a second Ctrl-C does not disturb it."""
        with ignore_interrupts():
            self.close()

    def close(self) -> None:
        """Lets go of the node, and ends it if it was started here; twice is fine."""
        self.closed = True
        self._close.close()


def _check_render(mode: str | None) -> None:
    if mode is not None and mode not in RENDER_MODES:
        raise InvalidConfig(f"render_mode {mode!r}; there are: {', '.join(RENDER_MODES)}")
