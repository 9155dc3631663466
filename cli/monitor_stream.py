"""The stream of `zenostat monitor`, with the comfort bands and rewards of the agents' part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest

if TYPE_CHECKING:
    import zenoh

    from zenostat.views.live.samples import RewardTerms
    from zenostat.views.live.stream import RerunStream


def reward_terms(manifest: Manifest) -> RewardTerms | None:
    """Return the terms of the scenario's reward; None without a reward, and for one that this version does not know.

    Raises:
        InvalidConfig: the node lacks a point that the reward reads.
    """
    from zenostat.agent_sdk.rewards import REWARDS, read_reward

    settings = manifest.task.reward
    if settings is None or settings.get("kind") not in REWARDS:
        return None
    reward = read_reward(settings).bind(manifest)

    def terms(values: Floats, begin: datetime) -> Mapping[str, float]:
        return reward(values, begin).terms

    return terms


def open_stream(session: zenoh.Session, node: str, sinks: Iterable[Any], *, is_live: bool) -> RerunStream:
    """Return a stream to Rerun that prints its notices; see `RerunStream`."""
    from zenostat.cli.console import err
    from zenostat.metrics.reward_comfort import display_comfort
    from zenostat.views.live.stream import RerunStream

    return RerunStream(
        session, node, sinks, is_live=is_live, comfort=display_comfort, reward=reward_terms, notify=err.warning
    )
