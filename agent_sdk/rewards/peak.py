"""A reward on the monthly peak demand."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.energy import EnergyReward, MeteredBound
from agent_sdk.rewards.slot_state import SlotState
from topics.messages import Manifest


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

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)


class _Bound(MeteredBound):
    def __init__(self, of: PeakReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        self._least_kw, self._of_peak = of.threshold_kw, -of.lambda_peak
        self._of_power = -of.weight * of.lambda_energy
        self._of_comfort = -(1.0 - of.weight) * of.lambda_temperature
        self._state = SlotState(of.kind, month=-1.0, peak_kw=of.threshold_kw)

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside, kwh = self._degrees(values, begin), self._energy.kwh(values)
        demand_kw = kwh * self._energy.kw_per_kwh
        power_w = demand_kw * 1e3
        before_kw, peak_kw = self._peaks(demand_kw, begin)
        energy, comfort = self._of_power * power_w, self._of_comfort * outside
        peak = self._of_peak * (peak_kw - before_kw)
        measures = {"power_w": power_w, "degrees_outside": outside, "energy_kwh": kwh, "peak_kw": peak_kw}
        return Outcome(energy + comfort + peak, {"energy": energy, "comfort": comfort, "peak": peak}, measures)

    def _peaks(self, demand_kw: Any, begin: Begin) -> tuple[Any, Any]:
        """Return the month's peak before and after this timestep."""
        shape = np.shape(demand_kw)
        was, month = self._state.of(shape), np.broadcast_to(_months(begin), shape)
        before_kw = np.where(was["month"] == month, was["peak_kw"], self._least_kw)
        peak_kw = np.maximum(before_kw, demand_kw)
        self._state.store(month=month, peak_kw=peak_kw)
        return before_kw, peak_kw

    def reset(self, slots: Sequence[int] | None = None) -> None:
        self._state.reset(slots)

    def state(self) -> dict[str, Any]:
        return self._state.state()

    def restore(self, state: dict[str, Any]) -> None:
        self._state.restore(state)


def _months(begin: Begin) -> Any:
    """Return the months since year 0, which differ between years."""
    if isinstance(begin, datetime):
        return begin.year * 12 + begin.month
    return np.array([moment.year * 12 + moment.month for moment in begin])
