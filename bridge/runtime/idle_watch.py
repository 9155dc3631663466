"""Detection of unresponsive processes by the processor time that they use."""

from __future__ import annotations

import psutil

from zenostat.bridge.runtime.processor_time import processor_s

LOOK_S = 0.5
"""Interval of checks in seconds."""


class IdleWatch:
    """Measures how long a process has been idle while the caller waits for it.

    Idle time is the sum of the caller's waits, not a difference of clock times: if the caller itself was suspended
    (for example with its machine), that time does not count as idle time of the process.

    Args:
        pid: the process id.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._used_s = -1.0
        self._idle_s = 0.0

    def look(self, waited_s: float = LOOK_S) -> float:
        """Return for how many seconds the process has been idle; call it after each wait of `waited_s`."""
        try:
            used_s = processor_s(psutil.Process(self._pid))
        except psutil.Error:  # it has ended
            used_s = 0.0
        self._idle_s = self._idle_s + waited_s if used_s == self._used_s else 0.0
        self._used_s = used_s
        return self._idle_s
