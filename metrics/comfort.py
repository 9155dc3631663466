"""Comfort bands of a building's zones, and deviations from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.roles import roles
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest
from zenostat.topics.plurals import counted

DEFAULT_BAND_DEGC = (20.0, 26.0)
"""Band of pictures where no reward has one: the design values of office rooms in EN 16798-1, category II."""

_Band = Callable[[Floats, datetime], tuple[Any, Any]]


class Comfort:
    """Comfort bands of zones, and which zones are occupied.

    Attributes:
        source: what the band is derived from, for readers.
        zones: indices of the zones' air temperatures among the values of a sample, shape (zones,).
        people: indices of the zones' occupant counts, None for a zone without one.
        follows_setpoints: whether each zone's band follows its setpoints; else all zones have the band of the day.
        setpoints: indices of the values of a sample that the band of each zone follows; none where it follows no value.
    """

    def __init__(
        self,
        source: str,
        zones: Sequence[int],
        people: Sequence[int | None],
        band: _Band,
        *,
        follows_setpoints: bool = False,
        setpoints: Sequence[Sequence[int]] | None = None,
    ) -> None:
        self.zones = np.array(zones, np.intp)
        self.people = tuple(people)
        self.source = f"{counted(len(zones), 'zone')}, {source}"
        self.follows_setpoints = follows_setpoints
        self.setpoints = [()] * len(zones) if setpoints is None else setpoints
        self._band = band
        self._always_occupied = np.array([index is None for index in people], bool)
        self._counts = np.array([index or 0 for index in people], np.intp)

    def limits(self, values: Floats, begin: datetime) -> tuple[Floats, Floats]:
        """Return the lower and the upper limit of each zone in degC, infinite for none, each of shape (zones,).

        Args:
            values: values of a sample, shape (points,).
            begin: simulated time at which the sample's timestep begins, which decides the season.
        """
        low, high = self._band(values, begin)
        shape = self.zones.shape
        return np.broadcast_to(np.asarray(low, float), shape), np.broadcast_to(np.asarray(high, float), shape)

    def limits_of_samples(self, values: Floats, begins: Sequence[datetime]) -> tuple[Floats, Floats]:
        """Return the limits of several samples, each of shape (samples, zones).

        Args:
            values: shape (samples, points).
            begins: simulated time at which the timestep of each sample begins.
        """
        low, high = (np.empty((len(values), len(self.zones))) for _ in range(2))
        day = None
        for row, begin in enumerate(begins):
            if self.follows_setpoints or begin.date() != day:
                limits, day = self.limits(values[row], begin), begin.date()
            low[row], high[row] = limits
        return low, high

    def outside(self, values: Floats, begin: datetime, temperatures: Floats | None = None) -> Floats:
        """Return the deviation from the band in K, at least 0, shape (zones,).

        Args:
            values: values of a sample, shape (points,).
            begin: simulated time at which the sample's timestep begins.
            temperatures: values with other temperatures for the same band; None is those of the sample.
        """
        low, high = self._band(values, begin)
        air = (values if temperatures is None else temperatures)[self.zones]
        outside: Floats = np.maximum(np.maximum(low - air, air - high), 0.0)
        return outside

    def deviations(self, values: Floats, begin: datetime) -> Floats:
        """Return the deviation from the band in K; see `deviations`; shape (zones,)."""
        return deviations(values[self.zones], *self._band(values, begin))

    def is_occupied(self, values: Floats) -> NDArray[np.bool_]:
        """Return whether each zone is occupied; True without an occupant count.

        Args:
            values: of one sample or several, shape (points,) or (samples, points).

        Returns:
            Shape (zones,) or (samples, zones).
        """
        occupied: NDArray[np.bool_] = self._always_occupied | (values[..., self._counts] > 0.0)
        return occupied


def deviations(air: Floats, low: Any, high: Any) -> Floats:
    """Return deviations from a band: negative below it, 0 within, NaN where the temperature is unknown."""
    result: Floats = np.maximum(air - high, 0.0) - np.maximum(low - air, 0.0)
    return result


def band_text(low: float, high: float, digits: str = "g") -> str:
    """Return a band in degC as text: `20 to 26 °C`, or `at least 20 °C` where the other limit is not finite."""
    if isfinite(low) and isfinite(high):
        return f"{low:{digits}} to {high:{digits}} °C"
    if isfinite(low):
        return f"at least {low:{digits}} °C"
    return f"at most {high:{digits}} °C" if isfinite(high) else "no limits"


def default_comfort(manifest: Manifest) -> Comfort | None:
    """Return `DEFAULT_BAND_DEGC` for all zones; None without a zone temperature."""
    zones = [zone for zone in roles(manifest).zones if zone.temperature is not None]
    if not zones:
        return None
    air, people = [zone.temperature or 0 for zone in zones], [zone.occupants for zone in zones]
    return Comfort(band_text(*DEFAULT_BAND_DEGC), air, people, lambda *_: DEFAULT_BAND_DEGC)
