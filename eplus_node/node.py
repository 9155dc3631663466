"""The node: one building on the bus, its episodes, and the snapshots and branches that are made of them."""

from __future__ import annotations

import gc
import os
import signal
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import FrameType

from bridge.exchange.episode import StepExchange
from bridge.runtime import affinity
from bridge.runtime.scratch import Scratch, sweep
from bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from bridge.transport.session import open_session
from eplus_node.branches import BranchManager
from eplus_node.config import NodeConfig, Plan, plan
from eplus_node.engine.client import EngineClient, start_all
from eplus_node.engine.group import EngineGroup
from eplus_node.engine.pool import EnginePool, EngineTemplate, weather_fields
from eplus_node.engine.registry import EngineRegistry
from eplus_node.fault_injection import NO_FAULTS
from eplus_node.fault_injection import State as Faulty
from eplus_node.server import NodeServer, Observer, Stopped
from eplus_node.shutdown import LIMIT_S, Ending
from models import energyplus
from topics import VERSION, codec, errors, keys
from topics.errors import NameInUse, SimulatorError
from topics.messages import (
    Ack,
    BranchCreated,
    CreateBranch,
    DropSnapshot,
    EngineStart,
    EpisodeStart,
    EventKind,
    Manifest,
    Message,
    Query,
    Reset,
    SnapshotTaken,
    State,
    TakeSnapshot,
    Versions,
)

_KEEP_S = 35.0
"""How long a node may take to end whose EnergyPlus finishes the files that are kept."""


class Node:
    """A building on the bus. `with Node(config) as node: node.serve()`, in the main thread.

    Args:
        config: what to simulate, and how.
        observer: told of each sample and event.
        program: the process is the node's alone, and is ended if the node does not come to its end in time.

    Attributes:
        runner: what it is on the bus.

    Raises (on entering):
        UsageError, SimulatorError, BusError: see `topics.errors`; nothing is left behind.
    """

    def __init__(self, config: NodeConfig, observer: Observer | None = None, *, program: bool = False) -> None:
        self.config = config
        self._observer = observer
        self._registry = EngineRegistry(config.unresponsive_s)
        self._scratch: Scratch | None = None
        limit_s = LIMIT_S if config.output_dir is None else _KEEP_S
        self._ending = Ending(self._stop_waiting, self._give_up if program else None, limit_s)
        self._runs: NodeServer | None = None
        self._close = ExitStack()

    # Life

    def __enter__(self) -> Node:
        with ExitStack() as undo:
            undo.callback(self.close)
            self._close.enter_context(self._ending)
            self.plan: Plan = plan(self.config)
            self._place()
            self._open_bus()
            self._make_folder()
            self._supplies = self._supply()
            for supply in self._supplies:
                self._close.callback(supply.close)
            self._run()
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the engines, leaves the bus and clears up; twice is fine. Who asks again meanwhile changes nothing."""
        with override_signals(lambda *_: None, *TERMINATION_SIGNALS):  # who asks again only has the end hurried
            self._registry.close()
            self._close.close()

    @property
    def manifest(self) -> Manifest:
        """What the node is."""
        return self.runner.manifest

    @property
    def exchange(self) -> StepExchange:
        """Where it stands."""
        return self.runner.exchange

    def _place(self) -> None:
        """Which cores are whose; several slots have all of them, and the node a part of one."""
        config = self.config
        self._cpus = affinity.allowed()
        self._engine_cpu, self.cpu = config.engine_cpu, config.cpu
        if config.cpu is None:
            self._engine_cpu, self.cpu = affinity.pick_cores(config.affinity)
        affinity.set_affinity(self.cpu)

    def _open_bus(self) -> None:
        config = self.config
        self.session = self._close.enter_context(
            open_session(
                listen=config.listen,
                connect=config.connect,
                expose=config.expose,
                keys=config.keys,
                role=keys.Role.NODE,
                certificate=config.certificate,
            )
        )
        self.instance = str(self.session.zid())
        self._refuse_second(config.name)

    def _tokens(self) -> list[str]:
        replies = self.session.liveliness().get(keys.NODE_TOKEN.at(self.config.name, name="*"))
        return [keys.last_chunk(str(reply.ok.key_expr)) for reply in replies if reply.ok]

    def _refuse_second(self, name: str) -> None:
        others = [token for token in self._tokens() if token != self.instance]
        if others:
            raise NameInUse(f"a node named {name!r} is on this bus already (instance {others[0]}); name this one else")

    def _make_folder(self) -> None:
        sweep()
        self._scratch = Scratch(self.config.folder)
        self._close.callback(self._scratch.remove)
        self._folder = self._scratch.folder

    def _supply(self) -> list[EnginePool]:
        waiting, slots = EngineTemplate(), self.config.slots
        if slots == 1:
            cpus = () if self._engine_cpu is None else (self._engine_cpu,)
            poll, spare = self._engine_cpu != self.cpu, self._without(cpus)
            return [
                EnginePool(self.plan, self._folder, waiting, cpus=cpus, spare=spare, poll=poll, registry=self._registry)
            ]
        # In blocks, the node's core last: engines there may have it before it has told all others to go.
        cores = sorted(self._cpus, key=lambda core: core == self.cpu) if self.cpu is not None else []
        own = [(cores[slot * len(cores) // slots],) if cores else () for slot in range(slots)]
        return [
            EnginePool(
                self.plan,
                self._folder,
                waiting,
                place=f"slot-{slot}",
                cpus=cpus,
                spare=self._without(cpus),
                registry=self._registry,
            )
            for slot, cpus in enumerate(own)
        ]

    def _without(self, cpus: tuple[int, ...]) -> tuple[int, ...]:
        """The other cores that the node may use; all, if there are no others."""
        return tuple(core for core in self._cpus if core not in cpus) or self._cpus

    def _weather_file(self, slot: int) -> Path:
        return self._supplies[slot].files.weather

    def _run(self) -> None:
        """The engines start, then the node shows itself: what it answers first, its presence last."""
        slots = range(self.config.slots)
        config = self.config
        exchange = StepExchange(
            self.plan.points.actuators,
            slots=config.slots,
            mode=config.mode,
            policy=config.policy,
            deadline_s=config.deadline_s,
        )
        engines = EngineGroup(self._engines(slots, exchange.episode))
        self._close.callback(engines.end)
        engines.begin(slots)
        self.runner = NodeServer(
            self.session, self.plan, self._manifest(), exchange, engines, self._weather_file, self._observer
        )
        self.runner.interrupt, self.runner.on_stop = self._registry.interrupt, self._stop_asked
        self._close.callback(self.runner.close)
        if self.config.output_dir is None:
            self._close.callback(self._registry.interrupt)  # all at once, which is quicker than one by one
        if self.plan.faults is not None:
            self.runner.inject(self.plan.faults)
        self.forks = BranchManager(self.runner, self._folder, cpus=self._cpus, limit=self.config.branches)
        self._close.callback(self.forks.close)
        self._runs = self.runner
        self._compare(slots)
        self._announce()

    def _announce(self) -> None:
        runner = self.runner
        runner.declare(self.status)
        inlets = runner.inlets
        inlets.watch(keys.CONTROLLER_TOKEN, self._left)
        inlets.request(keys.RESET, Reset, self._reset)
        inlets.request(keys.SNAPSHOT, TakeSnapshot, self._snapshot)
        inlets.request(keys.DROP, DropSnapshot, self._drop)
        inlets.request(keys.BRANCH, CreateBranch, self._branch)
        self._close.callback(signal.signal, signal.SIGCHLD, signal.getsignal(signal.SIGCHLD))
        signal.signal(signal.SIGCHLD, self._on_child)
        runner.exchange.ready()
        runner.begin_episodes([*range(self.config.slots)], [None] * self.config.slots)
        self._tell_begin("")
        for warning in self.plan.warnings:
            runner.event(runner.exchange.event(EventKind.WARNING, warning))
        runner.publish()
        runner.announce()
        if any(token < self.instance for token in self._tokens()):
            self._refuse_second(self.config.name)  # two that started at once: the one with the lower id stays

    def _manifest(self) -> Manifest:
        plan, config, source = self.plan, self.config, self._supplies[0].source
        return Manifest(
            node=config.name,
            instance=self.instance,
            building=plan.building.name,
            **weather_fields(source),
            begin=plan.period.time(0).isoformat(),
            end=plan.period.time(plan.period.steps).isoformat(),
            steps_per_hour=plan.period.steps_per_hour,
            steps=plan.period.steps,
            slots=config.slots,
            baseline=config.baseline,
            mode=config.mode,
            speed=config.speed,
            policy=config.policy,
            grace_s=config.grace_s,
            deadline_s=config.deadline_s,
            sensors=plan.points.sensors,
            meters=plan.points.meters,
            actuators=plan.points.actuators,
            task=plan.task,
            warnings=plan.warnings,
            versions=Versions(zenostat=VERSION, energyplus=energyplus.version()),
            host=affinity.host(),
            cpu=self.cpu,
        )

    def serve(self) -> None:
        """Serves until it is told to stop (by a request, a signal, or its owner's end)."""
        gc.freeze()  # what is loaded by now stays; collections need not look at it
        with override_signals(self._on_signal, *TERMINATION_SIGNALS):
            self.runner.serve()

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        # Nothing is raised here: it could be anywhere, in the midst of a thread's start as well.
        self.runner.inlets.post_first(self.runner.stop_serving)

    def _stop_asked(self) -> None:
        self.runner.cancel_step()
        self._ending.ask()

    def _stop_waiting(self, signals: int) -> None:
        """Waits for no engine any more, unless it finishes files that are kept; any thread may."""
        self._registry.close()
        if self._runs is not None:
            self._runs.cancel_step()
            self.forks.cancel_steps()
        if signals > 1 or self.config.output_dir is None or self._runs is None:
            self._registry.interrupt()

    def _give_up(self) -> None:
        """Ends the process in the midst of whatever it does, and leaves nothing; any thread may."""
        self._registry.interrupt()
        if self._scratch is not None:
            self._scratch.remove()
        os.write(2, f"node {self.config.name!r} did not end in time, and was ended\n".encode())
        os._exit(0)

    def _on_child(self, _number: int, _frame: FrameType | None) -> None:
        self.runner.inlets.notify()  # an engine's end is seen while nothing else comes
        self.forks.notify_all()

    def _left(self, who: str) -> None:
        self.runner.on_disconnect(who)
        self.forks.on_disconnect(who)

    # Episodes

    def _engines(self, slots: range | list[int], episode: list[int]) -> list[EngineClient]:
        """Engines at sample 0 of the present episodes of some slots."""
        supplies = self._supplies
        for slot in slots:
            supplies[slot].begin()
        return start_all(slots, lambda slot: supplies[slot].engine(episode[slot]))

    def _compare(self, slots: range | list[int]) -> None:
        """Forks the engines that nobody commands beside the ones of some slots."""
        engines = self.runner.engines
        if not self.config.baseline:
            return
        made = start_all(slots, lambda slot: self.forks.fork_baseline(engines.links[slot]))
        if not engines.baselines:
            engines.baselines = made
            return
        for slot, link in zip(slots, made, strict=True):
            engines.baselines[slot].close()
            engines.baselines[slot] = link

    def _reset(self, reset: Reset) -> Message:
        given = list(dict.fromkeys(reset.slots)) if reset.slots is not None else [*range(self.config.slots)]
        by_slot = dict(sorted(zip(given, self._seeds(reset, given), strict=True)))
        slots, seeds = [*by_slot], [*by_slot.values()]
        self.runner.check_slot(slots[-1])
        if reset.snapshot:
            return self._go_back(reset, slots)
        exchange = self.exchange
        if exchange.state is State.FAILED and len(slots) < self.config.slots:
            raise errors.RequestRejected("the engines have ended; reset all slots")
        untouched = [exchange.state is State.WAITING and not exchange.modified[slot] for slot in slots]
        exchange.reset(slots)
        try:
            starts = [
                self._supplies[slot].next_episode(seed, exchange.episode[slot], untouched=same)
                for slot, seed, same in zip(slots, seeds, untouched, strict=True)
            ]
        except SimulatorError as error:
            self.runner.fail(error)
            raise
        # The answer goes out before the start, which takes seconds in large buildings.
        self.runner.inlets.post_first(lambda: self._restart(slots, starts, seeds, reset.controller))
        return self._accepted(slots, starts)

    def _seeds(self, reset: Reset, slots: list[int]) -> list[int | None]:
        if isinstance(reset.seed, list):
            if len(reset.seed) != len(slots):
                raise errors.RequestRejected(
                    f"{len(reset.seed)} seeds for {len(slots)} slots; one each, or a single one"
                )
            return reset.seed
        return [None if reset.seed is None else reset.seed + place for place in range(len(slots))]

    def _accepted(self, slots: list[int], starts: list[EngineStart]) -> Ack:
        begun = [
            EpisodeStart(
                engine_start=start,
                weather=supply.source.name,
                noise_parameters=supply.files.noise_parameters,
                output_dir=supply.output_dir,
            )
            for start, supply in zip(starts, [self._supplies[slot] for slot in slots], strict=True)
        ]
        return Ack(episode=self.exchange.episode, episode_starts=begun)

    def _restart(self, slots: list[int], starts: list[EngineStart], seeds: list[int | None], source: str) -> None:
        runner, engines = self.runner, self.runner.engines
        fresh = [
            slot
            for slot, start in zip(slots, starts, strict=True)
            if start is not EngineStart.REUSED or not engines.links[slot].alive
        ]
        former = [engines.links[slot] for slot in fresh]
        # The former engines' end, which takes as long as a fork, can wait for these.
        quick = all(start in (EngineStart.FORKED, EngineStart.PREFETCHED, EngineStart.REUSED) for start in starts)
        if not quick:
            self._end(former)
        try:
            for slot, link in zip(fresh, self._engines(fresh, self.exchange.episode), strict=True):
                engines.links[slot] = link
            if fresh:
                self._compare(fresh)
        except SimulatorError as error:
            self._end(former)
            if runner.stopping:
                raise Stopped from None
            runner.fail(error)
            return
        engines.begin(slots)
        self._begin(dict.fromkeys(slots, 0), source, seeds)
        if quick:
            self._end(former)
        for slot in slots:
            self._supplies[slot].prefetch(self.exchange.episode[slot])

    def _end(self, links: list[EngineClient]) -> None:
        for link in links:
            link.end(failed=self.exchange.state is State.FAILED)

    def _begin(self, at: dict[int, int], source: str, seeds: list[int | None], faults: Faulty | None = None) -> None:
        """Episodes begin (slot to sample), of engines that are there; with the faults of a snapshot."""
        runner = self.runner
        runner.exchange.ready(at)
        runner.begin_episodes([*at], seeds)
        told = runner.manifest
        if faults is not None:
            runner.inject(faults[0])
            if runner.injection is not None:
                runner.injection.restore(faults)
        runner.failure = runner.failure_error = ""
        if told.weather != self._supplies[0].source.name:
            present = runner.manifest
            kept = {"mode": present.mode, "speed": present.speed, "faults_injected": present.faults_injected}
            runner.manifest = self._manifest().model_copy(update=kept)
        if runner.manifest != told:
            runner.outlets.manifest(runner.manifest)
        self._tell_begin(source)
        runner.publish()

    def _tell_begin(self, source: str) -> None:
        for supply in self._supplies:
            while supply.warnings:
                self.runner.event(self.exchange.event(EventKind.WARNING, supply.warnings.pop(0)))
        self.runner.event(self.exchange.event(EventKind.STARTED, self._begins(), source))

    def _begins(self) -> str:
        """What the episode simulates, in a line."""
        source, drawn = self._supplies[0].source, self._supplies[0].files.noise_parameters
        parts = [f"episode {self.exchange.episode[0]} of {self.manifest.building} begins", source.name]
        parts += [source.site.source] if source.site is not None else []
        parts += self.plan.building.notes
        parts += [f"{name} {value:.4g}" for name, value in drawn.items()]
        return "; ".join(parts)

    # Snapshots and branches

    def _snapshot(self, asked: TakeSnapshot) -> Message:
        taken = self.forks.snapshot(
            asked,
            lambda folder: [s.hold(s.position, folder / f"slot-{i}.epw") for i, s in enumerate(self._supplies)],
        )
        text = f"snapshot {taken.name} at step {taken.step[0]}"
        self.runner.event(self.exchange.event(EventKind.SNAPSHOT, text, asked.controller))
        return SnapshotTaken(snapshot=taken.name, episode=taken.episode, step=taken.step)

    def _drop(self, asked: DropSnapshot) -> Message:
        self.forks.drop(asked.snapshot)
        return Ack(episode=self.exchange.episode)

    def _branch(self, asked: CreateBranch) -> Message:
        branch = self.forks.branch(asked, self._supplies)
        self.runner.event(self.exchange.event(EventKind.BRANCH_CREATED, f"branch {branch.name}", asked.controller))
        return BranchCreated(node=branch.name)

    def _go_back(self, reset: Reset, slots: list[int]) -> Message:
        """The engines are forked before the present episode ends: if that fails, it goes on."""
        exchange, engines = self.exchange, self.runner.engines
        if len(slots) != self.config.slots:
            raise errors.RequestRejected("a snapshot is of all slots; reset all of them to it")
        snapshot = self.forks.find(reset.snapshot)
        episode = [number + 1 for number in exchange.episode]
        held = [
            supply.hold_for(position, number)
            for supply, position, number in zip(self._supplies, snapshot.positions, episode, strict=True)
        ]
        forks = [
            *(
                partial(supply.fork, link, number)
                for supply, link, number in zip(self._supplies, snapshot.engines.links, episode, strict=True)
            ),
            *(partial(self.forks.fork_baseline, link) for link in snapshot.engines.baselines),
        ]
        made = start_all(forks, lambda fork: fork())
        made, beside = made[: self.config.slots], made[self.config.slots :]
        for supply, position in zip(self._supplies, held, strict=True):
            supply.go_back(position)
        exchange.reset()
        former, engines.links = engines.links, made
        former += engines.baselines
        engines.baselines = beside
        engines.effective, engines.source_index = snapshot.engines.effective, snapshot.engines.source_index
        exchange.restore(snapshot.held)
        self._begin(dict(enumerate(snapshot.step)), reset.controller, [None] * len(slots), snapshot.faults or NO_FAULTS)
        self._end(former)
        return self._accepted(slots, [EngineStart.SNAPSHOT] * len(slots))

    def status(self, asked: Query) -> bytes:
        """Where the node stands; any thread may ask."""
        snapshots, branches = self.forks.status(memory=asked.memory)
        told = self.runner.status(memory=asked.memory)
        return codec.encode(told.model_copy(update={"snapshots": snapshots, "branches": branches}))
