"""Prices and emission factors of fuels, as time series by fuel."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from zenostat.agent_sdk.time_series import (
    LEAP_HOURS,
    Constant,
    HourlyFile,
    Signal,
    TimeSeries,
    currency,
    grams_per_kwh,
    per_kwh,
)
from zenostat.metrics.energy_meters import FUELS
from zenostat.topics import yaml12
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.user_file import user_file


@dataclass(frozen=True, slots=True)
class FuelRate:
    """A price or an emission factor of a fuel.

    Attributes:
        series: the time series, in its own unit.
        factor: factor from its unit to that of the KPIs: currency or kg CO2 per kWh.
    """

    series: TimeSeries
    factor: float

    def at(self, begin: datetime) -> float:
        """Return the rate of the hour in which a timestep begins, in currency or kg CO2 per kWh."""
        return float(self.series.at(begin)) * self.factor


Rate = float | str | Path | Mapping[str, Any] | Sequence[float] | TimeSeries | FuelRate
"""A price or an emission factor: a number, a number for each hour of a year, a CSV or YAML file, or a series."""

_ALIASES = {"gas": "natural_gas", "district_heating": "district_heating_water"}
_SIGNAL: TypeAdapter[TimeSeries] = TypeAdapter(Signal)
_YEAR = [datetime(2012, 1, 1) + timedelta(hours=hour) for hour in range(LEAP_HOURS)]
"""The hours of a leap year, with all weekdays of each month."""


def read_prices(prices: Mapping[str, Rate] | None, *, scenarios: Collection[str] = ()) -> dict[str, FuelRate]:
    """Read prices by fuel; a number, a list and a CSV file are in currency per kWh.

    A price may be negative, as on power exchanges.

    Args:
        prices: by fuel, or by price scenario.
        scenarios: names of price scenarios, which `prices` may have as well.

    Raises:
        InvalidConfig: unknown fuel, not a price per energy, two currencies, not finite, or not a year of hours.
    """
    rates = _read(prices or {}, "prices", "1/kWh", per_kwh, scenarios)
    currencies = {currency(rate.series.unit): fuel for fuel, rate in rates.items()}
    currencies.pop("", None)
    if len(currencies) > 1:
        each = " and ".join(f"{fuel} in {name}" for name, fuel in currencies.items())
        raise InvalidConfig(f"prices: {each}; prices in one currency expected")
    return rates


def read_emissions(emissions: Mapping[str, Rate] | None) -> dict[str, FuelRate]:
    """Read emission factors by fuel; a number, a list and a CSV file are in kg CO2 per kWh.

    Raises:
        InvalidConfig: unknown fuel, not a mass per energy, negative or not finite, or not a year of hours.
    """
    rates = _read(emissions or {}, "emissions", "kg/kWh", lambda unit: grams_per_kwh(unit) * 1e-3)
    for fuel, rate in rates.items():
        if (lowest := float(rate.series.at(_YEAR).min())) < 0.0:
            raise InvalidConfig(f"emissions: {fuel} has the factor {lowest:g}; numbers of at least 0 expected")
    return rates


def _read(
    rates: Mapping[str, Rate], argument: str, unit: str, factor_of: Any, scenarios: Collection[str] = ()
) -> dict[str, FuelRate]:
    if not isinstance(rates, Mapping):
        raise InvalidConfig(f"{argument}: a mapping from fuels to numbers or time series expected, got {rates!r}")
    result: dict[str, FuelRate] = {}
    for name, rate in rates.items():
        fuel = _ALIASES.get(str(name), str(name))
        if fuel not in FUELS and fuel not in scenarios:
            known = [*scenarios, *FUELS, *_ALIASES]
            raise InvalidConfig(f"{argument}: no fuel {name!r}; {did_you_mean(str(name), known)}")
        if fuel in result:
            raise InvalidConfig(f"{argument}: {fuel} is given twice")
        if isinstance(rate, FuelRate):
            result[fuel] = rate
            continue
        try:
            series = _series(rate, unit)
            series.load()
            result[fuel] = FuelRate(series, factor_of(series.unit))
        except ValidationError as error:
            raise InvalidConfig(f"{argument}: {name}: {describe_validation_errors(error)}") from None
        except (InvalidConfig, ValueError) as error:
            raise InvalidConfig(f"{argument}: {name}: {error}") from None
    return result


def _series(rate: Any, unit: str) -> TimeSeries:
    """Return the time series of a rate."""
    if isinstance(rate, np.ndarray | np.generic):
        rate = rate.tolist()
    if isinstance(rate, TimeSeries):
        return rate
    if isinstance(rate, Mapping):
        return _SIGNAL.validate_python({"unit": unit, **rate})
    if isinstance(rate, str | Path):
        return _file(Path(rate).expanduser(), unit)
    if isinstance(rate, Sequence):
        return _SIGNAL.validate_python({"hourly": tuple(rate), "unit": unit})
    if isinstance(rate, bool) or not isinstance(rate, Real) or not math.isfinite(rate):
        raise InvalidConfig(f"a finite number expected, got {rate!r}")
    return Constant(value=float(rate), unit=unit)


def _file(path: Path, unit: str) -> TimeSeries:
    """Return the time series in a YAML file, or the last column of a CSV file, with or without a header line."""
    if path.suffix in (".yaml", ".yml"):
        return _yaml_file(path, unit)
    with user_file(path), path.open(encoding="utf-8-sig", newline="") as file:
        first, second = [*itertools.islice(csv.reader(file), 2), [], []][:2]
    try:
        float(first[-1]) if first else 0.0
        header_row = 0
    except ValueError:
        header_row = 1
    if not header_row and (problem := _ambiguity(first, second)):
        raise InvalidConfig(
            f"{path}: its lines have no header, and {problem}; if the comma is the decimal separator, describe the "
            f"file in YAML, as {{csv: {path.name}, column: 1, header_row: 0, delimiter: ;, decimal: ','}}"
        )
    return HourlyFile(csv=path, column=max(len(first), 1), header_row=header_row, unit=unit)


def _ambiguity(first: list[str], second: list[str]) -> str:
    """Return why a comma in the first lines of a file without a header may be a decimal one; "" if it is none."""
    if len(first) == 2 == len(second) and not _is_later(second[0], first[0]):
        return f"of their two numbers the first ones are no times ({first[0]}, {second[0]})"
    ends = [*first[-2:], *second[-2:]]
    if len(first) > 2 and all(cell.strip().lstrip("+-").isdecimal() for cell in ends):
        return f"their last two cells are whole numbers ({', '.join(first[-2:])})"
    return ""


def _is_later(time: str, before: str) -> bool:
    """Return whether a first cell can be a time after another one; only numbers are compared."""
    try:
        return float(time) > float(before)
    except ValueError:
        return True


def _yaml_file(path: Path, unit: str) -> TimeSeries:
    """Return the time series that a YAML file describes; a CSV file in it is relative to its folder."""
    spec = yaml12.read_mapping(path)
    if "csv" in spec:
        spec["csv"] = path.parent / str(spec["csv"])
    return _SIGNAL.validate_python({"unit": unit, **spec})
