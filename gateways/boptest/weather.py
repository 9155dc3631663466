"""Weather of a test under BOPTEST's names, from the columns of its weather file and the position of the sun."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from zenostat.gateways.boptest.points import KELVIN
from zenostat.gateways.boptest.simulation import DAY_S, YEAR_S, wrapped
from zenostat.topics.arrays import Floats
from zenostat.topics.weather import WeatherColumn

_COLUMNS = {
    "TDryBul": ("dry_bulb_temperature", 1.0, KELVIN, "K", "Dry bulb temperature"),
    "TDewPoi": ("dew_point_temperature", 1.0, KELVIN, "K", "Dew point temperature"),
    "relHum": ("relative_humidity", 0.01, 0.0, "1", "Relative humidity"),
    "pAtm": ("atmospheric_station_pressure", 1.0, 0.0, "Pa", "Atmospheric pressure"),
    "HHorIR": ("horizontal_infrared_radiation_intensity", 1.0, 0.0, "W/m2", "Horizontal infrared irradiation"),
    "HGloHor": ("global_horizontal_radiation", 1.0, 0.0, "W/m2", "Global horizontal irradiation"),
    "HDirNor": ("direct_normal_radiation", 1.0, 0.0, "W/m2", "Direct normal irradiation"),
    "HDifHor": ("diffuse_horizontal_radiation", 1.0, 0.0, "W/m2", "Diffuse horizontal irradiation"),
    "winDir": ("wind_direction", np.pi / 180.0, 0.0, "rad", "Wind direction"),
    "winSpe": ("wind_speed", 1.0, 0.0, "m/s", "Wind speed"),
    "nTot": ("total_sky_cover", 0.1, 0.0, "1", "Total sky cover"),
    "nOpa": ("opaque_sky_cover", 0.1, 0.0, "1", "Opaque sky cover"),
    "ceiHei": ("ceiling_height", 1.0, 0.0, "m", "Ceiling height"),
}
_DERIVED = {
    "TWetBul": ("K", "Wet bulb temperature"),
    "TBlaSky": ("K", "Black-body sky temperature"),
    "cloTim": ("s", "Clock time"),
    "solTim": ("s", "Solar time"),
    "solDec": ("rad", "Solar declination angle"),
    "solHouAng": ("rad", "Solar hour angle"),
    "solAlt": ("rad", "Altitude angle"),
    "solZen": ("rad", "Zenith angle"),
    "lat": ("rad", "Latitude"),
    "lon": ("rad", "Longitude"),
}
COLUMNS = tuple(column for column, *_ in _COLUMNS.values())
"""Columns of a weather file that are requested of the node."""

_OF_SUN = ("HGloHor", "HDirNor", "HDifHor")
"""Points whose rows are means of their interval; as in EnergyPlus, they are 0 while the sun is down.

EnergyPlus interpolates them between the middles of hours, but takes the rows of a file with shorter intervals, which
are the timesteps, as they are.
"""

_STEFAN_BOLTZMANN = 5.670374419e-8


class Weather:
    """Weather as functions of time; columns without any value are left out.

    Args:
        begin_s: time at which the series begins; its first row is valid one interval later.
        interval_s: time between two rows.
        columns: by a weather file's name of a column, its values; NaN where one is missing that EnergyPlus does not
            use.
        latitude_deg, longitude_deg, time_zone_h: of the site.

    Attributes:
        points: by name, unit and description.
    """

    def __init__(
        self,
        begin_s: float,
        interval_s: float,
        columns: dict[str, Floats],
        latitude_deg: float,
        longitude_deg: float,
        time_zone_h: float,
    ) -> None:
        self._begin_s = begin_s
        self._latitude, self._longitude = np.radians(latitude_deg), np.radians(longitude_deg)
        self._solar_shift_s = (longitude_deg / 15.0 - time_zone_h) * 3600.0
        self._columns: dict[str, tuple[WeatherColumn, float, float]] = {}
        for name, (column, factor, offset, *_) in _COLUMNS.items():
            if not np.isnan(columns[column]).all():
                period = 360.0 if name == "winDir" else None
                is_mean = name in _OF_SUN and interval_s == 3600.0
                read = WeatherColumn(columns[column], interval_s, period=period, is_mean=is_mean)
                self._columns[name] = read, factor, offset
        count = len(columns["dry_bulb_temperature"])
        rows_s: Floats = begin_s + interval_s * np.arange(1, count + 1, dtype=np.float64)
        derived = {}
        if {"TDryBul", "relHum", "pAtm"} <= self._columns.keys():
            derived["TWetBul"] = wet_bulb(*(self._of_file(name, rows_s) for name in ("TDryBul", "relHum", "pAtm")))
        if "HHorIR" in self._columns:
            derived["TBlaSky"] = (self._of_file("HHorIR", rows_s) / _STEFAN_BOLTZMANN) ** 0.25
        self._columns |= {name: (WeatherColumn(rows, interval_s), 1.0, 0.0) for name, rows in derived.items()}
        solar = [name for name in _DERIVED if name not in ("TWetBul", "TBlaSky")]
        self.points = {name: self._describe(name) for name in (*self._columns, *solar)}

    @staticmethod
    def _describe(name: str) -> tuple[str, str]:
        return _DERIVED[name] if name in _DERIVED else _COLUMNS[name][3:]

    def at(self, name: str, times_s: Floats) -> Floats:
        """Return a point's values at some times, linear between two rows; after the run period, those of a year ago."""
        return self._values([name], times_s)[name]

    def now(self, time_s: float) -> dict[str, float]:
        """Return all points at one time."""
        values = self._values(self.points, np.array(time_s, np.float64))
        return {name: float(value) for name, value in values.items()}

    def _values(self, names: Collection[str], times_s: Floats) -> dict[str, Floats]:
        """Return points at some times, or at one."""
        in_period_s = wrapped(times_s)
        values = {name: self._of_file(name, in_period_s) for name in names if name in self._columns}
        if len(values) < len(names) or not values.keys().isdisjoint(_OF_SUN):
            sun = self._solar(times_s)
            values |= {name: sun[name] for name in names if name in sun}
            is_day = sun["solAlt"] > 0.0
            values |= {name: np.where(is_day, values[name], 0.0) for name in _OF_SUN if name in values}
        return values

    def _of_file(self, name: str, times_s: Floats) -> Floats:
        """Return a point of the weather file at times of the run period."""
        column, factor, offset = self._columns[name]
        return factor * column.at(times_s - self._begin_s) + offset

    def _solar(self, times_s: Floats) -> dict[str, Floats]:
        """Return the position of the sun.

        Declination and equation of time by J. W. Spencer (1971), Fourier series representation of the position of the
        sun, Search 2(5).
        """
        day = 2.0 * np.pi * (times_s % YEAR_S) / YEAR_S
        declination = (
            0.006918 - 0.399912 * np.cos(day) + 0.070257 * np.sin(day) - 0.006758 * np.cos(2 * day)
            + 0.000907 * np.sin(2 * day) - 0.002697 * np.cos(3 * day) + 0.00148 * np.sin(3 * day)
        )  # fmt: skip
        equation_min = 229.18 * (
            0.000075 + 0.001868 * np.cos(day) - 0.032077 * np.sin(day) - 0.014615 * np.cos(2 * day)
            - 0.040849 * np.sin(2 * day)
        )  # fmt: skip
        solar_s = times_s + self._solar_shift_s + 60.0 * equation_min
        hour_angle = (solar_s % DAY_S / 3600.0 - 12.0) * np.pi / 12.0
        sine = np.sin(self._latitude) * np.sin(declination)
        sine = sine + np.cos(self._latitude) * np.cos(declination) * np.cos(hour_angle)
        altitude = np.arcsin(np.clip(sine, -1.0, 1.0))
        same = np.ones_like(times_s, dtype=np.float64)
        return {
            "cloTim": times_s * same,
            "solTim": solar_s,
            "solDec": declination,
            "solHouAng": hour_angle,
            "solAlt": altitude,
            "solZen": np.pi / 2.0 - altitude,
            "lat": same * self._latitude,
            "lon": same * self._longitude,
        }


def wet_bulb(dry_bulb: Floats, humidity: Floats, pressure: Floats) -> Floats:
    """Return the wet bulb temperature in K, from dry bulb (K), relative humidity (1) and pressure (Pa).

    It solves the psychrometric equation with the coefficient 6.66e-4 1/K (WMO Guide to Instruments and Methods of
    Observation, 2018, annex 4.B) by bisection, with the Magnus form of the saturation pressure of the same annex.
    """
    celsius = dry_bulb - KELVIN
    vapor = np.clip(humidity, 0.0, 1.0) * _saturation(celsius)
    low, high = celsius - 60.0, celsius.copy()
    for _ in range(40):
        middle = 0.5 * (low + high)
        excess: Any = _saturation(middle) - 6.66e-4 * pressure * (celsius - middle) - vapor
        low, high = np.where(excess < 0.0, middle, low), np.where(excess < 0.0, high, middle)
    return 0.5 * (low + high) + KELVIN


def _saturation(celsius: Floats) -> Floats:
    saturation: Floats = 611.2 * np.exp(17.62 * celsius / (243.12 + celsius))
    return saturation
