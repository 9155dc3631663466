"""The comfort band that a controller keeps."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any

from agent_sdk.controllers.parameters import number
from agent_sdk.rewards import REWARDS, LinearReward, OccupiedReward, read_reward
from topics.errors import InvalidConfig
from topics.messages import Manifest

Band = tuple[float, float]
Bands = Callable[[datetime], Band]
"""A day to the ends of its comfort band, in degC."""

MARGIN_K = 1.0
"""Default distance of setpoints from the ends of the band: zones overshoot their setpoints by some tenths of a K."""

SETBACK_K, SHALLOW_SETBACK_K = 6.0, 1.0
"""Default setbacks: where comfort counts only while people are there, and where it counts around the clock."""


def comfort_bands(manifest: Manifest, low: object = None, high: object = None) -> Bands:
    """The bands of the task's reward; those of `LinearReward` where that has none.

    Args:
        manifest: of the node.
        low: the lower end in degC, all the year; None: the reward's.
        high: the upper end.

    Raises:
        InvalidConfig: no temperatures, or a lower end that is not below the upper one on some day of a year.
    """
    reward = _reward(manifest)
    theirs: Bands = (reward if hasattr(reward, "season") else LinearReward()).season(manifest).band
    own_low = None if low is None else number("low", low)
    own_high = None if high is None else number("high", high)

    def band(day: datetime) -> Band:
        least, most = theirs(day)
        return (least if own_low is None else own_low, most if own_high is None else own_high)

    for month in range(1, 13):
        least, most = band(datetime(2017, month, 15))
        if not least < most:
            raise InvalidConfig(
                f"the comfort band {least:g} to {most:g} degC is upside down; low= has to be below high="
            )
    return band


def inside(band: Band, margin_k: float | None = None) -> Band:
    """Setpoints within a comfort band, `margin_k` from its ends and no further than its middle.

    Without a margin it is `MARGIN_K`, and a third of a band that is narrower than three of these.
    """
    low, high = band
    margin = min(MARGIN_K, (high - low) / 3) if margin_k is None else min(margin_k, (high - low) / 2)
    return low + margin, high - margin


def default_setback(manifest: Manifest) -> float:
    """How far setpoints lie outside the band while nobody is there, in K: by what the task's reward counts."""
    return SETBACK_K if isinstance(_reward(manifest), OccupiedReward) else SHALLOW_SETBACK_K


def rewarded_temperatures(manifest: Manifest) -> tuple[str, ...]:
    """Names of the sensors whose temperatures the task's reward counts; empty if it does not say."""
    return tuple(getattr(_reward(manifest), "temperatures", None) or ())


def _reward(manifest: Manifest) -> Any:
    given = manifest.task.reward
    # A node of somebody else's may have a reward that is not known here.
    return read_reward(given) if given is not None and given.get("kind") in REWARDS else None
