"""Adaptive polling: poll for a while before sleeping, as long as it pays.

Waking a thread that sleeps on another core delays the step by 35 to 40 us, however long the thread waits. Polling
avoids this, but uses the whole wait as processor time, which other programs on the machine then lack. The shorter the
cycle (the time from one result to the next), the more polling gains and the less it costs. A thread therefore polls
only while its typical cycle is at most `Polling.LIMIT_S`, of which a saved wake-up is some 5 %, and then for up to
twice its typical wait. If a controller computes for longer or the machine is busy, both sides of an exchange sleep
immediately. A thread also measures the waits in which it sleeps, so it polls again after a few short cycles.

A typical time is a moving average of times that are clipped, so that one long pause does not change it for long.

The thread also measures whether its core is its own (the share of the polling time in which the thread ran). If it is
not, it sleeps immediately in the next thousand waits.

This module imports only the standard library, since the engine process uses it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


class Polling:
    """Adaptive polling of one thread for one condition.

    Args:
        enabled: whether to poll at all.
    """

    # Between the step of a small building with a quick controller (0.35 to 0.65 ms) and with one that computes for
    # 0.5 ms (0.85 to 1.15 ms). docs/performance.md has the measurements.
    LIMIT_S = 0.0008
    WEIGHT = 0.1
    WINDOW = 64
    PAUSE = 1024
    MIN_CPU_SHARE = 0.6

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled and (os.cpu_count() or 1) > 1
        self._wait_s = self.LIMIT_S
        self._cycle_s = 2.0 * self.LIMIT_S
        self._poll_s = 0.0
        self._end_s = float("-inf")
        self._waits = 0
        self._paused_until = 0
        self._wall_s = 0.0
        self._cpu_s = 0.0

    def wait(self, attempt: Callable[[], T | None], block: Callable[[], T]) -> T:
        """Wait for a result.

        Args:
            attempt: returns the result without waiting, or None if there is none yet.
            block: sleeps until there is a result and returns it.
        """
        if not self._enabled or self._waits < self._paused_until:
            self._waits += 1
            return block()
        clock = time.perf_counter
        result: T | None = None
        start = now = clock()
        if self._poll_s:
            cpu, until = time.thread_time(), start + self._poll_s
            result = attempt()
            while result is None and clock() < until:
                result = attempt()
            now = clock()
            self._wall_s += now - start
            self._cpu_s += time.thread_time() - cpu
        if result is None:
            result = block()
            now = clock()
        self._learn(now - start, now - self._end_s)
        self._end_s = now
        return result

    def _learn(self, waited_s: float, cycle_s: float) -> None:
        self._waits += 1
        limit_s = self.LIMIT_S
        self._wait_s += self.WEIGHT * (min(waited_s, limit_s) - self._wait_s)
        self._cycle_s += self.WEIGHT * (min(cycle_s, 2.0 * limit_s) - self._cycle_s)
        self._poll_s = min(2.0 * self._wait_s, limit_s) if self._cycle_s <= limit_s else 0.0
        if self._waits % self.WINDOW == 0:
            if self._cpu_s < self.MIN_CPU_SHARE * self._wall_s:
                self._paused_until = self._waits + self.PAUSE
            self._wall_s = self._cpu_s = 0.0
