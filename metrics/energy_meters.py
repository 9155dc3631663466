"""Points from which the energy of a node is measured, by fuel."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

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


@dataclass(frozen=True, slots=True)
class EnergySource:
    """A point that measures an energy.

    Attributes:
        index: index among the values of a sample.
        to_kwh: factor from its value to kWh of the timestep.
        source: the point, for readers.
        is_building: whether it measures a whole building, of which the HVAC is a part.
    """

    index: int
    to_kwh: float
    source: str
    is_building: bool = False


def facility_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of all fuels of the building that the node measures.

    They are meters; without one, the demand rate of electricity times the timestep.
    """
    meters = _meters(manifest)
    sources = {
        fuel: replace(source, is_building=True)
        for fuel, name in FUELS.items()
        if (source := meters.get(f"{name}:Facility".casefold())) is not None
    }
    own = {fuel: meters.get(name.casefold()) for fuel, name in FUELS.items()}
    sources |= {fuel: source for fuel, source in own.items() if source is not None and fuel not in sources}
    for index in _rates(manifest, FACILITY_POWER)[:1]:
        sources.setdefault("electricity", replace(_rate_source(manifest, index), is_building=True))
    return {fuel: sources[fuel] for fuel in FUELS if fuel in sources}


def hvac_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of the energy of heating, cooling and ventilation by fuel, where the node measures it.

    They are the meters `HVAC:<fuel>` (`zenostat.topics.energyplus_names.HVAC_METERS`), or a plant's own that are named
    as the metrics (`hvac_electricity`). Without one, EnergyPlus's own `<fuel>:HVAC` or demand rate serve, whose source
    tells what they leave out or have in addition. A meter of the whole building never does.
    """
    meters = _meters(manifest)
    sources: dict[str, EnergySource] = {}
    for fuel, name in FUELS.items():
        group = meters.get(f"{name}:HVAC".casefold())
        if group is not None:
            group = replace(group, source=f"{group.source}, {WITHOUT_PLANT}")
        source = meters.get(f"HVAC:{name}".casefold()) or group
        if source is not None:
            sources[fuel] = source
    for index in _rates(manifest, HVAC_POWER)[:1]:
        rate = _rate_source(manifest, index)
        sources.setdefault("electricity", replace(rate, source=f"{rate.source}, {WITH_PLANT}"))
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


def _rate_source(manifest: Manifest, index: int) -> EnergySource:
    sensor = manifest.sensors[index]
    note = ", read at its end (an approximation)" if sensor.aggregation is Aggregation.INSTANT else ""
    source = f"sensor {sensor.name}, {sensor.unit} times the timestep{note}"
    return EnergySource(index, energy_kwh(sensor.unit, manifest.step_s), source)
