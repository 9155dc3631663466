"""A node started by this process: a program of its own on a private unix socket that ends with its owner."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import psutil

from zenostat.bridge.python_plant.shipped import PLANT_SETTINGS
from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.scratch import Scratch
from zenostat.bridge.runtime.signals import defer_interrupts, override_signals
from zenostat.topics.errors import NodeLost, from_wire
from zenostat.topics.messages import Manifest

_EXIT_TIMEOUT_S = 5.0
_POLL_S = 0.5
_LATE_EXIT_S = 1.0  # that a killed process may take to end after its last message
_OUTPUT_TIMEOUT_S = 40.0  # EnergyPlus may still be writing output files that are kept
_SOCKET_PATH_MAX = 100  # sun_path has 108 bytes


class LocalNode:
    """A node process that ends on `close()`, or when this process ends for any reason.

    Args:
        settings: Fields of `zenostat.eplus_node.config.NodeConfig`; with `plant`, `fmu` or `grid` those of
            `zenostat.bridge.python_plant.node.PlantSettings`, with `district` those of
            `zenostat.cosim.node.DistrictSettings`; without endpoint, folder and core.
        placement: See `zenostat.bridge.runtime.affinity`.
        on_process: Called with this object when its process exists, before it is ready; another thread can then end
            it with `terminate`.

    Attributes:
        folder: The private folder of its socket.
        endpoint: The endpoint of its bus.
        core: The core that it runs on; None if it is not bound to one.
        manifest: The node's manifest, available before connecting to its bus; None if it only checked its settings.

    Raises:
        ZenostatError: The error that the node reported when it could not start.
        NodeLost: The node ended without reporting an error.
    """

    def __init__(
        self, settings: dict[str, Any], placement: Affinity, on_process: Callable[[LocalNode], None] = lambda _: None
    ) -> None:
        scratch = Scratch()
        if len(str(scratch.folder)) > _SOCKET_PATH_MAX - 10:
            scratch.remove()
            scratch = Scratch(parent="/tmp")
        self.folder = scratch.folder
        # A finalizer also runs at the interpreter's exit, and if the start is interrupted before there is a process.
        self._processes: list[subprocess.Popen[bytes]] = []
        self._owner = os.getpid()
        timeout_s = _EXIT_TIMEOUT_S if settings.get("output_dir") is None else _OUTPUT_TIMEOUT_S
        self._release = weakref.finalize(self, _release, self._processes, scratch, os.getpid(), timeout_s)
        self.endpoint = f"unixsock-stream/{self.folder}/bus"
        engine_core, self.core = affinity.pick_cores(placement)
        config = {**settings, "listen": [self.endpoint], "folder": str(self.folder)}
        config |= {"affinity": placement, "cpu": self.core, "engine_cpu": engine_core}
        try:
            # -P: files in the caller's folder must not shadow packages of the same name.
            # A process group of its own: Ctrl-C in the terminal is for the owner, which then ends the node. Not a
            # session of its own: Linux schedules sessions against each other, which costs about 20 us per step.
            with defer_interrupts():  # a process whose start is interrupted would be nobody's
                process = subprocess.Popen(
                    [sys.executable, "-P", "-m", _program(settings)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    process_group=0,
                )
                self._processes.append(process)
            _nodes.add(process)
            on_process(self)
            self._wait_ready(process, config)
        except BaseException:
            with ignore_interrupts():
                self.close()
            raise

    def _wait_ready(self, process: subprocess.Popen[bytes], config: dict[str, Any]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # if it has ended already, its reply is read next
            process.stdin.write(json.dumps(config).encode() + b"\n")
            process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            raise NodeLost(f"the node ended with code {process.wait()} before it was ready")
        reply = json.loads(line)
        if "error" in reply:
            raise from_wire(reply)
        self.manifest = Manifest.model_validate(reply["manifest"]) if "manifest" in reply else None

    @property
    def pid(self) -> int:
        """The node's process id."""
        return self._processes[0].pid

    @property
    def end(self) -> str:
        """Reason for which the node's process ended; empty while it runs, and always in a forked process."""
        if os.getpid() != self._owner or (code := self._processes[0].poll()) is None:
            return ""
        if code != -signal.SIGKILL:
            return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return "killed by SIGKILL, which the system also sends when memory runs out"

    def has_ended(self) -> bool:
        """Return whether its process has ended, after waiting up to a second: a killed process leaves the bus first."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            if os.getpid() == self._owner:
                self._processes[0].wait(_LATE_EXIT_S)
        return bool(self.end)

    @property
    def is_suspended(self) -> bool:
        """Whether its process is suspended, for example by Ctrl-Z or a debugger, and so cannot answer."""
        return _is_suspended(self.pid)

    def terminate(self) -> None:
        """Let the process end, from any thread, without waiting for it; a node that is starting raises `NodeLost`."""
        self._processes[0].terminate()

    def close(self) -> None:
        """End the node and remove its folder; idempotent."""
        self._release()


def _program(settings: dict[str, Any]) -> str:
    """Return the module that runs a node with these settings."""
    if "district" in settings:
        return "zenostat.cosim"
    return "zenostat.bridge.python_plant" if PLANT_SETTINGS & settings.keys() else "zenostat.eplus_node"


@contextlib.contextmanager
def ignore_interrupts() -> Iterator[None]:
    """Ignore further Ctrl-C during the cleanup after a first one, which takes a few seconds at most."""
    if threading.current_thread() is not threading.main_thread():  # Ctrl-C interrupts only the main thread
        yield
        return
    with override_signals(signal.SIG_IGN, signal.SIGINT):
        yield


_nodes: weakref.WeakSet[subprocess.Popen[bytes]] = weakref.WeakSet()
"""The nodes of this process."""


def _disown_nodes() -> None:
    """Close a forked child's copies of the pipes; with them open, a node would not notice the end of its owner."""
    for process in _nodes:
        _close_pipes(process)
    _nodes.clear()


os.register_at_fork(after_in_child=_disown_nodes)


def _close_pipes(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None and not pipe.closed:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


def _release(processes: list[subprocess.Popen[bytes]], scratch: Scratch, owner: int, timeout_s: float) -> None:
    """End a node and then remove its folder, to which it may be writing as long as it runs."""
    if os.getpid() != owner:
        return  # the exit of a forked child must not end its parent's node
    for process in processes:
        _close_pipes(process)
        _wait_or_kill(process, timeout_s)
    scratch.remove()


def _wait_or_kill(process: subprocess.Popen[bytes], timeout_s: float) -> None:
    """Wait for a process to exit; kill it after the timeout, or earlier if it is suspended."""
    start_s = time.monotonic()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_POLL_S)
            return
        waited_s = time.monotonic() - start_s
        if waited_s >= timeout_s or (waited_s >= _EXIT_TIMEOUT_S and _is_suspended(process.pid)):
            process.kill()
            process.wait()
            return


def _is_suspended(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_STOPPED)
    except psutil.Error:
        return False
