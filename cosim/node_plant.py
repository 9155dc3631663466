"""A coupled plant that is a node: one that is started for the district, or one on a bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from itertools import zip_longest
from typing import Any

import numpy as np

from zenostat.bridge.client.bus import Bus, connect
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.client.trials import PendingTrial, trial_message
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.transport.access_control import RESETTING
from zenostat.cosim.coupled import Rows
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BusError, EpisodeChanged, NodeLost, RequestRejected, ZenostatError
from zenostat.topics.messages import CommandOp, ControllerState, CreateBranch, Manifest, Mode, Reset, State, Status

_LEFT = (ControllerState.DISCONNECTED, ControllerState.ABSENT)
"""States of a controller that has left the bus, and for whose command the node waits."""

_SET, _RELINQUISH = int(CommandOp.SET), int(CommandOp.RELINQUISH)


class NodePlant:
    """A node as a plant of a district; implements `zenostat.cosim.coupled.CoupledPlant`.

    Args:
        node: name of the node.
        controller: name of the orchestrator on its bus.

    Attributes:
        manifest: its manifest at the start, which a node that replaces it has to fit.
        on_wait: called while the district waits for a timestep, with what keeps the node from it; empty: nothing that
            its status says.
    """

    def __init__(self, node: str, controller: str = "orchestrator") -> None:
        self._node, self._controller = node, controller
        self._bus: Bus | None = None
        self._link: ControllerLink | None = None
        self._accepted: Manifest | None = None  # of the link, compared with that of the plant
        self._pending: Floats | None = None
        self._sample: SampleView | None = None
        self._ordered = np.empty(0)  # the latest commands
        self._warnings: list[str] = []
        self.on_wait: Callable[[str], None] = lambda _: None
        self._trial: PendingTrial | None = None
        self._close_bus = ExitStack()
        self.manifest: Manifest

    @property
    def node(self) -> str:
        """Name of the node."""
        return self._node

    # The bus of the node

    def open_bus(self) -> Bus:
        """Connect to the node's bus."""
        raise NotImplementedError

    @property
    def bus(self) -> Bus:
        """The node's bus."""
        if self._bus is None:
            self._bus = self._close_bus.enter_context(self.open_bus())
        return self._bus

    def _disconnect(self) -> None:
        self._bus = self._link = self._sample = self._trial = None
        with suppress(ZenostatError):
            self._close_bus.close()

    @property
    def link(self) -> ControllerLink:
        """The orchestrator's claim on all actuators; `NodeLost` if another node has replaced the plant's."""
        if self._link is None:
            self._link = self.bus.controller(self._node, name=self._controller)
            self._link.on_wait = self._report_wait
        link = self._link
        if link.manifest is not self._accepted:
            if difference := _difference(link.manifest, self.manifest):
                self._disconnect()
                raise NodeLost(f"node {self._node!r} was replaced by one that does not fit: {difference}")
            self._accepted = link.manifest
        return link

    # The plant

    def reset(self, seed: int) -> Rows:
        """Begin an episode; see `CoupledPlant.reset`."""
        try:
            return self._reset(seed)
        except (BusError, EpisodeChanged):
            self.recover()  # the node, or the connection to it, was lost or closed: once more, with new ones
            return self._reset(seed)

    def recover(self) -> None:
        """Prepare for another connection after the node, or the connection to it, was lost."""
        self._disconnect()

    def _reset(self, seed: int) -> Rows:
        self._sample = self.link.reset(seed=seed)
        return _rows([self._sample])

    def begin(self, commands: Floats) -> None:
        """Send the commands of the first timestep; see `CoupledPlant.begin`."""
        self._pending = commands
        self._send(commands[0])

    def finish(self) -> Rows:
        """Receive the sample of each timestep; see `CoupledPlant.finish`."""
        commands, self._pending = self._pending, None
        assert commands is not None
        samples = []
        for number in range(len(commands)):
            if number:
                self._send(commands[number])
            self._sample = self._receive()
            samples.append(self._sample)
        return _rows(samples)

    def _receive(self) -> SampleView:
        return self.link.receive()

    def _report_wait(self) -> None:
        with suppress(ZenostatError):
            self.on_wait(_obstacle(self.bus.status(self._node)))

    def _send(self, row: Floats) -> None:
        self._ordered = row
        values, operations = _command(row)
        self.link.send(values, operations)

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Ask for a copy for each alternative; see `CoupledPlant.begin_trial`."""
        self._trial = None
        sample = self._sample
        assert sample is not None
        parts = [_command(row) for rows in commands for row in rows]
        operations = b"".join(codes or bytes([_SET]) * len(values) for values, codes in parts)
        request = trial_message(
            len(commands),
            len(commands[0]),
            b"".join(values.tobytes() for values, _ in parts),
            operations if any(codes for _, codes in parts) else None,
            at=sample.message,
        )
        self._trial = self.link.begin_trial(request)

    def finish_trial(self) -> list[Rows]:
        """Wait for the samples of the trial; see `CoupledPlant.finish_trial`."""
        trial = self._trial
        assert trial is not None
        tried = [_rows(samples) for samples in self.link.finish_trial(trial)]
        self._trial = None
        return tried

    def cancel_trial(self) -> None:
        """Make `finish_trial` raise soon, although the node may still simulate; thread-safe."""
        trial = self._trial
        if trial is not None:
            trial.reply.cancel()

    def check_copy(self) -> None:
        """Try a step in which nothing is commanded; `ForkFailed` if the plant cannot be copied."""
        self._sample = self._sample or self.link.current()
        self.begin_trial([np.full((1, len(self.manifest.actuators)), np.nan)])
        self.finish_trial()

    # Snapshots and branches; see `zenostat.cosim.copies.CopiedPlant`

    def snapshot(self) -> tuple[str, int]:
        """Take a snapshot of the node; return its name, and the step of its episode."""
        taken = self.bus.snapshot(self._node, self.link.name)
        return taken.snapshot, taken.step[0]

    def drop(self, snapshot: str) -> None:
        """Free a snapshot; does nothing if it is gone, such as with its node."""
        bus = self._bus
        if bus is not None:
            with suppress(BusError, RequestRejected):
                bus.drop(self._node, snapshot, self.link.name)

    def restore(self, snapshot: str) -> Rows:
        """Return to a snapshot; return its sample."""
        self._sample = self.link.reset(snapshot=snapshot)
        return _rows([self._sample])

    def branch(self, snapshot: str) -> NodePlant:
        """Create a branch of the node that continues from a snapshot."""
        name = self.bus.branch(self._node, CreateBranch(controller=self.link.name, snapshot=snapshot))
        return BranchPlant(name, self.connect_again, self.manifest, self.link.manifest.instance)

    def connect_again(self) -> Bus:
        """Connect to the node's bus once more, for a branch, which runs in another thread."""
        return self.open_bus()

    def is_reachable(self) -> bool:
        """Return whether the node answers; see `CoupledPlant.is_reachable`."""
        return False

    def drain_warnings(self) -> list[str]:
        """Return texts about the plant since the last call."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def interrupt(self) -> None:
        """Close the connection, so that pending calls raise; thread-safe."""
        bus = self._bus
        if bus is not None:
            with suppress(ZenostatError):
                bus.close()

    def close(self) -> None:
        """Disconnect from the node; idempotent."""
        self._disconnect()


class StartedPlant(NodePlant):
    """A node that is started for the district, as a program that ends with this process.

    Args:
        node: name of the node.
        settings: of the node.
        on_process: called with the node's process when it exists.
    """

    def __init__(self, node: str, settings: dict[str, Any], on_process: Callable[[LocalNode], None]) -> None:
        super().__init__(node)
        self._settings, self._on_process = {**settings, "name": node}, on_process
        self._local: LocalNode | None = None
        self._process: LocalNode | None = None  # exists before the node is ready
        self._is_ending = False
        manifest = self.start().manifest
        assert manifest is not None
        self.manifest = manifest

    def start(self) -> LocalNode:
        """Start the node, unless it runs.

        Raises:
            ZenostatError: the error with which it ended.
        """
        if self._local is not None and (self._is_ending or self._local.end):
            self._end()
        if self._local is None:
            self._local = LocalNode(self._settings, Affinity.OFF, self._on_start)
        return self._local

    def _on_start(self, process: LocalNode) -> None:
        self._process = process
        self._on_process(process)

    def open_bus(self) -> Bus:
        """Connect to the private bus of the node."""
        return connect(self.start().endpoint, affinity=Affinity.OFF)

    def connect_again(self) -> Bus:
        """Connect to the bus of the node that runs."""
        assert self._local is not None
        return connect(self._local.endpoint, affinity=Affinity.OFF)

    def recover(self) -> None:
        """End a process that has lost its bus, or is about to end."""
        if self._local is not None and (self._is_ending or self._local.has_ended()):
            self._end()
        self._disconnect()

    def interrupt(self) -> None:
        """Let the process end, without waiting for it, so that pending calls raise; thread-safe."""
        process = self._process
        if process is not None:
            self._is_ending = True
            process.terminate()

    def _end(self) -> None:
        self._disconnect()
        local, self._local, self._process, self._is_ending = self._local, None, None, False
        if local is not None:
            local.close()

    def close(self) -> None:
        """End the node; idempotent."""
        self._end()


class BranchPlant(NodePlant):
    """A branch of a plant's node, which ends with it; it has one episode, and cannot be reset.

    Args:
        node: name of the branch.
        open_bus: connects to its bus.
        manifest: of the plant.
        instance: of the plant's node.
    """

    def __init__(self, node: str, open_bus: Callable[[], Bus], manifest: Manifest, instance: str) -> None:
        super().__init__(node)
        self._open, self.manifest, self._instance = open_bus, manifest, instance
        self._sample = self.link.current()

    def open_bus(self) -> Bus:
        """Connect to the bus."""
        return self._open()

    def close(self) -> None:
        """End the branch; idempotent."""
        bus = self._bus
        if bus is not None:
            with suppress(ZenostatError):
                bus.stop(self._node, instance=self._instance)
        super().close()


class FoundPlant(NodePlant):
    """A node that runs already, on a bus.

    Args:
        node: name of the node.
        endpoint: of its bus.
        keys: folder of the keys for it.
        controller: name of the orchestrator on its bus.
    """

    def __init__(self, node: str, endpoint: str, keys: Any, controller: str = "orchestrator") -> None:
        super().__init__(node, controller)
        self._is_interrupted = False
        self._overridden = frozenset[tuple[str, str]]()  # actuators of the latest sample, and who commands them
        self._endpoint, self._keys, self._warned = endpoint, keys, ""
        self._threads = ThreadPoolExecutor(1)
        self._search: Future[bool] | None = None
        manifest = self.bus.manifest(node)
        self.manifest = manifest.model_copy(update={"warnings": (*manifest.warnings, *self.drain_warnings())})

    def open_bus(self) -> Bus:
        """Connect to the bus."""
        return connect(self._endpoint, affinity=Affinity.OFF, keys=self._keys, role=RESETTING, warn=self._warn)

    def _warn(self, text: str) -> None:
        """Warn once, however often it connects."""
        if text != self._warned:
            self._warned = text
            self._warnings.append(text)

    def is_reachable(self) -> bool:
        """Return whether the node answers; it is looked for in another thread, which may take seconds."""
        if self._search is None:
            self._disconnect()
            self._search = self._threads.submit(self._answers)
        if not self._search.done():
            return False
        search, self._search = self._search, None
        return search.result()

    def _answers(self) -> bool:
        try:
            with self.open_bus() as bus:
                bus.manifest(self._node)
        except ZenostatError:
            return False
        return True

    def interrupt(self) -> None:
        """Close the connection, so that pending calls raise; thread-safe."""
        self._is_interrupted = True
        super().interrupt()

    def recover(self) -> None:
        """Prepare for another connection; the timestep of which `interrupt` gave up the wait would delay its claim."""
        super().recover()
        is_interrupted, self._is_interrupted = self._is_interrupted, False
        if is_interrupted and self.bus.status(self._node).state is State.RUNNING:
            self.bus.reset(self._node, Reset(controller=self._controller))

    def close(self) -> None:
        """Disconnect from the node; idempotent."""
        super().close()
        self._threads.shutdown()

    def _receive(self) -> SampleView:
        """Receive a sample; `NodeLost` if the node does not wait for the district, or has not waited for it."""
        sample = super()._receive()
        if (mode := self.link.mode) is not Mode.LOCKSTEP:
            by = f" by {self.link.paced_by}" if self.link.paced_by else ""
            raise NodeLost(f"node {self._node!r} was set to the mode {mode}{by}, and does not wait for the district")
        if sample.fallback and not self._has_answered():
            raise NodeLost(
                f"node {self._node!r} simulated timestep {sample.step} without the district's command, which had not "
                f"arrived by its deadline; its policy is {self.link.manifest.policy}"
            )
        self._warn_of_others(sample)
        return sample

    def _warn_of_others(self, sample: SampleView) -> None:
        """Add a warning for each actuator that somebody begins to command in place of the district."""
        present = dict[tuple[str, str], tuple[float, float]]()
        if not {*sample.message.sources} <= {"", self.link.name}:
            values = zip(sample.commanded.tolist(), self._ordered.tolist(), strict=True)
            for (name, source), pair in zip(sample.value_source.items(), values, strict=True):
                if source not in ("", self.link.name) and not np.isnan(pair[1]):
                    present[name, source] = pair
        self._warnings += [
            f"{source} commands {name!r} of node {self._node!r} at a higher priority: its value is {value:g} in "
            f"timestep {sample.step} and not the district's {ordered:g}"
            for (name, source), (value, ordered) in present.items()
            if (name, source) not in self._overridden
        ]
        self._overridden = frozenset(present)

    def _has_answered(self) -> bool:
        """Return whether the node had the latest command in time; else another required controller's was missing."""
        status = self.bus.status(self._node)
        return (self.link.name, ControllerState.CONNECTED) in [(c.controller, c.state) for c in status.controllers]

    def _reset(self, seed: int) -> Rows:
        self._overridden = frozenset()
        if self.link.mode is not Mode.LOCKSTEP:
            self.bus.pace(self._node, mode=Mode.LOCKSTEP, source=self._controller)
        return super()._reset(seed)


def _obstacle(status: Status) -> str:
    """Return what keeps a node from its timestep: a pause, or controllers that have left; empty if it is neither."""
    if status.waiting or status.state is not State.WAITING:
        return status.waiting
    if status.paused and not status.steps_left:
        return f"node {status.node!r} is paused"
    left = [c.controller for c in status.controllers if c.required and c.state in _LEFT]
    are = "is" if len(left) == 1 else "are"
    waits = f"node {status.node!r} waits for {', '.join(map(repr, left))}, which {are} disconnected"
    return f"{waits} (policy {status.policy})" if left else ""


def _difference(manifest: Manifest, previous: Manifest) -> str:
    """Return in what a node that replaces another one differs for a district; empty if it fits."""
    for kind in ("sensors", "meters", "actuators"):
        for new, old in zip_longest(getattr(manifest, kind), getattr(previous, kind)):
            if new != old:
                names = ["none" if point is None else repr(point.name) for point in (new, old)]
                of_new = (
                    f"{names[0]} with other fields" if names[0] == names[1] else f"{names[0]} in place of {names[1]}"
                )
                return f"{kind}: {of_new}"
    if manifest.slots != previous.slots:
        return f"{manifest.slots} slots in place of {previous.slots}"
    if manifest.step_s != previous.step_s:
        return f"a timestep of {manifest.step_s:g} s in place of {previous.step_s:g} s"
    if manifest.steps != previous.steps:
        return f"an episode of {manifest.steps} timesteps in place of {previous.steps}"
    return ""


def _command(row: Floats) -> tuple[Floats, bytes | None]:
    """Return values and operations of a command; NaN relinquishes an actuator."""
    is_free = np.isnan(row)
    if not is_free.any():
        return row, None
    operations = np.where(is_free, _RELINQUISH, _SET).astype(np.uint8)
    return np.where(is_free, 0.0, row), operations.tobytes()


def _rows(samples: Sequence[SampleView]) -> Rows:
    return Rows(np.array([sample.values for sample in samples]), np.array([sample.effective for sample in samples]))
