"""State of this program for systemd, by its protocol sd_notify; without systemd nothing is sent."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from zenostat.bridge.runtime.timer import Timer

_REPORTS_PER_PERIOD = 2
"""Reports within `WatchdogSec=`, as systemd's manual recommends."""


def notify(state: str) -> None:
    """Send a state such as `READY=1`, if this program runs as a unit of systemd with `Type=notify`."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        sender.sendto(state.encode(), address.replace("@", "\0", 1) if address[0] == "@" else address)


def watchdog_s() -> float | None:
    """Return the time, in s, within which systemd expects a report (`WatchdogSec=`); None without a watchdog."""
    period = os.environ.get("WATCHDOG_USEC", "")
    is_watched = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(period) / 1e6 if is_watched and period.isdecimal() and int(period) else None


@contextmanager
def reported(post: Callable[[Callable[[], None]], object]) -> Iterator[None]:
    """Report that this program is ready, in the body of a `with` statement that it is alive, and then that it ends.

    Args:
        post: makes the program's main loop call a function. If the loop hangs, the reports end, and systemd restarts
            the program.
    """
    notify("READY=1")
    period_s = watchdog_s()
    with Timer() as timer:

        def report() -> None:
            notify("WATCHDOG=1")
            timer.at(timer.clock() + (period_s or 0.0) / _REPORTS_PER_PERIOD, post_report)

        def post_report() -> None:
            post(report)

        if period_s is not None:
            post_report()
        try:
            yield
        finally:
            notify("STOPPING=1")
