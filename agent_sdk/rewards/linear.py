"""The linear reward of energy and comfort."""

from __future__ import annotations

from typing import Literal

from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.config import Names
from zenostat.agent_sdk.rewards.selectors import powers
from zenostat.agent_sdk.rewards.terms import Power, Quantity, Term, TermSum
from zenostat.topics.messages import Manifest


class WeightedReward(ComfortBand):
    """Base of rewards that weigh power against comfort.

    Attributes:
        weight: w, the weight of energy, 0 to 1; that of comfort is 1 - w.
        lambda_energy: 1/W.
        lambda_temperature: 1/K.
        power: name or names of the sensors (W) or meters (J) for P; None is the HVAC's electric power.
    """

    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_temperature: float = Field(1.0, ge=0.0)
    power: Names | None = None

    def _energy_term(self, manifest: Manifest) -> Term:
        return Term("energy", -self.weight * self.lambda_energy, Power(*powers(self.kind, self.power, manifest)))

    def _comfort_term(self, quantity: Quantity) -> Term:
        return Term("comfort", -(1.0 - self.weight) * self.lambda_temperature, quantity)


class LinearReward(WeightedReward):
    """Weighted sum of power and of degrees outside the comfort band.

    Source: the `LinearReward` of Campoy-Nieves et al., "Sinergym: a virtual testbed for building energy
    optimization with Reinforcement Learning", Energy and Buildings.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    P is the HVAC's mean electric power in W: the meter HVAC:Electricity over the timestep, else EnergyPlus's Facility
    Total HVAC Electricity Demand Rate (or the sum of the named points). T_z is the air temperature of zone z in degC.
    The summer band is valid from `summer_begin` to `summer_end` (month, day; both inclusive), else the
    winter band, by the day on which the timestep began. Both terms are zero or negative.

    Terms: energy, comfort. Metrics: power_w, degrees_outside.
    """

    kind: Literal["linear"] = "linear"

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        energy = self._energy_term(manifest)
        return TermSum([energy, self._comfort_term(self._degrees_outside(manifest))], ["power_w", "degrees_outside"])
