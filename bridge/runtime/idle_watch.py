"""Telling a process that stands still from one that computes: by the processor time that it uses."""

from __future__ import annotations

import psutil

LOOK_S = 0.5
"""Time between two looks at a process."""


class IdleWatch:
    """Idle time of a process that is being waited for.

    What counts is the waiting of the caller, look by look, and not the clock: a watcher that was frozen itself
    (together with its machine, say) does not take that time for the idleness of the other.

    Args:
        pid: the process.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._used_s = -1.0
        self._idle_s = 0.0

    def look(self, waited_s: float = LOOK_S) -> float:
        """For how long the process has been idle, in seconds; to be called after each `waited_s` of waiting."""
        used_s = processor_s(self._pid)
        self._idle_s = self._idle_s + waited_s if used_s == self._used_s else 0.0
        self._used_s = used_s
        return self._idle_s


def processor_s(pid: int) -> float:
    """Processor time that a process has used, in seconds; 0 if it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)
