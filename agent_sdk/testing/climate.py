"""Sinusoidal weather with noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from topics.errors import UnknownName, did_you_mean
from topics.messages import WeatherSeries

Floats = NDArray[np.float64]

_UNITS = {"dry_bulb_temperature": "C", "global_horizontal_radiation": "Wh/m2"}  # as in EPW files
_COLDEST_DAY, _WARMEST_HOUR = 15.0, 15.0
_SUNRISE, _DAYLIGHT_H = 6.0, 12.0


@dataclass(frozen=True)
class Climate:
    """Outdoor temperature is a sine of the year and one of the day, sunshine the upper half of a sine.

    Attributes:
        mean_degc: mean of the year.
        season_k: how much the middle of July is warmer than that.
        day_k: how much 15 o'clock is warmer than the day's mean.
        sun_w_per_m2: global radiation at noon; there is none from 18 to 6 o'clock.
        noise_k: stationary standard deviation of the Ornstein-Uhlenbeck noise on the temperature.
        noise_tau_h: its time constant.
    """

    mean_degc: float = 11.0
    season_k: float = 12.0
    day_k: float = 5.0
    sun_w_per_m2: float = 600.0
    noise_k: float = 1.0
    noise_tau_h: float = 24.0

    def series(self, begin: datetime, rows: int, step_s: float, random: np.random.Generator) -> tuple[Floats, Floats]:
        """Temperature (degC) and global radiation (W/m2) at `begin` and each `step_s` after it, each of (rows,)."""
        first_h = begin.timetuple().tm_yday * 24.0 - 24.0 + begin.hour
        hours = first_h + np.arange(rows) * (step_s / 3600.0)
        season = -self.season_k * np.cos(2.0 * np.pi * (hours / 24.0 - _COLDEST_DAY) / 365.0)
        day = self.day_k * np.cos(2.0 * np.pi * (hours - _WARMEST_HOUR) / 24.0)
        sun = np.sin(np.pi * (hours % 24.0 - _SUNRISE) / _DAYLIGHT_H)
        noise = self._noise(rows, step_s / 3600.0, random)
        return self.mean_degc + season + day + noise, self.sun_w_per_m2 * np.maximum(sun, 0.0)

    def _noise(self, rows: int, step_h: float, random: np.random.Generator) -> Floats:
        keep = float(np.exp(-step_h / self.noise_tau_h))
        pushes = random.standard_normal(rows) * self.noise_k * np.sqrt(1.0 - keep * keep)
        now = float(random.standard_normal()) * self.noise_k
        noise = np.empty(rows)
        for row, push in enumerate(pushes.tolist()):
            noise[row] = now
            now = now * keep + push
        return noise


def weather_series(
    columns: Sequence[str], temperature: Floats, radiation: Floats, episode: int, step_s: float
) -> WeatherSeries:
    """As a node answers: `temperature` and `radiation` begin at the episode's begin, the series a step later.

    Raises:
        UnknownName: a column that a fake building's weather does not have.
    """
    have = {"dry_bulb_temperature": temperature, "global_horizontal_radiation": radiation}
    for column in columns:
        if column not in have:
            raise UnknownName(f"a fake building's weather has no column {column!r}; {did_you_mean(column, have)}")
    values = np.column_stack([have[column][1:] for column in columns])
    units = [_UNITS[column] for column in columns]
    return WeatherSeries(
        episode=episode, columns=list(columns), units=units, step_s=step_s, values=values.astype("<f8").tobytes()
    )
