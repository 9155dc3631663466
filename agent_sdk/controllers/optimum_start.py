"""Optimum start: the time before occupancy at which zones leave their setback."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta

_LEAST_K = 0.5
"""Smallest distance from which a rate is learned: below it, the thermostat's own throttling decides."""


@dataclass
class OptimumStart:
    """Start time from the distance of the zone to its occupied setpoint, and for heating from the outdoor temperature.

        lead = distance / rate + outdoor_h_per_k * max(setpoint - outdoor temperature, 0)

    The second term is for heating only. Each action has its own rate, which begins at `rate`. With `learning` a > 0, a
    start from which the zones reached the setpoint in the time t, or came closer to it by a distance d until people
    were expected, changes it to (1 - a) * rate + a * d / t.

    Sources: ASHRAE Guideline 36-2021, warm-up and cool-down modes: the start is computed from zone temperature,
    setpoint, outdoor temperature and a factor for the mass of the zone, which is set by hand or tuned by the system
    itself, and is no earlier than 3 hours before occupancy. Seem, Armstrong and Hancock, "Algorithms for predicting
    recovery time from night setback", ASHRAE Transactions 95(2), 1989.

    Attributes:
        rate: change of the zone's temperature while it recovers, K/h.
        outdoor_h_per_k: additional lead per kelvin between heating setpoint and outdoor temperature, h/K.
        longest: greatest lead.
        learning: weight of each new measurement of the rate, 0 to 1.
    """

    rate: float
    outdoor_h_per_k: float = 0.0
    longest: timedelta = timedelta(hours=3)
    learning: float = 0.0
    _rates: dict[str, float] = field(default_factory=dict)
    _recoveries: dict[str, _Recovery] = field(default_factory=dict)

    def begin(self) -> None:
        """Forget what was learned."""
        self._rates.clear()
        self._recoveries.clear()

    def is_started(self, action: str, distance_k: float, colder_k: float, expected: datetime, now: datetime) -> bool:
        """Return whether an action has to leave its setback for the arrival that is expected; it stays so until then.

        Args:
            action: name of the action.
            distance_k: distance of its worst zone to the occupied setpoint, K; negative where no recovery is needed.
            colder_k: kelvins by which it is colder outdoors than the heating setpoint; 0 for cooling.
            expected: time at which people are expected.
            now: present time.
        """
        recovery = self._recoveries.get(action)
        if recovery is not None and recovery.expected == expected:
            return True
        distance_k = max(distance_k, 0.0)
        if not distance_k:
            return False
        hours = distance_k / self.rate_of(action) + self.outdoor_h_per_k * max(colder_k, 0.0)
        if now < expected - min(timedelta(hours=hours), self.longest):
            return False
        self._recoveries[action] = _Recovery(now, expected, distance_k)
        return True

    def observe(self, action: str, distance_k: float, now: datetime) -> None:
        """Learn from a recovery that ends: the setpoint is reached, or people are expected now."""
        recovery = self._recoveries.get(action)
        if recovery is None or recovery.is_learned or (distance_k > 0.0 and now < recovery.expected):
            return
        recovery.is_learned = True
        hours = (now - recovery.begin) / timedelta(hours=1)
        covered_k = recovery.distance_k - max(distance_k, 0.0)
        if hours > 0.0 and recovery.distance_k >= _LEAST_K and covered_k > 0.0:
            self._rates[action] = (1.0 - self.learning) * self.rate_of(action) + self.learning * covered_k / hours

    def rate_of(self, action: str) -> float:
        """Return the present rate of an action, K/h."""
        return self._rates.get(action, self.rate)


@dataclass
class _Recovery:
    """Way of a zone from its setback to the occupied setpoint."""

    begin: datetime
    expected: datetime
    distance_k: float
    is_learned: bool = False
