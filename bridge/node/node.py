"""A node: one plant on the bus, from start to end."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from zenostat.bridge.engine.registry import EngineRegistry
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.faults import read_plan
from zenostat.bridge.node.branches import BranchManager
from zenostat.bridge.node.episodes import EpisodeManager
from zenostat.bridge.node.history import History
from zenostat.bridge.node.manifest import node_manifest
from zenostat.bridge.node.names import NameWatch, check_name_is_free
from zenostat.bridge.node.plant import PlantContext, PlantFactory, SlotPlacement
from zenostat.bridge.node.recording import RecordingManager
from zenostat.bridge.node.server import NodeServer, Observer
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.node.shutdown import SHUTDOWN_TIMEOUT_S, ShutdownGuard
from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.contention import CorePlacement
from zenostat.bridge.runtime.scratch import Scratch, sweep
from zenostat.bridge.runtime.service_manager import reported
from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.bridge.transport.link_watch import LinkWatch
from zenostat.bridge.transport.session import keys_folder, open_session
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NameInUse, RequestRejected, UnknownName, did_you_mean
from zenostat.topics.messages import Ack, EventKind, Manifest, Message, Query, RecordingStatus, Revoke

if TYPE_CHECKING:
    from zenostat.bridge.alarms.monitor import AlarmMonitor
    from zenostat.bridge.node.resumption import Resumption
    from zenostat.bridge.transport.deny_list import DenyList


class Node:
    """A plant on the bus. `with Node(settings, prepare) as node: node.serve()`, in the main thread.

    Args:
        settings: of the node.
        prepare: checks what the plant simulates, and returns a function that creates it; called first of all.
        observer: called with the server after each sample and event.
        program: whether the process belongs to the node alone; it is then ended if the node does not end in time.
        finish_s: time that the simulators may take to finish files that are kept; 0: they are killed at once.

    Attributes:
        plant: the plant.
        server: the node on the bus.
        branches: its snapshots and branches.
        namesake_warning: the latest warning that another node of the same name is on the bus; empty if none is.
        certificate_warning: the date on which its certificate expires, if that was soon at its start; otherwise empty.
        expiry_warning: the latest warning since its start that its certificate expires or has expired; empty if none.
        link_warning: the latest sentence about the loss or the return of its only connection; empty if none.

    Raises:
        InvalidConfig: the node's name cannot be part of a key.

    Raises (on entering):
        UsageError, SimulatorError, BusError: see `zenostat.topics.errors`; everything that was started is closed.
    """

    def __init__(
        self,
        settings: NodeSettings,
        prepare: Callable[[], PlantFactory],
        observer: Observer | None = None,
        *,
        program: bool = False,
        finish_s: float = 0.0,
    ) -> None:
        keys.check_name(settings.name, "the node's name")
        self.settings = settings
        self._prepare, self._observer, self._finish_s = prepare, observer, finish_s
        self._registry = EngineRegistry(settings.unresponsive_s)
        self._scratch: Scratch | None = None
        timeout_s = SHUTDOWN_TIMEOUT_S + finish_s
        self._guard = ShutdownGuard(self._stop_waiting, self._end_process if program else None, timeout_s)
        self._has_server = False
        self.namesake_warning = self.certificate_warning = self.expiry_warning = self.link_warning = ""
        self._deny_list: DenyList | None = None
        self._resumption: Resumption | None = None
        self._close = ExitStack()

    def check(self) -> None:
        """Check the settings and what the plant simulates; start nothing."""
        self._recording_path()
        self._prepare()

    def __enter__(self) -> Node:
        with ExitStack() as undo:
            undo.callback(self.close)
            self._close.enter_context(self._guard)
            self._record = self._recording_path()
            self._open_resumption()
            create = self._prepare()
            self._set_affinity()
            self._open_bus()
            self._create_scratch()
            self.plant = create(self._context())
            self._close.callback(self.plant.close)
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

    @property
    def recording(self) -> RecordingStatus | None:
        """The state of its present or latest recording; None if there was none."""
        return self._recordings.status()

    # Start

    def _recording_path(self) -> Path | None:
        """Return the file to record to; `InvalidConfig` if it exists, or if the libraries are missing."""
        settings = self.settings
        if settings.record is None:
            return None
        from zenostat.bridge.recording.file import check_library, check_path, recording_path  # few nodes record

        check_library()
        path = recording_path(settings.record, settings.name)
        check_path(path, overwrite=settings.record_overwrite)
        return path

    def _open_resumption(self) -> None:
        if self.settings.resume is None:
            return
        from zenostat.bridge.node.resumption import Resumption  # few nodes go on with a recording
        from zenostat.bridge.recording.file import check_library

        check_library()
        self._resumption = Resumption(self.settings.resume)
        self._close.callback(self._resumption.close)

    def _set_affinity(self) -> None:
        """Choose the cores of node and engines; several slots use all cores, and the node shares one of them."""
        settings = self.settings
        self._cpus = affinity.allowed()
        self._engine_cpu, self.cpu = settings.engine_cpu, settings.cpu
        if settings.cpu is None:
            self._engine_cpu, self.cpu = affinity.pick_cores(settings.affinity)
        affinity.set_affinity(self.cpu)
        if settings.slots == 1 and self._engine_cpu is not None and self.cpu not in (None, self._engine_cpu):
            self._registry.placement = CorePlacement(self._engine_cpu, self.cpu, self._cpus)

    def _open_bus(self) -> None:
        settings = self.settings
        self._opened = open_session(
            listen=settings.listen,
            connect=settings.connect,
            expose=settings.expose,
            keys=settings.keys,
            role=keys.Role.NODE,
            certificate=settings.certificate,
            warn=partial(setattr, self, "certificate_warning"),
        )
        self.session = self._close.enter_context(self._opened)
        self.instance = str(self.session.zid())
        check_name_is_free(self.session, settings.name)

    def _create_scratch(self) -> None:
        sweep()
        self._scratch = Scratch(self.settings.folder)
        self._close.callback(self._scratch.remove)
        self._folder = self._scratch.folder

    def _context(self) -> PlantContext:
        settings, slots = self.settings, self.settings.slots
        if slots == 1:
            cpus = () if self._engine_cpu is None else (self._engine_cpu,)
            placement = [SlotPlacement(cpus, self._spare_cpus(cpus), poll=self._engine_cpu != self.cpu)]
        else:
            # In blocks, the node's core last: an engine on it could delay the node's orders to all other engines.
            cores = sorted(self._cpus, key=lambda core: core == self.cpu) if self.cpu is not None else []
            by_slot = [(cores[slot * len(cores) // slots],) if cores else () for slot in range(slots)]
            placement = [SlotPlacement(cpus, self._spare_cpus(cpus)) for cpus in by_slot]
        return PlantContext(
            self._folder, tuple(placement), self._cpus, baseline=settings.baseline, registry=self._registry
        )

    def _spare_cpus(self, cpus: tuple[int, ...]) -> tuple[int, ...]:
        """Return the other cores that the node may use; all cores if there are no others."""
        return tuple(core for core in self._cpus if core not in cpus) or self._cpus

    def _start_server(self) -> None:
        """Start the plant and create the server, which is not on the bus yet."""
        settings, plant = self.settings, self.plant
        exchange = StepExchange(
            plant.description.actuators,
            slots=settings.slots,
            mode=settings.mode,
            policy=settings.policy,
            deadline_s=settings.deadline_s,
            connected=plant.description.connected,
        )
        resumption = self._resumption
        if resumption is None:
            plant.start(range(settings.slots))
        else:
            resumption.start(plant)
        history = History(plant.description, settings.slots, int(settings.history_mb * 1e6))
        kept = history if history.samples else None
        manifest = node_manifest(settings, plant, kept, instance=self.instance, cpu=self.cpu)
        if resumption is not None:
            resumption.check(manifest)
        self.server = NodeServer(
            self.session, plant, manifest, exchange, self._observer, kept, self._alarms(), folder=self._folder
        )
        self.server.on_stop = self._on_stop_request
        self._recordings = RecordingManager(self.server, plant, cpus=self._cpus)
        self._close.callback(self._recordings.close)
        self._close.callback(self.server.close)
        if not self._finish_s:
            self._close.callback(self._registry.end)  # all at once is faster than one by one
        if settings.faults is not None and resumption is None:
            self.server.inject(read_plan(settings.faults))
        self._control_access()
        self._watch_links()
        self.branches = BranchManager(
            self.server, self._folder, cpus=self._cpus, limit=settings.branches, registry=self._registry
        )
        self._close.callback(self.branches.close)
        self._has_server = True
        self._episodes = EpisodeManager(
            self.server, plant, self.branches, self._recordings, patience_s=settings.unresponsive_s
        )
        if resumption is not None:
            resumption.run(self.server, self._folder)
            plant.clean_up()

    def _control_access(self) -> None:
        """Apply the list of names and the deny list, where there are keys."""
        folder = keys_folder(self.settings.keys)
        if folder is None:
            return
        from zenostat.bridge.node.access import Access  # few nodes have keys
        from zenostat.bridge.transport.deny_list import DenyList

        names = self._opened.names()
        deny_list = DenyList(folder, self.session, self.server.timer, self._on_revoked, self._on_unreadable_deny_list)
        self._close.callback(deny_list.close)
        self.server.access = Access(names, lambda: deny_list.names)
        self._deny_list = deny_list
        self._opened.watch_expiry(self.server.timer, self._on_expiry)

    def _watch_links(self) -> None:
        """Report the loss and the return of its only connection."""
        if self.settings.connect and not self.settings.listen:
            watch = LinkWatch(self.session, self.settings.connect, self._on_link_change)
            self._close.callback(watch.close)

    def _on_link_change(self, text: str) -> None:
        """Report in any thread."""
        self.link_warning = text
        self._warn(text)

    def _on_revoked(self, names: frozenset[str]) -> None:
        """End what revoked names have; in any thread."""

        def revoke() -> None:
            for name in sorted(names):
                self.server.revoke(name)
                self.branches.revoke(name)

        self.server.subscriptions.post(revoke)

    def _on_unreadable_deny_list(self, error: str) -> None:
        self._warn(f"{error}; the names that are revoked stay so until the node is started again")

    def _on_expiry(self, warning: str) -> None:
        """Report that its certificate expires soon, or has expired; in any thread."""
        self.expiry_warning = warning
        self._warn(warning)

    def _warn(self, text: str) -> None:
        """Publish a warning; in any thread."""
        self.server.subscriptions.post(lambda: self.server.event(self.server.exchange.event(EventKind.WARNING, text)))

    def _on_name_in_use(self, error: NameInUse) -> None:
        """End with an error; in any thread."""

        def end() -> None:
            raise error

        self.server.subscriptions.post_first(end)

    def _on_namesake(self, instance: str) -> None:
        """Report another node of the same name, or that there is none any more; in any thread."""
        if not instance:
            self.namesake_warning = ""
            return
        self.namesake_warning = (
            f"another node named {self.settings.name!r} (instance {instance}) is on this bus, besides this one "
            f"(instance {self.instance}): subscribers receive the samples of both, and one of them answers a request; "
            "stop one of them"
        )
        self._warn(self.namesake_warning)

    def _revoke(self, request: Revoke) -> Message:
        if self._deny_list is None:
            raise RequestRejected("the node has no keys, so a name proves nothing; secure the bus: zenostat keys init")
        names = self._opened.names()
        if request.name not in names:
            raise UnknownName(f"no name {request.name!r} in the list of names; {did_you_mean(request.name, names)}")
        if request.name == self._opened.name:
            raise RequestRejected(f"{request.name} is this node's own name; stop the node instead")
        if keys.is_own(request.name, request.source):
            raise RequestRejected(
                f"{request.name} is your own name: revoke it with another operator's certificate, or on the node's "
                "machine, with zenostat keys revoke"
            )
        if keys.Role.NODE in names[request.name]:
            raise RequestRejected(
                f"{request.name} is the name of a node or router, on which others may depend: revoke it on its "
                "machines, with zenostat keys revoke"
            )
        text = f"{request.name} is revoked"
        try:
            self._deny_list.add(request.name)
        except InvalidConfig as error:
            text += f" until this node ends: {error}; before it is started again, add the name to its revoked.txt"
            self._warn(text)
        return Ack(episode=self.exchange.episode, text=text)

    def _alarms(self) -> AlarmMonitor | None:
        settings, resumption = self.settings, self._resumption
        if resumption is None and settings.alarms is None:
            return None
        from zenostat.bridge.alarms.monitor import AlarmMonitor  # few nodes have alarms
        from zenostat.bridge.alarms.rules import read_rules

        rules = None if settings.alarms is None else read_rules(settings.alarms)
        if resumption is not None:
            rules = resumption.agreed_rules(rules)
        return None if rules is None else AlarmMonitor(rules, self.plant.description, settings.slots)

    def _announce(self) -> None:
        """Put the node on the bus: first what answers requests, its presence last."""
        server = self.server
        server.declare(self.status)
        server.subscriptions.watch_presence(self._on_disconnect, server.on_reconnect)
        self._episodes.declare()
        self._recordings.declare()
        self.branches.declare()
        server.subscriptions.request(keys.REVOKE, Revoke, self._revoke)
        self._close.callback(signal.signal, signal.SIGCHLD, signal.getsignal(signal.SIGCHLD))
        signal.signal(signal.SIGCHLD, self._on_child)
        settings = self.settings
        if self._resumption is not None:
            written = self._resumption.written
            self._recordings.go_on(self._resumption.take_descriptor(), written, on_full=settings.record_on_full)
        elif self._record is not None:
            self._recordings.start(self._record, overwrite=settings.record_overwrite, on_full=settings.record_on_full)
        if self._resumption is None:
            self._episodes.begin_first()
        for warning in filter(None, (*self.plant.description.warnings, self.certificate_warning)):
            server.event(server.exchange.event(EventKind.WARNING, warning))
        if self._resumption is None:
            server.publish()
        else:
            server.go_on(self._resumption.describe())
            server.revoke_again()
        check_name_is_free(self.session, settings.name)  # the plant may have taken minutes to start
        watch = NameWatch(self.session, settings.name, server.timer, self._on_name_in_use, self._on_namesake)
        self._close.callback(watch.close)
        server.announce()

    # Run and stop

    def serve(self) -> None:
        """Serve until stopped by a request, a signal, or the end of the node's owner.

        Raises:
            NameInUse: another node of the name has started at the same time, and remains.
        """
        gc.freeze()  # objects loaded so far stay; the garbage collector need not scan them
        with override_signals(self._on_signal, *TERMINATION_SIGNALS), reported(self.server.subscriptions.post):
            self.server.serve()

    def status(self, query: Query) -> bytes:
        """Return the encoded status of the node; thread-safe."""
        snapshots, branches = self.branches.status(memory=query.memory)
        status = self.server.requests.status(memory=query.memory)
        recording = self._recordings.status()
        update = {"snapshots": snapshots, "branches": branches, "recording": recording}
        return codec.encode(status.model_copy(update=update))

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        # No exception here: the signal can arrive anywhere, even while a thread is being started.
        self.server.subscriptions.post_first(self.server.stop_serving)

    def _on_stop_request(self) -> None:
        self.server.cancel_step()
        self._guard.request()

    def _stop_waiting(self, signals: int) -> None:
        """Interrupt all engines, unless they are finishing files that are kept; thread-safe."""
        self._registry.close()
        if self._has_server:
            self.server.cancel_step()
            self.branches.cancel_steps()
        if signals > 1 or not self._finish_s or not self._has_server:
            self._registry.interrupt()

    def _end_process(self) -> None:
        """Kill the engines, remove all files and exit the process at once; thread-safe."""
        self._registry.interrupt()
        if self._scratch is not None:
            self._scratch.remove()
        os.write(2, f"node {self.settings.name!r} did not end in time and was ended\n".encode())
        os._exit(0)

    def _on_child(self, _number: int, _frame: FrameType | None) -> None:
        self.server.subscriptions.notify()  # so that the end of an engine is detected while no messages arrive
        self.branches.notify_all()

    def _on_disconnect(self, controller: str) -> None:
        self.server.on_disconnect(controller)
        self.branches.on_disconnect(controller)
