"""Recovery from lost messages: a controller that has waited for a sample for a while queries the node.

A node's stream is sent with Zenoh's *drop*, so that a slow subscriber never delays a step: on a congested link a sample
or an event can be lost. In lockstep, the node would then wait for the controller, and the controller for the node.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from zenostat.bridge.client.connection import Connection
from zenostat.bridge.runtime.timer import Timer
from zenostat.topics.errors import RequestRejected, ZenostatError, from_wire
from zenostat.topics.messages import Sample, State

_FIRST_S = 1.0
_LONGEST_S = 10.0


class ReceiveWatchdog:
    """Wakes a thread that has waited for the same sample for a second, and again after 2, 4, 8 and every 10 seconds.

    A step costs nothing more: a timer looks whether a thread is waiting, and whether it did so at the last look.

    Args:
        timer: makes the checks.
        waits_after: the sample after which a thread is waiting for the next one; False if none is waiting.
        wake: wakes it.

    Attributes:
        is_due: whether the thread should query the node; the thread sets it to False.
    """

    def __init__(self, timer: Timer, waits_after: Callable[[], object], wake: Callable[[], None]) -> None:
        self.is_due = False
        self._timer, self._waits_after, self._wake = timer, waits_after, wake
        self._seen: object = False
        self._delay_s = _FIRST_S
        self._closed = False
        self._next = timer.at(time.monotonic() + _FIRST_S, self._check)

    def _check(self) -> None:
        if self._closed:
            return
        before, self._seen = self._seen, self._waits_after()
        if self._seen is False or self._seen is not before:
            self._delay_s = _FIRST_S
        else:
            self._delay_s = min(2.0 * self._delay_s, _LONGEST_S)
            if not self.is_due:
                self.is_due = True
                self._wake()
        self._next = self._timer.at(time.monotonic() + self._delay_s, self._check)

    def close(self) -> None:
        """Make no more checks."""
        self._closed = True
        self._timer.cancel(self._next)


def query_sample(bus: Connection, node: str, controller: str) -> Sample | None:
    """Return a node's current sample; None if there is none yet, or the node does not answer.

    Raises:
        SimulatorError: the node's simulator has failed.
        RequestRejected: the controller has no claim, so the node does not wait for it.
    """
    try:
        sample, status = bus.latest(node), bus.status(node)
    except ZenostatError:  # the loss of the node is reported by its token
        return None
    if status.state is State.FAILED:
        raise from_wire({"error": status.failure_error, "message": status.failure})
    if all(other.controller != controller for other in status.controllers):
        raise RequestRejected(f"node {node!r} has no claim of {controller!r} any more")
    return sample
