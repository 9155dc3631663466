"""A reward that grows exponentially with the distance from the comfort band."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.linear import WeightedBound, WeightedReward
from agent_sdk.rewards.selectors import sum_at
from topics.messages import Manifest

MAX_K = 100.0
"""Upper limit of the degrees outside, so that the exponential stays finite."""


class ExponentialReward(WeightedReward):
    """`LinearReward` with the exponential of the degrees outside.

    Source: Sinergym's `ExpReward`.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_{z: v_z > 0} exp(v_z)
        v_z = max(low - T_z, T_z - high, 0), at most 100 K

    A zone within the band (bounds included) adds 0, and a zone just outside adds 1: leaving the band has a fixed cost.
    Terms: energy, comfort. Metrics: power_w, degrees_outside.
    """

    kind: Literal["exponential"] = "exponential"

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)


class _Bound(WeightedBound):
    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside = self._outside(values, begin)
        price = np.where(outside > 0.0, np.exp(np.minimum(outside, MAX_K)), 0.0).sum(axis=-1)
        power_w = sum_at(values, self._powers)
        energy, comfort = self._energy * power_w, self._comfort * price
        terms = {"energy": energy, "comfort": comfort}
        return Outcome(energy + comfort, terms, {"power_w": power_w, "degrees_outside": outside.sum(axis=-1)})
