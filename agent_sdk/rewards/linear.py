"""The linear reward of energy and comfort."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.comfort_band import BandedBound, ComfortBand
from agent_sdk.rewards.config import Names
from agent_sdk.rewards.selectors import powers, sum_at
from topics.messages import Manifest


class WeightedReward(ComfortBand):
    """Base of rewards that weigh power against comfort.

    Attributes:
        weight: w, the weight of energy, 0 to 1; that of comfort is 1 - w.
        lambda_energy: 1/W.
        lambda_temperature: 1/K.
        power: name or names of the sensors for P, W; None is the HVAC's electricity demand.
    """

    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_temperature: float = Field(1.0, ge=0.0)
    power: Names | None = None


class WeightedBound(BandedBound):
    """Knows the factors of both terms."""

    def __init__(self, of: WeightedReward, manifest: Manifest) -> None:
        self._powers = powers(of.kind, of.power, manifest)
        super().__init__(of, manifest)
        self._energy = -of.weight * of.lambda_energy
        self._comfort = -(1.0 - of.weight) * of.lambda_temperature


class LinearReward(WeightedReward):
    """Weighted sum of power and of degrees outside the comfort band.

    Source: the `LinearReward` of Campoy-Nieves et al., "Sinergym: a virtual testbed for building energy
    optimization with Reinforcement Learning", Energy and Buildings.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    P is the facility's HVAC electricity demand in W (or the sum of the named sensors), T_z the air temperature of
    zone z in degC. The summer band is valid from `summer_begin` to `summer_end` (month, day; both inclusive), else the
    winter band, by the day on which the timestep began. Both terms are zero or negative.

    Terms: energy, comfort. Metrics: power_w, degrees_outside.
    """

    kind: Literal["linear"] = "linear"

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)


class _Bound(WeightedBound):
    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside = self._degrees(values, begin)
        power_w = sum_at(values, self._powers)
        energy, comfort = self._energy * power_w, self._comfort * outside
        terms = {"energy": energy, "comfort": comfort}
        return Outcome(energy + comfort, terms, {"power_w": power_w, "degrees_outside": outside})
