"""A reward whose weights depend on the hour of the day."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.linear import WeightedBound, WeightedReward
from agent_sdk.rewards.selectors import sum_at
from agent_sdk.time_series import Hours, within
from topics.messages import Manifest


class HourlyReward(WeightedReward):
    """`LinearReward` with one weight for some hours of the day and another for the rest.

    Source: Sinergym's `HourlyLinearReward`, whose weight outside the hours is always 1.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)
        w = weight within hours, else weight_outside

    Terms: energy, comfort. Metrics: power_w, degrees_outside.

    Attributes:
        hours: first hour, and the hour after the last: (9, 20) is from 9:00 until 20:00. (22, 6) spans midnight.
        weight_outside: w in all other hours, 0 to 1; 1 ignores comfort.
    """

    kind: Literal["hourly"] = "hourly"
    hours: Hours = (9, 20)
    weight_outside: float = Field(1.0, ge=0.0, le=1.0)

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)


class _Bound(WeightedBound):
    def __init__(self, of: HourlyReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        self._of = of
        self._weights = [of.weight if within(of.hours, hour) else of.weight_outside for hour in range(24)]

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        weight = self._weight(begin)
        outside, power_w = self._degrees(values, begin), sum_at(values, self._powers)
        energy = -weight * self._of.lambda_energy * power_w
        comfort = -(1.0 - weight) * self._of.lambda_temperature * outside
        terms = {"energy": energy, "comfort": comfort}
        return Outcome(energy + comfort, terms, {"power_w": power_w, "degrees_outside": outside})

    def _weight(self, begin: Begin) -> Any:
        if isinstance(begin, datetime):
            return self._weights[begin.hour]
        return np.array([self._weights[moment.hour] for moment in begin])
