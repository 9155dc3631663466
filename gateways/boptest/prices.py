"""Prices and emission factors of a test, as series of hours and as BOPTEST's forecast points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zenostat.gateways.boptest.simulation import moment
from zenostat.metrics.fuel_rates import FuelRate, Rate, read_emissions, read_prices
from zenostat.topics.arrays import Floats

ELECTRICITY_PRICES = {"constant": "Constant", "dynamic": "Dynamic", "highly_dynamic": "HighlyDynamic"}
"""The price scenarios, with the end of their points' names."""

_FUEL_POINTS = {
    "natural_gas": "GasPower",
    "district_heating_water": "DistrictHeatingPower",
    "district_heating_steam": "DistrictHeatingSteamPower",
    "district_cooling": "DistrictCoolingPower",
}
_WEEKDAYS = ("mon", "tue", "wed", "thu", "fri")

DEFAULT_ELECTRICITY: Mapping[str, Rate] = {
    "constant": 0.15,
    "dynamic": {"table": [{"value": 0.20, "hours": [7, 22], "weekdays": list(_WEEKDAYS)}], "otherwise": 0.105},
    "highly_dynamic": {
        "table": [
            {"value": 0.31, "hours": [17, 20], "weekdays": list(_WEEKDAYS)},
            {"value": 0.24, "hours": [6, 9], "weekdays": list(_WEEKDAYS)},
            {"value": 0.05, "hours": [11, 15], "months": [4, 5, 6, 7, 8, 9]},
            {"value": 0.12, "hours": [11, 15]},
            {"value": 0.08, "hours": [0, 5]},
            {"value": 0.22, "hours": [17, 20]},
        ],
        "otherwise": 0.15,
    },
}
"""Prices of electricity in currency per kWh, assumed: flat; day and night; steep ramps and cheap solar hours."""

DEFAULT_PRICES: Mapping[str, Rate] = {
    "natural_gas": 0.05, "district_heating_water": 0.08, "district_heating_steam": 0.08, "district_cooling": 0.06,
    "propane": 0.10, "fuel_oil_1": 0.10, "fuel_oil_2": 0.10, "diesel": 0.12, "gasoline": 0.12, "coal": 0.03,
    "other_fuel_1": 0.08, "other_fuel_2": 0.08,
}  # fmt: skip
"""Prices of other fuels in currency per kWh, assumed."""

DEFAULT_EMISSIONS: Mapping[str, Rate] = {
    "electricity": 0.40, "natural_gas": 0.202, "district_heating_water": 0.20, "district_heating_steam": 0.22,
    "district_cooling": 0.10, "propane": 0.227, "fuel_oil_1": 0.267, "fuel_oil_2": 0.267, "diesel": 0.267,
    "gasoline": 0.249, "coal": 0.346, "other_fuel_1": 0.30, "other_fuel_2": 0.30,
}  # fmt: skip
"""Emission factors in kg CO2 per kWh.

Fuels: IPCC 2006 Guidelines for National Greenhouse Gas Inventories, volume 2, table 1.4. Electricity and district
energy: assumed.
"""


@dataclass(frozen=True)
class Rates:
    """Prices and emission factors by fuel, and the prices of electricity by scenario."""

    electricity: Mapping[str, FuelRate]
    prices: Mapping[str, FuelRate]
    emissions: Mapping[str, FuelRate]

    @cached_property
    def points(self) -> Mapping[str, tuple[FuelRate, str, str]]:
        """Return the forecast points by name: rate, unit and description."""
        points: dict[str, tuple[FuelRate, str, str]] = {}
        for name, suffix in ELECTRICITY_PRICES.items():
            text = f"Price of electricity, {name.replace('_', ' ')}"
            points[f"PriceElectricPower{suffix}"] = (self.electricity[name], "($/Euro)/kWh", text)
        for fuel, suffix in _FUEL_POINTS.items():
            points[f"Price{suffix}"] = (self.prices[fuel], "($/Euro)/kWh", f"Price of {fuel.replace('_', ' ')}")
        for fuel, suffix in {"electricity": "ElectricPower", **_FUEL_POINTS}.items():
            text = f"Emission factor of {fuel.replace('_', ' ')}"
            points[f"Emissions{suffix}"] = (self.emissions[fuel], "kgCO2/kWh", text)
        return points

    def prices_of(self, scenario: str) -> dict[str, FuelRate]:
        """Return the prices of all fuels in a price scenario."""
        return {**self.prices, "electricity": self.electricity[scenario]}


def read_rates(prices: Mapping[str, Rate] | None = None, emissions: Mapping[str, Rate] | None = None) -> Rates:
    """Read prices and emission factors; those that are not named have the defaults.

    Args:
        prices: by fuel, or of electricity by `constant`, `dynamic` and `highly_dynamic`; `electricity` sets all three.
        emissions: by fuel.

    Raises:
        InvalidConfig: unknown name, not a price or factor, or prices in two currencies.
    """
    named = dict(prices or {})
    if "electricity" in named:
        named = {**dict.fromkeys(ELECTRICITY_PRICES, named.pop("electricity")), **named}
    defaults = read_prices({**DEFAULT_ELECTRICITY, **DEFAULT_PRICES}, scenarios=ELECTRICITY_PRICES)
    of_fuels = defaults | read_prices(named, scenarios=ELECTRICITY_PRICES)
    electricity = {scenario: of_fuels.pop(scenario) for scenario in ELECTRICITY_PRICES}
    return Rates(electricity, of_fuels, read_emissions(DEFAULT_EMISSIONS) | read_emissions(emissions))


def rate_at(rate: FuelRate, times_s: Floats) -> Floats:
    """Return a rate at some times, that of the hour which contains each."""
    hours, inverse = np.unique(times_s // 3600.0, return_inverse=True)
    values = np.array([rate.at(moment(float(hour) * 3600.0)) for hour in hours])
    series: Floats = values[inverse]
    return series
