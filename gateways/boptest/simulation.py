"""The building of a test: its node process, and simulations on it.

A test has a node of its own, whose run period begins on the day on which its warm-up begins. Time is in seconds since
1 January, 0:00, of a year without 29 February, as in BOPTEST.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import date, datetime, timedelta
from math import ceil, floor, inf, isfinite
from threading import Lock
from typing import Any
from weakref import WeakSet

import numpy as np

from zenostat.bridge.client.bus import Bus, connect
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.client.node_arguments import for_node
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import CreateBranch, Manifest, Mode

DAY_S = 86400
YEAR = datetime(2017, 1, 1)
"""Time 0. Its 1 January is a Sunday, and neither it nor the next year has a 29 February."""

YEAR_S = 365 * DAY_S
MAX_COPIES = 64
"""Maximum number of snapshots and branches of a node, those of beginnings and baselines included."""

LAST_DAY = "2018-12-31"
"""Last day of each run period: tests continue past the end of the year."""

_NODE = "building"

RUN_END_S = 2 * YEAR_S
"""End of each run period."""


def wrapped(times_s: Floats) -> Floats:
    """Return times after the end of the run period as those of its last year at which the same data hold."""
    years: Floats = np.maximum(np.ceil((times_s - RUN_END_S) / YEAR_S), 0.0)
    return times_s - YEAR_S * years


def moment(time_s: float) -> datetime:
    """Return local standard time for seconds since 1 January."""
    return YEAR + timedelta(seconds=time_s)


def row_range(start_s: float, final_s: float, begin_s: int, step_s: int, count: int) -> tuple[int, int]:
    """Return the first row from a start on, and the row after the last one to an end; both may be infinite."""
    if start_s == inf or final_s == -inf:
        return 0, 0
    first = 0 if not isfinite(start_s) else max(ceil((start_s - begin_s) / step_s), 0)
    after = count if not isfinite(final_s) else min(floor((final_s - begin_s) / step_s) + 1, count)
    return (first, after) if first < after else (0, 0)


class Simulation:
    """One engine that is stepped by its test: that of the node, or of a branch.

    Args:
        bus, node: the bus and the node's name.
        name: the controller's, which is made unique.

    Attributes:
        bus, node: the bus and the node's name.
        manifest: its manifest.
        sample: the sample that it has reached.
    """

    def __init__(self, bus: Bus, node: str, name: str = "boptest") -> None:
        self.bus, self.node, self._name = bus, node, name
        self._link = bus.controller(node, name=name)
        self.manifest: Manifest = self._link.manifest
        self.sample: SampleView = self._link.current()

    @property
    def owner(self) -> str:
        """Name of its controller on the bus."""
        return self._link.name

    @property
    def lost(self) -> bool:
        """Whether its node has left the bus."""
        return self._link.lost

    def reset(self, snapshot: str = "") -> None:
        """Start an episode, or return to a snapshot."""
        self.sample = self._link.reset(snapshot=snapshot)

    def step(self, values: Floats | None = None, operations: bytes | None = None) -> SampleView:
        """Simulate a timestep; without values, all commands are kept."""
        self._link.send(values, operations)
        self.sample = self._link.receive()
        return self.sample

    def run_free(self, steps: int, add: Callable[[SampleView], None]) -> None:
        """Simulate timesteps under the baseline control, without a command for each of them.

        Args:
            steps: number of timesteps.
            add: called with the sample of each.
        """
        if steps <= 0:
            return
        self.bus.pause(self.node)
        self.bus.pace(self.node, mode=Mode.FREE)
        self.bus.step(self.node, steps)
        for _ in range(steps):
            self.sample = self._link.receive()
            add(self.sample)
        self.bus.pace(self.node, mode=Mode.LOCKSTEP)
        self.bus.resume(self.node)

    def snapshot(self) -> str:
        """Take a snapshot of the sample that it has reached, and return its name."""
        return self.bus.snapshot(self.node, self.owner).snapshot

    def branch(self, *, snapshot: str = "", relinquished: bool = False) -> Simulation:
        """Return a simulation that continues independently, from this sample or from a snapshot."""
        branch = CreateBranch(controller=self.owner, snapshot=snapshot, relinquished=relinquished)
        return Simulation(self.bus, self.bus.branch(self.node, branch), self._name)

    def close(self) -> None:
        """Disconnect; a branch ends by that."""
        self._link.close()


class Interruption:
    """Ends the nodes of a test from another thread, also one that is starting, and lets no other start.

    Attributes:
        is_set: whether it has taken place.
    """

    def __init__(self) -> None:
        self.is_set = False
        self._lock = Lock()
        self._nodes: WeakSet[LocalNode] = WeakSet()

    def watch(self, node: LocalNode) -> None:
        """Add a node whose process has just been started."""
        with self._lock:
            self._nodes.add(node)
            if self.is_set:
                node.terminate()

    def interrupt(self) -> None:
        """End the nodes, without waiting for it; calls that use them raise `NodeLost`."""
        with self._lock:
            self.is_set = True
            for node in self._nodes:
                node.terminate()


class Building:
    """A node process of its own, on a private socket.

    Args:
        arguments: arguments of the scenario, as of an environment.
        first_day: day of the year on which its run period begins, from 0.
        last_day: last day of its run period.
        interruption: can end it from another thread.
        name: name of its controller.

    Raises:
        ZenostatError: the node cannot start.
    """

    def __init__(
        self,
        arguments: Mapping[str, Any],
        first_day: int = 0,
        last_day: str = LAST_DAY,
        *,
        interruption: Interruption | None = None,
        name: str = "boptest",
    ) -> None:
        self.first_day = first_day
        begin: date = moment(first_day * DAY_S).date()
        period = {"begin": begin.isoformat(), "end": last_day}
        placement = Affinity.SEPARATE_CORES
        self._close = ExitStack()
        with ExitStack() as undo:
            undo.callback(self.close)
            settings = for_node({**arguments, **period, "branches": MAX_COPIES}, _NODE)
            on_process = (interruption or Interruption()).watch
            self._node = LocalNode(settings, placement, on_process)
            self._close.callback(self._node.close)
            bus = connect(self._node.endpoint, affinity=placement, core=self._node.core)
            self._close.enter_context(bus)
            bus.via = "boptest"
            self.main = Simulation(bus, _NODE, name)
            undo.pop_all()
        step_s = self.main.manifest.step_s
        if step_s != int(step_s) or self.main.manifest.slots != 1:
            raise InvalidConfig(f"a test case has one slot and a timestep of whole seconds, not {step_s:g} s")
        self.step_s = int(step_s)

    @property
    def begin_s(self) -> int:
        """Time at which its run period begins."""
        return self.first_day * DAY_S

    @property
    def pid(self) -> int:
        """The node's process id."""
        return self._node.pid

    @property
    def has_ended(self) -> bool:
        """Whether the node's process has ended."""
        return bool(self._node.end) or (self.main.lost and self._node.has_ended())

    def close(self) -> None:
        """End the node; idempotent."""
        self._close.close()
