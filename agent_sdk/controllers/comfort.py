"""The comfort band that a controller keeps."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any

from agent_sdk.controllers.parameters import number
from agent_sdk.rewards import REWARDS, LinearReward, read_reward
from topics.errors import InvalidConfig
from topics.messages import Manifest

Band = tuple[float, float]
Bands = Callable[[datetime], Band]
"""A day to the ends of its comfort band, in degC."""


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


def rewarded_temperatures(manifest: Manifest) -> tuple[str, ...]:
    """Names of the sensors whose temperatures the task's reward counts; empty if it does not say."""
    return tuple(getattr(_reward(manifest), "temperatures", None) or ())


def _reward(manifest: Manifest) -> Any:
    given = manifest.task.reward
    # A node of somebody else's may have a reward that is not known here.
    return read_reward(given) if given is not None and given.get("kind") in REWARDS else None
