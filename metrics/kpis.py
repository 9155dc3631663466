"""Key performance indicators as BOPTEST defines them: comfort, energy, cost, emissions and peaks.

D. Blum et al., Building optimization testing framework (BOPTEST) for simulation-based benchmarking of control
strategies in buildings, Journal of Building Performance Simulation 14(5), 2021. EnergyPlus gives the energy of each
timestep, so energies are exact sums; temperatures are states at its end, so their integrals are trapezoids.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from math import ceil, floor

import numpy as np

from zenostat.metrics.comfort import Comfort
from zenostat.metrics.energy_meters import FUELS, EnergySource, facility_sources, hvac_sources
from zenostat.metrics.fuel_rates import FuelRate
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Aggregation, Manifest

KPIS = {
    "tdis_tot": ("thermal discomfort", "K h/zone"),
    "idis_tot": ("indoor air quality discomfort", "ppm h/zone"),
    "ener_tot": ("HVAC energy", "kWh/m²"),
    "cost_tot": ("cost of HVAC energy", "currency/m²"),
    "emis_tot": ("CO2 of HVAC energy", "kg/m²"),
    "pele_tot": ("HVAC electricity peak", "kW/m²"),
    "pgas_tot": ("HVAC gas peak", "kW/m²"),
    "pdih_tot": ("HVAC district heating peak", "kW/m²"),
}
"""BOPTEST's names of the KPIs, each with a name for readers and its unit."""

CO2_LIMIT_PPM = 1200.0
"""Limit of `idis_tot`: 800 ppm above outdoor air (EN 16798-1, category II) with 400 ppm."""

_CO2 = "zone air co2 concentration"
_PEAKS = {
    "pele_tot": ("electricity",),
    "pgas_tot": ("natural_gas",),
    "pdih_tot": ("district_heating_water", "district_heating_steam"),
}
_RATES = {"cost_tot": "price", "emis_tot": "emission factor"}
_BIN_S = 900.0
_EPOCH = datetime(1970, 1, 1)


class PeakPower:
    """Highest mean power in bins of 15 minutes by the clock, for several powers at a time.

    The power of a timestep counts as constant, so bins are exact for timesteps of any length. The bins in which the
    measurement begins and ends count with their mean so far.
    """

    def __init__(self, count: int) -> None:
        self._peaks: Floats = np.full(count, -np.inf)
        self._kwh, self._covered_s = np.zeros(count), 0.0

    def add(self, begin_s: float, end_s: float, kw: Floats) -> None:
        """Add a timestep that follows the previous one; its duration does not matter to the time this takes.

        Args:
            begin_s: its beginning, in seconds since a midnight.
            end_s: its end.
            kw: mean powers in it, shape (powers,).
        """
        full_bins_begin_s = ceil(begin_s / _BIN_S) * _BIN_S
        full_bins_end_s = floor(end_s / _BIN_S) * _BIN_S
        if full_bins_begin_s > end_s:
            self._fill(end_s - begin_s, kw)
            return
        self._fill(full_bins_begin_s - begin_s, kw)
        self._close()
        if full_bins_end_s > full_bins_begin_s:
            self._peaks = np.maximum(self._peaks, kw)
        self._fill(end_s - full_bins_end_s, kw)

    def _fill(self, duration_s: float, kw: Floats) -> None:
        self._kwh += kw * (duration_s / 3600.0)
        self._covered_s += duration_s

    def _close(self) -> None:
        """End the bin, and begin the next one."""
        self._peaks = self.result()
        self._kwh, self._covered_s = np.zeros_like(self._kwh), 0.0

    def result(self) -> Floats:
        """Return the peaks in kW so far, shape (powers,)."""
        if not self._covered_s:
            return self._peaks
        return np.maximum(self._peaks, self._kwh / (self._covered_s / 3600.0))


class KpiAccumulator:
    """Accumulate the KPIs of an episode; each sample takes the same time.

    Args:
        manifest: manifest of the node.
        comfort: bands of the zones that count; None: thermal discomfort is unknown.
        prices, emissions: rates by fuel, in currency and kg CO2 per kWh.

    Attributes:
        sources: by KPI, the points that it is derived from.
    """

    def __init__(
        self,
        manifest: Manifest,
        comfort: Comfort | None,
        prices: Mapping[str, FuelRate] | None = None,
        emissions: Mapping[str, FuelRate] | None = None,
    ) -> None:
        self._area_m2, self._step_s = manifest.floor_area_m2, manifest.step_s
        self._comfort = comfort
        self._energies = _energies(manifest)
        fuels = list(self._energies)
        self._columns = np.array([energy.index for energy in self._energies.values()], np.intp)
        self._to_kwh = np.array([energy.to_kwh for energy in self._energies.values()])
        self._is_building = np.array([energy.is_building for energy in self._energies.values()], bool)
        self._rates = {
            kpi: [(rates or {}).get(fuel) for fuel in fuels]
            for kpi, rates in (("cost_tot", prices), ("emis_tot", emissions))
        }
        self._is_wanted = {"cost_tot": bool(prices), "emis_tot": bool(emissions)}
        self._groups = {
            kpi: np.array([fuel in group for fuel in fuels])
            for kpi, group in _PEAKS.items()
            if any(fuel in group for fuel in fuels)
        }
        self._co2 = np.array([i for i, s in enumerate(manifest.sensors) if s.variable.casefold() == _CO2], np.intp)
        zones = () if comfort is None else comfort.zones.tolist()
        self._air_weights = _end_weights(zones, manifest)
        self._co2_weights = _end_weights(self._co2.tolist(), manifest)
        self.sources = self._describe()
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._previous: Floats | None = None
        self._outside_kh = self._excess_ppmh = 0.0
        self._kwh = np.zeros(len(self._energies))
        self._totals = dict.fromkeys(self._rates, 0.0)
        self._is_unrated = dict.fromkeys(self._rates, False)
        self._peaks = PeakPower(len(self._groups))

    def begin(self, values: Floats) -> None:
        """Start from a sample; the timestep that it closes does not count."""
        self.reset()
        self._previous = values

    def add(self, values: Floats, begin: datetime) -> None:
        """Add the timestep from `begin` to the sample with these values."""
        previous = values if self._previous is None else self._previous
        step_h = self._step_s / 3600.0
        if self._comfort is not None:
            at_begin, at_end = (self._comfort.outside(values, begin, row) for row in (previous, values))
            self._outside_kh += step_h * float(at_begin @ (1.0 - self._air_weights) + at_end @ self._air_weights)
        if len(self._co2):
            at_begin, at_end = (np.maximum(row[self._co2] - CO2_LIMIT_PPM, 0.0) for row in (previous, values))
            self._excess_ppmh += step_h * float(at_begin @ (1.0 - self._co2_weights) + at_end @ self._co2_weights)
        kwh = self._to_kwh * values[self._columns]
        self._kwh += kwh
        self._rate(kwh, begin)
        if self._groups:
            kw = np.array([kwh[group].sum() for group in self._groups.values()]) / step_h
            begin_s = (begin - _EPOCH).total_seconds()
            self._peaks.add(begin_s, begin_s + self._step_s, kw)
        self._previous = values

    def _rate(self, kwh: Floats, begin: datetime) -> None:
        """Add cost and emissions; fuels in use without a rate make them unknown."""
        for kpi, rates in self._rates.items():
            if self._is_wanted[kpi]:
                for amount, rate in zip(kwh.tolist(), rates, strict=True):
                    if rate is not None:
                        self._totals[kpi] += amount * rate.at(begin)
                    elif amount:
                        self._is_unrated[kpi] = True

    def result(self) -> dict[str, float | None]:
        """Return the KPIs by the names of `KPIS`; None where the node lacks the points, its floor area or a rate.

        A fuel of which only the whole building is measured makes energy, cost, emissions and its own peak unknown, if
        the building uses any of it.
        """
        kpis: dict[str, float | None] = dict.fromkeys(KPIS)
        if self._comfort is not None:
            kpis["tdis_tot"] = self._outside_kh / len(self._comfort.zones)
        kpis["idis_tot"] = self._excess_ppmh / max(len(self._co2), 1)
        if self._area_m2 is None or not self._energies:
            return kpis
        is_unknown = self._is_building & (self._kwh != 0.0)
        if not is_unknown.any():
            kpis["ener_tot"] = float(self._kwh.sum()) / self._area_m2
            for kpi, total in self._totals.items():
                if self._is_wanted[kpi] and not self._is_unrated[kpi]:
                    kpis[kpi] = total / self._area_m2
        for (kpi, group), peak in zip(self._groups.items(), self._peaks.result().tolist(), strict=True):
            kpis[kpi] = None if is_unknown[group].any() else peak / self._area_m2
        return kpis

    def _describe(self) -> dict[str, str]:
        sources = {}
        if self._comfort is not None:
            sources["tdis_tot"] = self._comfort.source
        if self._area_m2 is not None and self._energies:
            energies = [energy.source for energy in self._energies.values() if not energy.is_building]
            whole = ", ".join(fuel for fuel, energy in self._energies.items() if energy.is_building)
            if whole:
                energies.append(
                    f"unknown if {whole} is used, of which the HVAC's part is not measured (monitoring does)"
                )
            floor_area = f"{'; '.join(energies)}; per m² of {self._area_m2:,.0f} m² floor area"
            names = ["ener_tot", *(kpi for kpi, wanted in self._is_wanted.items() if wanted), *self._groups]
            sources |= dict.fromkeys(names, floor_area)
            for kpi, rates in self._rates.items():
                missing = [fuel for fuel, rate in zip(self._energies, rates, strict=True) if rate is None]
                if self._is_wanted[kpi] and missing:
                    names_of_fuels = ", ".join(missing)
                    sources[kpi] += f"; unknown if {names_of_fuels} is used, for which no {_RATES[kpi]} was given"
        return sources


def _energies(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the source of the HVAC's energy of each fuel, else that of the whole building or plant."""
    hvac, facility = hvac_sources(manifest), facility_sources(manifest)
    return {fuel: hvac.get(fuel) or facility[fuel] for fuel in FUELS if fuel in hvac or fuel in facility}


def _end_weights(sensors: list[int] | tuple[int, ...], manifest: Manifest) -> Floats:
    """Return the weights of the values at the end of a timestep: 1/2 for states, 1 for means over the timestep."""
    means = [manifest.sensors[index].aggregation is not Aggregation.INSTANT for index in sensors]
    return np.where(means, 1.0, 0.5)
