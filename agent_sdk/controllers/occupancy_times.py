"""Occupancy of zones: measured at present, and expected from the arrival on earlier days."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta

from zenostat.topics.arrays import Floats

OPEN_HOURS = range(6, 22)
"""Hours in which zones count as occupied until the first arrival has been observed: comfort first."""

People = tuple[int, ...]
"""Indices of occupant counts in `sample.values`: the zones of an action."""


class OccupancyTimes:
    """Presence of people in the zones of actions, and the time at which they are expected.

    People are expected at the time of the day at which they first arrived on the last day with an arrival.

    Args:
        step: length of a timestep.
        threshold: share of the largest number of people in these zones so far, 0 to 1, above which they count as
            occupied; 0: anybody occupies them, 1: nobody does.
    """

    def __init__(self, step: timedelta, threshold: float = 0.0) -> None:
        self._step, self._threshold = step, threshold
        self._arrivals: dict[People, datetime] = {}
        self._largest: dict[People, float] = {}

    def begin(self) -> None:
        """Forget all arrivals."""
        self._arrivals.clear()
        self._largest.clear()

    def is_present(self, people: People, measured: Floats, now: datetime) -> bool:
        """Return whether zones are occupied at present; those without an occupant count always are."""
        if not people:
            return True
        counts = measured[list(people)]
        if not counts.max() > 0.0:
            return False
        total = float(counts.sum())
        largest = self._largest[people] = max(self._largest.get(people, 0.0), total)
        if self._threshold and not total > self._threshold * largest:
            return False
        arrival = self._arrivals.get(people)
        if arrival is None or arrival.date() != now.date():
            self._arrivals[people] = now - self._step
        return True

    def is_assumed(self, people: People, now: datetime) -> bool:
        """Return whether empty zones count as occupied because nobody has been observed yet."""
        return people not in self._largest and now.hour in OPEN_HOURS

    def is_occupied(
        self, people: People, measured: Floats, now: datetime, is_started: Callable[[datetime], bool]
    ) -> bool:
        """Return whether zones are occupied, or are preconditioned for people who are expected.

        Args:
            people: the occupant counts of the zones.
            measured: values of the sample.
            now: its time.
            is_started: whether preconditioning for an arrival at a time has started.
        """
        if self.is_present(people, measured, now) or self.is_assumed(people, now):
            return True
        expected = self.expected(people, now)
        return any(now < arrival + self._step and is_started(arrival) for arrival in expected)

    def expected(self, people: People, now: datetime) -> tuple[datetime, ...]:
        """Return the next times at which people are expected: today, unless they came already, and tomorrow."""
        arrival = self._arrivals.get(people)
        if arrival is None:
            return ()
        today = arrival.replace(year=now.year, month=now.month, day=now.day)
        times = (today, today + timedelta(days=1))  # preconditioning may start before midnight
        return tuple(time for time in times if time.date() != arrival.date())
