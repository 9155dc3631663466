"""CPU affinity and scheduling priority of threads.

A step is strictly sequential (engine, node, controller, node, engine), so wake-up latency determines its speed. A
thread that sleeps on another core takes 20 to 60 us to wake, one on the same core 5 us; a thread that polls does not
have to wake. EnergyPlus runs a quarter slower on a core whose caches the bus threads share. Hence the default,
`SEPARATE_CORES`: the engine polls on a core of its own, and the node polls on another one, which it shares with the bus
threads of its controller. While other programs need these cores, `zenostat.bridge.runtime.contention` leaves node and
engine to the operating system. `docs/performance.md` has the measurements.
"""

from __future__ import annotations

import itertools
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum

_LOW_PRIORITY = 10
_next_index = itertools.count(os.getpid())


class Affinity(StrEnum):
    """Placement of the engine, the node and the controller's bus threads.

    `SEPARATE_CORES`: the engine on one core; the node and the bus threads on another. `NODE`: all of them on one core.
    `TOGETHER`: like `NODE`, with the controller's own thread on the same core. `OFF`: left to the operating system.
    """

    SEPARATE_CORES = "apart"
    NODE = "node"
    TOGETHER = "together"
    OFF = "off"


def host() -> str:
    """Return an identifier of this machine and its last boot; affinity is only meaningful within one machine."""
    try:
        with open("/proc/sys/kernel/random/boot_id") as file:
            return file.read().strip()
    except OSError:
        return socket.gethostname()


def allowed() -> tuple[int, ...]:
    """Return the cores that the calling thread may use."""
    return tuple(sorted(os.sched_getaffinity(0)))


def pick_cores(wanted: Affinity) -> tuple[int | None, int | None]:
    """Return the cores of the next engine and its node, round-robin over this process's cores; None: no placement."""
    if wanted is Affinity.OFF:
        return None, None
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        return None, None
    first = next(_next_index) * (2 if wanted is Affinity.SEPARATE_CORES else 1)
    engine, node = cores[first % len(cores)], cores[(first + 1) % len(cores)]
    return (engine, node) if wanted is Affinity.SEPARATE_CORES else (engine, engine)


def set_affinity(core: int | None) -> None:
    """Set the core of the calling thread and of all threads and processes that it starts from now on."""
    if core is not None:
        os.sched_setaffinity(0, {core})


def lower_priority() -> None:
    """Lower the priority of the calling thread and of the threads that it starts from now on.

    Monitors call it once their Zenoh session is open, so that the session's own threads keep receiving in time. A nice
    value of 10 is the highest without loss: at 19, a year in free mode on two cores lost 65 of 35,040 samples.
    """
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _LOW_PRIORITY)


@contextmanager
def threads_started_on(core: int | None) -> Iterator[None]:
    """Set the core of threads started within this context; the calling thread's affinity is restored."""
    if core is None or core not in os.sched_getaffinity(0):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
