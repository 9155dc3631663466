"""How long a node may take to end, whatever it is doing.

A signal only reaches a program's main thread between two lines of Python. So a thread of its own hears of the wish to
end (the system writes the signal's number to a pipe) and sees to it that the node comes to its end.
"""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable
from time import monotonic

from bridge.runtime.signals import TERMINATION_SIGNALS

PATIENCE_S = 0.5
"""How long an engine that is computing may go on when the node is to end."""
LIMIT_S = 1.7
"""How long a node may take to end by itself."""

_AGAIN_S = 0.2
_ASKED, _OVER = 0, 255  # beside the numbers of signals


class Ending:
    """Sees to it that a node ends once it is asked to; `with Ending(...) as ending`, in the main thread.

    Args:
        stop_waiting: makes the node stop waiting; called after `PATIENCE_S`, then repeatedly, with the number of
            signals so far.
        give_up: ends the process; None leaves it be.
        limit_s: when; of a node that was asked a second time by a signal, after `LIMIT_S`.
    """

    def __init__(
        self, stop_waiting: Callable[[int], None], give_up: Callable[[], None] | None, limit_s: float = LIMIT_S
    ) -> None:
        self._stop_waiting, self._give_up, self._limit_s = stop_waiting, give_up, limit_s
        self._ear, self._mouth = os.pipe()
        os.set_blocking(self._mouth, False)
        self._thread = threading.Thread(target=self._run, name="ending", daemon=True)
        self._former = -1

    def __enter__(self) -> Ending:
        self._thread.start()
        self._former = signal.set_wakeup_fd(self._mouth, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._former)
        os.write(self._mouth, bytes([_OVER]))
        self._thread.join()
        os.close(self._ear)
        os.close(self._mouth)
        self._ear = self._mouth = -1

    def ask(self) -> None:
        """Has the node end in time, as a signal does; any thread may, until `__exit__`."""
        os.write(self._mouth, bytes([_ASKED]))

    def _run(self) -> None:
        signals, nudge_s, until_s = 0, 0.0, 0.0
        while (heard := self._hear(nudge_s)) != _OVER:
            now_s = monotonic()
            asked = heard == _ASKED or heard in TERMINATION_SIGNALS
            signals += asked and heard != _ASKED
            if asked and not until_s:
                nudge_s, until_s = now_s + PATIENCE_S, now_s + self._limit_s
            if asked and signals > 1:
                nudge_s, until_s = now_s, min(until_s, now_s + LIMIT_S)
            if until_s and now_s >= until_s and self._give_up is not None:
                self._give_up()
            if until_s and now_s >= nudge_s:
                self._stop_waiting(signals)
                nudge_s = now_s + _AGAIN_S

    def _hear(self, until_s: float) -> int | None:
        """What was heard; None if nothing was by then. 0: there is no time."""
        wait_s = max(until_s - monotonic(), 0.0) if until_s else None
        return os.read(self._ear, 1)[0] if select.select([self._ear], [], [], wait_s)[0] else None
