"""Snapshots and branches: copies of the plant of a running episode.

A snapshot waits at its sample, and an episode can go back to it. A branch runs at once, as a node of its own on the
bus, in a thread of its own; its simulators run on any free core. Both end when the node ends, or when the controller
that asked for them leaves the bus.
"""

from __future__ import annotations

import itertools
import os
import shutil
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from zenostat.bridge.engine.registry import EngineRegistry
from zenostat.bridge.exchange.actuator_commands import CommandSnapshot
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.node.fault_injection import NO_FAULTS, FaultState
from zenostat.bridge.node.manifest import site_fields
from zenostat.bridge.node.names import BranchNames
from zenostat.bridge.node.planning import require_episodes
from zenostat.bridge.node.plant import ForecastPlant, RunningPlant
from zenostat.bridge.node.server import NodeServer
from zenostat.topics import keys
from zenostat.topics.errors import ForkFailed, RequestRejected, did_you_mean
from zenostat.topics.messages import (
    CreateBranch,
    DropSnapshot,
    EventKind,
    ForkStatus,
    Manifest,
    Message,
    Mode,
    Policy,
    Reset,
    Revoke,
    StartRecording,
    StopRecording,
    TakeSnapshot,
)

if TYPE_CHECKING:
    from zenostat.bridge.alarms.monitor import AlarmSnapshot

_NODE_REQUESTS = (
    (keys.RESET, Reset),
    (keys.SNAPSHOT, TakeSnapshot),
    (keys.DROP_SNAPSHOT, DropSnapshot),
    (keys.BRANCH, CreateBranch),
    (keys.RECORD, StartRecording),
    (keys.STOP_RECORDING, StopRecording),
    (keys.REVOKE, Revoke),
)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State of a node at one sample.

    Attributes:
        name: of the snapshot.
        owner: the controller that asked for it.
        episode, step: of each slot.
        plant: a copy of the node's.
        commands: those in effect.
        received: the actuator values that the plant received last, after faults; empty if there was no timestep.
        faults: those that are injected.
        alarms: their states.
        folder: for the files of the copy.
    """

    name: str
    owner: str
    episode: list[int]
    step: list[int]
    plant: RunningPlant
    commands: CommandSnapshot
    received: bytes
    faults: FaultState | None
    alarms: AlarmSnapshot | None
    folder: Path

    @classmethod
    def of(cls, server: NodeServer, name: str, owner: str, folder: Path) -> Snapshot:
        """Take a snapshot of a node; `ForkFailed` if its plant cannot be copied."""
        exchange, injection = server.exchange, server.injection
        return cls(
            name,
            owner,
            [*exchange.episode],
            [*exchange.step],
            server.plant.fork(range(exchange.slots), folder, baseline=True),
            exchange.capture(),
            server.received,
            injection.state() if injection is not None else None,
            server.alarms.capture() if server.alarms is not None else None,
            folder,
        )

    def drop(self) -> None:
        """End its simulators and remove its files; idempotent."""
        self.plant.close()
        shutil.rmtree(self.folder, ignore_errors=True)


class Branch:
    """A branch, which runs in a thread of its own until it is stopped.

    Args:
        server: on the bus already.
        owner: the controller that asked for it.
        folder: removed at the end.
        cpus: where its thread runs.
        on_end: called with its name at the end, in the branch's thread.
    """

    def __init__(
        self, server: NodeServer, owner: str, folder: Path, cpus: tuple[int, ...], on_end: Callable[[str], None]
    ) -> None:
        self.server, self.owner = server, owner
        self._folder, self._cpus, self._on_end = folder, cpus, on_end
        self._thread = threading.Thread(target=self._serve, name=server.manifest.node, daemon=True)

    def start(self) -> None:
        """Start serving; `RuntimeError` if the system cannot start a thread."""
        self._thread.start()

    @property
    def name(self) -> str:
        """Its name on the bus."""
        return self.server.manifest.node

    def _serve(self) -> None:
        try:
            if self._cpus:
                os.sched_setaffinity(0, self._cpus)
            self.server.serve()
        finally:
            self.server.close()
            shutil.rmtree(self._folder, ignore_errors=True)
            self._on_end(self.name)

    def stop(self) -> None:
        """Ask the branch to end; thread-safe."""
        self.server.cancel_step()
        self.server.subscriptions.post(self.server.stop_serving)

    def join(self) -> None:
        """Wait for the branch to end."""
        self._thread.join()


class BranchManager:
    """All snapshots and branches of a node. Its methods are for the node's thread, unless noted.

    Args:
        server: the node's own.
        folder: for the files of the copies; the caller removes it.
        cpus: where their threads run; empty leaves it to the system.
        limit: maximum number of snapshots and of slots of branches at a time.
        registry: of the node's engines.
    """

    def __init__(
        self, server: NodeServer, folder: Path, *, cpus: tuple[int, ...], limit: int, registry: EngineRegistry
    ) -> None:
        self._server = server
        self._registry = registry
        self._cpus = cpus
        self._folder = folder
        self._limit = limit
        self._numbers = itertools.count(1)
        self.snapshots: dict[str, Snapshot] = {}
        self.branches: dict[str, Branch] = {}
        self._taken: BranchNames | None = None

    def declare(self) -> None:
        """Follow the names of other nodes, which branches do not take."""
        server = self._server
        self._taken = BranchNames(
            server.session,
            server.manifest.node,
            lambda name: server.subscriptions.post(lambda: self._on_taken(name)),
        )

    def _on_taken(self, name: str) -> None:
        """End a branch, as another node has its name: both would answer requests."""
        branch = self.branches.get(name)
        if branch is None or branch.server.stopping:
            return
        text = f"branch {name} ends, because another node of this name is on the bus now"
        self._server.event(self._server.exchange.event(EventKind.WARNING, text))
        branch.stop()

    def snapshot(self, request: TakeSnapshot) -> Snapshot:
        """Take a snapshot, which the controller of the request owns.

        Raises:
            RequestRejected: no episode is running, or the limit is reached.
            ForkFailed, SimulatorError: the plant cannot be copied, or `cancel_copying` was called.
        """
        name, folder = self._allocate("s")
        try:
            with self._registry.copying():
                self.snapshots[name] = Snapshot.of(self._server, name, request.controller, folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return self.snapshots[name]

    def find(self, name: str) -> Snapshot:
        """Return a snapshot by its name; raise `RequestRejected` with similar names if there is none."""
        if name not in self.snapshots:
            raise RequestRejected(
                f"no snapshot {name!r} on node {self._server.manifest.node!r}; {did_you_mean(name, self.snapshots)}"
            )
        return self.snapshots[name]

    def drop(self, name: str) -> None:
        """End a snapshot, which frees its memory; raise `RequestRejected` if there is none of that name."""
        self.find(name)
        self.snapshots.pop(name).drop()

    def branch(self, request: CreateBranch) -> Branch:
        """Create a branch from the present sample or from a snapshot; the controller of the request owns it.

        Raises:
            RequestRejected: no such slot or snapshot, no episode is running, or the limit is reached.
            ForkFailed, SimulatorError: the plant cannot be copied, or `cancel_copying` was called.
        """
        parent = self._server
        parent.check_slot(request.slot)
        snapshot = self.find(request.snapshot) if request.snapshot else None
        name, folder = self._allocate("b", request.slots, from_snapshot=snapshot is not None)
        with ExitStack() as undo:
            undo.callback(shutil.rmtree, folder, ignore_errors=True)
            full_name = keys.check_name(self._full_name(name), "a branch's name")
            origin = snapshot.plant if snapshot is not None else parent.plant
            with self._registry.copying():
                plant = _fork(origin, request, folder)
            undo.callback(plant.close)
            server = self._branch_server(full_name, plant, request, snapshot, folder)
            branch = self._start(Branch(server, request.controller, folder, self._cpus, self._on_end))
            undo.pop_all()
        return branch

    def cancel_copying(self, reason: str) -> None:
        """Give up the snapshot or the branch that is being created, if any; thread-safe."""
        self._registry.cancel_copying(reason)

    def _start(self, branch: Branch) -> Branch:
        self.branches[branch.name] = branch
        try:
            branch.start()
        except RuntimeError as error:  # the system cannot start a thread
            del self.branches[branch.name]
            branch.server.close()
            raise ForkFailed(f"cannot branch node {self._server.manifest.node!r}: {error}") from None
        return branch

    def _branch_manifest(self, name: str, slots: int, plant: RunningPlant) -> Manifest:
        manifest = self._server.manifest
        return manifest.model_copy(
            update={
                "node": name,
                "branch_of": manifest.node,
                "slots": slots,
                **site_fields(plant.site(0)),
                "baseline": False,
                "warnings": (),
                "history_samples": 0,
                "history_bytes": 0,
                "mode": Mode.LOCKSTEP,
                "policy": Policy.WAIT,
                "grace_s": 0.0,
                "deadline_s": None,
                "cpu": None,
            }
        )

    def _branch_server(
        self, name: str, plant: RunningPlant, request: CreateBranch, snapshot: Snapshot | None, folder: Path
    ) -> NodeServer:
        parent, slots = self._server, request.slots
        origin = snapshot or parent.exchange
        exchange = StepExchange(
            parent.exchange.actuators,
            slots=slots,
            episode=[origin.episode[request.slot]] * slots,
            connected=parent.exchange.connected,
        )
        commands = None
        if not request.relinquished:
            commands = (snapshot.commands if snapshot else parent.exchange.capture()).of_slot(request.slot, slots)
        exchange.ready(monotonic(), dict.fromkeys(range(slots), origin.step[request.slot]), commands)
        manifest = self._branch_manifest(name, slots, plant)
        alarms = None
        if parent.alarms is not None:
            alarms = parent.alarms.of_branch(request.slot, slots, snapshot.alarms if snapshot is not None else None)
        server = NodeServer(parent.session, plant, manifest, exchange, alarms=alarms, folder=folder)
        if parent.access is not None:
            server.access = parent.access.of_branch(request.controller)
        present = parent.injection.state() if parent.injection is not None else None
        faults = (snapshot.faults if snapshot is not None else present) or NO_FAULTS
        received = snapshot.received if snapshot is not None else parent.received
        size = len(received) // parent.manifest.slots
        server.received = received[request.slot * size : (request.slot + 1) * size] * slots
        try:
            server.inject(faults[0])
            if server.injection is not None:
                server.injection.restore(faults, request.slot)
            server.declare()
            for topic, kind in _NODE_REQUESTS:
                server.subscriptions.request(topic, kind, self._reject)
            server.subscriptions.watch_presence(
                lambda controller: server.publish_events(exchange.fallback.on_disconnect(controller, monotonic())),
                server.on_reconnect,
            )
            server.revoke_again()
            server.publish()
            server.announce()
        except BaseException:
            server.close()
            raise
        return server

    def _reject(self, _: object) -> Message:
        raise RequestRejected(
            "a branch has a single episode and no snapshots, branches or recordings; ask its node "
            f"{self._server.manifest.node!r}"
        )

    def _allocate(self, prefix: str, slots: int = 1, *, from_snapshot: bool = False) -> tuple[str, Path]:
        """Return a name and a folder for a fork; raise `RequestRejected` if it is not allowed now."""
        limit = self._limit
        if not from_snapshot:
            require_episodes(self._server.exchange, "fork")
        branches = [branch.server for branch in self.branches.values() if not branch.server.stopping]
        count = len(self.snapshots) + sum(server.manifest.slots for server in branches)
        if count + slots > limit:
            more = f", and {slots} slots would be added" if slots > 1 else ""
            raise RequestRejected(
                f"the node has {count} snapshots and branches, counted by slots, and allows {limit} (branches={limit})"
                f"{more}; close some, or start the node with a higher limit"
            )
        names = (f"{prefix}{number}" for number in self._numbers)
        name = next(name for name in names if self._taken is None or self._full_name(name) not in self._taken)
        return name, self._folder / name

    def _full_name(self, name: str) -> str:
        return f"{self._server.manifest.node}.{name}"

    def _on_end(self, name: str) -> None:
        def remove() -> None:
            self.branches.pop(name, None)

        self._server.subscriptions.post(remove)

    def on_disconnect(self, owner: str) -> None:
        """End the snapshots and branches of a controller that has left."""
        for name in [name for name, snapshot in self.snapshots.items() if snapshot.owner == owner]:
            self.drop(name)
        for branch in self.branches.values():
            if branch.owner == owner:
                branch.stop()

    def revoke(self, name: str) -> None:
        """End the snapshots and branches of a certificate's name that is revoked, and its claims on other branches."""
        owners = {snapshot.owner for snapshot in self.snapshots.values()}
        owners |= {branch.owner for branch in self.branches.values()}
        for owner in owners:
            if keys.is_own(name, owner):
                self.on_disconnect(owner)
        for branch in [*self.branches.values()]:
            if not keys.is_own(name, branch.owner):
                branch.server.subscriptions.post(lambda server=branch.server: server.revoke(name))  # type: ignore[misc]

    def notify_all(self) -> None:
        """Wake each branch so that it checks its engines; thread-safe."""
        for branch in [*self.branches.values()]:
            branch.server.subscriptions.notify()

    def cancel_steps(self) -> None:
        """Interrupt the engines of all branches that are computing; thread-safe."""
        for branch in [*self.branches.values()]:
            branch.server.cancel_step()

    def close(self) -> None:
        """End all snapshots and branches; idempotent."""
        if self._taken is not None:
            self._taken.close()
            self._taken = None
        for branch in self.branches.values():
            branch.stop()
        for branch in self.branches.values():
            branch.join()
        self.branches.clear()
        for name in [*self.snapshots]:
            self.snapshots.pop(name).drop()

    def status(self, *, memory: bool) -> tuple[list[ForkStatus], list[ForkStatus]]:
        """Return the status of all snapshots and of all branches; thread-safe."""
        snapshots = [(s.name, s.owner, s.step, s.plant) for s in [*self.snapshots.values()]]
        branches = [(b.name, b.owner, b.server.exchange.step, b.server.plant) for b in [*self.branches.values()]]
        return _fork_status(snapshots, memory=memory), _fork_status(branches, memory=memory)


def _fork(origin: RunningPlant, request: CreateBranch, folder: Path) -> RunningPlant:
    slots = [request.slot] * request.slots
    if not request.forecast_error:
        return origin.fork(slots, folder)
    if not isinstance(origin, ForecastPlant):
        raise RequestRejected("this plant has no outdoor temperature that a forecast error could change")
    return origin.fork_with_error(slots, folder, request.forecast_error)


def _fork_status(forks: Sequence[tuple[str, str, list[int], RunningPlant]], *, memory: bool) -> list[ForkStatus]:
    return [
        ForkStatus(
            name=name,
            owner=owner,
            step=step[0],
            engines=plant.simulators,
            private_bytes=plant.memory_bytes(private=True) if memory else 0,
        )
        for name, owner, step, plant in forks
    ]
