"""A deadline for the end of a node, whatever it is doing.

Python handles a signal only between two bytecodes of the main thread. A thread of its own therefore receives the
request to end (the system writes the signal's number to a pipe) and makes sure that the node ends.
"""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable
from time import monotonic

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS

ENGINE_TIMEOUT_S = 0.5
"""Time from the request to end until engines that are computing are interrupted."""
SHUTDOWN_TIMEOUT_S = 1.7
"""Time from the request to end until the process is ended."""

_INTERRUPT_INTERVAL_S = 0.2
_REQUESTED, _CLOSED = 0, 255  # no signal has these numbers


class ShutdownGuard:
    """Makes a node end once it is asked to; `with ShutdownGuard(...) as guard`, in the main thread.

    Args:
        stop_waiting: makes the node stop waiting for engines; called after `ENGINE_TIMEOUT_S`, then repeatedly, with
            the number of signals so far.
        end_process: called after `timeout_s`; None never ends the process.
        timeout_s: time for the node to end by itself; `SHUTDOWN_TIMEOUT_S` after a second signal.
    """

    def __init__(
        self,
        stop_waiting: Callable[[int], None],
        end_process: Callable[[], None] | None,
        timeout_s: float = SHUTDOWN_TIMEOUT_S,
    ) -> None:
        self._stop_waiting, self._end_process, self._timeout_s = stop_waiting, end_process, timeout_s
        self._read_end, self._write_end = os.pipe()
        os.set_blocking(self._write_end, False)
        self._thread = threading.Thread(target=self._run, name="shutdown", daemon=True)
        self._previous_wakeup = -1

    def __enter__(self) -> ShutdownGuard:
        self._thread.start()
        self._previous_wakeup = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._previous_wakeup)
        os.write(self._write_end, bytes([_CLOSED]))
        self._thread.join()
        os.close(self._read_end)
        os.close(self._write_end)
        self._read_end = self._write_end = -1

    def request(self) -> None:
        """Start the deadline, as a signal does; thread-safe until `__exit__`."""
        os.write(self._write_end, bytes([_REQUESTED]))

    def _run(self) -> None:
        signals, interrupt_s, end_s = 0, 0.0, 0.0
        while (byte := self._read(interrupt_s)) != _CLOSED:
            now_s = monotonic()
            requested = byte == _REQUESTED or byte in TERMINATION_SIGNALS
            signals += requested and byte != _REQUESTED
            if requested and not end_s:
                interrupt_s, end_s = now_s + ENGINE_TIMEOUT_S, now_s + self._timeout_s
            if requested and signals > 1:
                interrupt_s, end_s = now_s, min(end_s, now_s + SHUTDOWN_TIMEOUT_S)
            if end_s and now_s >= end_s and self._end_process is not None:
                self._end_process()
            if end_s and now_s >= interrupt_s:
                self._stop_waiting(signals)
                interrupt_s = now_s + _INTERRUPT_INTERVAL_S

    def _read(self, until_s: float) -> int | None:
        """Return the next byte from the pipe, or None at `until_s`; 0 waits without limit."""
        wait_s = max(until_s - monotonic(), 0.0) if until_s else None
        return os.read(self._read_end, 1)[0] if select.select([self._read_end], [], [], wait_s)[0] else None
