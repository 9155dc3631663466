"""Polling a while before sleeping.

Waking a thread that sleeps on another core costs more than a small building's own timestep. So a thread that
has a core to itself polls for what it waits for, up to twice as long as it usually takes, and sleeps only
then. It learns both: how long the wait usually is, and whether the core is really its own (the share of the
polling time that the system gave to the thread); where it is not, it sleeps at once for a thousand waits.

Imports nothing but the standard library: the engine uses it as well.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


class Polling:
    """One thread's waiting for one thing.

    Args:
        enabled: whether to poll at all.
    """

    LIMIT_S = 0.002
    WINDOW = 64
    PAUSE = 1024
    LEAST_SHARE = 0.6

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled and (os.cpu_count() or 1) > 1
        self._typical_s = self.LIMIT_S
        self._waits = 0
        self._paused_until = 0
        self._wall_s = 0.0
        self._cpu_s = 0.0

    def wait(self, attempt: Callable[[], T | None], block: Callable[[], T]) -> T:
        """What `attempt` (which never waits, None: nothing yet) or else `block` (which sleeps) returns."""
        if not self._enabled or self._waits < self._paused_until:
            self._waits += 1
            return block()
        start, cpu = time.perf_counter(), time.thread_time()
        until = start + min(2.0 * self._typical_s, self.LIMIT_S)
        clock = time.perf_counter
        got = attempt()
        while got is None and clock() < until:
            got = attempt()
        now = clock()
        self._wall_s += now - start
        self._cpu_s += time.thread_time() - cpu
        if got is None:
            got = block()
            now = clock()
        self._learn(now - start)
        return got

    def _learn(self, waited_s: float) -> None:
        self._waits += 1
        # Past the limit it makes no difference how long: a pause of the other side is soon forgotten.
        self._typical_s += 0.1 * (min(waited_s, self.LIMIT_S) - self._typical_s)
        if self._waits % self.WINDOW == 0:
            if self._cpu_s < self.LEAST_SHARE * self._wall_s:
                self._paused_until = self._waits + self.PAUSE
            self._wall_s = self._cpu_s = 0.0
