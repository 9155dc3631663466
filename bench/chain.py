"""A lower bound for a step across processes: the same messages between the same processes, as bare bytes.

EnergyPlus in a process of its own, two pipes, a process with a Zenoh session, a unix socket, and this process.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from zenoh.handlers import FifoChannel

from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.transport.session import open_session
from zenostat.topics.arrays import Floats

_SAMPLE, _COMMAND = "sample", "command"
_MAX_BYTES = 1 << 16
_TIMEOUT_S = 60.0

Simulate = Callable[[Callable[[], bytes], Callable[[bytes], None]], None]


class Chain:
    """Steps an engine with bare bytes; `with Chain(run, folder, placement) as chain`.

    Args:
        run: a `bench.worker.InProcess` that simulates in a process forked from this one; None: no engine, and the node
            sends back what it receives.
        folder: for the socket.
        placement: `node` or `together`; see `zenostat.bridge.runtime.affinity`.
    """

    def __init__(self, run: Any, folder: Path, placement: Affinity) -> None:
        core, _ = affinity.pick_cores(placement)
        endpoint = f"unixsock-stream/{folder}/chain"
        self._action: Floats = run.action if run is not None else np.zeros(1)
        with ExitStack() as undo:
            self._start(undo, run, endpoint, core)  # fork before this process opens a Zenoh session
            with affinity.threads_started_on(core):
                session = undo.enter_context(open_session(connect=[endpoint], wait=True))
                samples = undo.enter_context(session.declare_subscriber(_SAMPLE, FifoChannel(16)))
                commands = undo.enter_context(session.declare_publisher(_COMMAND))
            if placement is Affinity.TOGETHER:
                affinity.set_affinity(core)
            until = time.monotonic() + _TIMEOUT_S
            while not commands.matching_status.matching and time.monotonic() < until:
                time.sleep(0.01)
            self._recv, self._put = samples.recv, commands.put
            self._put(b"")  # requests sample 0
            self._recv()
            self._close = undo.pop_all()

    def __enter__(self) -> Chain:
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    def step(self) -> None:
        """Send a command and wait for the next sample."""
        self._put(self._action.tobytes())
        np.frombuffer(self._recv().payload.to_bytes()).astype(np.float32)

    def _start(self, undo: ExitStack, run: Any, endpoint: str, core: int | None) -> None:
        if run is None:
            self._fork(undo, lambda: _echo(endpoint, core), ())
            return
        orders, frames = os.pipe(), os.pipe()
        self._fork(undo, lambda: _engine(run, orders[0], frames[1], core), (orders[1], frames[0]))
        self._fork(undo, lambda: _node(endpoint, frames[0], orders[1], core), (orders[0], frames[1]))
        for end in (*orders, *frames):
            os.close(end)

    @staticmethod
    def _fork(undo: ExitStack, work: Callable[[], None], unused: tuple[int, ...]) -> None:
        child = os.fork()
        if child == 0:
            try:
                for end in unused:
                    os.close(end)
                work()
            finally:
                os._exit(0)
        undo.callback(os.waitpid, child, 0)
        undo.callback(os.kill, child, signal.SIGKILL)


def _engine(run: Any, orders: int, frames: int, core: int | None) -> None:
    affinity.set_affinity(core)

    def exchange(state: Any) -> None:
        os.write(frames, np.array(run.read(state)).tobytes())
        order = os.read(orders, _MAX_BYTES)
        if not order:
            os._exit(0)
        run.set(state, np.frombuffer(order).tolist())

    run.run(exchange, None)


def _node(endpoint: str, frames: int, orders: int, core: int | None) -> None:
    affinity.set_affinity(core)
    with open_session(listen=[endpoint]) as session:
        commands = session.declare_subscriber(_COMMAND, FifoChannel(16))
        samples = session.declare_publisher(_SAMPLE)
        commands.recv()
        while frame := os.read(frames, _MAX_BYTES):
            samples.put(frame)
            os.write(orders, commands.recv().payload.to_bytes())


def _echo(endpoint: str, core: int | None) -> None:
    affinity.set_affinity(core)
    with open_session(listen=[endpoint]) as session:
        commands = session.declare_subscriber(_COMMAND, FifoChannel(16))
        samples = session.declare_publisher(_SAMPLE)
        while True:
            samples.put(commands.recv().payload.to_bytes())
