"""Recognize that the system has no memory or no threads left, and describe the limits that apply."""

from __future__ import annotations

import resource

_THREAD_TEXTS = ("can't start new thread", "spawn worker thread")
_LIMITS = ((resource.RLIMIT_AS, "address space", "ulimit -v"), (resource.RLIMIT_NPROC, "threads", "ulimit -u"))


def describe_exhaustion(error: BaseException) -> str | None:
    """Return a sentence about the limits that an error comes from; None if it has another cause."""
    if isinstance(error, MemoryError):
        return f"the system has no memory left for this process: {_limits()}"
    if any(text in str(error) for text in _THREAD_TEXTS):
        return f"the system cannot start another thread for this process: {_limits()}"
    return None


def _limits() -> str:
    limits = [f"{what} {_limit(kind)} ({command})" for kind, what, command in _LIMITS]
    return f"its limits are {' and '.join(limits)}; raise them, or free memory"


def _limit(kind: int) -> str:
    soft, _ = resource.getrlimit(kind)
    if soft == resource.RLIM_INFINITY:
        return "unlimited"
    return f"{soft / 1e6:,.0f} MB" if kind == resource.RLIMIT_AS else f"{soft:,}"
