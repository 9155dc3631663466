"""A reward on carbon dioxide emissions."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.energy import EnergyReward, MeteredBound
from agent_sdk.time_series import Intensity, grams_per_kwh
from topics.messages import Manifest


class CarbonReward(EnergyReward):
    """Weighted sum of emissions and of degrees outside the comfort band.

        r = -w * lambda_carbon * E * c / 1000 - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    E is the timestep's energy in kWh, c the carbon intensity in g/kWh in the hour in which the timestep
    began.

    Terms: carbon, comfort. Metrics: degrees_outside, energy_kwh, co2_kg.

    Attributes:
        intensity: a signal of `agent_sdk.time_series` in g/kWh, kg/MWh, kg/kWh or t/MWh.
        lambda_carbon: 1/kg.
    """

    kind: Literal["carbon"] = "carbon"
    intensity: Intensity
    lambda_carbon: float = Field(1.0, ge=0.0)

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)


class _Bound(MeteredBound):
    def __init__(self, of: CarbonReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        of.intensity.load()
        self._intensity, self._kg = of.intensity, grams_per_kwh(of.intensity.unit) * 1e-3
        self._of_carbon = -of.weight * of.lambda_carbon
        self._of_comfort = -(1.0 - of.weight) * of.lambda_temperature

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside, kwh = self._degrees(values, begin), self._energy.kwh(values)
        co2_kg = kwh * (self._intensity.at(begin) * self._kg)
        carbon, comfort = self._of_carbon * co2_kg, self._of_comfort * outside
        measures = {"degrees_outside": outside, "energy_kwh": kwh, "co2_kg": co2_kg}
        return Outcome(carbon + comfort, {"carbon": carbon, "comfort": comfort}, measures)
