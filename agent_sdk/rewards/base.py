"""What a reward is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from topics.messages import Manifest

Terms = dict[str, Any]
"""By name, floats or arrays of the reward's leading shape."""

Begin = datetime | Sequence[datetime]
"""Simulated time at which the rewarded timestep began: one for all, or one for each slot."""


class Outcome(NamedTuple):
    """A reward, the terms that add up to it, and what was measured on the way (in units, not in reward)."""

    reward: Any
    terms: Terms
    metrics: Terms


class BoundReward(ABC):
    """A reward on the points of one node. It may remember things of the running episode."""

    @abstractmethod
    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        """The reward of a timestep.

        Args:
            values: shape (points,) or (slots, points), in manifest order and units.
            begin: when the timestep began.

        Returns:
            Floats, or arrays of shape (slots,).
        """

    def reset(self, slots: Sequence[int] | None = None) -> None:  # noqa: B027  # most remember nothing
        """An episode begins: forgets what was of the former one (in these slots; None: in all)."""

    def state(self) -> dict[str, Any]:
        """What it remembers, as plain values."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:  # noqa: B027
        """Goes on from a `state`."""


class Reward(Protocol):
    """A reward that can be bound to the points of a node."""

    def bind(self, manifest: Manifest) -> BoundReward:
        """The reward on this node's values; `InvalidConfig` if a point that it needs is missing."""
