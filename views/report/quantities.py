"""Time series that a report shows, derived from the trajectory of an episode.

Energy and comfort come from the same points as the metrics of `zenostat.metrics.episode_metrics`, so that the
figures of a report add up to its totals.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.comfort import deviations
from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.metrics.reward_comfort import comfort, display_comfort
from zenostat.metrics.roles import EndUse, PointRoles, PowerSource, roles
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.arrays import Floats

Times = NDArray[Any]
"""Arrays of `datetime64`: days, months or seconds."""
HOUR_S = 3600.0


@dataclass(frozen=True, slots=True)
class EndUseEnergy:
    """Energy of one end use in each timestep, kWh, shape (steps,)."""

    label: str
    fuel: str
    kwh: Floats


@dataclass(frozen=True, slots=True)
class ZoneComfort:
    """Comfort of all zones with a band; arrays of shape (steps, zones).

    Attributes:
        labels: the zones' names.
        temperature: air temperature at the end of each timestep, degC.
        low, high: comfort band, degC.
        occupied: whether the zone was occupied; True where occupants are not measured.
        source: what the band is, for a caption.
        has_occupants: whether occupants are measured in any of the zones.
        is_rated: whether the band is that of a reward, so that the metrics measure it too.
    """

    labels: tuple[str, ...]
    temperature: Floats
    low: Floats
    high: Floats
    occupied: NDArray[np.bool_]
    source: str
    has_occupants: bool
    is_rated: bool

    @property
    def deviation(self) -> Floats:
        """Kelvin above (positive) or below (negative) the band; 0 within it, NaN where the temperature is unknown."""
        return deviations(self.temperature, self.low, self.high)


class Quantities:
    """Quantities of one recorded episode.

    Args:
        trajectory: samples of the episode.
        reward: reward with the comfort band; None: that of the scenario.
        weather: weather of the episode, if known.
    """

    def __init__(self, trajectory: Trajectory, reward: Any = None, weather: EpisodeWeather | None = None) -> None:
        self.trajectory, self._reward, self._weather = trajectory, reward, weather
        self.roles: PointRoles = roles(trajectory.manifest)

    @property
    def step_h(self) -> float:
        """Length of a timestep in hours."""
        return self.trajectory.step_h

    @cached_property
    def begins(self) -> Times:
        """Time at which each timestep begins, in seconds, shape (steps,)."""
        offsets = np.rint(np.arange(self.trajectory.steps) * self.trajectory.manifest.step_s).astype("timedelta64[s]")
        begins: Times = np.datetime64(self.trajectory.begin, "s") + offsets
        return begins

    @cached_property
    def energy_kwh(self) -> dict[str, Floats]:
        """Energy in each timestep by fuel, and of the HVAC as `hvac_electricity`, kWh, each of shape (steps,)."""
        values, points = self.trajectory.fault_free_values[1:], self.roles
        sources: dict[str, PowerSource | EndUse | None] = {
            "electricity": points.facility_power,
            "hvac_electricity": points.hvac_power,
        }
        sources |= {meter.fuel: meter for meter in points.other_fuels}
        sources |= {f"hvac_{meter.fuel}": meter for meter in points.hvac_fuels}
        return {
            name: values[:, source.index] * source.to_kw * self.step_h
            for name, source in sources.items()
            if source is not None
        }

    @cached_property
    def power_kw(self) -> Floats | None:
        """Electric power of the facility, else of the HVAC, mean of each timestep; None if it is not measured."""
        for name in ("electricity", "hvac_electricity"):
            if name in self.energy_kwh:
                return self.energy_kwh[name] / self.step_h
        return None

    @property
    def peak_time(self) -> datetime | None:
        """Time at which the timestep with the highest `power_kw` ends, the first one of several; None without power."""
        power = self.power_kw
        if power is None or not np.isfinite(power).any():
            return None
        return self.trajectory.begin + (int(np.nanargmax(power)) + 1) * self.trajectory.manifest.timestep

    @property
    def power_label(self) -> str:
        """Name of `power_kw`."""
        return "Electricity" if "electricity" in self.energy_kwh else "HVAC electricity"

    @cached_property
    def end_uses(self) -> tuple[EndUseEnergy, ...]:
        """End uses with any energy in the episode."""
        uses = []
        for use in self.roles.end_uses:
            kwh = self.trajectory.fault_free_values[1:, use.index] * use.to_kw * self.step_h
            if np.nansum(np.abs(kwh)) > 0.0:
                uses.append(EndUseEnergy(use.label, use.fuel, kwh))
        return tuple(uses)

    @cached_property
    def comfort(self) -> ZoneComfort | None:
        """Comfort of the zones that the reward rates, else of all; None without zone temperatures."""
        manifest = self.trajectory.manifest
        band = comfort(manifest, self._reward)
        is_rated = band is not None
        band = band or display_comfort(manifest, self._reward)
        if band is None:
            return None
        values = self.trajectory.fault_free_values[1:]
        labels = {zone.temperature: zone.label for zone in self.roles.zones}
        names = self.trajectory.manifest.names
        low, high = band.limits_of_samples(values, self.trajectory.begins())
        return ZoneComfort(
            tuple(labels.get(int(zone), names[int(zone)]) for zone in band.zones),
            values[:, band.zones], low, high, band.is_occupied(values), band.source,
            any(index is not None for index in band.people), is_rated,
        )  # fmt: skip

    @cached_property
    def degree_hours(self) -> tuple[Floats, Floats] | None:
        """Degree-hours above and below the band while occupied, each of shape (zones,)."""
        if self.comfort is None:
            return None
        deviation = np.where(self.comfort.occupied, np.nan_to_num(self.comfort.deviation), 0.0) * self.step_h
        return np.maximum(deviation, 0.0).sum(axis=0), np.maximum(-deviation, 0.0).sum(axis=0)

    @cached_property
    def weather(self) -> EpisodeWeather | None:
        """Weather of the episode; without a weather file, the outdoor temperature that a sensor measures."""
        index = self.roles.outdoor_temperature
        if self._weather is not None or index is None:
            return self._weather
        temperature = self.trajectory.fault_free_values[1:, index]
        return EpisodeWeather(self.trajectory.manifest.step_s, temperature, np.full(len(temperature), np.nan))


def by_hour(values: Floats, begins: Times, step_s: float) -> tuple[Times, Floats]:
    """Return the days and the mean of each hour, shape (days, 24); NaN where there is no value.

    A timestep counts for each hour that it covers, by its part of the hour.
    """
    first = begins[0].astype("datetime64[D]")
    start = (begins - first.astype("datetime64[s]")) / np.timedelta64(1, "s")
    end = start + step_s
    size = int(np.ceil(np.round(end[-1]) / HOUR_S / 24.0)) * 24
    hours, known = (start // HOUR_S).astype(int), np.isfinite(values)
    sums, weights = np.zeros(size), np.zeros(size)
    for hour in (hours + offset for offset in range(int(np.ceil(step_s / HOUR_S)) + 1)):
        covered = np.minimum(end, (hour + 1) * HOUR_S) - np.maximum(start, hour * HOUR_S)
        part = known & (covered > 0.0) & (hour < size)
        weights += np.bincount(hour[part], weights=covered[part], minlength=size)
        sums += np.bincount(hour[part], weights=covered[part] * values[part], minlength=size)
    means = np.divide(sums, weights, out=np.full(size, np.nan), where=weights > 0.0)
    return first + np.arange(size // 24), means.reshape(-1, 24)


def by_period(values: Floats, begins: Times) -> tuple[Times, Floats]:
    """Return the sum of each month if there are several, else of each day, with the periods' first days."""
    unit = "datetime64[M]" if begins[0].astype("datetime64[M]") != begins[-1].astype("datetime64[M]") else ""
    unit = unit if unit and len(np.unique(begins.astype("datetime64[D]"))) > 45 else "datetime64[D]"
    periods = begins.astype(unit)
    places = (periods - periods[0]).astype(int)
    sums = np.bincount(places, weights=np.nan_to_num(values), minlength=int(places[-1]) + 1)
    every: Times = np.arange(periods[0], periods[-1] + 1)
    return every, sums.astype(np.float64)


def load_duration(power: Floats) -> tuple[Floats, Floats]:
    """Return the share of the time in percent and the power exceeded in it, both of shape (steps + 1,), falling."""
    falling = np.sort(power[np.isfinite(power)])[::-1]
    share = np.linspace(0.0, 100.0, len(falling) + 1)
    return share, np.append(falling, falling[-1:])
