"""A reward on carbon dioxide emissions."""

from __future__ import annotations

from typing import Literal

from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.energy import EnergyReward
from zenostat.agent_sdk.rewards.terms import PricedEnergy, Term, TermSum
from zenostat.agent_sdk.time_series import Intensity, grams_per_kwh
from zenostat.topics.messages import Manifest


class CarbonReward(EnergyReward):
    """Weighted sum of emissions and of degrees outside the comfort band.

        r = -w * lambda_carbon * E * c / 1000 - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    E is the timestep's energy in kWh, c the carbon intensity in g/kWh in the hour in which the timestep
    began.

    Terms: carbon, comfort. Metrics: degrees_outside, energy_kwh, co2_kg.

    Attributes:
        intensity: a signal of `zenostat.time_series` in g/kWh, kg/MWh, kg/kWh or t/MWh.
        lambda_carbon: 1/kg.
    """

    kind: Literal["carbon"] = "carbon"
    intensity: Intensity
    lambda_carbon: float = Field(1.0, ge=0.0)

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        degrees, meter = self._degrees_outside(manifest), self._energy_meter(manifest)
        self.intensity.load()
        emissions = PricedEnergy(meter, self.intensity, grams_per_kwh(self.intensity.unit) * 1e-3, "co2_kg")
        terms = [
            Term("carbon", -self.weight * self.lambda_carbon, emissions),
            Term("comfort", -(1.0 - self.weight) * self.lambda_temperature, degrees),
        ]
        return TermSum(terms, ["degrees_outside", "energy_kwh", "co2_kg"])
