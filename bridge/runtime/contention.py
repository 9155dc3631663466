"""Cores of an engine and its node while other programs need them.

A fixed placement makes a step short on idle cores: each side polls on a core of its own. With two such nodes on two
cores, or a controller that computes, an engine often waits for its core while the other one is idle, which the
operating system would have chosen. Linux counts the time that a thread was ready and waited for a core
(`/proc/<pid>/schedstat`). While that is much of the engine's time, the operating system places engine and node, and
the bus threads of the controller that started them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from pathlib import Path


class CorePlacement:
    """Places an engine and the threads of its node on one core each, unless other programs use these cores.

    Args:
        engine_core, node_core: where they run by default.
        allowed: the cores that they may use.

    Attributes:
        released: whether the operating system places them at present.
    """

    SAMPLES = 64
    """Samples between two measurements."""
    WINDOW = 8
    """Measurements before each decision: 512 samples, 0.2 to 2 s of most buildings."""
    PAUSE = 32
    """Windows until the fixed placement is tried again: it costs 3 % of the samples at most."""
    MAX_WAIT_SHARE = 0.2
    """Waiting for a core, as a share of waiting and running. On idle cores it is below 0.06, and 0.35 to 0.5 with two
    environments on two cores."""

    def __init__(self, engine_core: int, node_core: int, allowed: Sequence[int]) -> None:
        self._engine_core, self._node_core, self._allowed = engine_core, node_core, frozenset(allowed)
        self.released = False
        self._threads: set[int] = set()
        self._pid = 0
        self._samples = self._measurements = self._paused = 0
        self._times = (0, 0)
        self._run_ns = self._wait_ns = 0

    def count(self, pid: int) -> None:
        """Count a sample of the engine with this process id; now and then, measure and place."""
        if pid != self._pid:
            self._start(pid)
        self._samples += 1
        if self._samples >= self.SAMPLES:
            self._samples = 0
            self._measure()

    def _start(self, pid: int) -> None:
        self._pid, self._samples, self._times = pid, 0, _times(pid)
        if self.released:
            _place(pid, self._allowed)

    def _measure(self) -> None:
        if self.released:  # an engine that was prefetched is pinned once more when its episode begins
            _place(self._pid, self._allowed)
        run_ns, wait_ns = _times(self._pid)
        self._run_ns += max(run_ns - self._times[0], 0)
        self._wait_ns += max(wait_ns - self._times[1], 0)
        self._times = run_ns, wait_ns
        self._measurements += 1
        if self._measurements < self.WINDOW:
            return
        if self.released:
            self._paused += 1
            if self._paused >= self.PAUSE:
                self._pin()
        elif self._wait_ns > self.MAX_WAIT_SHARE * (self._run_ns + self._wait_ns):
            self._release()
        self._measurements = self._run_ns = self._wait_ns = 0

    def _release(self) -> None:
        self.released, self._paused = True, 0
        self._threads = {thread for thread in own_threads() if _cores(thread) == {self._node_core}}
        for thread in (self._pid, *self._threads):
            _place(thread, self._allowed)

    def _pin(self) -> None:
        self.released = False
        _place(self._pid, {self._engine_core})
        _place_own(self._threads, {self._node_core})


class FollowedPlacement:
    """Places threads like a node's own: on its core, or wherever the operating system places them.

    Args:
        node: process id of the node.
        core: the node's core, on which the threads run at first.
        threads: native ids of threads of this process.
    """

    SAMPLES = 512
    """Samples between two looks at the node's cores: as many as between two decisions of `CorePlacement`."""

    def __init__(self, node: int, core: int, threads: AbstractSet[int]) -> None:
        self._node, self._core, self._threads = node, core, threads
        self._allowed = frozenset(os.sched_getaffinity(0)) | {core}
        self._samples = 0
        self._released = False

    def count(self) -> None:
        """Count a sample of the node; now and then, look at its cores."""
        self._samples += 1
        if self._samples < self.SAMPLES:
            return
        self._samples = 0
        cores = _cores(self._node)
        if not cores or (released := cores != {self._core}) == self._released:
            return
        self._released = released
        _place_own(self._threads, self._allowed if released else {self._core})


def _times(pid: int) -> tuple[int, int]:
    """Return for how many nanoseconds a process's main thread has run, and has waited for a core; 0 if unknown."""
    try:
        run_ns, wait_ns, _ = Path(f"/proc/{pid}/schedstat").read_text().split()
        return int(run_ns), int(wait_ns)
    except (OSError, ValueError):
        return 0, 0


def own_threads() -> set[int]:
    """Return the native ids of this process's threads."""
    return {int(name) for name in os.listdir("/proc/self/task")}


def _cores(thread: int) -> set[int]:
    try:
        return os.sched_getaffinity(thread)
    except OSError:
        return set()


def _place(thread: int, cores: AbstractSet[int]) -> None:
    with suppress(OSError):  # it has ended, or a container has lost the core
        os.sched_setaffinity(thread, cores)


def _place_own(threads: AbstractSet[int], cores: AbstractSet[int]) -> None:
    """Place those threads that have not ended; another process may have the id of one that has."""
    for thread in threads & own_threads():
        _place(thread, cores)
