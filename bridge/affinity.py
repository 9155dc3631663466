"""Which core a process's threads run on. Wake-ups rule the speed of a step, and a wake-up on the same
core costs a tenth of one on another.

The default places the node, its engine and the *bus threads* of its controller on one core: then a step
crosses between cores twice, when the controller's own thread hands its command over and gets its sample.
"""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum

_next = itertools.count(os.getpid())


class Affinity(StrEnum):
    """`NODE`: node, engine and bus threads on one core. `TOGETHER`: the controller as well. `OFF`: none."""

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


def pick_core() -> int | None:
    """The next of the cores that this process may use, in turn; None where there is no choice."""
    if not supported():
        return None
    cores = sorted(os.sched_getaffinity(0))
    return cores[next(_next) % len(cores)] if len(cores) > 1 else None


def pin(core: int | None) -> None:
    """Places the calling thread, and all threads and processes that it starts from now on."""
    if core is not None and supported():
        os.sched_setaffinity(0, {core})


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
