"""Snapshots and branches: engines forked from those of a running episode.

A snapshot waits at its sample, and an episode can go back there. A branch goes on at once, as a node of its own on
the bus, in a thread of its own; its engines run on whatever core is free. Both end with the node at the latest, and
when the controller that asked for them leaves.
"""

from __future__ import annotations

import itertools
import os
import shutil
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bridge.exchange.actuator_commands import CommandSnapshot
from bridge.exchange.episode import StepExchange
from eplus_node.engine.client import EngineClient, start_all
from eplus_node.engine.group import EngineGroup
from eplus_node.engine.pool import EnginePool, EpisodeWeather, made, weather_fields
from eplus_node.fault_injection import NO_FAULTS
from eplus_node.fault_injection import State as Faulty
from eplus_node.server import NodeServer
from models.scenario.episode import WeatherSource
from topics import keys
from topics.errors import ForkFailed, RequestRejected, did_you_mean
from topics.messages import (
    CreateBranch,
    DropSnapshot,
    ForkStatus,
    Manifest,
    Message,
    Mode,
    Policy,
    Reset,
    State,
    TakeSnapshot,
)

_NOT_OF_A_BRANCH = (
    (keys.RESET, Reset),
    (keys.SNAPSHOT, TakeSnapshot),
    (keys.DROP, DropSnapshot),
    (keys.BRANCH, CreateBranch),
)
_NEVER = "there is nothing to fork: the episode is {}; reset it first"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Where a node stood: engines that wait there, what held, and which weather each slot had."""

    name: str
    owner: str
    episode: list[int]
    step: list[int]
    engines: EngineGroup
    held: CommandSnapshot
    faults: Faulty | None
    positions: list[EpisodeWeather]
    folder: Path

    def drop(self) -> None:
        """Ends its engines; twice is fine."""
        self.engines.end()
        shutil.rmtree(self.folder, ignore_errors=True)


class Branch:
    """A branch, running in a thread of its own until it is told to stop.

    Args:
        runner: on the bus already.
        owner: the controller that asked for it.
        folder: cleared at the end.
        cpus: where its thread runs.
        over: told at the end, in the branch's own thread.
    """

    def __init__(
        self, runner: NodeServer, owner: str, folder: Path, cpus: tuple[int, ...], over: Callable[[str], None]
    ) -> None:
        self.runner, self.owner = runner, owner
        self._folder, self._cpus, self._over = folder, cpus, over
        self._thread = threading.Thread(target=self._serve, name=runner.manifest.node, daemon=True)

    def start(self) -> None:
        """Begins to serve; `RuntimeError` if the system has no thread for it."""
        self._thread.start()

    @property
    def name(self) -> str:
        """Its name on the bus."""
        return self.runner.manifest.node

    def _serve(self) -> None:
        try:
            if self._cpus:
                os.sched_setaffinity(0, self._cpus)
            self.runner.serve()
        finally:
            self.runner.close()
            shutil.rmtree(self._folder, ignore_errors=True)
            self._over(self.name)

    def stop(self) -> None:
        """Tells it to end; any thread may."""
        self.runner.cancel_step()
        self.runner.inlets.post(self.runner.stop_serving)

    def join(self) -> None:
        """Waits for its end."""
        self._thread.join()


class BranchManager:
    """All snapshots and branches of a node.

    Args:
        runner: the node's own; the methods are for its thread.
        folder: for files of engines; the caller removes it.
        cpus: where their engines and threads run; empty leaves it to the system.
        limit: of snapshots and branches at a time.
    """

    def __init__(self, runner: NodeServer, folder: Path, *, cpus: tuple[int, ...], limit: int) -> None:
        self._runner = runner
        self._cpus = cpus
        self._folder = folder
        self._limit = limit
        self._numbers = itertools.count(1)
        self.snapshots: dict[str, Snapshot] = {}
        self.branches: dict[str, Branch] = {}

    def snapshot(self, asked: TakeSnapshot, positions: Callable[[Path], list[EpisodeWeather]]) -> Snapshot:
        """Keeps where the node stands.

        Args:
            asked: by whom.
            positions: the weather of each slot; held in the folder that it is given, too.

        Raises:
            RequestRejected: no episode runs, or there are as many forks as are allowed.
            ForkFailed: the system cannot fork.
        """
        name, folder = self._place("s")
        exchange = self._runner.exchange
        try:
            held = positions(folder)  # first: what fails after the fork would leave its engines
            engines = self._runner.engines.fork(lambda link: self._child(link, folder))
            taken = Snapshot(
                name,
                asked.controller,
                [*exchange.episode],
                [*exchange.step],
                engines,
                exchange.capture(),
                self._runner.injection.state() if self._runner.injection is not None else None,
                held,
                folder,
            )
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self.snapshots[name] = taken
        return taken

    def find(self, name: str) -> Snapshot:
        """A snapshot by its name; `RequestRejected` lists those that are there."""
        if name not in self.snapshots:
            raise RequestRejected(
                f"no snapshot {name!r} on node {self._runner.manifest.node!r}; {did_you_mean(name, self.snapshots)}"
            )
        return self.snapshots[name]

    def drop(self, name: str) -> None:
        """Gives a snapshot's memory back; `RequestRejected` if there is none of that name."""
        self.find(name)
        self.snapshots.pop(name).drop()

    def branch(self, asked: CreateBranch, supplies: Sequence[EnginePool]) -> Branch:
        """Has the node go on twice.

        Args:
            asked: what, and by whom.
            supplies: of each slot.

        Raises:
            RequestRejected: no such slot or snapshot, no episode runs, or there are as many forks as are allowed.
            ForkFailed: the system cannot fork.
        """
        parent = self._runner
        parent.check_slot(asked.slot)
        snapshot = self.find(asked.snapshot) if asked.snapshot else None
        name, folder = self._place("b", waits=snapshot is not None)
        try:
            full = keys.check_name(f"{parent.manifest.node}.{name}", "a branch's name")
            supply = supplies[asked.slot]
            weather = supply.hold(snapshot.positions[asked.slot] if snapshot else supply.position, folder / "in.epw")
            manifest = self._branch_manifest(full, asked.slots, supply.source_of(weather))
            engines = self._engines(snapshot.engines if snapshot else parent.engines, asked, folder)
            runner = self._branch_runner(manifest, engines, asked, snapshot, weather.files.weather)
            branch = self._serve(Branch(runner, asked.controller, folder, self._cpus, self._over))
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return branch

    def _serve(self, branch: Branch) -> Branch:
        self.branches[branch.name] = branch
        try:
            branch.start()
        except RuntimeError as error:  # the system has no thread for it
            del self.branches[branch.name]
            branch.runner.close()
            raise ForkFailed(f"no branch of node {self._runner.manifest.node!r}: {error}") from None
        return branch

    def _engines(self, of: EngineGroup, asked: CreateBranch, folder: Path) -> EngineGroup:
        link = of.links[asked.slot]
        return of.of_slot(asked.slot, start_all(range(asked.slots), lambda _: self._child(link, folder)))

    def _branch_manifest(self, name: str, slots: int, weather: WeatherSource) -> Manifest:
        of = self._runner.manifest
        return of.model_copy(
            update={
                "node": name,
                "branch_of": of.node,
                "slots": slots,
                **weather_fields(weather),
                "baseline": False,
                "warnings": (),
                "mode": Mode.LOCKSTEP,
                "policy": Policy.WAIT,
                "grace_s": 0.0,
                "deadline_s": None,
                "cpu": None,
            }
        )

    def _branch_runner(
        self, manifest: Manifest, engines: EngineGroup, asked: CreateBranch, snapshot: Snapshot | None, weather: Path
    ) -> NodeServer:
        parent, slots = self._runner, asked.slots
        of = snapshot or parent.exchange
        exchange = StepExchange(
            parent.exchange.actuators,
            slots=slots,
            episode=[of.episode[asked.slot]] * slots,
        )
        if not asked.relinquished:
            exchange.restore((snapshot.held if snapshot else parent.exchange.capture()).of_slot(asked.slot, slots))
        exchange.ready(dict.fromkeys(range(slots), of.step[asked.slot]))
        runner = NodeServer(parent.session, parent.plan, manifest, exchange, engines, lambda _: weather)
        present = parent.injection.state() if parent.injection is not None else None
        faults = (snapshot.faults if snapshot is not None else present) or NO_FAULTS
        try:
            runner.inject(faults[0])
            if runner.injection is not None:
                runner.injection.restore(faults, asked.slot)
            runner.declare()
            for topic, message in _NOT_OF_A_BRANCH:
                runner.inlets.request(topic, message, self._refuse)
            runner.inlets.watch(keys.CONTROLLER_TOKEN, lambda who: runner.publish_events(exchange.on_disconnect(who)))
            runner.publish()
            runner.announce()
        except BaseException:
            runner.close()
            raise
        return runner

    def _refuse(self, _: object) -> Message:
        of = self._runner.manifest.node
        raise RequestRejected(
            f"a branch has one episode, and no snapshots and branches of its own; ask its node {of!r}"
        )

    def _place(self, kind: str, *, waits: bool = False) -> tuple[str, Path]:
        """A name and a folder for a fork, if there may be one now."""
        state, limit = self._runner.exchange.state, self._limit
        if not waits and (state is not State.WAITING or any(self._runner.exchange.done)):
            raise RequestRejected(_NEVER.format(state if state in (State.STARTING, State.FAILED) else "over"))
        live = len(self.snapshots) + sum(not branch.runner.stopping for branch in self.branches.values())
        if live >= limit:
            raise RequestRejected(
                f"{live} snapshots and branches are there, and the node allows {limit} (branches={limit}); "
                "close some, or start the node with more"
            )
        name = f"{kind}{next(self._numbers)}"
        return name, made(self._folder / name)

    def _child(self, link: EngineClient, folder: Path) -> EngineClient:
        own = made(folder / str(next(self._numbers)))
        child = link.fork(replace(link.run, folder=own, keep_output=False, cpus=self._cpus, poll=False, branch=True))
        try:
            child.receive()
        except BaseException:
            child.close()
            raise
        return child

    def fork_baseline(self, link: EngineClient) -> EngineClient:
        """A fork that goes on beside an engine, for the baseline.

        Raises:
            SimulatorError: it cannot be forked.
        """
        return self._child(link, self._folder / "baseline")

    def _over(self, name: str) -> None:
        def forget() -> None:
            self.branches.pop(name, None)

        self._runner.inlets.post(forget)

    # The others' ends

    def on_disconnect(self, owner: str) -> None:
        """A controller has gone: what it asked for ends."""
        for name in [name for name, snapshot in self.snapshots.items() if snapshot.owner == owner]:
            self.drop(name)
        for branch in self.branches.values():
            if branch.owner == owner:
                branch.stop()

    def notify_all(self) -> None:
        """Has each branch look after its engines; any thread may."""
        for branch in [*self.branches.values()]:
            branch.runner.inlets.notify()

    def cancel_steps(self) -> None:
        """Has no branch wait for an engine that is computing; any thread may."""
        for branch in [*self.branches.values()]:
            branch.runner.cancel_step()

    def close(self) -> None:
        """Ends all; twice is fine."""
        for branch in self.branches.values():
            branch.stop()
        for branch in self.branches.values():
            branch.join()
        self.branches.clear()
        for name in [*self.snapshots]:
            self.snapshots.pop(name).drop()

    def status(self, *, memory: bool) -> tuple[list[ForkStatus], list[ForkStatus]]:
        """The snapshots, and the branches; any thread may ask."""
        kept = [(s.name, s.owner, s.step, s.engines) for s in [*self.snapshots.values()]]
        running = [(b.name, b.owner, b.runner.exchange.step, b.runner.engines) for b in [*self.branches.values()]]
        return _told(kept, memory=memory), _told(running, memory=memory)


def _told(forks: Sequence[tuple[str, str, list[int], EngineGroup]], *, memory: bool) -> list[ForkStatus]:
    return [
        ForkStatus(
            name=name,
            owner=owner,
            step=step[0],
            engines=len(engines.all),
            private_bytes=engines.private_bytes if memory else 0,
        )
        for name, owner, step, engines in forks
    ]
