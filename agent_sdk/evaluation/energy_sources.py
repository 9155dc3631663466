"""Points from which the energy of a node is measured, by fuel."""

from __future__ import annotations

from dataclasses import dataclass

from topics.energyplus_names import END_USES, FACILITY_POWER, HVAC_END_USES, HVAC_POWER
from topics.messages import Aggregation, Manifest

J_PER_KWH = 3.6e6
FUELS = {
    "electricity": "Electricity", "natural_gas": "NaturalGas", "district_cooling": "DistrictCooling",
    "district_heating_water": "DistrictHeatingWater", "district_heating_steam": "DistrictHeatingSteam",
    "propane": "Propane", "fuel_oil_1": "FuelOilNo1", "fuel_oil_2": "FuelOilNo2", "diesel": "Diesel",
    "gasoline": "Gasoline", "coal": "Coal", "other_fuel_1": "OtherFuel1", "other_fuel_2": "OtherFuel2",
}  # fmt: skip
"""Energy carriers, with their names in EnergyPlus's meters."""

HVAC = "hvac_electricity"
"""Electricity of the HVAC, beside the fuels of the whole building."""


@dataclass(frozen=True, slots=True)
class EnergySource:
    """Points that add up to an energy.

    Attributes:
        indices: indices among the values of a sample.
        to_kwh: factor from their sum to kWh of the timestep.
        source: the points, for readers.
    """

    indices: tuple[int, ...]
    to_kwh: float
    source: str


def facility_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of all fuels of the building, and of `HVAC`, that the node measures.

    They are meters; without one, the demand rate of electricity times the timestep.
    """
    meter_names = {fuel: f"{name}:Facility" for fuel, name in FUELS.items()} | {HVAC: "Electricity:HVAC"}
    by_name = {name.casefold(): key for key, name in meter_names.items()} | {key: key for key in meter_names}
    sources: dict[str, EnergySource] = {}
    for index, meter in enumerate(manifest.meters, len(manifest.sensors)):
        key = by_name.get((meter.meter or meter.name).casefold())
        if key is not None and meter.unit == "J":
            sources[key] = EnergySource((index,), 1.0 / J_PER_KWH, f"meter {meter.meter or meter.name}")
    for key, variable in (("electricity", FACILITY_POWER), (HVAC, HVAC_POWER)):
        sensors = [_rate_source(manifest, index) for index in _rates(manifest, variable)]
        if sensors:
            sources.setdefault(key, sensors[0])
    return {key: sources[key] for key in meter_names if key in sources}


def hvac_sources(manifest: Manifest) -> dict[str, EnergySource]:
    """Return the sources of the energy of heating, cooling and ventilation by fuel.

    A fuel with meters of end uses (`Heating:NaturalGas`) has those of `HVAC_END_USES`; they may be none. Without any,
    electricity is the HVAC's mean demand rate times the timestep, and else the energy of the whole building.
    """
    facility = facility_sources(manifest)
    meters = {
        meter.meter.casefold(): index
        for index, meter in enumerate(manifest.meters, len(manifest.sensors))
        if meter.unit == "J"
    }
    sources: dict[str, EnergySource] = {}
    for fuel, name in FUELS.items():
        if any(f"{use}:{name}".casefold() in meters for use in END_USES):
            uses = [f"{use}:{name}" for use in HVAC_END_USES if f"{use}:{name}".casefold() in meters]
            indices = tuple(meters[use.casefold()] for use in uses)
            sources[fuel] = EnergySource(indices, 1.0 / J_PER_KWH, f"meters {', '.join(uses)}" if uses else "")
        elif fuel == "electricity" and (rates := _rates(manifest, HVAC_POWER, Aggregation.MEAN)):
            sources[fuel] = _rate_source(manifest, rates[0])
        elif fuel in facility:
            sources[fuel] = facility[fuel]
    if "electricity" not in sources and HVAC in facility:
        sources = {"electricity": facility[HVAC], **sources}
    return sources


def _rates(manifest: Manifest, variable: str, aggregation: Aggregation | None = None) -> list[int]:
    """Return the sensors of a demand rate in W, with this aggregation or with any."""
    return [
        index
        for index, sensor in enumerate(manifest.sensors)
        if sensor.variable.casefold() == variable.casefold()
        and sensor.unit == "W"
        and aggregation in (None, sensor.aggregation)
    ]


def _rate_source(manifest: Manifest, index: int) -> EnergySource:
    sensor = manifest.sensors[index]
    note = ", read at its end (an approximation)" if sensor.aggregation is Aggregation.INSTANT else ""
    source = f"sensor {sensor.name}, W times the timestep{note}"
    return EnergySource((index,), 1e-3 / (3600.0 / manifest.step_s), source)
