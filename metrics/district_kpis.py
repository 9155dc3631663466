"""Key performance indicators of a district's electricity, by CityLearn's names where they mean the same.

CityLearn's definitions are those of its class `CostFunction` (CityLearn 2.x; J. R. Vázquez-Canteli, S. Dey, G. Henze,
Z. Nagy, CityLearn: Standardizing research in multi-agent reinforcement learning for demand response and urban energy
management, arXiv:2012.10504, 2020). It reports them divided by those of a baseline, as `relative` does.

E is the net consumption of a timestep in kWh: what the district draws less what it feeds in. P is the same as mean
power in kW. CityLearn has E in place of P, which is the same in its timesteps of an hour.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isnan

import numpy as np

from zenostat.agent_sdk.rewards import DistrictReward
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.manifest_data import known_rewards
from zenostat.agent_sdk.time_series import price_per_kwh
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Manifest
from zenostat.topics.points import is_mean

DISTRICT_KPIS = {
    "electricity_consumption_total": ("energy drawn", "kWh"),
    "zero_net_energy": ("net energy", "kWh"),
    "cost_total": ("cost", "currency"),
    "carbon_emissions_total": ("CO2", "kg"),
    "daily_peak_average": ("mean of the daily peaks", "kW"),
    "all_time_peak_average": ("peak", "kW"),
    "ramping_average": ("increases of power", "kW"),
    "daily_one_minus_load_factor_average": ("1 - load factor of days", "1"),
    "monthly_one_minus_load_factor_average": ("1 - load factor of months", "1"),
    "self_consumption": ("share of the generation that is used", "1"),
    "limit_exceeded_h": ("time above a limit", "h"),
    "limit_excess": ("greatest ratio to a limit", "1"),
}
"""Names of the KPIs, each with a name for readers and its unit; the last three are not CityLearn's."""

_DAY_S = 86400.0
_MONTH_S = 730.0 * 3600.0
"""CityLearn's month: 730 timesteps of an hour."""


@dataclass(frozen=True, slots=True)
class DistrictPoints:
    """The points of a district from which its KPIs are computed.

    Attributes:
        consumption: meters (J) or power sensors (W) that the district draws.
        feed_in: those that it feeds in.
        price: sensor of the price of the coming timestep, or, if it is a mean over the timestep as the price of a
            market, of that timestep; None: the cost is unknown.
        limits: by point, its upper limit.
        generation: power or energy that is generated in the district; without it, self-consumption is unknown.

    Raises:
        InvalidConfig: a list of names is a text, there is no consumption, or a limit is not above 0.
    """

    consumption: Sequence[str]
    feed_in: Sequence[str] = ()
    price: str | None = None
    limits: Mapping[str, float] | None = None
    generation: Sequence[str] = ()

    def __post_init__(self) -> None:
        for name in ("consumption", "feed_in", "generation"):
            if isinstance(getattr(self, name), str):
                raise InvalidConfig(f"{name} = {getattr(self, name)!r}: a list of points expected")
        if not self.consumption:
            raise InvalidConfig("consumption: at least one point expected")
        for point, limit in (self.limits or {}).items():
            if not (isfinite(limit) and limit > 0.0):
                raise InvalidConfig(f"limits[{point!r}] = {limit!r}: a finite number above 0 expected")


def points_of(manifest: Manifest, generation: Sequence[str] = ()) -> DistrictPoints:
    """Return the points that the district's reward names.

    Args:
        manifest: of the district's node.
        generation: see `DistrictPoints`; a reward does not name it.

    Raises:
        InvalidConfig: neither the reward that is paid nor that of the file is of the kind `district`.
    """
    for reward in known_rewards(manifest):
        if isinstance(reward, DistrictReward):
            limits = {limit.point: limit.high for limit in reward.limits}
            return DistrictPoints(reward.consumption, reward.generation, reward.price, limits, generation)
    raise InvalidConfig(
        f"node {manifest.node!r} has no reward of the kind district, which names the points of its KPIs; "
        "name them as DistrictPoints(consumption=...)"
    )


def district_kpis(
    trajectory: Trajectory, points: DistrictPoints | None = None, *, emissions_kg_kwh: float | None = None
) -> dict[str, float | None]:
    """Return the KPIs of a run by the names of `DISTRICT_KPIS`; None where points, a factor or values are missing.

    Args:
        trajectory: of the district, from sample 0 on; values without injected faults count.
        points: that the KPIs are computed from; None: those of the district's reward.
        emissions_kg_kwh: CO2 per kWh that is drawn.

    Raises:
        InvalidConfig: a point does not exist, or has no such unit.
    """
    manifest, step_s = trajectory.manifest, trajectory.manifest.step_s
    points = points_of(manifest) if points is None else points
    rows = trajectory.fault_free_values[1:]
    meter = EnergyMeter("district", points.consumption, manifest)
    fed_in = EnergyMeter("district", points.feed_in, manifest).kwh(rows) if points.feed_in else np.zeros(len(rows))
    net_kwh: Floats = meter.kwh(rows) - fed_in
    kpis: dict[str, float | None] = dict.fromkeys(DISTRICT_KPIS)
    if not len(net_kwh):
        return kpis
    net_kw = net_kwh * meter.kw_per_kwh
    kpis["electricity_consumption_total"] = float(np.maximum(net_kwh, 0.0).sum())
    kpis["zero_net_energy"] = float(net_kwh.sum())
    if points.price is not None:
        column = _column(manifest, points.price)
        point, values = manifest.points[column], trajectory.fault_free_values[:, column]
        factor = price_per_kwh(f"the price {points.price!r}", point.unit)
        prices = (values[1:] if is_mean(point) else values[:-1]) * factor
        kpis["cost_total"] = float(np.maximum(net_kwh * prices, 0.0).sum())
    if emissions_kg_kwh is not None:
        kpis["carbon_emissions_total"] = float(np.maximum(net_kwh * emissions_kg_kwh, 0.0).sum())
    days, months = [*_windows(net_kw, _DAY_S, step_s)], [*_windows(net_kw, _MONTH_S, step_s)]
    kpis["daily_peak_average"] = float(np.mean([day.max() for day in days]))
    kpis["all_time_peak_average"] = float(net_kw.max())
    kpis["ramping_average"] = float(np.maximum(np.diff(net_kw), 0.0).sum())
    kpis["daily_one_minus_load_factor_average"] = _one_minus_load_factor(days)
    kpis["monthly_one_minus_load_factor_average"] = _one_minus_load_factor(months)
    if points.generation:
        generated = float(EnergyMeter("district", points.generation, manifest).kwh(rows).sum())
        kpis["self_consumption"] = 1.0 - float(fed_in.sum()) / generated if generated > 0.0 else None
    if points.limits:
        ratios = np.array([rows[:, _column(manifest, name)] / high for name, high in points.limits.items()])
        is_above = np.where(np.isnan(ratios), np.nan, ratios > 1.0)
        kpis["limit_exceeded_h"] = float(is_above.max(axis=0).sum()) * step_s / 3600.0
        kpis["limit_excess"] = float(ratios.max())
    return {name: None if value is None or isnan(value) else value for name, value in kpis.items()}


def relative(kpis: Mapping[str, float | None], baseline: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return KPIs divided by those of a baseline, as CityLearn reports them: below 1 is better for most.

    A KPI that is 0 in both is 1; one that is 0 in the baseline only is unknown, and so is one that either lacks.
    """
    ratios: dict[str, float | None] = {}
    for name, value in kpis.items():
        reference = baseline.get(name)
        if value is None or reference is None:
            ratios[name] = None
        elif reference == 0.0:
            ratios[name] = 1.0 if value == 0.0 else None
        else:
            ratios[name] = value / reference
    return ratios


def _column(manifest: Manifest, name: str) -> int:
    if name not in manifest.names:
        raise InvalidConfig(f"the district has no point {name!r}; {did_you_mean(name, manifest.names)}")
    return manifest.names.index(name)


def _windows(net_kw: Floats, window_s: float, step_s: float) -> Iterator[Floats]:
    """Yield consecutive windows from the first timestep on; the last one may be shorter."""
    length = max(round(window_s / step_s), 1)
    return (net_kw[first : first + length] for first in range(0, len(net_kw), length))


def _one_minus_load_factor(windows: Sequence[Floats]) -> float | None:
    """Return the mean of 1 - mean/peak; None if a window has no positive peak."""
    if any(window.max() <= 0.0 for window in windows):
        return None
    return float(np.mean([1.0 - window.mean() / window.max() for window in windows]))
