"""What an episode came to: energy, comfort, peak."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta

import numpy as np

from agent_sdk.rewards import LinearReward
from agent_sdk.sample import SampleView
from topics.errors import InvalidConfig
from topics.messages import Manifest

J_PER_KWH = 3.6e6
_TEMPERATURE = "zone air temperature"
_OCCUPANTS = "zone people occupant count"
_ELECTRICITY = "electricity:facility"
_HVAC = "electricity:hvac"
_GAS = "naturalgas:facility"


@dataclass(frozen=True, slots=True)
class Result:
    """Totals of an episode. Comfort is in kelvin hours outside the season's band, summed over the zones."""

    steps: int
    electricity_kwh: float
    hvac_electricity_kwh: float
    gas_kwh: float
    peak_kw: float
    discomfort_kh: float
    occupied_discomfort_kh: float
    late: int
    rejected: int


class Tally:
    """Adds up an episode's samples.

    Args:
        manifest: of a node with zone air temperatures and the facility's electricity meter.

    Raises:
        InvalidConfig: it lacks one of them.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._band = LinearReward().band
        self._step = timedelta(hours=1 / manifest.steps_per_hour)
        occupants = {s.key: i for i, s in enumerate(manifest.sensors) if s.variable.casefold() == _OCCUPANTS}
        zones = [(i, s.key) for i, s in enumerate(manifest.sensors) if s.variable.casefold() == _TEMPERATURE]
        self._zones = [i for i, _ in zones]
        self._occupants = [occupants.get(key) for _, key in zones]
        first_meter = len(manifest.sensors)
        self._meters = {m.meter.casefold(): first_meter + i for i, m in enumerate(manifest.meters)}
        if not self._zones or _ELECTRICITY not in self._meters:
            raise InvalidConfig("an evaluation needs zone air temperatures and the meter 'Electricity:Facility'")
        self._sums = dict.fromkeys((_ELECTRICITY, _HVAC, _GAS), 0.0)
        self._peak_w = self._outside = self._occupied_outside = 0.0
        self._steps = self._late = self._rejected = 0

    def add(self, sample: SampleView) -> None:
        """Adds a timestep; sample 0 closes none."""
        if sample.step == 0:
            return
        hours = self._step.total_seconds() / 3600
        values = sample.values
        for name in self._sums:
            if name in self._meters:
                self._sums[name] += float(values[self._meters[name]])
        self._peak_w = max(self._peak_w, float(values[self._meters[_ELECTRICITY]]) / self._step.total_seconds())
        low, high = self._band(sample.time - self._step)
        temperatures = values[self._zones]
        outside = np.maximum(np.maximum(low - temperatures, temperatures - high), 0.0)
        in_use = np.array([i is None or values[i] > 0.0 for i in self._occupants])
        self._outside += float(outside.sum()) * hours
        self._occupied_outside += float(outside[in_use].sum()) * hours
        self._steps += 1
        self._late, self._rejected = sample.wire.late, sample.wire.rejected

    def result(self) -> Result:
        """The totals so far."""
        return Result(
            steps=self._steps,
            electricity_kwh=self._sums[_ELECTRICITY] / J_PER_KWH,
            hvac_electricity_kwh=self._sums[_HVAC] / J_PER_KWH,
            gas_kwh=self._sums[_GAS] / J_PER_KWH,
            peak_kw=self._peak_w / 1e3,
            discomfort_kh=self._outside,
            occupied_discomfort_kh=self._occupied_outside,
            late=self._late,
            rejected=self._rejected,
        )
