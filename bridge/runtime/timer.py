"""Delayed calls: a thread of its own around the standard library's `sched`.

Calls should be short, and hand long work to the thread that it belongs to (`Subscriptions.post`).
"""

from __future__ import annotations

import math
import sched
import sys
import threading
import time
from collections.abc import Callable

Call = Callable[[], None]

_MAX_WAIT_S = 3600.0  # a thread cannot wait for more than some hundred years; a slow pace may ask for it


class Timer:
    """Makes calls when they are due, in a thread of its own: `with Timer() as timer`.

    The thread starts with the first call. An exception in a call goes to `threading.excepthook`; later calls are made
    all the same.

    Args:
        clock: the monotonic clock that `due_s` refers to.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._scheduler = sched.scheduler(clock)
        self._lock = threading.RLock()  # reentrant: a signal handler may close the timer
        self._wakeup = threading.Event()
        self._wakes_at_s = math.inf
        self._thread: threading.Thread | None = None
        self._closed = False

    def __enter__(self) -> Timer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def at(self, due_s: float, call: Call) -> sched.Event:
        """Schedule a call at a time of the clock, or immediately if that has passed; never after `close`.

        Returns:
            An event to `cancel` it with.
        """
        with self._lock:
            event = self._scheduler.enterabs(due_s, 0, self._call, (call,))
            if self._thread is None and not self._closed:
                thread = threading.Thread(target=self._run, name="timer", daemon=True)
                thread.start()
                self._thread = thread  # once it can be joined: a signal may end the caller at any line
        if due_s < self._wakes_at_s:
            self._wakeup.set()
        return event

    def cancel(self, event: sched.Event) -> bool:
        """Cancel a call; false if it was already made or is in progress."""
        try:
            self._scheduler.cancel(event)
        except ValueError:
            return False
        return True

    def close(self) -> None:
        """Stop the thread and drop pending calls; idempotent, and a call may do it."""
        with self._lock:
            self._closed = True
            thread = self._thread
        self._wakeup.set()
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _call(self, call: Call) -> None:
        if not self._closed:
            call()

    def _run(self) -> None:
        while not self._closed:
            self._wakeup.clear()
            self._wakes_at_s = math.inf  # until it is known, each new call wakes this thread
            try:
                delay_s = self._scheduler.run(blocking=False)
            except Exception:
                threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))
                continue
            if delay_s is None:
                self._wakeup.wait()
            else:
                self._wakes_at_s = self.clock() + delay_s
                self._wakeup.wait(min(delay_s, _MAX_WAIT_S))
