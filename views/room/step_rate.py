"""The speed of a node's simulation, from the step that it is at whenever it is asked."""

from __future__ import annotations

from collections import deque

WINDOW_S = 5.0
"""The rate is that of the last changes of the step which this window has, and at least of the last two."""
_STALLED = 2.0
"""A node whose step has not changed for this many of its latest timesteps, and for `WINDOW_S`, has stopped."""


class StepRate:
    """Simulated seconds per second, measured between changes of the step, whatever the distance between two polls."""

    __slots__ = ("_at", "_changes", "_is_stopped")

    def __init__(self) -> None:
        self._at: tuple[int, int] | None = None
        self._is_stopped = False
        self._changes: deque[tuple[float, int]] = deque()

    def clear(self) -> None:
        """Forget what was seen."""
        self._at, self._is_stopped = None, False
        self._changes.clear()

    def add(self, now_s: float, episode: int, step: int, *, is_stopped: bool = False) -> None:
        """Add a poll: `episode` and `step` of the node at `now_s` of a monotonic clock; `is_stopped`: it is paused."""
        before, self._at = self._at, (episode, step)
        self._is_stopped = is_stopped
        if is_stopped:
            self._changes.clear()
            return
        if before is None or before == self._at:
            return
        changes = self._changes
        if episode != before[0] or step < before[1] or self._has_stalled(now_s):
            changes.clear()
        changes.append((now_s, step))
        while len(changes) > 2 and now_s - changes[1][0] >= WINDOW_S:
            changes.popleft()

    def rate(self, now_s: float, step_s: float) -> float | None:
        """Return the simulated seconds per second; 0 of a node that has stopped, None before two changes of the step.

        Args:
            now_s: the present time of the same clock.
            step_s: length of a timestep in s.
        """
        if self._is_stopped or self._has_stalled(now_s):
            return 0.0
        if len(self._changes) < 2:
            return None
        (begin_s, first), (end_s, last) = self._changes[0], self._changes[-1]
        return (last - first) * step_s / (end_s - begin_s)

    def _has_stalled(self, now_s: float) -> bool:
        if len(self._changes) < 2:
            return False
        (begin_s, first), (end_s, last) = self._changes[0], self._changes[-1]
        return now_s - end_s > max(WINDOW_S, _STALLED * (end_s - begin_s) / (last - first))
