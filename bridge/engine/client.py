"""The node's side of an engine: start it, exchange a frame per timestep, detect its death, clean up."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from time import monotonic
from typing import Any

import psutil

from zenostat.bridge.engine.frame import Frame
from zenostat.bridge.engine.launch import describe_exit, launch
from zenostat.bridge.engine.lists import close_all
from zenostat.bridge.engine.process_handle import ForkedProcess, Process
from zenostat.bridge.engine.protocol import PROCESS_ID, FrameKind, OrderKind
from zenostat.bridge.engine.registry import EngineRegistry
from zenostat.bridge.engine.sockets import SocketPair, fill, read_process_id, send_all, socket_pairs
from zenostat.bridge.engine.spec import EngineSpec
from zenostat.bridge.runtime.idle_watch import LOOK_S, IdleWatch
from zenostat.bridge.runtime.polling import Polling
from zenostat.topics.errors import EngineDied, EngineUnresponsive, ForkFailed, SimulatorError

_MAX_ORDERED_FORKS = 8
"""Forks ordered at a time: their sockets are in transit until the engine receives them."""
_FINISH_TIMEOUT_S = 30.0
_EXIT_TIMEOUT_S = 5.0
_ORDERS = {
    OrderKind.RESET: "begin an episode",
    OrderKind.SAVE: "save its state",
    OrderKind.RESTORE: (_RESTORE := "restore a state"),
}
_FAILED, _LAST, _WARNING = float(FrameKind.FAILED), float(FrameKind.LAST), float(FrameKind.WARNING)


class EngineClient:
    """A running engine.

    Args:
        spec: what it simulates.
        forked: sockets and process of a fork of another engine; None starts a new engine.
        registry: the node's engines; also defines how long an engine may be unresponsive.

    Attributes:
        frame: its latest frame.
        last: whether that is its last sample.
        warnings: texts of warnings that arrived with its samples and were not drained yet.
    """

    def __init__(
        self, spec: EngineSpec, forked: tuple[SocketPair, Process] | None = None, registry: EngineRegistry | None = None
    ) -> None:
        self._spec, self.registry = spec, registry or EngineRegistry()
        self.frame = Frame(spec)
        self._finish = struct.pack("=dd", OrderKind.FINISH, 0.0) + bytes(8 * spec.actuators)
        self._repeat = struct.pack("=dd", OrderKind.REPEAT, 0.0) + bytes(8 * spec.actuators)
        self._order_bytes = 8 * spec.actuators
        self._step = struct.pack("=dd", OrderKind.STEP, 0.0)
        self.last = False
        self.warnings: list[str] = []
        self._interrupted = self._unresponsive = ""
        self._order = _RESTORE if spec.state else ""  # that it has not answered, other than to step
        self._closing_until_s = 0.0
        if forked is None:
            self.registry.check_open()
        self._sockets, self._process = forked or launch(spec)
        self._orders, self._frames = self._sockets
        self._orders_descriptor, self._frames_descriptor = self._orders.fileno(), self._frames.fileno()
        self._frame_bytes, self._frame_buffers = self.frame.buffer, [self.frame.buffer]
        self._polling = Polling(enabled=spec.poll)
        self._placement = self.registry.placement if spec.poll else None
        self.registry.add(self)
        if self.registry.closing:
            self.interrupt()  # the node was told to end in the meantime
        if forked is None:
            self._send_spec()

    def _send_spec(self) -> None:
        text = json.dumps(self._spec.fields()).encode()
        try:
            with suppress(ConnectionError):  # the next `receive` detects that the engine has ended
                send_all(self._orders, struct.pack("<I", len(text)) + text, self._watchdog())
        except BaseException:
            self.close()
            raise

    def fork(self, spec: EngineSpec) -> EngineClient:
        """Fork this engine. The fork waits at the same sample and has the folder of `spec`.

        Raises:
            EngineDied: this engine has ended, or its fork ended at once or does not answer.
            ForkFailed: the system cannot fork the engine, which keeps waiting at its sample.
        """
        return self.fork_all([spec])[0]

    def fork_all(self, specs: Sequence[EngineSpec]) -> list[EngineClient]:
        """Fork this engine once for each specification; the forks set themselves up while it forks again.

        Raises:
            EngineDied, ForkFailed: as `fork` does; the forks so far are closed.
        """
        children: list[EngineClient] = []
        try:
            for first in range(0, len(specs), _MAX_ORDERED_FORKS):
                self._fork_some(specs[first : first + _MAX_ORDERED_FORKS], children)
        except BaseException:
            close_all(children)
            raise
        return children

    def _fork_some(self, specs: Sequence[EngineSpec], children: list[EngineClient]) -> None:
        """Order several forks, then receive them all, so that no reply of this engine remains unread."""
        with ExitStack() as unused:
            pairs = []
            try:
                for _ in specs:
                    ours, theirs = socket_pairs()
                    pairs.append((ours, unused.enter_context(theirs)))
            except OSError as error:
                for ours, _ in pairs:
                    ours.close()
                raise ForkFailed(f"cannot open sockets for a fork: {error.strerror}") from None
            for spec, (_, theirs) in zip(specs, pairs, strict=True):
                self._order_fork(spec, theirs)
        failure: ForkFailed | None = None
        for position, (spec, (ours, _)) in enumerate(zip(specs, pairs, strict=True)):
            try:
                pid = self._forked_pid(ours.frames)
            except ForkFailed as error:
                ours.close()
                failure = error
                continue
            except BaseException:
                for rest, _ in pairs[position:]:
                    rest.close()
                raise
            children.append(EngineClient(spec, (ours, ForkedProcess(pid)), self.registry))
            self.receive()
        if failure is not None:
            raise failure

    def _order_fork(self, spec: EngineSpec, theirs: SocketPair) -> None:
        # Only the fields that differ: a short text arrives in one piece, with its sockets.
        text = json.dumps(spec.fork_fields()).encode()
        order = struct.pack("=dd", OrderKind.FORK, len(text)) + bytes(self._order_bytes)
        with suppress(OSError):  # `_forked_pid` detects that the engine has ended
            self._orders.sendall(order)
            socket.send_fds(self._orders, [text], theirs.descriptors)

    def send_reset(self, seed: int) -> None:
        """Order another episode; `receive` waits for its sample 0.

        Raises:
            EngineDied: the process has ended.
        """
        self._send_text(OrderKind.RESET, seed=seed)

    def send_restore(self, path: Path) -> None:
        """Order the state that another process of the same plant has saved; `receive` waits for its sample.

        Raises:
            EngineDied: the process has ended.
        """
        self._send_text(OrderKind.RESTORE, path=str(path))

    def confirm(self) -> None:
        """Have the engine, which waits at a sample, send it again.

        Raises:
            EngineDied, EngineUnresponsive: as `receive` does.
        """
        try:
            send_all(self._orders, self._repeat, self._watchdog())
        except ConnectionError:
            raise self._exit_error() from None
        self.receive()

    def save(self, path: Path) -> None:
        """Let the simulator write its state to a file.

        Raises:
            ForkFailed: it cannot; the text has its reason. The engine keeps waiting at its sample.
            EngineDied: the process has ended.
        """
        self._send_text(OrderKind.SAVE, path=str(path))
        raw = bytearray(PROCESS_ID.size)
        if not fill(self._frames, memoryview(raw), self._watchdog()):
            raise self._exit_error()
        self._order = ""
        if PROCESS_ID.unpack(raw)[0] != 0:
            raise ForkFailed(path.read_text(errors="replace"))

    def _send_text(self, kind: OrderKind, **fields: Any) -> None:
        self._order = _ORDERS[kind]
        text = json.dumps(fields).encode()
        order = struct.pack("=dd", kind, len(text)) + bytes(self._order_bytes)
        try:
            send_all(self._orders, order + text, self._watchdog())
        except ConnectionError:
            raise self._exit_error() from None

    def _forked_pid(self, frames: socket.socket) -> int:
        """Return the process id of the ordered fork, from this engine or from the fork; raise as `fork` does."""
        reply = read_process_id(self._frames, self._watchdog())
        if reply < 0:
            self.receive()
            # An engine with threads replies EBUSY: its fork would lose them.
            reason = (
                "its process has threads, which a fork would lose" if reply == -errno.EBUSY else os.strerror(-reply)
            )
            raise ForkFailed(f"cannot fork an engine of {self.rss_bytes / 1e6:.0f} MB: {reason}")
        pid = read_process_id(frames, self._watchdog(reply)) or reply
        if not pid:
            raise self._exit_error()
        return pid

    @property
    def pid(self) -> int:
        """The engine's process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    @property
    def rss_bytes(self) -> int:
        """Resident memory of the process; 0 once it has ended."""
        try:
            return int(psutil.Process(self._process.pid).memory_info().rss)
        except psutil.Error:
            return 0

    @property
    def private_bytes(self) -> int:
        """Memory that the process shares with no other; 0 once it has ended."""
        try:
            return int(psutil.Process(self._process.pid).memory_full_info().uss)
        except psutil.Error:
            return 0

    @property
    def spec(self) -> EngineSpec:
        """Specification of its run."""
        return self._spec

    def interrupt(self, reason: str = "the node ends") -> None:
        """Kill the process, so that the thread waiting for its frame gets `EngineDied` with a reason; thread-safe.

        One that has been told to close is left alone for `close_s`.
        """
        if monotonic() < self._closing_until_s:
            return
        self._interrupted = reason
        self._kill()

    @property
    def interrupted(self) -> bool:
        """Whether it was killed by `interrupt`."""
        return bool(self._interrupted)

    def _kill(self) -> None:
        if self._spec.program.leads_session:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()

    def order_close(self) -> bool:
        """Tell a simulator that has something to release to end; return whether it was told. `close` waits for it."""
        if not self._spec.close_s or self._interrupted or self._closing_until_s or not self.alive:
            return False
        self._closing_until_s = monotonic() + self._spec.close_s
        with suppress(OSError):  # it has ended, or has not read its previous orders
            self._orders.send(self._finish, socket.MSG_DONTWAIT)
        return True

    def await_close(self) -> None:
        """Wait until a simulator that was told to end has ended, for `close_s` at most."""
        if self._closing_until_s:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(max(self._closing_until_s - monotonic(), 0.0))

    def receive(self) -> None:
        """Wait for the next frame.

        Raises:
            SimulatorError: the simulator failed; the text contains its own message.
            EngineDied: the process ended.
            EngineUnresponsive: the process neither answered nor used processor time, and was killed.
        """
        self._receive_frame()
        while (kind := self.frame.kind) == _WARNING:
            self.warnings.append(self._receive_text(self.frame.number))
            self._receive_frame()
        if kind == _FAILED:
            raise self._failure(self.frame.number)
        self._order = ""
        self.last = kind == _LAST
        if self._placement is not None:
            self._placement.count(self._process.pid)

    def _receive_frame(self) -> None:
        got, size = self._polling.wait(self._try_read, self._read), len(self._frame_bytes)
        if got < size and not (got and fill(self._frames, self._frame_bytes[got:], self._watchdog())):
            raise self._exit_error()

    def _receive_text(self, length: int) -> str:
        raw = bytearray(length)
        fill(self._frames, memoryview(raw), self._watchdog())
        return raw.decode(errors="replace")

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
        """Wait for a frame and watch the engine in the meantime."""
        return len(self._frame_bytes) if fill(self._frames, self._frame_bytes, self._watchdog()) else 0

    def _watchdog(self, pid: int = 0) -> Callable[[], None]:
        """Return a check of the engine, or of its fork `pid`, to be called repeatedly while waiting for it."""
        process = ForkedProcess(pid) if pid else self._process
        watch = IdleWatch(process.pid)

        def check() -> None:
            if self._interrupted:
                raise EngineDied(f"the engine process was killed because {self._interrupted}")
            limit_s = self.registry.unresponsive_s
            if watch.look() < limit_s:
                return
            process.kill()
            process.wait()
            answered = f"answered the order to {self._order}" if self._order else "answered"
            sample = "" if self._order == _RESTORE else f" after sample {self.frame.number}"
            idle = f"neither {answered} nor used processor time for {limit_s:g} s{sample}"
            text = f"the engine process {idle}, and was killed"
            if not pid:
                self._unresponsive = text
            raise EngineUnresponsive(text)

        return check

    def send(self, actuators: bytes) -> None:
        """Order the next timestep with these actuator values (raw float64); NaN relinquishes an actuator."""
        order = self._step + actuators
        try:
            written = os.write(self._orders_descriptor, order)
            if written < len(order):
                send_all(self._orders, order[written:], self._watchdog())
        except BlockingIOError:
            send_all(self._orders, order, self._watchdog())
        except (BrokenPipeError, ConnectionResetError):
            raise self._exit_error() from None

    def send_several(self, rows: Iterable[bytes]) -> None:
        """Order several timesteps; as `send`. The engine must have room for them: see `EngineGroup.run`."""
        try:
            send_all(self._orders, b"".join([self._step + row for row in rows]), self._watchdog())
        except (BrokenPipeError, ConnectionResetError):
            raise self._exit_error() from None

    def end(self, *, failed: bool) -> None:
        """End the run. If its output is kept and it has not failed, let the simulator finish its files."""
        if self._spec.keep_output and not failed:
            self.finish()
        else:
            self.close()

    def finish(self) -> None:
        """Let the simulator end the run early and write its files, then close."""
        check, until_s = self._watchdog(), monotonic() + _FINISH_TIMEOUT_S
        with suppress(OSError, EngineDied):  # it has ended already, or was killed
            self._orders.sendall(self._finish)
            while monotonic() < until_s:
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(LOOK_S)
                    break
                check()
        self.close()

    def close(self) -> None:
        """End the process and remove its folder unless its output is kept; idempotent."""
        self.order_close()
        self.await_close()
        self._sockets.close()
        if self._process.poll() is None or self._spec.program.leads_session:
            self._kill()  # what the process has started may outlive it
        self._process.wait()
        self.registry.remove(self)
        if not self._spec.keep_output:
            shutil.rmtree(self._spec.folder, ignore_errors=True)

    def _exit_code(self) -> int:
        """Wait for a process that has closed its sockets; kill it if it does not end."""
        try:
            return self._process.wait(_EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _failure(self, length: int) -> SimulatorError:
        text = self._receive_text(length)
        self._exit_code()
        return self._spec.program.failure(text, self._spec.folder)

    def _exit_error(self) -> EngineDied:
        code = self._exit_code()
        if self._unresponsive:
            return EngineUnresponsive(self._unresponsive)
        if self._interrupted:
            return EngineDied(f"the engine process was killed because {self._interrupted}")
        return EngineDied(describe_exit(self._spec, code, self.frame.number))
