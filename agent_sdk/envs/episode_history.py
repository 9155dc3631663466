"""The last samples of an episode, for pictures of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats

_DAY = timedelta(days=1)
_MIN_STEPS, _MAX_STEPS = 48, 1440


class EpisodeHistory:
    """The last samples of an episode: those of a day, but at least 48 timesteps and at most 1,440.

    A queue, and no `zenostat.recording.Trajectory`: the first samples leave it as others come, and a sample costs a few
    microseconds, a tenth of its copy into arrays.

    Args:
        step: Length of a timestep.

    Attributes:
        span: Length of the recorded time.
        rows: Time (end of the timestep), values, effective values, action, reward and reward terms of each sample. The
            first sample of an episode has no action.
        total: Sum of the rewards since the reset.
    """

    __slots__ = ("rows", "span", "total")

    def __init__(self, step: timedelta) -> None:
        self.span = min(max(_DAY, _MIN_STEPS * step), _MAX_STEPS * step)
        self.rows: deque[tuple[datetime, Floats, Floats, Any, float, Mapping[str, Any]]] = deque()
        self.total = 0.0

    def start(self, time: datetime, values: Floats, effective: Floats, terms: Mapping[str, Any]) -> None:
        """Remove all samples and add the first one of an episode."""
        self.rows.clear()
        self.rows.append((time, values, effective, None, 0.0, terms))
        self.total = 0.0

    def add(
        self, time: datetime, values: Floats, effective: Floats, action: Any, reward: float, terms: Mapping[str, Any]
    ) -> None:
        """Add a timestep with the agent's action, its reward and the terms of it, and remove what is too old."""
        rows = self.rows
        rows.append((time, values, effective, np.array(action, np.float64), reward, terms))
        self.total += reward
        while time - rows[0][0] > self.span:
            rows.popleft()
