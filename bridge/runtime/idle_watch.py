"""Detection of unresponsive processes by the processor time that they use."""

from __future__ import annotations

import psutil

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
        used_s = processor_s(self._pid)
        self._idle_s = self._idle_s + waited_s if used_s == self._used_s else 0.0
        self._used_s = used_s
        return self._idle_s


def processor_s(pid: int) -> float:
    """Return the processor time that a process has used, in seconds; 0 if it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)
