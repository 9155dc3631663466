"""The node's side of an engine: start it, exchange a frame a timestep, notice its death, clear up."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import socket
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import psutil
from numpy.typing import NDArray

from bridge.polling import Polling
from eplus_node.engine import Order, Said
from models.energyplus import ISOLATED
from models.errfile import explain
from models.points import Points
from topics.errors import EngineDied, ModelRefused

_SOCKET_BYTES = 1 << 20
_FINISH_S = 30.0


@dataclass(frozen=True, slots=True)
class Run:
    """What one engine simulates: prepared files, the number of timesteps, the points in order."""

    model: Path
    weather: Path
    folder: Path
    steps: int
    steps_per_hour: int
    points: Points
    keep: bool = False
    cpu: int | None = None
    poll: bool = False

    def spec(self) -> dict[str, Any]:
        """The description that the engine reads first."""
        points = self.points
        return {
            "model": str(self.model),
            "weather": str(self.weather),
            "folder": str(self.folder),
            "steps": self.steps,
            "steps_per_hour": self.steps_per_hour,
            "keep": self.keep,
            "parent": os.getpid(),
            "cpu": self.cpu,
            "poll": self.poll,
            "sensors": [
                (s.variable, s.key, str(s.reading), system)
                for s, system in zip(points.sensors, points.system, strict=True)
            ],
            "meters": [(m.meter, h) for m, h in zip(points.meters, points.meter_handles, strict=True)],
            "actuators": [(a.component_type, a.control_type, a.key) for a in points.actuators],
            "feedback": [(a.feedback, a.key) for a in points.actuators if a.feedback],
        }


class Process(Protocol):
    """A process of ours."""

    @property
    def pid(self) -> int:
        """Its number."""

    def poll(self) -> int | None:
        """How it ended (negative: by that signal), None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Waits for its end; `subprocess.TimeoutExpired`."""

    def kill(self) -> None:
        """Ends it."""


class Forked:
    """A child that an engine made of itself for this process."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None

    def poll(self) -> int | None:
        """See `Process`."""
        return self._reap(os.WNOHANG)

    def wait(self, timeout: float | None = None) -> int:
        """See `Process`."""
        if timeout is not None and self._code is None:
            watch = os.pidfd_open(self.pid)
            try:
                if not select.select([watch], [], [], timeout)[0]:
                    raise subprocess.TimeoutExpired(f"engine {self.pid}", timeout)
            finally:
                os.close(watch)
        code = self._reap(0)
        assert code is not None
        return code

    def kill(self) -> None:
        """See `Process`."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)

    def _reap(self, how: int) -> int | None:
        if self._code is None:
            done, status = os.waitpid(self.pid, how)
            if done:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code


def _socket_pair() -> tuple[socket.socket, socket.socket]:
    pair = socket.socketpair()
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BYTES)
    return pair


def _start(run: Run) -> tuple[socket.socket, Process]:
    """Starts an engine as a program and tells it what to simulate."""
    ours, theirs = _socket_pair()
    try:
        with (run.folder / "engine.log").open("wb") as log:
            process = subprocess.Popen(
                [*ISOLATED, "eplus_node.engine", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
    finally:
        theirs.close()
    spec = json.dumps(run.spec()).encode()
    ours.sendall(struct.pack("<I", len(spec)) + spec)
    return ours, process


class EngineLink:
    """A running engine. `values`, `step` and `last` are those of its latest frame.

    Args:
        run: what it simulates.
        forked: the socket and the process of a child that another engine has made of itself; else one is started.
    """

    def __init__(self, run: Run, forked: tuple[socket.socket, Process] | None = None) -> None:
        self._run = run
        points = run.points
        self._told = [i for i, a in enumerate(points.actuators) if a.feedback]
        values = len(points.sensors) + len(points.meters)
        self._frame_bytes = memoryview(bytearray(8 * (2 + values + len(self._told))))
        self._frame: NDArray[np.float64] = np.frombuffer(self._frame_bytes)
        self._values_bytes = self._frame_bytes[16 : 16 + 8 * values]
        self._feedback_bytes = self._frame_bytes[16 + 8 * values :]
        self._finish = struct.pack("=dd", Order.FINISH, 0.0) + bytes(8 * len(points.actuators))
        self._order_bytes = 8 * len(points.actuators)
        self._step = struct.pack("=dd", Order.STEP, 0.0)
        self.values = self._frame[2 : 2 + values]
        self.last = False
        self._socket, self._process = forked or _start(run)
        self._descriptor = self._socket.fileno()
        self._frame_buffers = [self._frame_bytes]
        self._polling = Polling(enabled=run.poll)

    def fork(self, run: Run) -> EngineLink:
        """A child of this engine, which waits: it goes on from the same sample in the folder of `run`, on its own.

        Raises:
            EngineDied: this engine has ended.
        """
        ours, theirs = _socket_pair()
        # Only what differs: a short text comes in one piece, with its socket.
        told = run.spec()
        spec = json.dumps({name: told[name] for name in ("folder", "keep", "parent", "cpu", "poll")}).encode()
        order = struct.pack("=dd", Order.FORK, len(spec)) + bytes(self._order_bytes)
        try:
            self._socket.sendall(order)
            socket.send_fds(self._socket, [spec], [theirs.fileno()])
            theirs.close()
            said = ours.recv(8, socket.MSG_WAITALL)
        except OSError:
            said = b""
        if len(said) < 8:
            ours.close()
            raise EngineDied(self._last_words())
        self.receive()
        return EngineLink(run, (ours, Forked(*struct.unpack("=q", said))))

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

    def interrupt(self) -> None:
        """Ends a process that is computing, so that whoever waits for its frame is told; any thread may."""
        self._process.kill()

    @property
    def step(self) -> int:
        """The number of the latest sample."""
        return int(self._frame[1])

    def values_bytes(self) -> bytes:
        """The latest sensors and meters, raw."""
        return bytes(self._values_bytes)

    def applied_bytes(self, commanded: bytes) -> bytes:
        """What each actuator really was, raw: as EnergyPlus tells, else as `commanded`."""
        if len(self._told) * 8 == len(commanded):
            return bytes(self._feedback_bytes)
        applied = np.frombuffer(commanded).copy()
        applied[self._told] = np.frombuffer(self._feedback_bytes)
        return applied.tobytes()

    def receive(self) -> None:
        """Waits for the next frame.

        Raises:
            ModelRefused: EnergyPlus gave up; with its own words.
            EngineDied: the process ended without a word.
        """
        got, size = self._polling.wait(self._try_read, self._read), len(self._frame_bytes)
        while got and got < size:
            more = self._socket.recv_into(self._frame_bytes[got:])
            got = got + more if more else 0
        if not got:
            raise EngineDied(self._last_words())
        said = self._frame[0]
        if said == Said.FAILED:
            raise ModelRefused(self._refusal(int(self._frame[1])))
        self.last = bool(said == Said.LAST)

    def _try_read(self) -> int | None:
        try:
            return self._socket.recv_into(self._frame_bytes, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except ConnectionResetError:
            return 0

    def _read(self) -> int:
        try:
            return os.readv(self._descriptor, self._frame_buffers)
        except ConnectionResetError:
            return 0

    def send(self, actuators: bytes) -> None:
        """Orders the next timestep with these actuator values (float64); NaN releases an actuator."""
        order = self._step + actuators
        try:
            written = os.write(self._descriptor, order)
            if written < len(order):
                self._socket.sendall(order[written:])
        except (BrokenPipeError, ConnectionResetError):
            raise EngineDied(self._last_words()) from None

    def finish(self) -> None:
        """Lets EnergyPlus end the run early and write its files, then closes."""
        try:
            self._socket.sendall(self._finish)
            self._process.wait(_FINISH_S)
        except (OSError, subprocess.TimeoutExpired):
            pass  # it has ended already, or is ended now
        self.close()

    def close(self) -> None:
        """Ends the process and clears its folder unless that is kept; twice is fine."""
        self._socket.close()
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        if not self._run.keep:
            shutil.rmtree(self._run.folder, ignore_errors=True)

    def _refusal(self, length: int) -> str:
        text = self._socket.recv(length, socket.MSG_WAITALL).decode(errors="replace")
        self._process.wait()
        return f"{text}. {explain(self._run.folder, 'EnergyPlus gave no reason in eplusout.err')}"

    def _last_words(self) -> str:
        code = self._process.wait()
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        log = self._run.folder / "engine.log"
        said = log.read_text(errors="replace").strip().splitlines()[-3:] if log.exists() else []
        words = explain(self._run.folder, "\n  ".join(["its last words:", *said]) if said else "it left no word")
        return f"the engine process {how} after sample {self.step}; {words}"
