"""Running totals of an episode: energy, peak power and degree-hours outside the comfort band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bridge.display.roles import PointRoles, PowerSource
from bridge.rerun.samples import Floats, SampleBlock
from topics.messages import Manifest


@dataclass(frozen=True, eq=False)
class TotalRows:
    """Totals up to each sample of a block, each of shape (n,).

    Attributes:
        facility_kw, hvac_kw: electric power, mean of the timestep; NaN where the node does not measure it.
        facility_kwh, hvac_kwh: electricity since the first sample; NaN where the node does not measure it.
        outside_kh: kelvin hours outside the comfort band, sum over the zones.
        occupied_kh: the same in occupied zones only.
    """

    facility_kw: Floats
    hvac_kw: Floats
    facility_kwh: Floats
    hvac_kwh: Floats
    outside_kh: Floats
    occupied_kh: Floats


class Totals:
    """Accumulates totals over the samples of an episode, from the plant's own values.

    The timestep that sample 0 closes belongs to the warmup and does not count.
    """

    def __init__(self, manifest: Manifest, roles: PointRoles) -> None:
        self._step_h = manifest.step_s / 3600.0
        self._sources = (roles.facility_power, roles.hvac_power)
        self._sums = np.zeros(4)  # facility kWh, HVAC kWh, K h, occupied K h

    def add(self, block: SampleBlock) -> TotalRows:
        """Add the timesteps that the samples close."""
        powers = [_power(block, source) for source in self._sources]
        outside_k = np.abs(np.nan_to_num(block.deviations))
        rates = np.stack([*powers, outside_k.sum(axis=1), (outside_k * block.is_occupied).sum(axis=1)])
        rates[:, block.steps == 0] = 0.0
        rows = self._sums[:, None] + np.cumsum(rates * self._step_h, axis=1)
        self._sums = rows[:, -1]
        return TotalRows(powers[0], powers[1], *rows)


def _power(block: SampleBlock, source: PowerSource | None) -> Floats:
    if source is None:
        return np.full(len(block), np.nan)
    return block.plant_values[:, source.index] * source.to_kw
