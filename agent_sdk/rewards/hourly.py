"""A reward whose weights depend on the hour of the day."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any, Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import Begin, BoundReward
from zenostat.agent_sdk.rewards.linear import WeightedReward
from zenostat.agent_sdk.rewards.terms import Term, TermSum
from zenostat.agent_sdk.time_series import Hours
from zenostat.topics.calendar import in_hours
from zenostat.topics.messages import Manifest


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

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        weights = [self.weight if in_hours(self.hours, hour) else self.weight_outside for hour in range(24)]
        energy_factors = [-weight * self.lambda_energy for weight in weights]
        comfort_factors = [-(1.0 - weight) * self.lambda_temperature for weight in weights]
        energy = self._energy_term(manifest)._replace(factor=_by_hour(energy_factors))
        comfort = Term("comfort", _by_hour(comfort_factors), self._degrees_outside(manifest))
        return TermSum([energy, comfort], ["power_w", "degrees_outside"])


def _by_hour(factors: list[float]) -> Callable[[Begin], Any]:
    """Return a function from the beginning of a timestep to the factor of its hour."""

    def factor(begin: Begin) -> Any:
        if isinstance(begin, datetime):
            return factors[begin.hour]
        return np.array([factors[moment.hour] for moment in begin])

    return factor
