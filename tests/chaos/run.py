"""The run: a node, its crew, and the script that troubles them. What it leaves are journals and an `Outcome`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any

import psutil
import zenoh
from support.nodes import SMALL, ZONES, NodeProgram, engines_of, until
from zenoh.handlers import Callback

import zenostat
from chaos.controller import LOST
from chaos.crew import Member
from chaos.disturbances import FLOODS, LONG_S, SIZES, Disturbance, Step, script
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import codec, keys
from zenostat.topics.errors import SimulatorError
from zenostat.topics.messages import Ack, Event, EventKind, Manifest, Pause, Reset, Resume, Status

BUILDING = SMALL | {"begin": "07-01", "end": "07-07"}
NODE = BUILDING | {"policy": "hold", "deadline_s": 0.25, "baseline": False}
LEVELS = {"north": 10, "south": 10, "base": 12}
_OWN = {"north": ZONES[:2], "south": ZONES[2:4]}
_RECORD, _FLOODS = "record.msgpack", "floods.jsonl"


def actuators_of(role: str) -> list[str] | None:
    """Return the actuators that a controller claims; None is the whole building."""
    zones = _OWN.get(role)
    return None if zones is None else [f"{zone}_{kind}_setpoint" for zone in zones for kind in ("heating", "cooling")]


@dataclass(slots=True)
class Resources:
    """Resources of node and engine at a time of the run: resident bytes, descriptors, threads."""

    at_s: float
    node_bytes: int
    engine_bytes: int
    descriptors: int
    threads: int


@dataclass(slots=True)
class Outcome:
    """Outcome of a run, besides its journals in `folder`.

    Attributes:
        done: how often each disturbance was applied.
        faults: what went wrong beside the journals, in words.
        lost: how often a controller took the node for gone.
    """

    folder: Path
    seed: int
    seconds: float = 0.0
    done: Counter[Disturbance] = field(default_factory=Counter)
    resources: list[Resources] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    lost: int = 0
    manifest: Manifest | None = None
    status: Status | None = None

    @property
    def record(self) -> Path:
        """Path of the recording monitor's messages."""
        return self.folder / _RECORD

    @property
    def recording(self) -> Path:
        """Path of the node's recording."""
        return self.folder / "recording.mcap"

    @property
    def floods(self) -> Path:
        """Path of the flooder's journal."""
        return self.folder / _FLOODS

    def journal(self, role: str) -> Path:
        """Path of a controller's journal."""
        return self.folder / f"{role}.jsonl"


class Chaos:
    """A node and its crew, and what is done to them. `with Chaos(outcome) as chaos: chaos.run(60.0)`."""

    def __init__(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self._close = ExitStack()
        self._events: SimpleQueue[Event] = SimpleQueue()
        self._names: dict[str, str] = {}
        self._frozen: list[int] = []
        self._looked_s = 0.0

    def __enter__(self) -> Chaos:
        with ExitStack() as undo:
            undo.callback(self._close.close)
            self._open()
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    def _open(self) -> None:
        folder, enter = self.outcome.folder, self._close.enter_context
        self.node = enter(NodeProgram(folder / "node", **NODE, record=str(self.outcome.recording)))
        self._close.callback(self._thaw_all)
        self._bus = enter(zenostat.connect(self.node.endpoint, affinity=Affinity.OFF))
        self.outcome.manifest = self._bus.manifest(self.node.name)
        hears = self._bus.session.declare_subscriber(keys.EVENT.at("office"), Callback(self._on_event, indirect=False))
        self._close.callback(hears.undeclare)
        where = {"endpoint": self.node.endpoint, "node": self.node.name}
        self.recorder = self._member("monitor", "recorder", where | {"record": str(self.outcome.record)})
        self.recorder.await_ready()
        self.listener = self._member("monitor", "listener", where | {"record": None})
        self.flooder = self._member(
            "flooder", "flooder", where | {"journal": str(self.outcome.floods)}, stdin=subprocess.PIPE
        )
        self.controllers = {role: self._controller(role, where) for role in LEVELS}
        self.timer = enter(Timer())  # ends first: nobody is started or thawed after that
        self._reset()  # so that all is recorded from a sample 0 on

    def _member(self, module: str, name: str, settings: dict[str, Any], **popen: Any) -> Member:
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE} | popen
        member = Member(module, settings, self.outcome.folder / f"{name}.log", **pipes)
        self._close.callback(member.end, signal.SIGKILL)
        return member

    def _controller(self, role: str, where: dict[str, Any]) -> Member:
        own = {"name": role, "priority": LEVELS[role], "actuators": actuators_of(role)}
        return self._member("controller", role, where | own | {"journal": str(self.outcome.journal(role))})

    def _on_event(self, message: zenoh.Sample) -> None:
        self._events.put(codec.decode(Event, message.payload.to_bytes()))

    # The script

    def run(self, seconds: float) -> None:
        """Troubles them for a time; then calm returns, and all end in good order."""
        until(lambda: self._status().step[0] > 0, "the first timestep")
        began_s = due_s = monotonic()
        for step in script(self.outcome.seed, seconds):
            due_s += step.pause_s
            if due_s > began_s + seconds:
                break
            self._attend(due_s, began_s)
            if self._do(step):
                self.outcome.done[step.disturbance] += 1
            due_s = max(due_s, monotonic() - 1.0)  # the time that a disturbance takes is not made up for all at once
        self._attend(began_s + seconds, began_s)
        self.outcome.seconds = monotonic() - began_s
        self._calm(began_s)

    def _attend(self, until_s: float, began_s: float) -> None:
        """Lets time pass: episodes that are over are followed by others, and so are programs that have ended."""
        while True:
            self._look(began_s)
            try:
                event = self._events.get(timeout=max(min(until_s - monotonic(), 0.1), 0.0))
            except Empty:
                if monotonic() >= until_s:
                    return
                continue
            if event.kind is EventKind.CONNECTED and "controls" in event.text:
                self._names[event.source.partition("-")[0]] = event.source
            if event.kind in (EventKind.ENDED, EventKind.FAILED):
                self._reset()

    def _look(self, began_s: float) -> None:
        for member in (*self.controllers.values(), self.listener, self.recorder, self.flooder):
            member.look()
        now_s = monotonic()
        if now_s - self._looked_s < 0.5:
            return
        self._looked_s, node = now_s, psutil.Process(self.node.pid)
        with suppress(psutil.Error, IndexError):
            engine = engines_of(self.node.pid)[-1].memory_info().rss
            used = (node.memory_info().rss, engine, node.num_fds(), node.num_threads())
            self.outcome.resources.append(Resources(now_s - began_s, *used))

    def _reset(self) -> None:
        while True:
            try:
                self._bus.reset(self.node.name, Reset(controller="chaos"))
                return
            except SimulatorError:  # the engine that was to be forked had been killed as well
                threading.Event().wait(0.05)

    def _status(self) -> Status:
        return self._bus.status(self.node.name)

    def _do(self, step: Step) -> bool:
        """Whether the disturbance had a target."""
        if step.disturbance in FLOODS:
            return self._flood(step)
        if step.disturbance in (Disturbance.KILL_MONITOR, Disturbance.FREEZE_MONITOR):
            return self._trouble(step, [self.listener])
        if step.disturbance in (
            Disturbance.KILL,
            Disturbance.FREEZE,
            Disturbance.FREEZE_LONG,
            Disturbance.RESTART,
            Disturbance.REPEAT,
        ):
            return self._trouble(step, [*self.controllers.values()])
        return self._trouble_node(step)

    def _trouble(self, step: Step, members: list[Member]) -> bool:
        running = [member for member in members if member.up]
        if not running:
            return False
        one = running[int(step.draw * len(running))]
        match step.disturbance:
            case Disturbance.KILL | Disturbance.KILL_MONITOR:
                one.end(signal.SIGKILL)
                self.timer.at(monotonic() + 2.0 * step.amount, one.start)
            case Disturbance.RESTART:
                one.end(signal.SIGTERM)
                one.start()
            case Disturbance.REPEAT:
                one.process.send_signal(signal.SIGUSR1)
            case _:
                longest = {Disturbance.FREEZE: 1.5, Disturbance.FREEZE_LONG: LONG_S, Disturbance.FREEZE_MONITOR: 3.0}[
                    step.disturbance
                ]
                one.freeze()
                spell_s = LONG_S if step.disturbance is Disturbance.FREEZE_LONG else longest * step.amount
                self.timer.at(monotonic() + spell_s, one.thaw)
        return True

    def _trouble_node(self, step: Step) -> bool:
        match step.disturbance:
            case Disturbance.RESET:
                self._reset()
            case Disturbance.PAUSE:
                self._bus.ask(keys.PAUSE, self.node.name, Pause(source="chaos"), Ack)
                threading.Event().wait(0.5 * step.amount)
                self._bus.ask(keys.RESUME, self.node.name, Resume(source="chaos"), Ack)
            case Disturbance.FREEZE_NODE:
                self._freeze(self.node.pid, 0.8 * step.amount)
            case _:
                engines = engines_of(self.node.pid)
                if not engines:
                    return False
                if step.disturbance is Disturbance.FREEZE_ENGINE:
                    self._freeze(engines[-1].pid, 0.8 * step.amount)
                else:
                    with suppress(psutil.NoSuchProcess):
                        engines[-1].kill()
        return True

    def _freeze(self, pid: int, duration_s: float) -> None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGSTOP)
            self._frozen.append(pid)
            self.timer.at(monotonic() + duration_s, lambda: self._thaw(pid))

    def _thaw(self, pid: int) -> None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)

    def _thaw_all(self) -> None:
        for pid in self._frozen:
            if pid == self.node.pid or (psutil.pid_exists(pid) and psutil.Process(pid).ppid() == self.node.pid):
                self._thaw(pid)

    def _flood(self, step: Step) -> bool:
        low, high = SIZES.get(step.disturbance, (1, 400))
        order = {
            "disturbance": step.disturbance,
            "count": low + int(step.amount * (high - low)),
            "seed": int(step.draw * 2**32),
        }
        assert self.flooder.process.stdin is not None
        self.flooder.process.stdin.write(json.dumps(order | {"names": sorted(self._names.values())}) + "\n")
        self.flooder.process.stdin.flush()
        return True

    # The end

    def _calm(self, began_s: float) -> None:
        """Whoever is down or frozen comes back, the building goes on with all of them, and then all end."""
        self.timer.close()
        self._thaw_all()
        for member in (*self.controllers.values(), self.listener):
            member.thaw()
            member.start()
        self.listener.await_ready()
        assert self.flooder.process.stdin is not None
        self.flooder.process.stdin.close()
        self._expect(self.flooder, "the flooder", 0)
        until(lambda: self._all_answer(began_s), "all controllers answer again")
        self._bus.ask(keys.PAUSE, self.node.name, Pause(source="chaos"), Ack)
        self.outcome.status = self._settled()
        self._bus.stop(self.node.name)
        if self.node.process.wait(60) != 0:
            self.outcome.faults.append(f"the node ended with {self.node.process.returncode}")
        self._expect(self.recorder, "the recording monitor", 0)
        self._expect(self.listener, "the other monitor", 0)
        for role, member in self.controllers.items():
            self._expect(member, role, LOST)

    def _all_answer(self, began_s: float) -> bool:
        self._attend(monotonic(), began_s)
        connected = {
            one.controller.partition("-")[0]: one for one in self._status().controllers if one.state.is_connected
        }
        return set(connected) == set(LEVELS) and all(one.accepted for one in connected.values())

    def _settled(self) -> Status:
        """The status once nothing more comes."""
        before, same = self._status(), 0
        while same < 20:
            threading.Event().wait(0.02)
            status = self._status()
            counted = (status.accepted, status.rejected, status.late, status.duplicate, status.statistics.rate_limited)
            was = (before.accepted, before.rejected, before.late, before.duplicate, before.statistics.rate_limited)
            before, same = status, same + 1 if counted == was else 0
        return before

    def _expect(self, member: Member, what: str, code: int) -> None:
        ended = member.finish()
        self.outcome.lost += member.lost
        self.outcome.faults += member.ended
        if ended != code:
            self.outcome.faults.append(f"{what} ended with {ended}, {code} expected")


def run(folder: Path, *, seconds: float, seed: int) -> Outcome:
    """A run in `folder`, which is the place of temporary files of all its programs."""
    outcome = Outcome(folder, seed)
    signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # inherited: it must not kill a controller that has just begun
    with Chaos(outcome) as chaos:
        chaos.run(seconds)
    return outcome
