"""The episodes of a node: reset, go back to a snapshot, branch."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from bridge.exchange.step_exchange import StepExchange
from eplus_node.branches import BranchManager
from eplus_node.engine.client import EngineClient, start_all
from eplus_node.engine.pool import EnginePool
from eplus_node.fault_injection import NO_FAULTS, FaultState
from eplus_node.manifests import weather_fields
from eplus_node.plan import Plan
from eplus_node.server import NodeServer, Stopped
from topics import keys
from topics.errors import RequestRejected, SimulatorError
from topics.messages import (
    Ack,
    BranchCreated,
    CreateBranch,
    DropSnapshot,
    EngineStart,
    EpisodeStart,
    EventKind,
    Message,
    Reset,
    SnapshotTaken,
    State,
    TakeSnapshot,
)


def start_engines(pools: Sequence[EnginePool], slots: Sequence[int], episode: Sequence[int]) -> list[EngineClient]:
    """Return engines at sample 0 of the present episodes of some slots.

    Args:
        pools: by slot.
        slots: of these.
        episode: numbers of the episodes, by slot.
    """
    for slot in slots:
        pools[slot].start()
    return start_all(slots, lambda slot: pools[slot].engine(episode[slot]))


class EpisodeManager:
    """Resets, snapshots and branches of a node. Its methods are for the server's thread.

    A reset is answered before its engines start; `_start_episodes` then ends the previous engines, starts the new ones
    and publishes sample 0.

    Args:
        server: the node on the bus.
        plan: what it simulates.
        pools: the engines of each slot.
        branches: the node's snapshots and branches.
    """

    def __init__(self, server: NodeServer, plan: Plan, pools: Sequence[EnginePool], branches: BranchManager) -> None:
        self._server, self._plan, self._pools, self._branches = server, plan, pools, branches
        self._slots = len(pools)

    @property
    def _exchange(self) -> StepExchange:
        return self._server.exchange

    def declare(self) -> None:
        """Answer requests about episodes, snapshots and branches."""
        subscriptions = self._server.subscriptions
        subscriptions.request(keys.RESET, Reset, self._reset)
        subscriptions.request(keys.SNAPSHOT, TakeSnapshot, self._snapshot)
        subscriptions.request(keys.DROP, DropSnapshot, self._drop)
        subscriptions.request(keys.BRANCH, CreateBranch, self._branch)

    def begin_first(self) -> None:
        """Begin the first episodes; the engines are at sample 0. The caller publishes it."""
        self._exchange.ready()
        self._server.begin_episodes([*range(self._slots)], [None] * self._slots)
        self._publish_start("")

    def fork_baselines(self, slots: Sequence[int]) -> None:
        """Fork the engines of some slots for the baseline, if the node has one."""
        engines = self._server.engines
        if not self._plan.config.baseline:
            return
        forks = start_all(slots, lambda slot: self._branches.fork_baseline(engines.clients[slot]))
        if not engines.baselines:
            engines.baselines = forks
            return
        for slot, client in zip(slots, forks, strict=True):
            engines.baselines[slot].close()
            engines.baselines[slot] = client

    # Resets

    def _reset(self, reset: Reset) -> Message:
        requested = list(dict.fromkeys(reset.slots)) if reset.slots is not None else [*range(self._slots)]
        by_slot = dict(sorted(zip(requested, _seeds(reset, len(requested)), strict=True)))
        slots, seeds = [*by_slot], [*by_slot.values()]
        self._server.check_slot(slots[-1])
        if reset.snapshot:
            return self._restore(reset, slots)
        exchange = self._exchange
        if exchange.state is State.FAILED and len(slots) < self._slots:
            raise RequestRejected("the engines have ended; reset all slots")
        untouched = [exchange.state is State.WAITING and not exchange.modified[slot] for slot in slots]
        exchange.reset(slots)
        try:
            starts = [
                self._pools[slot].next_episode(seed, exchange.episode[slot], untouched=is_untouched)
                for slot, seed, is_untouched in zip(slots, seeds, untouched, strict=True)
            ]
        except SimulatorError as error:
            self._server.fail(error)
            raise
        # The reply is sent before the engines start, which takes seconds in large buildings.
        self._server.subscriptions.post_first(lambda: self._start_episodes(slots, starts, seeds, reset.controller))
        return self._ack(slots, starts)

    def _ack(self, slots: list[int], starts: list[EngineStart]) -> Ack:
        episode_starts = [
            EpisodeStart(
                engine_start=start,
                weather=pool.source.name,
                noise_parameters=pool.files.noise_parameters,
                output_dir=pool.output_dir,
            )
            for start, pool in zip(starts, [self._pools[slot] for slot in slots], strict=True)
        ]
        return Ack(episode=self._exchange.episode, episode_starts=episode_starts)

    def _start_episodes(
        self, slots: list[int], starts: list[EngineStart], seeds: list[int | None], source: str
    ) -> None:
        server, engines = self._server, self._server.engines
        replaced = [
            slot
            for slot, start in zip(slots, starts, strict=True)
            if start is not EngineStart.REUSED or not engines.clients[slot].alive
        ]
        previous = [engines.clients[slot] for slot in replaced]
        # Ending the previous engines takes as long as a fork, so a fast start goes first.
        is_fast = all(start in (EngineStart.FORKED, EngineStart.PREFETCHED, EngineStart.REUSED) for start in starts)
        if not is_fast:
            self._end(previous)
        try:
            started = start_engines(self._pools, replaced, self._exchange.episode)
            for slot, client in zip(replaced, started, strict=True):
                engines.clients[slot] = client
            if replaced:
                self.fork_baselines(replaced)
        except SimulatorError as error:
            self._end(previous)
            if server.stopping:
                raise Stopped from None
            server.fail(error)
            return
        engines.begin(slots)
        self._begin(dict.fromkeys(slots, 0), source, seeds)
        if is_fast:
            self._end(previous)
        for slot in slots:
            self._pools[slot].prefetch(self._exchange.episode[slot])

    def _end(self, clients: list[EngineClient]) -> None:
        for client in clients:
            client.end(failed=self._exchange.state is State.FAILED)

    def _begin(
        self, steps: dict[int, int], source: str, seeds: list[int | None], faults: FaultState | None = None
    ) -> None:
        """Begin episodes whose engines are ready, and publish their first sample.

        Args:
            steps: the first sample of each slot.
            source: the controller that asked for the reset.
            seeds: by slot, for injected faults.
            faults: those of a snapshot.
        """
        server = self._server
        server.exchange.ready(steps)
        server.begin_episodes([*steps], seeds)
        previous = server.manifest
        if faults is not None:
            server.inject(faults[0])
            if server.injection is not None:
                server.injection.restore(faults)
        server.failure = server.failure_error = ""
        if previous.weather != self._pools[0].source.name:
            server.manifest = server.manifest.model_copy(update=weather_fields(self._pools[0].source))
        if server.manifest != previous:
            server.publications.manifest(server.manifest)
        self._publish_start(source)
        server.publish()

    def _publish_start(self, source: str) -> None:
        for pool in self._pools:
            while pool.warnings:
                self._server.event(self._exchange.event(EventKind.WARNING, pool.warnings.pop(0)))
        self._server.event(self._exchange.event(EventKind.STARTED, self._describe(), source))

    def _describe(self) -> str:
        """Describe in one line what the episode of slot 0 simulates."""
        source, noise_parameters = self._pools[0].source, self._pools[0].files.noise_parameters
        parts = [f"episode {self._exchange.episode[0]} of {self._server.manifest.building} begins", source.name]
        parts += [source.site.source] if source.site is not None else []
        parts += self._plan.building.notes
        parts += [f"{name} {value:.4g}" for name, value in noise_parameters.items()]
        return "; ".join(parts)

    # Snapshots and branches

    def _snapshot(self, request: TakeSnapshot) -> Message:
        snapshot = self._branches.snapshot(
            request,
            lambda folder: [
                pool.link(pool.weather, folder / f"slot-{slot}.epw") for slot, pool in enumerate(self._pools)
            ],
        )
        text = f"snapshot {snapshot.name} at step {snapshot.step[0]}"
        self._server.event(self._exchange.event(EventKind.SNAPSHOT, text, request.controller))
        return SnapshotTaken(snapshot=snapshot.name, episode=snapshot.episode, step=snapshot.step)

    def _drop(self, request: DropSnapshot) -> Message:
        self._branches.drop(request.snapshot)
        return Ack(episode=self._exchange.episode)

    def _branch(self, request: CreateBranch) -> Message:
        branch = self._branches.branch(request, self._pools)
        self._server.event(self._exchange.event(EventKind.BRANCH_CREATED, f"branch {branch.name}", request.controller))
        return BranchCreated(node=branch.name)

    def _restore(self, reset: Reset, slots: list[int]) -> Message:
        """Go back to a snapshot. Its engines are forked first: if that fails, the present episode continues."""
        exchange, engines = self._exchange, self._server.engines
        if len(slots) != self._slots:
            raise RequestRejected("a snapshot contains all slots; reset all of them to it")
        snapshot = self._branches.find(reset.snapshot)
        episode = [number + 1 for number in exchange.episode]
        weather = [
            pool.link_for_episode(source, number)
            for pool, source, number in zip(self._pools, snapshot.weather, episode, strict=True)
        ]
        fork_calls = [
            *(
                partial(pool.fork, client, number)
                for pool, client, number in zip(self._pools, snapshot.engines.clients, episode, strict=True)
            ),
            *(partial(self._branches.fork_baseline, client) for client in snapshot.engines.baselines),
        ]
        forks = start_all(fork_calls, lambda fork: fork())
        for pool, linked in zip(self._pools, weather, strict=True):
            pool.restore(linked)
        exchange.reset()
        previous = engines.all
        engines.clients, engines.baselines = forks[: self._slots], forks[self._slots :]
        engines.effective, engines.source_index = snapshot.engines.effective, snapshot.engines.source_index
        exchange.restore(snapshot.commands)
        steps = dict(enumerate(snapshot.step))
        self._begin(steps, reset.controller, [None] * len(slots), snapshot.faults or NO_FAULTS)
        self._end(previous)
        return self._ack(slots, [EngineStart.SNAPSHOT] * len(slots))


def _seeds(reset: Reset, slots: int) -> list[int | None]:
    """Return a seed for each of the slots to reset."""
    if isinstance(reset.seed, list):
        if len(reset.seed) != slots:
            raise RequestRejected(f"{len(reset.seed)} seeds for {slots} slots; one each, or a single one")
        return reset.seed
    return [None if reset.seed is None else reset.seed + index for index in range(slots)]
