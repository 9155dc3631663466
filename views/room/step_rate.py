"""The speed of a node's simulation, from the step that it is at whenever it is asked."""

from __future__ import annotations

from collections import deque

WINDOW_S = 5.0
"""The rate is that of the last changes of the step which this window has, and at least of the last two."""
_STALLED = 2.0
"""A node whose step has not changed for this many of its latest timesteps, and for `WINDOW_S`, has stopped."""


class StepRate:
    """Simulated seconds per second, measured between changes of the step, whatever the distance between two polls."""

    __slots__ = ("_at", "_begin_s", "_changes", "_is_stopped", "_pace_s")

    def __init__(self) -> None:
        self._at: tuple[int, int] | None = None
        self._is_stopped, self._begin_s, self._pace_s = False, 0.0, 0.0
        self._changes: deque[tuple[float, int]] = deque()

    def clear(self) -> None:
        """Forget what was seen."""
        self._at, self._is_stopped = None, False
        self._changes.clear()

    def add(self, now_s: float, episode: int, step: int, *, is_stopped: bool = False, pace_s: float = 0.0) -> None:
        """Add a poll.

        Args:
            now_s: time of a monotonic clock.
            episode: number of the node's episode.
            step: its step.
            is_stopped: whether it is paused, or its episode is over.
            pace_s: time that its pace gives a timestep, in s; 0 if it is not paced.
        """
        before, self._at = self._at, (episode, step)
        self._is_stopped, self._pace_s = is_stopped, pace_s
        if before is None or is_stopped:
            self._begin_s = now_s
        if is_stopped:
            self._changes.clear()
            return
        if before is None or before == self._at:
            return
        changes = self._changes
        if episode != before[0] or step < before[1] or (len(changes) > 1 and self._has_stalled(now_s)):
            changes.clear()  # a single change stays: of an unpaced node, the time of a timestep is not known yet
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
        if self._at is None:
            return False
        changes = self._changes
        end_s, duration_s = changes[-1][0] if changes else self._begin_s, self._pace_s
        if len(changes) > 1:
            duration_s = (end_s - changes[0][0]) / (changes[-1][1] - changes[0][1])
        return now_s - end_s > max(WINDOW_S, _STALLED * duration_s)
