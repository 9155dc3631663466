"""Which core a process's threads run on.

The step is strictly sequential (engine, node, controller, node, engine), so wake-ups rule its speed. A thread
that sleeps on another core takes 20 to 60 us to wake; a thread that polls takes none, and one on the same core
5 us. And EnergyPlus runs a quarter slower on a core whose caches the bus shares. Hence the default, APART: the
engine has a core to itself and polls there; the node polls on another one, which it shares with the bus threads
of its controller. `docs/performance.md` has the measurements.
"""

from __future__ import annotations

import itertools
import os
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum

_STAND_BACK = 10
_turn = itertools.count(os.getpid())


class Affinity(StrEnum):
    """Where engine, node and the controller's bus threads run.

    `APART`: the engine on one core; node and bus threads on another. `NODE`: all of them on one core.
    `TOGETHER`: as `NODE`, and the controller's own thread there as well. `OFF`: wherever the system likes.
    """

    SEPARATE_CORES = "apart"
    NODE = "node"
    TOGETHER = "together"
    OFF = "off"


def supported() -> bool:
    """Whether this system can place threads."""
    return hasattr(os, "sched_setaffinity")


def host() -> str:
    """A name for this machine since its last start; placement only makes sense within it."""
    try:
        with open("/proc/sys/kernel/random/boot_id") as file:
            return file.read().strip()
    except OSError:
        return socket.gethostname()


def allowed() -> tuple[int, ...]:
    """The cores that the calling thread may use; empty if this system cannot place threads."""
    return tuple(sorted(os.sched_getaffinity(0))) if supported() else ()


def pick_cores(wanted: Affinity) -> tuple[int | None, int | None]:
    """(the engine's, the node's) core of those that this process may use, in turn; None: no choice."""
    if wanted is Affinity.OFF or not supported():
        return None, None
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        return None, None
    first = next(_turn) * (2 if wanted is Affinity.SEPARATE_CORES else 1)
    engine, node = cores[first % len(cores)], cores[(first + 1) % len(cores)]
    return (engine, node) if wanted is Affinity.SEPARATE_CORES else (engine, engine)


def set_affinity(core: int | None) -> None:
    """Places the calling thread, and all threads and processes that it starts from now on."""
    if core is not None and supported():
        os.sched_setaffinity(0, {core})


def lower_priority() -> None:
    """Has the calling thread, and those that it starts from now on, stand back where others want the core.

    For monitors, once their Zenoh session is open: the session's own threads go on to receive in time. Ten is as
    far as it goes without a loss: at nineteen, a year flat out on two cores lost 65 of 35,040 samples.
    """
    if sys.platform.startswith("linux"):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _STAND_BACK)


@contextmanager
def threads_started_on(core: int | None) -> Iterator[None]:
    """Places the threads that start meanwhile; the calling thread stays as it was."""
    if core is None or not supported() or core not in os.sched_getaffinity(0):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
