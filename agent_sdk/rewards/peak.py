"""A reward on the monthly peak demand."""

from __future__ import annotations

from typing import Literal

from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.energy import EnergyReward
from zenostat.agent_sdk.rewards.slot_state import SlotState
from zenostat.agent_sdk.rewards.terms import MeanPower, PeakIncrease, Term, TermSum
from zenostat.topics.messages import Manifest


class PeakReward(EnergyReward):
    """Weighted sum of power, of degrees outside the comfort band, and of increases of the month's peak demand.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * D - lambda_peak * max(K - K_max, 0)
        D = sum_z max(low - T_z, T_z - high, 0)

    P is the timestep's mean power in W, K the same in kW, and K_max the maximum of K in the calendar month so far, at
    least the threshold. Over a month the last terms add up to -lambda_peak * (peak - threshold): a demand charge, paid
    when it arises. K_max restarts at the threshold with each month and each episode; each slot has its own.

    Terms: energy, comfort, peak. Metrics: power_w, degrees_outside, energy_kwh, peak_kw (K_max including this timestep,
    at least the threshold).

    Attributes:
        threshold_kw: peak demand without charge, kW.
        lambda_energy: 1/W.
        lambda_peak: 1/kW.
    """

    kind: Literal["peak"] = "peak"
    threshold_kw: float = Field(0.0, ge=0.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_peak: float = Field(1.0, ge=0.0)

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        degrees, meter = self._degrees_outside(manifest), self._energy_meter(manifest)
        peaks = SlotState(self.kind, month=-1.0, peak_kw=self.threshold_kw)
        terms = [
            Term("energy", -self.weight * self.lambda_energy, MeanPower(meter)),
            Term("comfort", -(1.0 - self.weight) * self.lambda_temperature, degrees),
            Term("peak", -self.lambda_peak, PeakIncrease(meter, peaks, self.threshold_kw)),
        ]
        return TermSum(terms, ["power_w", "degrees_outside", "energy_kwh", "peak_kw"], peaks)
