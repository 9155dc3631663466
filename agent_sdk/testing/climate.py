"""Sinusoidal weather with noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import UnknownName, did_you_mean
from zenostat.topics.messages import WeatherSeries

_UNITS = {"dry_bulb_temperature": "C", "global_horizontal_radiation": "Wh/m2"}  # as in EPW files
_COLDEST_DAY, _WARMEST_HOUR = 15.0, 15.0
_SUNRISE, _DAYLIGHT_H = 6.0, 12.0


@dataclass(frozen=True)
class Climate:
    """Synthetic climate: outdoor temperature with a yearly and a daily sine, radiation as the upper half of a sine.

    Attributes:
        mean_degc: annual mean temperature.
        season_k: amplitude of the yearly sine, with its maximum in mid July.
        day_k: amplitude of the daily sine, with its maximum at 15 o'clock.
        sun_w_per_m2: global radiation at noon; 0 from 18 to 6 o'clock.
        noise_k: stationary standard deviation of the Ornstein-Uhlenbeck noise on the temperature.
        noise_tau_h: time constant of the noise.
    """

    mean_degc: float = 11.0
    season_k: float = 12.0
    day_k: float = 5.0
    sun_w_per_m2: float = 600.0
    noise_k: float = 1.0
    noise_tau_h: float = 24.0

    def series(self, begin: datetime, rows: int, step_s: float, random: np.random.Generator) -> tuple[Floats, Floats]:
        """Return temperature (degC) and global radiation (W/m2) from `begin` in intervals of `step_s`, each (rows,)."""
        first_h = begin.timetuple().tm_yday * 24.0 - 24.0 + begin.hour
        hours = first_h + np.arange(rows) * (step_s / 3600.0)
        season = -self.season_k * np.cos(2.0 * np.pi * (hours / 24.0 - _COLDEST_DAY) / 365.0)
        day = self.day_k * np.cos(2.0 * np.pi * (hours - _WARMEST_HOUR) / 24.0)
        sun = np.sin(np.pi * (hours % 24.0 - _SUNRISE) / _DAYLIGHT_H)
        noise = self._noise(rows, step_s / 3600.0, random)
        return self.mean_degc + season + day + noise, self.sun_w_per_m2 * np.maximum(sun, 0.0)

    def _noise(self, rows: int, step_h: float, random: np.random.Generator) -> Floats:
        keep = float(np.exp(-step_h / self.noise_tau_h))
        shocks = random.standard_normal(rows) * self.noise_k * np.sqrt(1.0 - keep * keep)
        now = float(random.standard_normal()) * self.noise_k
        noise = np.empty(rows)
        for row, shock in enumerate(shocks.tolist()):
            noise[row] = now
            now = now * keep + shock
        return noise


def weather_series(
    columns: Sequence[str], temperature: Floats, radiation: Floats, episode: int, step_s: float
) -> WeatherSeries:
    """Build a node's reply to a weather query: the arrays start with the episode, the series one timestep later.

    Raises:
        UnknownName: a column that the weather of a fake building does not have.
    """
    available = {"dry_bulb_temperature": temperature, "global_horizontal_radiation": radiation}
    for column in columns:
        if column not in available:
            raise UnknownName(f"a fake building's weather has no column {column!r}; {did_you_mean(column, available)}")
    values = np.column_stack([available[column][1:] for column in columns])
    units = [_UNITS[column] for column in columns]
    return WeatherSeries(
        episode=episode, columns=list(columns), units=units, step_s=step_s, values=values.astype("<f8").tobytes()
    )
