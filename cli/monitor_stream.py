"""The stream of `zenostat monitor`, with the comfort bands and rewards of the agents' part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import date, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topics.messages import Manifest

Floats = NDArray[np.float64]

if TYPE_CHECKING:
    import zenoh

    from bridge.rerun.samples import Comfort, RewardTerms
    from bridge.rerun.stream import RerunStream


def reward_terms(manifest: Manifest) -> RewardTerms | None:
    """Return the terms of the scenario's reward; None without a reward, and for one that this version does not know.

    Raises:
        InvalidConfig: the node lacks a point that the reward reads.
    """
    from agent_sdk.rewards import REWARDS, read_reward

    settings = manifest.task.reward
    if settings is None or settings.get("kind") not in REWARDS:
        return None
    reward = read_reward(settings).bind(manifest)

    def terms(values: Floats, begin: datetime) -> Mapping[str, float]:
        return reward(values, begin).terms

    return terms


class _DailyBand:
    """A comfort band that depends on the day only, computed once a day."""

    def __init__(self, comfort: Comfort) -> None:
        self.zones, self.source = comfort.zones, comfort.source
        self._comfort = comfort
        self._day: date | None = None
        self._limits = (np.empty(0), np.empty(0))

    def limits(self, values: Floats, begin: datetime) -> tuple[Floats, Floats]:
        """Return the limits of each zone; see `Comfort`."""
        if begin.date() != self._day:
            self._day, self._limits = begin.date(), self._comfort.limits(values, begin)
        return self._limits


def comfort_band(manifest: Manifest) -> Comfort | None:
    """Return the comfort bands of a node's zones, by the scenario's reward; None without zone temperatures."""
    from agent_sdk.evaluation.comfort import display_comfort
    from agent_sdk.rewards import MultiZoneReward

    comfort = display_comfort(manifest)
    kind = MultiZoneReward.model_fields["kind"].default
    if comfort is None or (manifest.task.reward or {}).get("kind") == kind:  # its band follows the setpoints
        return comfort
    return _DailyBand(comfort)


def open_stream(session: zenoh.Session, node: str, sinks: Iterable[Any], *, is_live: bool) -> RerunStream:
    """Return a stream to Rerun that prints its notices; see `RerunStream`."""
    from bridge.rerun.stream import RerunStream
    from cli.console import err

    def notify(text: str) -> None:
        err.print(f"warning: {text}", style="yellow", markup=False, soft_wrap=True)

    return RerunStream(session, node, sinks, is_live=is_live, comfort=comfort_band, reward=reward_terms, notify=notify)
