"""Processor time of this process and of the processes that it has started: nodes and engines."""

from __future__ import annotations

from contextlib import suppress

import psutil


def processor_s() -> float:
    """Return the processor time so far, in seconds: user and system, of this process and all that descend from it."""
    own, total = psutil.Process(), 0.0
    for process in (own, *own.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            total += sum(process.cpu_times()[:4])  # the last two are those of its ended children
    return total
