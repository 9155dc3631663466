"""Processor time of a process with all that it started, and the share of the cores that other processes used."""

from __future__ import annotations

import os
import time
from contextlib import suppress

import psutil

_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


def _busy_s() -> float:
    with open("/proc/stat") as file:
        user, nice, system, _idle, _iowait, irq, soft, steal = map(int, file.readline().split()[1:9])
    return (user + nice + system + irq + soft + steal) * _TICK_S


def _own_s() -> dict[int, float]:
    """Return the time of this process and each of its descendants, with the ended children that each waited for."""
    me = psutil.Process()
    spent = {}
    for process in [me, *me.children(recursive=True)]:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        spent[process.pid] = sum(times[:4])
    return spent


class ProcessorTime:
    """Processor time of this process and of those that it has started by now, ended ones included; Linux only."""

    def __init__(self) -> None:
        me = psutil.Process()
        # The kernel's clock of another process, see clock_getcpuclockid(3): exact, where /proc counts in ticks.
        self._clocks = [(~process.pid << 3) | 2 for process in [me, *me.children(recursive=True)]]
        self._latest = [0.0] * len(self._clocks)

    def seconds(self) -> float:
        """Return the sum over the processes."""
        for number, clock in enumerate(self._clocks):
            with suppress(OSError):  # it has ended
                self._latest[number] = time.clock_gettime(clock)
        return sum(self._latest)


class OtherLoad:
    """Processor time that other processes and the host have used since its creation; Linux only."""

    def __init__(self) -> None:
        self._wall, self._busy, self._own = os.times().elapsed, _busy_s(), _own_s()

    def share(self) -> float:
        """Return the share of all cores, 0 to 1."""
        wall = os.times().elapsed - self._wall
        own = sum(spent - self._own.get(pid, 0.0) for pid, spent in _own_s().items())
        return max(0.0, (_busy_s() - self._busy - own) / (wall * (os.cpu_count() or 1)))
