"""Rewards on energy costs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.energy import EnergyReward
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.terms import MeanPower, PricedEnergy, Term, TermSum
from zenostat.agent_sdk.time_series import Number, Period, Price, TimeOfUse, TimeSeries, Unit, per_kwh
from zenostat.topics.messages import Manifest


class EnergyCostReward(EnergyReward):
    """Weighted sum of power, of degrees outside the comfort band, and of energy costs.

        r = -w * lambda_energy * P - w_T * lambda_temperature * D - (1 - w - w_T) * lambda_cost * E * price
        D = sum_z max(low - T_z, T_z - high, 0)

    E is the timestep's energy in kWh, P its mean power in W, and the price that of the hour in which the timestep
    began, in currency per kWh. A negative price makes the cost term positive; the other terms are zero or negative.

    Source: Sinergym's `EnergyCostLinearReward`, whose cost is the price alone, independent of the energy.

    Terms: energy, comfort, cost. Metrics: power_w, degrees_outside, energy_kwh, cost (in the price's currency).

    Attributes:
        price: a signal of `zenostat.time_series`.
        weight_temperature: w_T, 0 to 1; its sum with `weight` is at most 1.
        lambda_energy: 1/W.
        lambda_cost: per unit of currency.
    """

    kind: Literal["energy_cost"] = "energy_cost"
    price: Price
    weight: float = Field(0.4, ge=0.0, le=1.0)
    weight_temperature: float = Field(0.4, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_cost: float = Field(1.0, ge=0.0)

    @model_validator(mode="after")
    def _check_weights(self) -> EnergyCostReward:
        if self.weight + self.weight_temperature > 1.0 + 1e-9:
            raise ValueError(
                f"the sum of weight {self.weight} and weight_temperature {self.weight_temperature} is above 1"
            )
        return self

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        degrees, meter = self._degrees_outside(manifest), self._energy_meter(manifest)
        weight_cost = max(1.0 - self.weight - self.weight_temperature, 0.0)
        terms = [
            Term("energy", -self.weight * self.lambda_energy, MeanPower(meter)),
            Term("comfort", -self.weight_temperature * self.lambda_temperature, degrees),
            Term("cost", -weight_cost * self.lambda_cost, energy_cost(meter, self.price)),
        ]
        return TermSum(terms, ["power_w", "degrees_outside", "energy_kwh", "cost"])


class TariffReward(EnergyReward):
    """Weighted sum of energy costs under a time-of-use tariff and of degrees outside the comfort band.

        r = -w * lambda_cost * E * price - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    E is the timestep's energy in kWh; the price is that of the first period that contains the hour in which the
    timestep began, else `otherwise`. Weekdays are those of simulated time.

    Terms: cost, comfort. Metrics: degrees_outside, energy_kwh, cost (in the price's currency).

    Attributes:
        periods: hours with other prices; see `zenostat.time_series.Period`.
        otherwise: the price in all other hours.
        unit: unit of all these prices, such as EUR/kWh.
        lambda_cost: per unit of currency.
    """

    kind: Literal["tariff"] = "tariff"
    periods: Annotated[tuple[Period, ...], Field(min_length=1)]
    otherwise: Number
    unit: Unit
    lambda_cost: float = Field(1.0, ge=0.0)

    @field_validator("unit")
    @classmethod
    def _check_unit(cls, unit: str) -> str:
        per_kwh(unit)
        return unit

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        degrees, meter = self._degrees_outside(manifest), self._energy_meter(manifest)
        price = TimeOfUse(table=self.periods, otherwise=self.otherwise, unit=self.unit)
        terms = [
            Term("cost", -self.weight * self.lambda_cost, energy_cost(meter, price)),
            Term("comfort", -(1.0 - self.weight) * self.lambda_temperature, degrees),
        ]
        return TermSum(terms, ["degrees_outside", "energy_kwh", "cost"])


def energy_cost(
    meter: EnergyMeter, price: TimeSeries, metric: str = "cost", energy_metric: str = "energy_kwh"
) -> PricedEnergy:
    """Return the cost of energy in the price's currency; errors of the price's file as of `TimeSeries.load`."""
    price.load()
    return PricedEnergy(meter, price, per_kwh(price.unit), metric, energy_metric)
