"""Metrics of an episode: energy, power, comfort, reward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from zenostat.agent_sdk.rewards import Reward
from zenostat.bridge.client.sample import SampleView
from zenostat.metrics.energy_meters import GENERATION, facility_sources, generation_sources, hvac_sources
from zenostat.metrics.fuel_rates import Rate, read_emissions, read_prices
from zenostat.metrics.kpis import KPIS, KpiAccumulator
from zenostat.metrics.reward_comfort import comfort
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.unmet_hours import UnmetHours
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest


@dataclass(frozen=True, slots=True)
class EpisodeMetrics:
    """Totals of an episode; None where the scenario lacks the points.

    Attributes:
        steps: number of timesteps.
        reward: sum of the rewards.
        terms: sum of each reward term.
        energy_kwh: energy by fuel (the keys of `FUELS`), for the fuels that the scenario measures.
        hvac_kwh: energy of heating, cooling and ventilation by fuel, for the fuels of which it is measured.
        mean_power_w: mean electric power of the facility, else of the HVAC; see `MetricsAccumulator.sources`.
        peak_kw: maximum of the mean power in a timestep, from the same source.
        mean_deviation_k: deviation from the comfort band, mean over its zones and all timesteps.
        outside_percent: share of timesteps at whose end at least one zone is outside the band.
        outside_kh: degree-hours outside the band, sum over the zones.
        occupied_outside_kh: degree-hours outside in occupied zones; all hours for zones without an occupant count.
        late, rejected: commands that the node did not accept during the episode.
        terminated: whether a termination limit ended the episode.
        kpis: key performance indicators by BOPTEST's names; see `zenostat.metrics.kpis`.
        site_kwh_m2: energy of all fuels of the building per m² of floor area.
        unmet_heating_h, unmet_cooling_h: hours in which an occupied zone misses its setpoint; see `unmet_hours`.
        lost: number of samples that were not received, whose timesteps are in no total.
        generation_kwh: electricity that a building with generators produces, buys and sells (the keys of `GENERATION`),
            as far as it is measured.
        peak_purchased_kw: maximum of the mean power in a timestep that the building buys from the grid.
    """

    steps: int
    reward: float | None
    terms: dict[str, float]
    energy_kwh: dict[str, float]
    hvac_kwh: dict[str, float]
    mean_power_w: float | None
    peak_kw: float | None
    mean_deviation_k: float | None
    outside_percent: float | None
    outside_kh: float | None
    occupied_outside_kh: float | None
    late: int
    rejected: int
    terminated: bool
    kpis: dict[str, float | None] = field(default_factory=dict)
    site_kwh_m2: float | None = None
    unmet_heating_h: float | None = None
    unmet_cooling_h: float | None = None
    lost: int = 0
    generation_kwh: dict[str, float] = field(default_factory=dict)
    peak_purchased_kw: float | None = None

    @property
    def hvac_electricity_kwh(self) -> float | None:
        """Electricity of heating, cooling and ventilation."""
        return self.hvac_kwh.get("electricity")

    def metrics(self) -> dict[str, float | None]:
        """Return all metrics by name, terms as `reward.energy` and `mean_reward.energy`, fuels as `electricity_kwh`."""
        steps = max(self.steps, 1)
        rewards = {"reward": self.reward} | {f"reward.{name}": value for name, value in self.terms.items()}
        means = {f"mean_{name}": None if value is None else value / steps for name, value in rewards.items()}
        energy = {"electricity_kwh": None} | {f"{fuel}_kwh": value for fuel, value in self.energy_kwh.items()}
        generation = {f"{name}_kwh": value for name, value in self.generation_kwh.items()}
        if self.peak_purchased_kw is not None:
            generation["peak_purchased_kw"] = self.peak_purchased_kw
        return {
            **rewards,
            **means,
            **energy,
            "hvac_electricity_kwh": None,
            **{f"hvac_{fuel}_kwh": value for fuel, value in self.hvac_kwh.items()},
            "site_kwh_m2": self.site_kwh_m2,
            "mean_power_w": self.mean_power_w,
            "peak_kw": self.peak_kw,
            **generation,
            "mean_deviation_k": self.mean_deviation_k,
            "outside_percent": self.outside_percent,
            "outside_kh": self.outside_kh,
            "occupied_outside_kh": self.occupied_outside_kh,
            "unmet_heating_h": self.unmet_heating_h,
            "unmet_cooling_h": self.unmet_cooling_h,
            "steps": self.steps,
            "late": self.late,
            "rejected": self.rejected,
            "terminated": float(self.terminated),
            **{f"kpi.{name}": self.kpis.get(name) for name in KPIS},
        }


_HVAC = "hvac_"
_PURCHASED = "electricity_purchased"


class MetricsAccumulator:
    """Accumulate metrics over the samples of an episode, from sample 0.

    Energy is taken from the meters `<fuel>:Facility` and `HVAC:<fuel>`; of a plant that is no EnergyPlus model, from
    meters named as the metrics, such as `electricity`. Without a meter, electricity is the demand rate of the facility
    or the HVAC times the timestep. Comfort is measured against the band of the reward; for
    `MultiZoneReward`, against each zone's setpoints.

    Args:
        manifest: manifest of the node.
        reward: reward with the comfort band; None, or a reward without a band: that of the scenario.
        prices, emissions: prices and emission factors by fuel for these KPIs; see `zenostat.metrics.fuel_rates`.

    Attributes:
        sources: by metric, the point or reward that it is derived from.
    """

    def __init__(
        self,
        manifest: Manifest,
        reward: Reward | None = None,
        prices: Mapping[str, Rate] | None = None,
        emissions: Mapping[str, Rate] | None = None,
    ) -> None:
        self._step_h = manifest.step_h
        self._step = timedelta(hours=self._step_h)
        meters = facility_sources(manifest)
        meters |= {f"{_HVAC}{fuel}": source for fuel, source in hvac_sources(manifest).items()}
        meters |= generation_sources(manifest)
        self._names = tuple(meters)
        self._indices = np.array([meter.index for meter in meters.values()], np.intp)
        self._to_kwh = np.array([meter.to_kwh for meter in meters.values()])
        electric = [name for name in ("electricity", f"{_HVAC}electricity") if name in meters]
        self._electric = self._names.index(electric[0]) if electric else None
        self._purchased = self._names.index(_PURCHASED) if _PURCHASED in meters else None
        self._comfort = comfort(manifest, reward)
        self.sources = {f"{name}_kwh": meter.source for name, meter in meters.items()}
        if electric:
            self.sources |= dict.fromkeys(("mean_power_w", "peak_kw"), meters[electric[0]].source)
        if _PURCHASED in meters:
            self.sources["peak_purchased_kw"] = meters[_PURCHASED].source
        if self._comfort is not None:
            self.sources["mean_deviation_k"] = self._comfort.source
        self._unmet, self._area_m2 = UnmetHours(manifest), manifest.floor_area_m2
        rates = read_prices(prices), read_emissions(emissions)
        self._kpis = KpiAccumulator(manifest, self._comfort, *rates)
        self.sources |= {f"kpi.{name}": source for name, source in self._kpis.sources.items()}
        self._latest_step: int | None = None
        self._reset()

    def _reset(self) -> None:
        self._kwh = np.zeros(len(self._names))
        self._terms: dict[str, float] | None = None
        self._peak_purchased_kwh = -np.inf
        self._peak_kwh, self._outside_k, self._occupied_k, self._steps_outside = -np.inf, 0.0, 0.0, 0.0
        self._steps = self._lost = 0
        self._unmet.reset()
        self._not_accepted = self._initially_not_accepted = (0, 0)

    def begin(self, sample: SampleView) -> None:
        """Start from `sample`, at any step: the timestep that it closes does not count."""
        self._latest_step = sample.step
        self._begin(sample.fault_free_values, (sample.message.late, sample.message.rejected))

    def add(self, sample: SampleView, terms: Mapping[str, float] | None = None) -> None:
        """Add the timestep that `sample` closes, with the terms of its reward; sample 0 starts a new episode."""
        if sample.step == 0:
            self.begin(sample)
            return
        self._lost += max(sample.step - self._latest_step - 1, 0) if self._latest_step is not None else 0
        self._latest_step = sample.step
        not_accepted = (sample.message.late, sample.message.rejected)
        self._add(sample.fault_free_values, sample.time - self._step, not_accepted, terms or {})

    def measure(self, trajectory: Trajectory, *, terminated: bool = False) -> EpisodeMetrics:
        """Return the totals of a trajectory; what was added before does not count."""
        values, not_accepted = trajectory.fault_free_values, [(0, 0)] * len(trajectory)
        if trajectory.not_accepted is not None:
            not_accepted = [(late, rejected) for late, rejected in trajectory.not_accepted.tolist()]
        self._begin(values[0], not_accepted[0])
        for step, begin in enumerate(trajectory.begins()):
            terms = {name: term[step] for name, term in trajectory.terms.items()}
            self._add(values[step + 1], begin, not_accepted[step + 1], terms)
        return self.result(terminated=terminated)

    def _begin(self, values: Floats, not_accepted: tuple[int, int]) -> None:
        self._reset()
        self._kpis.begin(values)
        self._initially_not_accepted = self._not_accepted = not_accepted

    def _add(self, values: Floats, begin: datetime, not_accepted: tuple[int, int], terms: Mapping[str, float]) -> None:
        kwh = values[self._indices] * self._to_kwh
        self._kwh += kwh
        if self._electric is not None:
            self._peak_kwh = float(np.maximum(self._peak_kwh, kwh[self._electric]))  # NaN stays
        if self._purchased is not None:
            self._peak_purchased_kwh = float(np.maximum(self._peak_purchased_kwh, kwh[self._purchased]))
        if self._comfort is not None:
            outside = self._comfort.outside(values, begin)
            total_k = float(outside.sum())
            self._outside_k += total_k
            self._occupied_k += float(outside[self._comfort.is_occupied(values)].sum())
            self._steps_outside += 1.0 if (outside > 0.0).any() else total_k  # 0, or NaN if a temperature is unknown
        self._kpis.add(values, begin)
        self._unmet.add(values)
        for name, term in terms.items():
            self._terms = self._terms or {}
            self._terms[name] = self._terms.get(name, 0.0) + float(term)
        self._steps += 1
        self._not_accepted = not_accepted

    def result(self, *, terminated: bool = False) -> EpisodeMetrics:
        """Return the totals so far; without any timestep, energy, power and comfort are None."""
        kwh = dict(zip(self._names, self._kwh.tolist(), strict=True)) if self._steps else {}
        generation = {name: value for name, value in kwh.items() if name in GENERATION}
        building = {name: kwh[name] for name in kwh if not name.startswith(_HVAC) and name not in GENERATION}
        electric = self._electric if self._steps else None
        comfort = self._comfort if self._steps else None
        mean_kwh = None if electric is None else float(self._kwh[electric]) / self._steps
        return EpisodeMetrics(
            steps=self._steps,
            reward=None if self._terms is None else sum(self._terms.values()),
            terms=dict(self._terms or {}),
            energy_kwh=building,
            hvac_kwh={name.removeprefix(_HVAC): value for name, value in kwh.items() if name.startswith(_HVAC)},
            mean_power_w=None if mean_kwh is None else mean_kwh / self._step_h * 1e3,
            peak_kw=None if electric is None else self._peak_kwh / self._step_h,
            mean_deviation_k=None if comfort is None else self._outside_k / (self._steps * len(comfort.zones)),
            outside_percent=None if comfort is None else 100.0 * self._steps_outside / self._steps,
            outside_kh=None if comfort is None else self._outside_k * self._step_h,
            occupied_outside_kh=None if comfort is None else self._occupied_k * self._step_h,
            late=self._not_accepted[0] - self._initially_not_accepted[0],
            rejected=self._not_accepted[1] - self._initially_not_accepted[1],
            terminated=terminated,
            kpis=self._kpis.result() if self._steps else {},
            site_kwh_m2=sum(building.values()) / self._area_m2 if building and self._area_m2 else None,
            unmet_heating_h=self._unmet.heating_h if self._steps else None,
            unmet_cooling_h=self._unmet.cooling_h if self._steps else None,
            lost=self._lost,
            generation_kwh=generation,
            peak_purchased_kw=self._peak_purchased_kwh / self._step_h if _PURCHASED in generation else None,
        )
