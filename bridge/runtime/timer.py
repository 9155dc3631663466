"""Calls at a later time: one thread, and an agenda of what is due when.

What is called should be short, and hand long work to the thread that it belongs to (`Subscriptions.shelve`).
"""

from __future__ import annotations

import heapq
import itertools
import sys
import threading
import time
from collections.abc import Callable

Call = Callable[[], None]

_LOOK_UP_S = 3600.0


class Agenda:
    """Calls in the order in which they are due; of the same time, in that in which they were asked for."""

    def __init__(self) -> None:
        self._numbers = itertools.count()
        self._heap: list[tuple[float, int]] = []
        self._calls: dict[int, Call] = {}

    def __len__(self) -> int:
        return len(self._calls)

    def add(self, due_s: float, call: Call) -> int:
        """Notes a call; its number."""
        number = next(self._numbers)
        self._calls[number] = call
        heapq.heappush(self._heap, (due_s, number))
        return number

    def remove(self, number: int) -> bool:
        """Forgets a call; false if it was not there any more."""
        found = self._calls.pop(number, None) is not None
        if len(self._heap) > 64 + 2 * len(self._calls):  # deadlines that are met, one a step, would pile up
            self._heap = [entry for entry in self._heap if entry[1] in self._calls]
            heapq.heapify(self._heap)
        return found

    @property
    def next_s(self) -> float | None:
        """When the first call is due."""
        while self._heap and self._heap[0][1] not in self._calls:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def pop(self, now_s: float) -> Call | None:
        """The first call, if it is due; it is not in the agenda any more."""
        due_s = self.next_s
        if due_s is None or due_s > now_s:
            return None
        return self._calls.pop(heapq.heappop(self._heap)[1])


class Timer:
    """Does calls when they are due, in a thread of its own. `with Timer() as timer`.

    The thread starts with the first call. A call that raises is told by `threading.excepthook`; the others go on.

    Args:
        clock: of `due_s`; one that never goes back.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._agenda = Agenda()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False

    def __enter__(self) -> Timer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def at(self, due_s: float, call: Call) -> int:
        """Has `call` done at a time of the clock, or at once if that is over; never after `close`.

        Returns:
            A number to `cancel` it with.
        """
        with self._changed:
            first_s = self._agenda.next_s
            number = self._agenda.add(due_s, call)
            if self._thread is None and not self._closed:
                thread = threading.Thread(target=self._run, name="timer", daemon=True)
                thread.start()
                self._thread = thread  # once it can be joined: a signal may end the caller at any line
            elif first_s is None or due_s < first_s:
                self._changed.notify()
            return number

    def cancel(self, number: int) -> bool:
        """Has a call not done; false if it was done already, or is being done."""
        with self._changed:
            return self._agenda.remove(number)

    def close(self) -> None:
        """Ends the thread; what is not due yet is not done. Twice is fine, and so is a call that closes."""
        with self._changed:
            self._closed = True
            self._changed.notify()
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        while (call := self._wait()) is not None:
            try:
                call()
            except Exception:
                threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))

    def _wait(self) -> Call | None:
        """The next call, when it is due; None after `close`."""
        with self._changed:
            while not self._closed:
                now_s = self.clock()
                call = self._agenda.pop(now_s)
                if call is not None:
                    return call
                next_s = self._agenda.next_s
                # There is a longest time to wait, which a slow pace may well exceed.
                self._changed.wait(None if next_s is None else min(max(next_s - now_s, 0.0), _LOOK_UP_S))
            return None
