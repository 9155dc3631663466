"""A reward on the energy bill and on comfort in occupied zones."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.config import Names
from zenostat.agent_sdk.rewards.energy import EnergyReward
from zenostat.agent_sdk.rewards.energy_cost import energy_cost
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.occupied import OccupiedComfort
from zenostat.agent_sdk.rewards.slot_state import SlotState
from zenostat.agent_sdk.rewards.terms import PeakIncrease, Term, TermSum
from zenostat.agent_sdk.time_series import Price, currency
from zenostat.topics.messages import Manifest

GAS_METERS = ("NaturalGas:Facility", "HVAC:NaturalGas", "NaturalGas:HVAC")


class OccupiedCostReward(OccupiedComfort, EnergyReward):
    """Energy bill with a time-of-use tariff and a demand charge, and degree-hours outside the band in occupied zones.

        r = -w * (lambda_cost * (E * price + G * gas_price) + lambda_peak * max(K - K_max, 0))
            -(1 - w) * lambda_temperature * h * sum_z n_z * max(low - T_z, T_z - high, 0)

    E and G are the timestep's electricity and gas in kWh, and the prices those of the hour in which the timestep
    began, in currency per kWh. K is the timestep's mean electric power in kW, and K_max the maximum of K in the
    calendar month so far, at least the threshold: over a month the peak terms add up to a demand charge. K_max restarts
    at the threshold with each month and each episode. h is the timestep in hours. n_z is 1 while zone z is occupied
    (`by: presence`) or its number of people (`by: people`), and `empty_weight` while it is empty. Comfort counts by the
    hour, so that the weights do not depend on the length of a timestep.

    Terms: cost, gas (with `gas_price`), peak, comfort. Metrics: energy_kwh, cost, gas_kwh and gas_cost (with
    `gas_price`), demand_kwh, peak_kw, degrees_outside (weighted), people.

    Attributes:
        price: price of electricity, a signal of `zenostat.time_series`.
        gas_price: price of gas, in the same forms; None: gas is not counted.
        lambda_cost: per unit of currency.
        lambda_peak: demand charge, 1/kW.
        threshold_kw: peak demand without charge, kW.
        lambda_temperature: 1/(K h); with `by: people` for each person.
        energy: meters of the electricity that is paid by the kWh.
        demand: meters of the electricity whose peak is charged; None: those of `energy`.
        gas: meters of the gas; None: NaturalGas:Facility, else HVAC:NaturalGas, else NaturalGas:HVAC.
    """

    kind: Literal["occupied_cost"] = "occupied_cost"
    price: Price
    gas_price: Price | None = None
    lambda_cost: float = Field(1.0, ge=0.0)
    lambda_peak: float = Field(1.0, ge=0.0)
    threshold_kw: float = Field(0.0, ge=0.0)
    demand: Names | None = None
    gas: Names | None = None

    @model_validator(mode="after")
    def _check_currency(self) -> OccupiedCostReward:
        currencies = {currency(price.unit) for price in (self.price, self.gas_price) if price is not None} - {""}
        if len(currencies) > 1:
            raise ValueError(f"price and gas_price are in {' and '.join(sorted(currencies))}; one currency expected")
        return self

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        occupied, meter = self._occupied_degrees(manifest), self._energy_meter(manifest)
        demand = meter if self.demand is None else EnergyMeter(self.kind, self.demand, manifest)
        peaks = SlotState(self.kind, month=-1.0, peak_kw=self.threshold_kw)
        terms = [Term("cost", -self.weight * self.lambda_cost, energy_cost(meter, self.price))]
        metrics = ["energy_kwh", "cost"]
        if self.gas_price is not None:
            gas = EnergyMeter(self.kind, self.gas, manifest, default=GAS_METERS)
            cost = energy_cost(gas, self.gas_price, "gas_cost", "gas_kwh")
            terms.append(Term("gas", -self.weight * self.lambda_cost, cost))
            metrics += ["gas_kwh", "gas_cost"]
        increase = PeakIncrease(demand, peaks, self.threshold_kw, "demand_kwh")
        terms.append(Term("peak", -self.weight * self.lambda_peak, increase))
        terms.append(Term("comfort", -(1.0 - self.weight) * self.lambda_temperature * manifest.step_h, occupied))
        return TermSum(terms, [*metrics, "demand_kwh", "peak_kw", "degrees_outside", "people"], peaks)
