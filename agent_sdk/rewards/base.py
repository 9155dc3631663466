"""What a reward is."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from topics.messages import Manifest

Terms = dict[str, Any]
"""Named terms, floats or arrays of the reward's leading shape."""

BoundReward = Callable[[NDArray[np.float64], datetime], tuple[Any, Terms]]
"""`(values, begin) -> (reward, terms)`: values of shape (…, points) in manifest order and units, and the
simulated time at which the rewarded timestep began. The reward has the leading shape, a float if none."""


class Reward(Protocol):
    """A reward that can be bound to the points of a node."""

    def bind(self, manifest: Manifest) -> BoundReward:
        """The reward on this node's values; `InvalidConfig` if a point that it needs is missing."""
