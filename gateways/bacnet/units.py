"""BACnet engineering units of the units on the bus.

Names are those of the enumeration BACnetEngineeringUnits (ASHRAE 135, clause 21), as bacpypes3 spells them. A unit that
has no entry there, such as `ach` or `clo`, is `noUnits`; the object's description then names it.
"""

from __future__ import annotations

from typing import NamedTuple

NO_UNITS = "noUnits"


class BacnetUnit(NamedTuple):
    """A BACnet unit and the default COV increment of quantities in it; 0: report each change."""

    name: str
    increment: float = 0.0


_UNITS = {
    "1": BacnetUnit(NO_UNITS),
    "A": BacnetUnit("amperes"),
    "Hz": BacnetUnit("hertz"),
    "J": BacnetUnit("joules"),
    "J/kg": BacnetUnit("joulesPerKilogramDryAir"),
    "J/kg-K": BacnetUnit("joulesPerKilogramDegreeKelvin"),
    "J/m3": BacnetUnit("joulesPerCubicMeter"),
    "K": BacnetUnit("degreesKelvin", 0.1),
    "L": BacnetUnit("liters"),
    "L/min": BacnetUnit("litersPerMinute"),
    "L/s": BacnetUnit("litersPerSecond"),
    "MJ": BacnetUnit("megajoules"),
    "MVA": BacnetUnit("megavoltAmperes"),
    "MW": BacnetUnit("megawatts"),
    "MWh": BacnetUnit("megawattHours"),
    "Mvar": BacnetUnit("megavoltAmperesReactive"),
    "N-m": BacnetUnit("newtonMeters"),
    "Pa": BacnetUnit("pascals"),
    "V": BacnetUnit("volts"),
    "VA": BacnetUnit("voltAmperes"),
    "W": BacnetUnit("watts", 1.0),
    "W/m2": BacnetUnit("wattsPerSquareMeter", 0.1),
    "W/m2-K": BacnetUnit("wattsPerSquareMeterDegreeKelvin"),
    "W/m-K": BacnetUnit("wattsPerMeterPerDegreeKelvin"),
    "Wh": BacnetUnit("wattHours"),
    "bar": BacnetUnit("bars"),
    "cd/m2": BacnetUnit("candelasPerSquareMeter"),
    "day": BacnetUnit("days"),
    "deg": BacnetUnit("degreesAngular"),
    "degC": BacnetUnit("degreesCelsius", 0.1),
    "degF": BacnetUnit("degreesFahrenheit", 0.2),
    "delta_degC": BacnetUnit("deltaDegreesKelvin", 0.1),
    "h": BacnetUnit("hours"),
    "hr": BacnetUnit("hours"),
    "kBtu": BacnetUnit("kiloBtus"),
    "kJ": BacnetUnit("kilojoules"),
    "kPa": BacnetUnit("kilopascals"),
    "kV": BacnetUnit("kilovolts"),
    "kVA": BacnetUnit("kilovoltAmperes"),
    "kW": BacnetUnit("kilowatts", 0.001),
    "kWh": BacnetUnit("kilowattHours"),
    "kg": BacnetUnit("kilograms"),
    "kg/h": BacnetUnit("kilogramsPerHour"),
    "kg/m3": BacnetUnit("kilogramsPerCubicMeter"),
    "kg/s": BacnetUnit("kilogramsPerSecond"),
    "kgWater/kgDryAir": BacnetUnit("kilogramsPerKilogram"),
    "kgWater/s": BacnetUnit("kilogramsPerSecond"),
    "kvar": BacnetUnit("kilovoltAmperesReactive"),
    "lum": BacnetUnit("lumens"),
    "lux": BacnetUnit("luxes", 1.0),
    "m": BacnetUnit("meters"),
    "m/s": BacnetUnit("metersPerSecond", 0.01),
    "m2": BacnetUnit("squareMeters"),
    "m3": BacnetUnit("cubicMeters"),
    "m3/h": BacnetUnit("cubicMetersPerHour"),
    "m3/s": BacnetUnit("cubicMetersPerSecond"),
    "min": BacnetUnit("minutes"),
    "percent": BacnetUnit("percent", 0.1),
    "ppm": BacnetUnit("partsPerMillion", 1.0),
    "rad": BacnetUnit("radians"),
    "rad/s": BacnetUnit("radiansPerSecond"),
    "rev/min": BacnetUnit("revolutionsPerMinute"),
    "s": BacnetUnit("seconds"),
    "therm": BacnetUnit("therms"),
    "var": BacnetUnit("voltAmperesReactive"),
}


def bacnet_unit(unit: str) -> BacnetUnit:
    """Return the BACnet unit of a unit on the bus."""
    return _UNITS.get(unit, BacnetUnit(NO_UNITS))
