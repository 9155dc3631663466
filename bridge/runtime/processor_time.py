"""Processor time of a process, and of it with all processes that it has started."""

from __future__ import annotations

from contextlib import suppress

import psutil


def processor_s(process: psutil.Process) -> float:
    """Return the processor time of a process so far, in seconds: user and system."""
    times = process.cpu_times()
    return float(times.user + times.system)


def tree_processor_s(root: psutil.Process | None = None) -> float:
    """Return the processor time so far, in seconds, of a process (by default this one) and all that descend from it."""
    root, total = root or psutil.Process(), 0.0
    for process in (root, *root.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            total += sum(process.cpu_times()[:4])  # the last two are those of its ended children
    return total
