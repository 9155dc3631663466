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


class ForkedProcess:
    """A child that an engine made of itself for this process."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None
        self._lock = threading.Lock()  # one thread may wait for it while another kills it

    def poll(self) -> int | None:
        """See `Process`."""
        with self._lock:
            return self._reap()

    def wait(self, timeout: float | None = None) -> int:
        """See `Process`."""
        if self._code is None:
            with suppress(ChildProcessError):  # another thread has reaped it meanwhile
                self._wait(timeout)
        code = self.poll()
        assert code is not None
        return code

    def _wait(self, timeout: float | None) -> None:
        if timeout is None:
            os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT)
            return
        try:
            watch = os.pidfd_open(self.pid)
        except ProcessLookupError:
            return
        try:
            if not select.select([watch], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(f"engine {self.pid}", timeout)
        finally:
            os.close(watch)

    def kill(self) -> None:
        """See `Process`."""
        with self._lock:
            if self._reap() is None:
                os.kill(self.pid, signal.SIGKILL)

    def _reap(self) -> int | None:
        if self._code is None:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code
