"""Moist air and the sky: relative humidity, dew point and infrared radiation.

These closed formulas take whole arrays, and dew point and humidity are exact inverses of each other. Packages such as
PsychroLib take single numbers and solve for the dew point iteratively.
"""

from __future__ import annotations

import numpy as np

from zenostat.models.weather.epw import COLUMNS
from zenostat.topics.arrays import Floats

_A, _B_C, _ES_PA = 17.625, 243.04, 610.94


def saturation_pressure(celsius: Floats) -> Floats:
    """Return the saturation pressure over water in Pa.

    Magnus form of O. A. Alduchov and R. E. Eskridge (1996), J. Appl. Meteorol. 35, 601.
    """
    return np.asarray(_ES_PA * np.exp(_A * celsius / (celsius + _B_C)))


def relative_humidity(dry_bulb: Floats, dew_point: Floats) -> Floats:
    """Return the relative humidity in percent, from two temperatures in C."""
    return 100.0 * saturation_pressure(dew_point) / saturation_pressure(dry_bulb)


def dew_point(dry_bulb: Floats, humidity: Floats) -> Floats:
    """Return the dew point in C, from a temperature in C and a relative humidity in percent.

    It is the inverse of `relative_humidity`, limited to the EPW data dictionary's minimum, which air of about 0 % would
    fall below.
    """
    with np.errstate(divide="ignore"):
        gamma = np.log(humidity / 100.0) + _A * dry_bulb / (dry_bulb + _B_C)
    lowest = COLUMNS["dew_point_temperature"].low
    gamma = np.maximum(gamma, _A * lowest / (lowest + _B_C))
    return np.asarray(_B_C * gamma / (_A - gamma))


def clear_sky_infrared(dry_bulb: Floats, dew_point: Floats) -> Floats:
    """Return the horizontal infrared radiation of a clear sky in W/m2, from two temperatures in C.

    Emissivity by G. Clark and C. Allen (1978) as in EnergyPlus's Engineering Reference, "Sky Radiation
    Modeling": 0.787 + 0.764 ln(T_dew / 273 K).
    """
    emissivity = 0.787 + 0.764 * np.log((dew_point + 273.15) / 273.0)
    return np.asarray(emissivity * 5.6697e-8 * (dry_bulb + 273.15) ** 4)


def sky_infrared(dry_bulb: Floats, dew_point: Floats, opaque_sky_cover: Floats) -> Floats:
    """Return the horizontal infrared radiation of the sky in W/m2 as EnergyPlus 25.2 computes it.

    Emissivity of a clear sky by G. Clark and C. Allen (1978), with the influence of clouds by G. N. Walton (1983) as in
    EnergyPlus's Engineering Reference, "Sky Radiation Modeling".

    Args:
        dry_bulb: In C.
        dew_point: In C.
        opaque_sky_cover: In tenths.
    """
    clear = 0.787 + 0.764 * np.log((np.minimum(dry_bulb, dew_point) + 273.15) / 273.15)
    clouds = 1.0 + 0.0224 * opaque_sky_cover - 0.0035 * opaque_sky_cover**2 + 0.00028 * opaque_sky_cover**3
    return np.asarray(clear * clouds * 5.6697e-8 * (dry_bulb + 273.15) ** 4)
