"""Comfort bands for controllers: from the task's reward or from parameters."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from zenostat.agent_sdk.controllers.parameters import number
from zenostat.agent_sdk.rewards import LinearReward
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.manifest_data import comfort_reward
from zenostat.agent_sdk.rewards.occupied import OccupiedComfort
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

Band = tuple[float, float]
Bands = Callable[[datetime], Band]
"""Function from a date to its comfort band, in degC."""

MARGIN_K = 1.0
"""Default distance of setpoints from the limits of the band: zones overshoot by some tenths of a kelvin."""

SETBACK_K, SHALLOW_SETBACK_K = 6.0, 1.0
"""Default setbacks: if comfort counts only while zones are occupied, and if it always counts."""


def comfort_bands(manifest: Manifest, low: object = None, high: object = None) -> Bands:
    """Return the comfort bands of the task's reward; if it has none, those of the scenario's, or of `LinearReward`.

    Args:
        manifest: manifest of the node.
        low: lower limit in degC for the whole year; None: that of the reward.
        high: upper limit in degC; None: that of the reward.

    Raises:
        InvalidConfig: a limit is not a number, or the lower limit is not below the upper one on some day of the year.
    """
    reward = comfort_reward(manifest)
    from_reward: Bands = (reward if isinstance(reward, ComfortBand) else LinearReward()).season(manifest).band
    fixed_low = None if low is None else number("low", low)
    fixed_high = None if high is None else number("high", high)

    def band(day: datetime) -> Band:
        lower, upper = from_reward(day)
        return (lower if fixed_low is None else fixed_low, upper if fixed_high is None else fixed_high)

    for month in range(1, 13):
        lower, upper = band(datetime(2017, month, 15))
        if not lower < upper:
            raise InvalidConfig(f"the comfort band {lower:g} to {upper:g} degC is reversed; low= has to be below high=")
    return band


def inside(band: Band, margin_k: float | None = None) -> Band:
    """Return setpoints within a comfort band, `margin_k` from its limits but not beyond its middle.

    The default margin is `MARGIN_K`, or a third of the band if that is less.
    """
    low, high = band
    margin = min(MARGIN_K, (high - low) / 3) if margin_k is None else min(margin_k, (high - low) / 2)
    return low + margin, high - margin


def default_setback(manifest: Manifest) -> float:
    """Return the default distance of setpoints outside the band in unoccupied zones, in K, for the task's reward."""
    return SETBACK_K if isinstance(comfort_reward(manifest), OccupiedComfort) else SHALLOW_SETBACK_K


def rewarded_temperatures(manifest: Manifest) -> tuple[str, ...]:
    """Return the names of the temperature sensors in the task's reward; empty if it names none."""
    return tuple(getattr(comfort_reward(manifest), "temperatures", None) or ())


def apart(setpoints: Band) -> Band:
    """Return a heating and a cooling setpoint, or their offsets, that do not cross: both their mean if they would."""
    low, high = setpoints
    return (low, high) if low <= high else ((low + high) / 2, (low + high) / 2)
