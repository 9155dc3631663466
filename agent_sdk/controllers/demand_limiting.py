"""Demand limiting: setpoints give way while the building's power is near a limit."""

from __future__ import annotations

from datetime import datetime

from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.manifest_data import known_rewards
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

RECOVERY_K_PER_H = 1.0
"""Rate at which setpoints return, so that zones that were released do not make the next peak together."""


class DemandLimiter:
    """Share of the setpoint adjustment that the building's power asks for, 0 to 1.

    The limit is `limit_kw`, or the highest power of the calendar month so far where that is higher: what is paid
    already cannot be saved. The share rises linearly from 0 at `start` times the limit to 1 at the limit. It falls by
    at most `RECOVERY_K_PER_H` divided by the greatest adjustment. Without `limit_kw` and a threshold, the first power
    of a month is at the limit.

    Sources: global temperature adjustment of all zones, as in Motegi, Piette, Watson, Kiliccote and Xu, "Introduction
    to commercial building control strategies and techniques for demand response", LBNL-59975, 2007; the demand-limit
    setpoint adjustment of zones in ASHRAE Guideline 36-2021, which has three fixed steps instead of a share.

    Args:
        manifest: manifest of the node.
        limit_kw: limit, kW; the threshold of the reward's demand charge if that is higher.
        start: share of the limit at which the adjustment begins, 0 to 1.
        greatest_k: greatest adjustment of any setpoint, K.
        meter: name of the building's electricity meter; empty: that of the reward, or of the manifest.

    Raises:
        ControllerMismatch: neither the task's reward nor a meter measures the building's electricity.
    """

    def __init__(self, manifest: Manifest, limit_kw: float, start: float, greatest_k: float, meter: str = "") -> None:
        measured = (EnergyMeter("portable-limit", [meter], manifest), 0.0) if meter else _demand_meter(manifest)
        self._meter, threshold_kw = measured
        self._limit_kw, self._start = max(limit_kw, threshold_kw), start
        self._recovery = RECOVERY_K_PER_H * manifest.step_s / 3600.0 / greatest_k
        self.begin()

    def begin(self) -> None:
        """Forget the peak so far."""
        self._month: tuple[int, int] | None = None
        self._peak_kw = self._share = 0.0

    def share(self, measured: Floats, now: datetime) -> float:
        """Return the share for the timestep that begins at `now`, from the power of the last one."""
        power_kw = float(self._meter.kwh(measured)) * self._meter.kw_per_kwh
        if (now.year, now.month) != self._month:
            self._month, self._peak_kw = (now.year, now.month), 0.0
        limit_kw = max(self._limit_kw, self._peak_kw)
        self._peak_kw = max(self._peak_kw, power_kw)
        begin_kw = self._start * limit_kw
        if limit_kw <= begin_kw:
            wanted = float(power_kw >= limit_kw)
        else:
            wanted = min(max((power_kw - begin_kw) / (limit_kw - begin_kw), 0.0), 1.0)
        self._share = max(wanted, self._share - self._recovery)
        return self._share


def _demand_meter(manifest: Manifest) -> tuple[EnergyMeter, float]:
    """Return the meter whose peak the reward charges, or else that of all electricity; and the peak without charge."""
    for reward in known_rewards(manifest):
        if hasattr(reward, "threshold_kw"):
            names = getattr(reward, "demand", None) or getattr(reward, "energy", None)
            return EnergyMeter("rbc", names, manifest), float(reward.threshold_kw)
    try:
        return EnergyMeter("rbc", None, manifest), 0.0
    except InvalidConfig:
        raise ControllerMismatch(
            f"demand limiting needs the building's electricity: add the meter Electricity:Facility to meters= of node "
            f"{manifest.node!r}"
        ) from None
