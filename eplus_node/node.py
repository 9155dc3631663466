"""A node: one building on the bus, from start to end."""

from __future__ import annotations

import gc
import os
import signal
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

from bridge.engine.registry import EngineRegistry
from bridge.exchange.step_exchange import StepExchange
from bridge.runtime import affinity
from bridge.runtime.scratch import Scratch, sweep
from bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from bridge.transport.session import open_session
from eplus_node.branches import BranchManager
from eplus_node.config import NodeConfig
from eplus_node.engine.group import EngineGroup
from eplus_node.engine.pool import EnginePool
from eplus_node.engine.template import EngineTemplate
from eplus_node.episodes import EpisodeManager, start_engines
from eplus_node.manifests import node_manifest
from eplus_node.plan import Plan, plan
from eplus_node.server import NodeServer, Observer
from eplus_node.shutdown import SHUTDOWN_TIMEOUT_S, ShutdownGuard
from topics import codec, keys
from topics.errors import NameInUse
from topics.messages import EventKind, Manifest, Query

_KEEP_OUTPUT_TIMEOUT_S = 35.0
"""Time for a node to end while EnergyPlus finishes the files that are kept."""


class Node:
    """A building on the bus. `with Node(config) as node: node.serve()`, in the main thread.

    Args:
        config: what to simulate, and how.
        observer: called with the server after each sample and event.
        program: whether the process belongs to the node alone; it is then ended if the node does not end in time.

    Attributes:
        server: the node on the bus.
        branches: its snapshots and branches.

    Raises (on entering):
        UsageError, SimulatorError, BusError: see `topics.errors`; everything that was started is closed.
    """

    def __init__(self, config: NodeConfig, observer: Observer | None = None, *, program: bool = False) -> None:
        self.config = config
        self._observer = observer
        self._registry = EngineRegistry(config.unresponsive_s)
        self._scratch: Scratch | None = None
        timeout_s = SHUTDOWN_TIMEOUT_S if config.output_dir is None else _KEEP_OUTPUT_TIMEOUT_S
        self._guard = ShutdownGuard(self._stop_waiting, self._end_process if program else None, timeout_s)
        self._has_server = False
        self._close = ExitStack()

    def __enter__(self) -> Node:
        with ExitStack() as undo:
            undo.callback(self.close)
            self._close.enter_context(self._guard)
            self.plan: Plan = plan(self.config)
            self._set_affinity()
            self._open_bus()
            self._create_scratch()
            self._pools = self._create_pools()
            for pool in self._pools:
                self._close.callback(pool.close)
            self._start_server()
            self._announce()
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the engines, leave the bus and remove all files; idempotent. Signals are ignored in the meantime."""
        with override_signals(lambda *_: None, *TERMINATION_SIGNALS):  # the guard counts them
            self._registry.close()
            self._close.close()

    @property
    def manifest(self) -> Manifest:
        """The description that the node publishes of itself."""
        return self.server.manifest

    @property
    def exchange(self) -> StepExchange:
        """The state of its episodes and controllers."""
        return self.server.exchange

    # Start

    def _set_affinity(self) -> None:
        """Choose the cores of node and engines; several slots use all cores, and the node shares one of them."""
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
        self._check_name_is_free(config.name)

    def _tokens(self) -> list[str]:
        replies = self.session.liveliness().get(keys.NODE_TOKEN.at(self.config.name, name="*"))
        return [keys.last_chunk(str(reply.ok.key_expr)) for reply in replies if reply.ok]

    def _check_name_is_free(self, name: str) -> None:
        others = [token for token in self._tokens() if token != self.instance]
        if others:
            raise NameInUse(f"a node named {name!r} is on this bus already (instance {others[0]}); choose another name")

    def _create_scratch(self) -> None:
        sweep()
        self._scratch = Scratch(self.config.folder)
        self._close.callback(self._scratch.remove)
        self._folder = self._scratch.folder

    def _create_pools(self) -> list[EnginePool]:
        template, slots = EngineTemplate(), self.config.slots
        if slots == 1:
            cpus = () if self._engine_cpu is None else (self._engine_cpu,)
            poll, spare = self._engine_cpu != self.cpu, self._spare_cpus(cpus)
            return [
                EnginePool(
                    self.plan, self._folder, template, cpus=cpus, spare=spare, poll=poll, registry=self._registry
                )
            ]
        # In blocks, the node's core last: an engine on it could delay the node's orders to all other engines.
        cores = sorted(self._cpus, key=lambda core: core == self.cpu) if self.cpu is not None else []
        cpus_by_slot = [(cores[slot * len(cores) // slots],) if cores else () for slot in range(slots)]
        return [
            EnginePool(
                self.plan,
                self._folder,
                template,
                subfolder=f"slot-{slot}",
                cpus=cpus,
                spare=self._spare_cpus(cpus),
                registry=self._registry,
            )
            for slot, cpus in enumerate(cpus_by_slot)
        ]

    def _spare_cpus(self, cpus: tuple[int, ...]) -> tuple[int, ...]:
        """Return the other cores that the node may use; all cores if there are no others."""
        return tuple(core for core in self._cpus if core not in cpus) or self._cpus

    def _weather_file(self, slot: int) -> Path:
        return self._pools[slot].files.weather

    def _start_server(self) -> None:
        """Start the engines and create the server, which is not on the bus yet."""
        slots = range(self.config.slots)
        config = self.config
        exchange = StepExchange(
            self.plan.points.actuators,
            slots=config.slots,
            mode=config.mode,
            policy=config.policy,
            deadline_s=config.deadline_s,
        )
        engines = EngineGroup(start_engines(self._pools, slots, exchange.episode))
        self._close.callback(engines.end)
        engines.begin(slots)
        manifest = node_manifest(self.plan, self._pools[0].source, instance=self.instance, cpu=self.cpu)
        self.server = NodeServer(
            self.session, self.plan, manifest, exchange, engines, self._weather_file, self._observer
        )
        self.server.interrupt, self.server.on_stop = self._registry.interrupt, self._on_stop_request
        self._close.callback(self.server.close)
        if config.output_dir is None:
            self._close.callback(self._registry.interrupt)  # all at once is faster than one by one
        if self.plan.faults is not None:
            self.server.inject(self.plan.faults)
        self.branches = BranchManager(self.server, self._folder, cpus=self._cpus, limit=config.branches)
        self._close.callback(self.branches.close)
        self._has_server = True
        self._episodes = EpisodeManager(self.server, self.plan, self._pools, self.branches)
        self._episodes.fork_baselines(slots)

    def _announce(self) -> None:
        """Put the node on the bus: first what answers requests, its presence last."""
        server = self.server
        server.declare(self.status)
        server.subscriptions.watch_presence(keys.CONTROLLER_TOKEN, self._on_disconnect)
        self._episodes.declare()
        self._close.callback(signal.signal, signal.SIGCHLD, signal.getsignal(signal.SIGCHLD))
        signal.signal(signal.SIGCHLD, self._on_child)
        self._episodes.begin_first()
        for warning in self.plan.warnings:
            server.event(server.exchange.event(EventKind.WARNING, warning))
        server.publish()
        server.announce()
        if any(token < self.instance for token in self._tokens()):
            self._check_name_is_free(self.config.name)  # of two nodes that started at once, the lower id remains

    # Run and stop

    def serve(self) -> None:
        """Serve until stopped by a request, a signal, or the end of the node's owner."""
        gc.freeze()  # objects loaded so far stay; the garbage collector need not scan them
        with override_signals(self._on_signal, *TERMINATION_SIGNALS):
            self.server.serve()

    def status(self, query: Query) -> bytes:
        """Return the encoded status of the node; thread-safe."""
        snapshots, branches = self.branches.status(memory=query.memory)
        status = self.server.requests.status(memory=query.memory)
        return codec.encode(status.model_copy(update={"snapshots": snapshots, "branches": branches}))

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        # No exception here: the signal can arrive anywhere, even while a thread is being started.
        self.server.subscriptions.post_first(self.server.stop_serving)

    def _on_stop_request(self) -> None:
        self.server.cancel_step()
        self._guard.request()

    def _stop_waiting(self, signals: int) -> None:
        """Interrupt all engines, unless EnergyPlus is finishing files that are kept; thread-safe."""
        self._registry.close()
        if self._has_server:
            self.server.cancel_step()
            self.branches.cancel_steps()
        if signals > 1 or self.config.output_dir is None or not self._has_server:
            self._registry.interrupt()

    def _end_process(self) -> None:
        """Kill the engines, remove all files and exit the process at once; thread-safe."""
        self._registry.interrupt()
        if self._scratch is not None:
            self._scratch.remove()
        os.write(2, f"node {self.config.name!r} did not end in time and was ended\n".encode())
        os._exit(0)

    def _on_child(self, _number: int, _frame: FrameType | None) -> None:
        self.server.subscriptions.notify()  # so that the end of an engine is detected while no messages arrive
        self.branches.notify_all()

    def _on_disconnect(self, controller: str) -> None:
        self.server.on_disconnect(controller)
        self.branches.on_disconnect(controller)
