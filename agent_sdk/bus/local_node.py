"""A node of one's own: started as a program, reached over a private unix socket, ended with its owner."""

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
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

from bridge.runtime import affinity
from bridge.runtime.affinity import Affinity
from bridge.runtime.scratch import Scratch
from bridge.runtime.signals import override_signals
from topics.errors import NodeLost, from_wire
from topics.messages import Manifest

_END_S = 5.0
_LOOK_S = 0.5
_FINISH_S = 40.0  # EnergyPlus may be finishing files that are kept
_SOCKET_PATH_MAX = 100  # sun_path has 108 bytes


class LocalNode:
    """A node process that ends on `close()`, or when this process ends in any way.

    Args:
        settings: of `eplus_node.config.NodeConfig`; the endpoint, folder and core are filled in here.
        placement: see `bridge.runtime.affinity`.

    Attributes:
        manifest: what the node is, told before anybody has joined its bus; None if it was only to check.

    Raises:
        ZenostatError: whatever the node raised when it could not start.
        NodeLost: it ended without a word.
    """

    def __init__(self, settings: dict[str, Any], placement: Affinity) -> None:
        scratch = Scratch()
        if len(str(scratch.folder)) > _SOCKET_PATH_MAX - 10:
            scratch.remove()
            scratch = Scratch(parent="/tmp")
        self.folder = scratch.folder
        # Also at the interpreter's exit, and if the start is interrupted before there is a process.
        self._held: list[subprocess.Popen[bytes]] = []
        self._owner = os.getpid()
        self._let_go = weakref.finalize(
            self, _let_go, self._held, scratch, os.getpid(), _END_S if settings.get("output_dir") is None else _FINISH_S
        )
        self.endpoint = f"unixsock-stream/{self.folder}/bus"
        engine_core, self.core = affinity.pick_cores(placement)
        config = {**settings, "listen": [self.endpoint], "folder": str(self.folder)}
        config |= {"affinity": placement, "cpu": self.core, "engine_cpu": engine_core}
        try:
            # -P: a models.py in the caller's folder must not stand in for the room of that name.
            # A process group of its own: Ctrl-C in the terminal is for the owner, who then ends the node. Not a
            # session of its own: Linux schedules sessions against each other, which costs some 20 us a step.
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "eplus_node"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                process_group=0,
            )
            self._held.append(process)
            _nodes.add(process)
            self._wait_ready(process, config)
        except BaseException:
            with ignore_interrupts():
                self.close()
            raise

    def _wait_ready(self, process: subprocess.Popen[bytes], config: dict[str, Any]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # what it said before it ended, if anything, is read next
            process.stdin.write(json.dumps(config).encode() + b"\n")
            process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            raise NodeLost(f"the node ended with code {process.wait()} before it was ready")
        said = json.loads(line)
        if "error" in said:
            raise from_wire(said)
        self.manifest = Manifest.model_validate(said["manifest"]) if "manifest" in said else None

    @property
    def pid(self) -> int:
        """The node's process id."""
        return self._held[0].pid

    @property
    def end(self) -> str:
        """How the node's process ended; empty while it runs, and in a forked process, which cannot know."""
        if os.getpid() != self._owner or (code := self._held[0].poll()) is None:
            return ""
        if code != -signal.SIGKILL:
            return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return "killed by SIGKILL, which the system also sends when memory runs out"

    def close(self) -> None:
        """Ends the node and clears its folder; twice is fine."""
        self._let_go()


@contextlib.contextmanager
def ignore_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C while that which was interrupted already is cleared up, which takes some seconds at most."""
    if threading.current_thread() is not threading.main_thread():  # it interrupts no other
        yield
        return
    with override_signals(signal.SIG_IGN, signal.SIGINT):
        yield


_nodes: weakref.WeakSet[subprocess.Popen[bytes]] = weakref.WeakSet()
"""Nodes of this process."""


def _forget_nodes() -> None:
    """A forked child has the pipes of its parent's nodes, too: a node would not hear of its owner's end."""
    for process in _nodes:
        _close_pipes(process)
    _nodes.clear()


os.register_at_fork(after_in_child=_forget_nodes)


def _close_pipes(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None and not pipe.closed:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


def _let_go(held: list[subprocess.Popen[bytes]], scratch: Scratch, owner: int, limit_s: float) -> None:
    """Ends a node, within a time, and clears its folder, in this order: a node that runs may be writing there."""
    if os.getpid() != owner:
        return  # a forked child's end is not its parent's
    for process in held:
        _close_pipes(process)
        _end(process, limit_s)
    scratch.remove()


def _end(process: subprocess.Popen[bytes], limit_s: float) -> None:
    """Waits for the end of a process that was told to end; one that does not come to it, or is stopped, is killed."""
    began_s = time.monotonic()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_LOOK_S)
            return
        waited_s = time.monotonic() - began_s
        if waited_s >= limit_s or (waited_s >= _END_S and _stopped(process.pid)):
            process.kill()
            process.wait()
            return


def _stopped(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_STOPPED)
    except psutil.Error:
        return False


class Monitor:
    """A live view of a bus, in a process of its own: Rerun's viewer if there is a display, else its web page."""

    def __init__(self, endpoint: str, keys: Path | None = None) -> None:
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        program = [sys.executable, "-P", "-m", "cli.main", "monitor", "--connect", endpoint]
        program += ["--keys", str(keys)] if keys is not None else []
        self._process = subprocess.Popen([*program, *([] if display else ["--web"])], stdin=subprocess.DEVNULL)
        self._owner = os.getpid()

    def close(self) -> None:
        """Ends it."""
        if os.getpid() != self._owner:
            return  # a forked child's end is not its parent's
        self._process.terminate()
        try:
            self._process.wait(timeout=_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
