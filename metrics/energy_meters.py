"""Points from which the energy of a node is measured, by fuel."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from zenostat.metrics.labels import words
from zenostat.topics.energyplus_names import END_USES, FACILITY_POWER, GENERATION_METERS, HVAC_POWER
from zenostat.topics.messages import Aggregation, Manifest, Meter
from zenostat.topics.units import energy_kwh, quantity

FUELS = {
    "electricity": "Electricity", "natural_gas": "NaturalGas", "district_cooling": "DistrictCooling",
    "district_heating_water": "DistrictHeatingWater", "district_heating_steam": "DistrictHeatingSteam",
    "propane": "Propane", "fuel_oil_1": "FuelOilNo1", "fuel_oil_2": "FuelOilNo2", "diesel": "Diesel",
    "gasoline": "Gasoline", "coal": "Coal", "other_fuel_1": "OtherFuel1", "other_fuel_2": "OtherFuel2",
}  # fmt: skip
"""Energy carriers, with their names in EnergyPlus's meters."""

GENERATION = dict(
    zip(("electricity_produced", "electricity_purchased", "electricity_sold"), GENERATION_METERS, strict=False)
)
"""Electricity that a building with generators produces, buys and sells, with EnergyPlus's names of the meters."""

_METERS = {
    plain: meter
    for fuel, name in FUELS.items()
    for meter in (f"{name}:Facility", *(f"{use}:{name}" for use in ("HVAC", *END_USES)))
    for text in (meter, meter.replace(name, fuel))
    for plain in (
        text.replace(":", "_").casefold(),
        re.sub(r"(?<=[a-z])(?=[A-Z0-9])", "_", text.replace(":", "_")).lower(),
    )
} | FUELS | {
    plain: meter
    for name, meter in GENERATION.items()
    for plain in (name, f"{name}_facility", meter.replace(":", "_").casefold())
}  # fmt: skip
"""EnergyPlus's meters by the names that their points have by default, and its fuels by those of `FUELS`."""

WITHOUT_PLANT = "without chillers, boilers, cooling towers and their pumps"
WITH_PLANT = "with electric water heaters and other plant equipment"
"""What distinguishes EnergyPlus's own quantities from the end uses of the HVAC."""

_HVAC_POWERS = ("hvac_electricity", "electricity_hvac")
"""Names of a plant's own power sensors of its HVAC, before `_power`."""

_ELECTRIC_WORDS = {"electric", "electrical", "electricity", "power"}
_NOT_ELECTRIC_WORDS = {"cooling", "gain", "heating", "pv", "solar", "thermal"}
"""Words of powers that are not electric, unless the name says so, or that are generated."""


@dataclass(frozen=True, slots=True)
class EnergySource:
    """A point that measures an energy.

    Attributes:
        index: index among the values of a sample.
        to_kwh: factor from its value to kWh of the timestep.
        source: the point, for readers.
        label: what it measures, in pictures.
        is_building: whether it measures a whole building, of which the HVAC is a part.
    """

    index: int
    to_kwh: float
    source: str
    label: str = "Whole building"
    is_building: bool = False


def facility_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of all fuels of the building that the node measures.

    They are meters; without one, the demand rate of electricity times the timestep, or a plant's own power sensor: one
    that is named as the metric (`electricity`, `electricity_power`), else its only one, if its name says electric.
    """
    meters = _meters(manifest)
    sources = {
        fuel: replace(source, is_building=True)
        for fuel, name in FUELS.items()
        if (source := meters.get(f"{name}:Facility".casefold())) is not None
    }
    own = {fuel: meters.get(name.casefold()) for fuel, name in FUELS.items()}
    sources |= {fuel: source for fuel, source in own.items() if source is not None and fuel not in sources}
    if "electricity" not in sources:
        if rates := _rates(manifest, FACILITY_POWER) or _own_powers(manifest, ("electricity_facility",)):
            sources["electricity"] = replace(_rate_source(manifest, rates[0]), is_building=True)
        elif rates := _own_powers(manifest, ("electricity",)) or _only_power(manifest):
            sources["electricity"] = _rate_source(manifest, rates[0])
    return {fuel: sources[fuel] for fuel in FUELS if fuel in sources}


def hvac_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of the energy of heating, cooling and ventilation by fuel, where the node measures it.

    They are the meters `HVAC:<fuel>` (`zenostat.topics.energyplus_names.HVAC_METERS`), or a plant's own that are named
    as the metrics (`hvac_electricity`, or `electricity_hvac`). Without one, EnergyPlus's own `<fuel>:HVAC` or demand
    rate serve, whose source tells what they leave out or have in addition; last, a plant's own power sensor
    `hvac_electricity_power`. A meter of the whole building never does.
    """
    meters = _meters(manifest)
    sources: dict[str, EnergySource] = {}
    for fuel, name in FUELS.items():
        group = meters.get(f"{name}:HVAC".casefold())
        if group is not None:
            group = replace(group, source=f"{group.source}, {WITHOUT_PLANT}", label="HVAC without plant")
        if source := meters.get(f"HVAC:{name}".casefold()) or meters.get(f"{fuel}_hvac"):
            sources[fuel] = replace(source, label="HVAC")
        elif group is not None:
            sources[fuel] = group
    if "electricity" not in sources:
        if rates := _rates(manifest, HVAC_POWER):
            rate = _rate_source(manifest, rates[0])
            sources["electricity"] = replace(rate, source=f"{rate.source}, {WITH_PLANT}", label="HVAC and plant")
        elif rates := _own_powers(manifest, _HVAC_POWERS):
            sources["electricity"] = replace(_rate_source(manifest, rates[0]), label="HVAC")
    return {fuel: sources[fuel] for fuel in FUELS if fuel in sources}


def generation_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of what a building with generators produces, buys and sells, where the node measures it."""
    meters = _meters(manifest)
    sources = {name: meters.get(meter.casefold()) for name, meter in GENERATION.items()}
    return {name: source for name, source in sources.items() if source is not None}


def meter_name(meter: Meter) -> str:
    """Return EnergyPlus's name of a meter, case-folded; of a plant's own of a whole fuel, that of the fuel.

    The meters of a building in a district, and of a plant of one's own, only have the names of their points:
    `natural_gas_facility` is `naturalgas:facility`, `hvac_electricity` is `hvac:electricity`, and `natural_gas` is
    `naturalgas`.
    """
    name = meter.meter or meter.name
    return (name if meter.meter else _METERS.get(name.casefold(), name)).casefold()


def _meters(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the meters of energy by `meter_name`."""
    sources: dict[str, EnergySource] = {}
    for index, meter in enumerate(manifest.meters, len(manifest.sensors)):
        if quantity(meter.unit) == "energy":
            source = EnergySource(index, energy_kwh(meter.unit, manifest.step_s), f"meter {meter.meter or meter.name}")
            sources.setdefault(meter_name(meter), source)
    return sources


def _rates(manifest: Manifest, variable: str) -> list[int]:
    """Return the sensors of a demand rate, means over the timestep first."""
    rates = [
        index
        for index, sensor in enumerate(manifest.sensors)
        if sensor.variable.casefold() == variable.casefold() and quantity(sensor.unit) == "power"
    ]
    return sorted(rates, key=lambda index: manifest.sensors[index].aggregation is Aggregation.INSTANT)


def _own_powers(manifest: Manifest, names: Sequence[str] | None = None) -> list[int]:
    """Return the power sensors of a plant without EnergyPlus's variables: of these names, in order, or all of them."""
    powers = {
        index: sensor.name.casefold().removesuffix("_power")
        for index, sensor in enumerate(manifest.sensors)
        if quantity(sensor.unit) == "power" and not sensor.variable
    }
    if names is None:
        return list(powers)
    return [index for name in names for index, own in powers.items() if own == name]


def _only_power(manifest: Manifest) -> list[int]:
    """Return the only power sensor of a plant without meters of energy, besides that of its HVAC, if it is electric."""
    if any(quantity(meter.unit) == "energy" for meter in manifest.meters):
        return []
    hvac = _own_powers(manifest, _HVAC_POWERS)[:1]
    powers = [index for index in _own_powers(manifest) if index not in hvac]
    return powers if len(powers) == 1 and _is_electric(manifest.sensors[powers[0]].name) else []


def _is_electric(name: str) -> bool:
    electric = _ELECTRIC_WORDS.intersection(words(name))
    return bool(electric) and (electric != {"power"} or not _NOT_ELECTRIC_WORDS.intersection(words(name)))


def _rate_source(manifest: Manifest, index: int) -> EnergySource:
    sensor = manifest.sensors[index]
    note = ", read at its end (an approximation)" if sensor.aggregation is Aggregation.INSTANT else ""
    source = f"sensor {sensor.name}, {sensor.unit} times the timestep{note}"
    return EnergySource(index, energy_kwh(sensor.unit, manifest.step_s), source)
