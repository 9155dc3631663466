"""Processor time of this process and of the processes that it has started: nodes and engines."""

from __future__ import annotations

import os
from pathlib import Path

_FIELDS = slice(11, 15)
"""utime, stime, cutime and cstime in `/proc/PID/stat`, counted after the name of the program; see proc(5)."""


def processor_s() -> float:
    """Return the processor time so far, in seconds: user and system, of this process and all that descend from it."""
    stats = {int(path.name): stat for path in Path("/proc").iterdir() if path.name.isdigit() and (stat := _stat(path))}
    children: dict[int, list[int]] = {}
    for pid, (parent, _) in stats.items():
        children.setdefault(parent, []).append(pid)
    ticks, waiting = 0, [os.getpid()]
    while waiting:
        pid = waiting.pop()
        ticks += stats.get(pid, (0, 0))[1]
        waiting += children.get(pid, [])
    return ticks / os.sysconf("SC_CLK_TCK")


def _stat(process: Path) -> tuple[int, int] | None:
    """Return a process's parent and its ticks, those of its ended children included; None if it has ended."""
    try:
        fields = (process / "stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return None
    return int(fields[1]), sum(map(int, fields[_FIELDS]))
