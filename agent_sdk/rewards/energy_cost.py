"""Rewards on energy costs."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.energy import EnergyReward, MeteredBound
from agent_sdk.time_series import Number, Period, Price, TimeOfUse, TimeSeries, Unit, per_kwh
from topics.messages import Manifest


class EnergyCostReward(EnergyReward):
    """Weighted sum of power, of degrees outside the comfort band, and of energy costs.

        r = -w * lambda_energy * P - w_T * lambda_temperature * D - (1 - w - w_T) * lambda_cost * E * price
        D = sum_z max(low - T_z, T_z - high, 0)

    E is the timestep's energy in kWh, P its mean power in W, and the price that of the hour in which the timestep
    began, in currency per kWh. A negative price makes the cost term positive; the other terms are zero or negative.

    Source: Sinergym's `EnergyCostLinearReward`, whose cost is the price alone, independent of the energy.

    Terms: energy, comfort, cost. Metrics: power_w, degrees_outside, energy_kwh, cost (in the price's currency).

    Attributes:
        price: a signal of `agent_sdk.time_series`.
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

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _ThreeTerms(self, manifest)


class _ThreeTerms(MeteredBound):
    def __init__(self, of: EnergyCostReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        self._price = _PerKwh(of.price)
        self._of_power = -of.weight * of.lambda_energy
        self._of_comfort = -of.weight_temperature * of.lambda_temperature
        self._of_cost = -max(1.0 - of.weight - of.weight_temperature, 0.0) * of.lambda_cost

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside, kwh = self._degrees(values, begin), self._energy.kwh(values)
        power_w, cost = kwh * self._energy.kw_per_kwh * 1e3, kwh * self._price.at(begin)
        energy, comfort, money = self._of_power * power_w, self._of_comfort * outside, self._of_cost * cost
        measures = {"power_w": power_w, "degrees_outside": outside, "energy_kwh": kwh, "cost": cost}
        return Outcome(energy + comfort + money, {"energy": energy, "comfort": comfort, "cost": money}, measures)


class TariffReward(EnergyReward):
    """Weighted sum of energy costs under a time-of-use tariff and of degrees outside the comfort band.

        r = -w * lambda_cost * E * price - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    E is the timestep's energy in kWh; the price is that of the first period that contains the hour in which the
    timestep began, else `otherwise`. Weekdays are those of simulated time.

    Terms: cost, comfort. Metrics: degrees_outside, energy_kwh, cost (in the price's currency).

    Attributes:
        periods: hours with other prices; see `agent_sdk.time_series.Period`.
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

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _TwoTerms(self, manifest)


class _TwoTerms(MeteredBound):
    def __init__(self, of: TariffReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        self._price = _PerKwh(TimeOfUse(table=of.periods, otherwise=of.otherwise, unit=of.unit))
        self._of_cost = -of.weight * of.lambda_cost
        self._of_comfort = -(1.0 - of.weight) * of.lambda_temperature

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside, kwh = self._degrees(values, begin), self._energy.kwh(values)
        cost = kwh * self._price.at(begin)
        money, comfort = self._of_cost * cost, self._of_comfort * outside
        measures = {"degrees_outside": outside, "energy_kwh": kwh, "cost": cost}
        return Outcome(money + comfort, {"cost": money, "comfort": comfort}, measures)


class _PerKwh:
    """A price in currency per kWh."""

    def __init__(self, price: TimeSeries) -> None:
        price.load()
        self._signal, self._factor = price, per_kwh(price.unit)

    def at(self, begin: Begin) -> float | NDArray[np.float64]:
        price: float | NDArray[np.float64] = self._signal.at(begin) * self._factor
        return price
