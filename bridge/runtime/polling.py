"""Adaptive polling: poll for a while before sleeping.

Waking a thread that sleeps on another core takes longer than a small building's timestep. A thread with a core of its
own therefore polls for up to twice the usual waiting time before it sleeps. It measures the usual waiting time, and
whether the core is really its own (the share of the polling time in which the thread ran). If it is not, it sleeps
immediately in the next thousand waits.

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

    LIMIT_S = 0.002
    WINDOW = 64
    PAUSE = 1024
    MIN_CPU_SHARE = 0.6

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled and (os.cpu_count() or 1) > 1
        self._typical_s = self.LIMIT_S
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
        start, cpu = time.perf_counter(), time.thread_time()
        until = start + min(2.0 * self._typical_s, self.LIMIT_S)
        clock = time.perf_counter
        result = attempt()
        while result is None and clock() < until:
            result = attempt()
        now = clock()
        self._wall_s += now - start
        self._cpu_s += time.thread_time() - cpu
        if result is None:
            result = block()
            now = clock()
        self._learn(now - start)
        return result

    def _learn(self, waited_s: float) -> None:
        self._waits += 1
        # Clipped, so that one long pause of the other side does not change the estimate for long.
        self._typical_s += 0.1 * (min(waited_s, self.LIMIT_S) - self._typical_s)
        if self._waits % self.WINDOW == 0:
            if self._cpu_s < self.MIN_CPU_SHARE * self._wall_s:
                self._paused_until = self._waits + self.PAUSE
            self._wall_s = self._cpu_s = 0.0
