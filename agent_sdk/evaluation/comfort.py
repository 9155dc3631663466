"""Comfort bands of a building's zones, for metrics, KPIs and pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent_sdk.rewards import REWARDS, MultiZoneReward, OccupiedReward, Reward, read_reward
from agent_sdk.rewards.comfort_band import ComfortBand
from agent_sdk.rewards.occupied import PEOPLE
from agent_sdk.rewards.selectors import same_zone, temperatures
from bridge.display.roles import roles
from topics.errors import InvalidConfig
from topics.messages import Manifest

Floats = NDArray[np.float64]

DISPLAY_BAND_DEGC = (20.0, 26.0)
"""Band of pictures where no reward has one: the design values of office rooms in EN 16798-1, category II."""

_Band = Callable[[Floats, datetime], tuple[Any, Any]]


class Comfort:
    """Comfort bands of zones, and which zones are occupied.

    Attributes:
        source: what the band is derived from, for readers.
        zones: indices of the zones' air temperatures among the values of a sample, shape (zones,).
        people: indices of the zones' occupant counts, None for a zone without one.
        is_shared: whether all zones have the same band.
    """

    def __init__(
        self, source: str, zones: Sequence[int], people: Sequence[int | None], band: _Band, *, is_shared: bool = True
    ) -> None:
        self.zones = np.array(zones, np.intp)
        self.people = tuple(people)
        self.source = f"{len(zones)} zone{'' if len(zones) == 1 else 's'}, {source}"
        self.is_shared = is_shared
        self._band = band
        self._always_occupied = np.array([index is None for index in people])
        self._counts = np.array([index or 0 for index in people], np.intp)

    def limits(self, values: Floats, begin: datetime) -> tuple[Floats, Floats]:
        """Return the lower and the upper limit of each zone in degC, each of shape (zones,).

        Args:
            values: values of a sample, shape (points,).
            begin: simulated time at which the sample's timestep begins, which decides the season.
        """
        low, high = self._band(values, begin)
        shape = self.zones.shape
        return np.broadcast_to(np.asarray(low, float), shape), np.broadcast_to(np.asarray(high, float), shape)

    def outside(self, values: Floats, begin: datetime) -> Floats:
        """Return the deviation from the band in K, at least 0, shape (zones,)."""
        low, high = self._band(values, begin)
        air = values[self.zones]
        outside: Floats = np.maximum(np.maximum(low - air, air - high), 0.0)
        return outside

    def deviations(self, values: Floats, begin: datetime) -> Floats:
        """Return the deviation from the band in K, negative below it, 0 within, shape (zones,)."""
        low, high = self._band(values, begin)
        air = values[self.zones]
        deviations: Floats = np.maximum(air - high, 0.0) - np.maximum(low - air, 0.0)
        return deviations

    def is_occupied(self, values: Floats) -> NDArray[np.bool_]:
        """Return whether each zone is occupied, shape (zones,); True without an occupant count."""
        occupied: NDArray[np.bool_] = self._always_occupied | (values[self._counts] > 0.0)
        return occupied


def comfort(manifest: Manifest, reward: Reward | None = None) -> Comfort | None:
    """Return the comfort bands of the zones that a reward rates; None where no reward has a band.

    Args:
        manifest: manifest of the node.
        reward: a reward with a comfort band; None, or a reward without a band: that of the scenario.
    """
    settings = manifest.task.reward
    # A node of another version may have a reward that is unknown in this process.
    from_task = read_reward(settings) if settings is not None and settings.get("kind") in REWARDS else None
    for candidate in (reward, from_task):
        try:
            if isinstance(candidate, ComfortBand):
                return _from_band(candidate, manifest)
            if isinstance(candidate, MultiZoneReward):
                return _from_setpoints(candidate, manifest)
        except InvalidConfig:  # the node lacks the temperatures
            continue
    return None


def display_comfort(manifest: Manifest, reward: Reward | None = None) -> Comfort | None:
    """Return comfort bands of all zones of a manifest, for pictures; None where it has no zone temperature.

    The zones are those of `bridge.display.roles`, in its order. Those that the reward rates have its band; all others
    have the band of the reward too, or `DISPLAY_BAND_DEGC` where each zone has its own or no reward has one.
    """
    zones = [zone for zone in roles(manifest).zones if zone.temperature is not None]
    if not zones:
        return None
    air, people = [zone.temperature or 0 for zone in zones], [zone.occupants for zone in zones]
    rated = comfort(manifest, reward)
    if rated is None:
        low, high = DISPLAY_BAND_DEGC
        return Comfort(f"{low:g} to {high:g} °C", air, people, lambda *_: DISPLAY_BAND_DEGC)
    column = {int(index): place for place, index in enumerate(rated.zones)}
    places = np.array([column.get(index, -1) for index in air], np.intp)

    def band(values: Floats, begin: datetime) -> tuple[Floats, Floats]:
        low, high = rated.limits(values, begin)
        rest = (float(low[0]), float(high[0])) if rated.is_shared else DISPLAY_BAND_DEGC
        return np.append(low, rest[0])[places], np.append(high, rest[1])[places]

    return Comfort(rated.source.partition(", ")[2], air, people, band)


def _from_band(reward: ComfortBand, manifest: Manifest) -> Comfort:
    band, zones = reward.season(manifest).band, temperatures(reward.kind, reward.temperatures, manifest).tolist()
    if isinstance(reward, OccupiedReward):
        zones, people = map(list, zip(*reward.pairs(zones, manifest), strict=True))
    else:
        people = same_zone(zones, PEOPLE, manifest, observed=False)
    return Comfort(_of(reward), zones, people, lambda _, begin: band(begin))


def _from_setpoints(reward: MultiZoneReward, manifest: Manifest) -> Comfort:
    air, heat, cool = map(list, zip(*reward._points(manifest), strict=True))  # noqa: SLF001
    threshold = reward.threshold
    people = same_zone(air, PEOPLE, manifest, observed=False)
    return Comfort(
        _of(reward),
        air,
        people,
        lambda values, _: (values[heat] - threshold, values[cool] + threshold),
        is_shared=False,
    )


def _of(reward: ComfortBand | MultiZoneReward) -> str:
    return f"the band of the {reward.kind} reward"
