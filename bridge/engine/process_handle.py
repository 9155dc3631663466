"""A process that an engine forked, with the interface of `subprocess.Popen`."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import threading
from contextlib import suppress
from typing import Protocol


class Process(Protocol):
    """A child process, as `subprocess.Popen` or a `ForkedProcess`."""

    @property
    def pid(self) -> int:
        """Process id."""

    def poll(self) -> int | None:
        """Return the exit code (negative: killed by that signal), or None while the process runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the process to end and return its exit code; raise `subprocess.TimeoutExpired`."""

    def kill(self) -> None:
        """Kill the process; no effect once it has ended."""


class ForkedProcess:
    """A fork of an engine. Its parent is the node, not the engine that forked: see `system_calls.clone`."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None
        self._lock = threading.Lock()  # one thread may wait while another kills the process

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        with self._lock:
            return self._reap()

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the process to end and return its exit code."""
        if self._code is None:
            with suppress(ChildProcessError):  # another thread has reaped it
                self._wait(timeout)
        code = self.poll()
        assert code is not None
        return code

    def _wait(self, timeout: float | None) -> None:
        if timeout is None:
            os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT)
            return
        try:
            descriptor = os.pidfd_open(self.pid)
        except ProcessLookupError:
            return
        try:
            if not select.select([descriptor], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(f"engine {self.pid}", timeout)
        finally:
            os.close(descriptor)

    def kill(self) -> None:
        """Kill the process unless it has ended."""
        with self._lock:
            if self._reap() is None:
                os.kill(self.pid, signal.SIGKILL)

    def _reap(self) -> int | None:
        if self._code is None:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code
