"""Running totals of an episode: energy, peak power and degree-hours outside the comfort band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zenostat.metrics.roles import EndUse, PointRoles, PowerSource
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest
from zenostat.views.live.samples import SampleBlock


@dataclass(frozen=True, eq=False)
class TotalRows:
    """Totals up to each sample of a block, each of shape (n,).

    Attributes:
        facility_kw, hvac_kw: electric power, mean of the timestep; NaN where the node does not measure it.
        facility_kwh, hvac_kwh: electricity since the first sample; NaN where the node does not measure it.
        peak_kw: highest electric power of the whole building since the first sample; NaN before the first timestep.
        fuels_kw, fuels_kwh: power and energy of each fuel of `PointRoles.other_fuels`, shape (n, fuels).
        outside_kh: degree-hours outside the comfort band, sum over the zones.
        occupied_kh: the same in occupied zones only.
    """

    facility_kw: Floats
    hvac_kw: Floats
    facility_kwh: Floats
    hvac_kwh: Floats
    outside_kh: Floats
    occupied_kh: Floats
    peak_kw: Floats
    fuels_kw: Floats
    fuels_kwh: Floats


class Totals:
    """Accumulates totals over the samples of an episode, from the plant's own values.

    The timestep that sample 0 closes belongs to the warmup and does not count.
    """

    def __init__(self, manifest: Manifest, roles: PointRoles) -> None:
        self._step_h = manifest.step_h
        self._sources = (roles.facility_power, roles.hvac_power)
        self._fuels = roles.other_fuels
        self._sums = np.zeros(4 + len(self._fuels))  # facility kWh, HVAC kWh, K h, occupied K h, fuels kWh
        self._peak_kw = np.nan

    def add(self, block: SampleBlock) -> TotalRows:
        """Add the timesteps that the samples close."""
        powers = [_power(block, source) for source in self._sources]
        fuels_kw = [_power(block, fuel) for fuel in self._fuels]
        outside_k = np.abs(np.nan_to_num(block.deviations))
        rates = np.stack([*powers, outside_k.sum(axis=1), (outside_k * block.is_occupied).sum(axis=1), *fuels_kw])
        is_warmup = block.steps == 0
        rates[:, is_warmup] = 0.0
        rows = self._sums[:, None] + np.cumsum(rates * self._step_h, axis=1)
        self._sums = rows[:, -1]
        peaks = np.concatenate([[self._peak_kw], np.where(is_warmup, np.nan, powers[0])])
        peaks_kw = np.fmax.accumulate(peaks)[1:]
        self._peak_kw = peaks_kw[-1]
        facility_kwh, hvac_kwh, outside_kh, occupied_kh = rows[:4]
        return TotalRows(
            facility_kw=powers[0],
            hvac_kw=powers[1],
            facility_kwh=facility_kwh,
            hvac_kwh=hvac_kwh,
            outside_kh=outside_kh,
            occupied_kh=occupied_kh,
            peak_kw=peaks_kw,
            fuels_kw=np.reshape(fuels_kw, (len(self._fuels), len(block))).T,
            fuels_kwh=rows[4:].T,
        )


def _power(block: SampleBlock, source: PowerSource | EndUse | None) -> Floats:
    if source is None:
        return np.full(len(block), np.nan)
    return block.plant_values[:, source.index] * source.to_kw
