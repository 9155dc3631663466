"""The interface of rewards."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple, Protocol

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest

Terms = dict[str, Any]
"""Floats or arrays of the reward's leading shape, by name."""

Begin = datetime | Sequence[datetime]
"""Simulated time at which the rewarded timestep began: one for all slots, or one for each."""


class Outcome(NamedTuple):
    """A reward, the terms that add up to it, and metrics in physical units."""

    reward: Any
    terms: Terms
    metrics: Terms


class BoundReward(ABC):
    """A reward bound to the points of one node. It may have state of the running episode."""

    @abstractmethod
    def __call__(self, values: Floats, begin: Begin) -> Outcome:
        """Return the reward of a timestep.

        Args:
            values: shape (points,) or (slots, points), in the order and units of the manifest.
            begin: time at which the timestep began.

        Returns:
            Floats, or arrays of shape (slots,).
        """

    def reset(self, slots: Sequence[int] | None = None) -> None:  # noqa: B027  # most have no state
        """Reset the state at the start of an episode, in these slots or (None) in all."""

    def state(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:  # noqa: B027
        """Restore a state that `state` returned."""


class Reward(Protocol):
    """A reward that can be bound to the points of a node."""

    def bind(self, manifest: Manifest) -> BoundReward:
        """Bind the reward to a node's points.

        Raises:
            InvalidConfig: the node does not have a point that the reward needs.
        """
