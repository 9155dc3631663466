"""What an episode came to, in the field's metrics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent_sdk.bus.sample import SampleView
from agent_sdk.rewards import REWARDS, MultiZoneReward, OccupiedReward, Reward, read_reward
from agent_sdk.rewards.comfort_band import ComfortBand
from agent_sdk.rewards.occupied import PEOPLE
from agent_sdk.rewards.selectors import HVAC_POWER, same_zone, temperatures
from topics.errors import InvalidConfig
from topics.messages import Aggregation, Manifest

J_PER_KWH = 3.6e6
FUELS = {
    "electricity": "Electricity", "natural_gas": "NaturalGas", "district_cooling": "DistrictCooling",
    "district_heating_water": "DistrictHeatingWater", "district_heating_steam": "DistrictHeatingSteam",
    "propane": "Propane", "fuel_oil_1": "FuelOilNo1", "fuel_oil_2": "FuelOilNo2", "diesel": "Diesel",
    "gasoline": "Gasoline", "coal": "Coal", "other_fuel_1": "OtherFuel1", "other_fuel_2": "OtherFuel2",
}  # fmt: skip
"""What buildings burn or buy, and EnergyPlus's words for it in the names of its meters."""

_FACILITY_POWER = "Facility Total Electricity Demand Rate"
_HVAC = "hvac_electricity"


@dataclass(frozen=True, slots=True)
class EpisodeMetrics:
    """An episode's totals; None is what the scenario does not tell.

    Attributes:
        steps: timesteps.
        reward: the sum of its rewards.
        terms: of these, the sum of each term.
        energy_kwh: by fuel (the keys of `FUELS`) that the scenario measures.
        hvac_electricity_kwh: what heating, cooling and ventilation have of it.
        mean_power_w: of electricity; the facility's, else the HVAC's. `MetricsAccumulator.sources` says which.
        peak_kw: the greatest of the timesteps' mean powers, of the same.
        mean_deviation_k: degrees outside the comfort band, the mean over its zones and all timesteps.
        outside_percent: timesteps at whose end one zone at least is outside.
        outside_kh: kelvin hours outside, summed over the zones.
        occupied_outside_kh: of these, those of zones with people in them; all hours where people are not measured.
        late, rejected: messages that the node refused during the episode.
        terminated: whether a limit of the scenario ended it.
    """

    steps: int
    reward: float | None
    terms: dict[str, float]
    energy_kwh: dict[str, float]
    hvac_electricity_kwh: float | None
    mean_power_w: float | None
    peak_kw: float | None
    mean_deviation_k: float | None
    outside_percent: float | None
    outside_kh: float | None
    occupied_outside_kh: float | None
    late: int
    rejected: int
    terminated: bool

    def metrics(self) -> dict[str, float | None]:
        """All by name, terms as `reward.energy` and `mean_reward.energy`, fuels as `electricity_kwh`."""
        steps = max(self.steps, 1)
        rewards = {"reward": self.reward} | {f"reward.{name}": value for name, value in self.terms.items()}
        means = {f"mean_{name}": None if value is None else value / steps for name, value in rewards.items()}
        energy = {"electricity_kwh": None} | {f"{fuel}_kwh": value for fuel, value in self.energy_kwh.items()}
        return {
            **rewards,
            **means,
            **energy,
            "hvac_electricity_kwh": self.hvac_electricity_kwh,
            "mean_power_w": self.mean_power_w,
            "peak_kw": self.peak_kw,
            "mean_deviation_k": self.mean_deviation_k,
            "outside_percent": self.outside_percent,
            "outside_kh": self.outside_kh,
            "occupied_outside_kh": self.occupied_outside_kh,
            "steps": self.steps,
            "late": self.late,
            "rejected": self.rejected,
            "terminated": float(self.terminated),
        }


class MetricsAccumulator:
    """Adds up an episode's samples, from sample 0 on.

    Energy is that of the meters `<fuel>:Facility` and `Electricity:HVAC`; electricity without a meter is that of the
    sensor of the facility's or the HVAC's demand rate, W times the timestep. Comfort is measured against the band of
    the reward; of `MultiZoneReward` against each zone's setpoints.

    Args:
        manifest: of the node.
        reward: whose comfort band counts; None, or one without a band: that of the scenario's reward.

    Attributes:
        sources: by metric, what it is measured by.
    """

    def __init__(self, manifest: Manifest, reward: Reward | None = None) -> None:
        self._step_h = 1.0 / manifest.steps_per_hour
        self._step = timedelta(hours=self._step_h)
        meters = _meters(manifest)
        self._names = tuple(meters)
        self._places = np.array([meter.place for meter in meters.values()], np.intp)
        self._to_kwh = np.array([meter.to_kwh for meter in meters.values()])
        electric = [name for name in ("electricity", _HVAC) if name in meters]
        self._electric = self._names.index(electric[0]) if electric else None
        self._comfort = _comfort(manifest, reward)
        self.sources = {f"{name}_kwh": meter.source for name, meter in meters.items()}
        if electric:
            self.sources |= dict.fromkeys(("mean_power_w", "peak_kw"), meters[electric[0]].source)
        if self._comfort is not None:
            self.sources["mean_deviation_k"] = self._comfort.source
        self._clear()

    def _clear(self) -> None:
        self._kwh = np.zeros(len(self._names))
        self._terms: dict[str, float] | None = None
        self._peak_kwh = self._outside_k = self._occupied_k = 0.0
        self._steps = self._steps_outside = 0
        self._refused = self._refused_before = (0, 0)

    def begin(self, sample: SampleView) -> None:
        """Start again from `sample`, whatever its step: the timestep that ended there does not count."""
        self._clear()
        self._refused_before = self._refused = (sample.message.late, sample.message.rejected)

    def add(self, sample: SampleView, terms: Mapping[str, float] | None = None) -> None:
        """Adds the timestep that ended at `sample`, and the terms of its reward; at sample 0 it begins anew."""
        if sample.step == 0:
            self.begin(sample)
            return
        refused = (sample.message.late, sample.message.rejected)
        values = sample.fault_free_values
        kwh = values[self._places] * self._to_kwh
        self._kwh += kwh
        if self._electric is not None:
            self._peak_kwh = max(self._peak_kwh, float(kwh[self._electric]))
        if self._comfort is not None:
            outside = self._comfort.outside(values, sample.time - self._step)
            self._outside_k += float(outside.sum())
            self._occupied_k += float(outside[self._comfort.in_use(values)].sum())
            self._steps_outside += bool((outside > 0.0).any())
        for name, term in (terms or {}).items():
            self._terms = self._terms or {}
            self._terms[name] = self._terms.get(name, 0.0) + float(term)
        self._steps += 1
        self._refused = refused

    def result(self, *, terminated: bool = False) -> EpisodeMetrics:
        """The totals so far; without a timestep there is no energy, power or comfort."""
        kwh = dict(zip(self._names, self._kwh.tolist(), strict=True)) if self._steps else {}
        hvac_kwh = kwh.pop(_HVAC, None)
        electric = self._electric if self._steps else None
        comfort = self._comfort if self._steps else None
        mean_kwh = None if electric is None else float(self._kwh[electric]) / self._steps
        return EpisodeMetrics(
            steps=self._steps,
            reward=None if self._terms is None else sum(self._terms.values()),
            terms=dict(self._terms or {}),
            energy_kwh=kwh,
            hvac_electricity_kwh=hvac_kwh,
            mean_power_w=None if mean_kwh is None else mean_kwh / self._step_h * 1e3,
            peak_kw=None if electric is None else self._peak_kwh / self._step_h,
            mean_deviation_k=None if comfort is None else self._outside_k / (self._steps * len(comfort.zones)),
            outside_percent=None if comfort is None else 100.0 * self._steps_outside / self._steps,
            outside_kh=None if comfort is None else self._outside_k * self._step_h,
            occupied_outside_kh=None if comfort is None else self._occupied_k * self._step_h,
            late=self._refused[0] - self._refused_before[0],
            rejected=self._refused[1] - self._refused_before[1],
            terminated=terminated,
        )


@dataclass(frozen=True, slots=True)
class _Metered:
    """Where an energy stands among a sample's values, what makes kWh of it, and what it is."""

    place: int
    to_kwh: float
    source: str


def _meters(manifest: Manifest) -> dict[str, _Metered]:
    """By fuel, and the HVAC's electricity, as far as they are there."""
    first = len(manifest.sensors)
    there = {m.meter.casefold(): (first + i, m) for i, m in enumerate(manifest.meters) if m.unit == "J"}
    wanted = {fuel: f"{word}:Facility" for fuel, word in FUELS.items()} | {_HVAC: "Electricity:HVAC"}
    found = {}
    for name, energyplus in wanted.items():
        if energyplus.casefold() in there:
            place, meter = there[energyplus.casefold()]
            found[name] = _Metered(place, 1.0 / J_PER_KWH, f"meter {meter.meter}")
    for name, variable in (("electricity", _FACILITY_POWER), (_HVAC, HVAC_POWER)):
        for place, sensor in enumerate(manifest.sensors):
            if name not in found and sensor.variable.casefold() == variable.casefold() and sensor.unit == "W":
                how = ", read at its end (an approximation)" if sensor.aggregation is Aggregation.INSTANT else ""
                source = f"sensor {sensor.name}, W times the timestep{how}"
                found[name] = _Metered(place, 1e-3 / manifest.steps_per_hour, source)
    return found


class _Comfort:
    """The zones that should be comfortable, their bands, and who is in them."""

    def __init__(
        self, source: str, zones: Sequence[int], people: Sequence[int | None], band: Callable[[Any, Any], Any]
    ) -> None:
        self.zones = np.array(zones, np.intp)
        self.source = f"{len(zones)} zone{'s' if len(zones) > 1 else ''}, the band of the {source} reward"
        self._band = band
        self._always = np.array([place is None for place in people])
        self._people = np.array([place or 0 for place in people], np.intp)

    def outside(self, values: NDArray[np.float64], begin: Any) -> NDArray[np.float64]:
        """Kelvin outside the band, by zone."""
        low, high = self._band(values, begin)
        air = values[self.zones]
        outside: NDArray[np.float64] = np.maximum(np.maximum(low - air, air - high), 0.0)
        return outside

    def in_use(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """By zone, whether people are there; True where they are not measured."""
        used: NDArray[np.bool_] = self._always | (values[self._people] > 0.0)
        return used


def _comfort(manifest: Manifest, reward: Reward | None) -> _Comfort | None:
    said = manifest.task.reward
    # A node of somebody else's may have a reward that is not known here.
    theirs = read_reward(said) if said is not None and said.get("kind") in REWARDS else None
    for candidate in (reward, theirs):
        try:
            if isinstance(candidate, ComfortBand):
                return _banded(candidate, manifest)
            if isinstance(candidate, MultiZoneReward):
                return _by_setpoints(candidate, manifest)
        except InvalidConfig:  # the node lacks the temperatures
            continue
    return None


def _banded(reward: ComfortBand, manifest: Manifest) -> _Comfort:
    band, zones = reward.season(manifest).band, temperatures(reward.kind, reward.temperatures, manifest).tolist()
    if isinstance(reward, OccupiedReward):
        zones, people = map(list, zip(*reward.pairs(zones, manifest), strict=True))
    else:
        people = same_zone(zones, PEOPLE, manifest)
    return _Comfort(reward.kind, zones, people, lambda _, begin: band(begin))


def _by_setpoints(reward: MultiZoneReward, manifest: Manifest) -> _Comfort:
    air, heat, cool = map(list, zip(*reward._points(manifest), strict=True))  # noqa: SLF001  # their pairs
    around = reward.threshold
    people = same_zone(air, PEOPLE, manifest)
    return _Comfort(reward.kind, air, people, lambda values, _: (values[heat] - around, values[cool] + around))
