"""The node's side of an engine: start it, exchange a frame a timestep, notice its death, clear up."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import struct
import subprocess
from collections.abc import Callable, Iterable
from contextlib import suppress
from time import monotonic
from typing import TypeVar

import numpy as np
import psutil
from numpy.typing import NDArray

from bridge.runtime.idle_watch import LOOK_S, IdleWatch
from bridge.runtime.polling import Polling
from eplus_node.engine.forked_process import ForkedProcess, Process
from eplus_node.engine.protocol import FrameKind, OrderKind
from eplus_node.engine.registry import EngineRegistry
from eplus_node.engine.sockets import SocketPair, fill, read_process_id, send_all, socket_pairs
from eplus_node.engine.spec import EngineSpec
from models.energyplus import ISOLATED
from models.err_file import explain
from topics.errors import EngineDied, EngineUnresponsive, ForkFailed, ModelError

LOG = "engine.log"
"""What an engine says on standard error, in its folder."""

T = TypeVar("T")
_FINISH_S = 30.0
_END_S = 5.0
# Fewer page tables, so that a fork copies less: it takes half the time (docs/performance.md).
_HUGE_PAGES = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
_FAILED, _LAST = float(FrameKind.FAILED), float(FrameKind.LAST)
_OF_A_CHILD = ("folder", "keep", "parent", "cpus", "poll", "branch")


def _start(run: EngineSpec) -> tuple[SocketPair, Process]:
    """Starts an engine as a program, which waits to be told what to simulate."""
    ours, theirs = socket_pairs()
    with theirs, (run.folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            [*ISOLATED, "eplus_node.engine", *map(str, theirs.descriptors), str(os.getpid())],
            pass_fds=theirs.descriptors,
            env=os.environ | _HUGE_PAGES,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
        )
    return ours, process


def start_all(of: Iterable[T], make: Callable[[T], EngineClient]) -> list[EngineClient]:
    """An engine for each; where one cannot be made, those made so far end."""
    made: list[EngineClient] = []
    try:
        for each in of:
            made.append(make(each))  # noqa: PERF401  # a comprehension would lose those made so far
    except BaseException:
        for link in made:
            link.close()
        raise
    return made


class EngineClient:
    """A running engine. `step` and `last` are those of its latest frame.

    Args:
        run: what it simulates.
        forked: the sockets and the process of a child that another engine has made of itself; else one is started.
        registry: of the node's engines; also says how long this one may stand still while it is waited for.
    """

    def __init__(
        self, run: EngineSpec, forked: tuple[SocketPair, Process] | None = None, registry: EngineRegistry | None = None
    ) -> None:
        self._run, self._registry = run, registry or EngineRegistry()
        points = run.points
        self._told = [i for i, a in enumerate(points.actuators) if a.feedback]
        values = len(points.sensors) + len(points.meters)
        self._frame_bytes = memoryview(bytearray(8 * (2 + values + len(self._told))))
        self._frame: NDArray[np.float64] = np.frombuffer(self._frame_bytes)
        self._said = self._frame_bytes.cast("d")
        self._values_bytes = self._frame_bytes[16 : 16 + 8 * values]
        self._feedback_bytes = self._frame_bytes[16 + 8 * values :]
        self._finish = struct.pack("=dd", OrderKind.FINISH, 0.0) + bytes(8 * len(points.actuators))
        self._order_bytes = 8 * len(points.actuators)
        self._step = struct.pack("=dd", OrderKind.STEP, 0.0)
        self.last = False
        self._interrupted = False
        if forked is None:
            self._registry.check_open()
        self._ends, self._process = forked or _start(run)
        self._socket, self._frames = self._ends
        self._descriptor, self._frames_descriptor = self._socket.fileno(), self._frames.fileno()
        self._frame_buffers = [self._frame_bytes]
        self._polling = Polling(enabled=run.poll)
        self._registry.add(self)
        if self._registry.closing:
            self.interrupt()  # the node has been told to end meanwhile
        if forked is None:
            self._tell_spec()

    def _tell_spec(self) -> None:
        spec = json.dumps(self._run.spec()).encode()
        try:
            with suppress(ConnectionError):  # an engine that has ended is noticed by whoever waits for it
                send_all(self._socket, struct.pack("<I", len(spec)) + spec, self._look())
        except BaseException:
            self.close()
            raise

    def fork(self, run: EngineSpec) -> EngineClient:
        """A child of this engine, which waits: it goes on from the same sample in the folder of `run`, on its own.

        Raises:
            EngineDied: this engine has ended, or its child has at once, or does not answer.
            ForkFailed: the system cannot fork it; it waits on.
        """
        try:
            ours, theirs = socket_pairs()
        except OSError as error:
            raise ForkFailed(f"the node has no socket for a fork: {error.strerror}") from None
        # Only what differs: a short text comes in one piece, with its socket.
        told = run.spec()
        spec = json.dumps({name: told[name] for name in _OF_A_CHILD}).encode()
        order = struct.pack("=dd", OrderKind.FORK, len(spec)) + bytes(self._order_bytes)
        with theirs, suppress(OSError):  # an engine that has ended is noticed below
            self._socket.sendall(order)
            socket.send_fds(self._socket, [spec], theirs.descriptors)
        try:
            pid = self._forked(ours.frames)
        except BaseException:
            ours.close()
            raise
        child = EngineClient(run, (ours, ForkedProcess(pid)), self._registry)
        try:
            self.receive()
        except BaseException:
            child.close()
            raise
        return child

    def _forked(self, frames: socket.socket) -> int:
        """The process id of a child that was ordered, which says it itself as well; raises as `fork` does."""
        said = read_process_id(self._frames, self._look())
        if said < 0:
            self.receive()
            raise ForkFailed(f"the system cannot fork an engine of {self.rss_bytes / 1e6:.0f} MB: {os.strerror(-said)}")
        pid = read_process_id(frames, self._look(said)) or said
        if not pid:
            raise EngineDied(self._last_words())
        return pid

    @property
    def pid(self) -> int:
        """The engine's process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    @property
    def rss_bytes(self) -> int:
        """Resident memory of the process; 0 if it has ended."""
        try:
            return int(psutil.Process(self._process.pid).memory_info().rss)
        except psutil.Error:
            return 0

    @property
    def private_bytes(self) -> int:
        """Memory of the process that it shares with no other; 0 if it has ended."""
        try:
            return int(psutil.Process(self._process.pid).memory_full_info().uss)
        except psutil.Error:
            return 0

    @property
    def run(self) -> EngineSpec:
        """What it simulates."""
        return self._run

    def interrupt(self) -> None:
        """Ends a process that is computing, so that whoever waits for its frame is told; any thread may."""
        self._interrupted = True
        self._process.kill()

    @property
    def step(self) -> int:
        """The number of the latest sample."""
        return int(self._frame[1])

    def values_bytes(self) -> bytes:
        """The latest sensors and meters, raw."""
        return bytes(self._values_bytes)

    def effective_bytes(self, commanded: bytes) -> bytes:
        """What each actuator really was, raw: as EnergyPlus tells, else as `commanded`."""
        if len(self._told) * 8 == len(commanded):
            return bytes(self._feedback_bytes)
        effective = np.frombuffer(commanded).copy()
        effective[self._told] = np.frombuffer(self._feedback_bytes)
        return effective.tobytes()

    def receive(self) -> None:
        """Waits for the next frame.

        Raises:
            ModelError: EnergyPlus gave up; with its own words.
            EngineDied: the process ended without a word.
            EngineUnresponsive: it did not answer, used no processor time, and was killed.
        """
        got, size = self._polling.wait(self._try_read, self._read), len(self._frame_bytes)
        if got < size and not (got and fill(self._frames, self._frame_bytes[got:], self._look())):
            raise EngineDied(self._last_words())
        said = self._said[0]
        if said == _FAILED:
            raise ModelError(self._refusal(int(self._frame[1])))
        self.last = said == _LAST

    def _try_read(self) -> int | None:
        try:
            return self._frames.recv_into(self._frame_bytes, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except ConnectionResetError:
            return 0

    def _read(self) -> int:
        try:
            return os.readv(self._frames_descriptor, self._frame_buffers)
        except BlockingIOError:
            return self._read_slow()
        except ConnectionResetError:
            return 0

    def _read_slow(self) -> int:
        """Waits for a frame that takes its time, and looks after the engine meanwhile."""
        return len(self._frame_bytes) if fill(self._frames, self._frame_bytes, self._look()) else 0

    def _look(self, pid: int = 0) -> Callable[[], None]:
        """What looks after the engine, or a child `pid` in its place, while it is waited for."""
        process = ForkedProcess(pid) if pid else self._process
        watch = IdleWatch(process.pid)

        def look() -> None:
            if self._interrupted:
                raise EngineDied("the engine process was ended, since the node ends")
            limit_s = self._registry.unresponsive_s
            if watch.look() < limit_s:
                return
            process.kill()
            process.wait()
            raise EngineUnresponsive(
                f"the engine process neither answered nor used processor time for {limit_s:g} s after sample "
                f"{self.step}, and was killed"
            )

        return look

    def send(self, actuators: bytes) -> None:
        """Orders the next timestep with these actuator values (float64); NaN releases an actuator."""
        order = self._step + actuators
        try:
            written = os.write(self._descriptor, order)
            if written < len(order):
                send_all(self._socket, order[written:], self._look())
        except BlockingIOError:
            send_all(self._socket, order, self._look())
        except (BrokenPipeError, ConnectionResetError):
            raise EngineDied(self._last_words()) from None

    def end(self, *, failed: bool) -> None:
        """Ends the run; where its files are kept, EnergyPlus may finish them, unless it has failed."""
        if self._run.keep_output and not failed:
            self.finish()
        else:
            self.close()

    def finish(self) -> None:
        """Lets EnergyPlus end the run early and write its files, then closes."""
        look, until_s = self._look(), monotonic() + _FINISH_S
        with suppress(OSError, EngineDied):  # it has ended already, or is ended now
            self._socket.sendall(self._finish)
            while monotonic() < until_s:
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(LOOK_S)
                    break
                look()
        self.close()

    def close(self) -> None:
        """Ends the process and clears its folder unless that is kept; twice is fine."""
        self._ends.close()
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._registry.remove(self)
        if not self._run.keep_output:
            shutil.rmtree(self._run.folder, ignore_errors=True)

    def _ended(self) -> int:
        """How a process ended that has closed its sockets."""
        try:
            return self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _refusal(self, length: int) -> str:
        raw = bytearray(length)
        fill(self._frames, memoryview(raw), self._look())
        text = raw.decode(errors="replace")
        self._ended()
        return f"{text}. {explain(self._run.folder, 'EnergyPlus gave no reason in eplusout.err')}"

    def _last_words(self) -> str:
        code = self._ended()
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        log = self._run.folder / LOG
        said = log.read_text(errors="replace").strip().splitlines()[-3:] if log.exists() else []
        words = explain(self._run.folder, "\n  ".join(["its last words:", *said]) if said else "it left no word")
        return f"the engine process {how} after sample {self.step}; {words}"
