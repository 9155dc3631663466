"""Noise on the weather: an Ornstein-Uhlenbeck process on columns of a weather file, and what follows from it.

What follows, so that an hour stays one that can be:

- Dry bulb: the moisture stays (dew point, at most the new dry bulb), relative humidity is calculated.
- Relative humidity: the dew point is calculated. Dew point: relative humidity is. Not both.
- Horizontal infrared: scaled as a clear sky's would change, unless it has noise of its own.
- Direct and diffuse radiation: global is calculated. Global: direct and diffuse are scaled. Not both.
- Limits: those of the EPW data dictionary; relative humidity to 100 %; wind direction goes round; direct and
  diffuse radiation to the extraterrestrial. Rows without sun stay as they are.

EnergyPlus uses direct and diffuse radiation only, and of the sky cover nothing where infrared is given, so
illuminances are left alone, and infrared does not follow the sky cover.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, field_validator, model_validator

from models.weather.epw import COLUMNS, Column, Floats, Weather, find_column
from models.weather.psychrometrics import clear_sky_infrared, dew_point, relative_humidity
from topics.errors import InvalidConfig

Mask = NDArray[np.bool_]


def _one_or_two(value: Any) -> Any:
    numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
    if not all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers) or len(numbers) not in (1, 2):
        raise ValueError("a number or a range of two numbers [low, high] is expected")
    if len(numbers) == 2 and numbers[0] > numbers[1]:
        raise ValueError(f"a range goes from low to high: [{numbers[1]}, {numbers[0]}]")
    return numbers if len(numbers) == 2 else numbers[0]


Range = Annotated[float | tuple[float, float], BeforeValidator(_one_or_two)]
"""A number, or `[low, high]`, from which one is drawn uniformly for each episode."""


def _least(value: float | tuple[float, float]) -> float:
    return value[0] if isinstance(value, tuple) else value


class ColumnNoise(BaseModel):
    """Noise on one column, in the unit of the column.

    Attributes:
        sigma: standard deviation of the noise, 0 or more.
        mu: mean of the noise.
        tau_h: hours after which its correlation has fallen to 1/e, more than 0.
        low, high: limits of the column's values, within the physical ones.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sigma: Range
    mu: Range = 0.0
    tau_h: Range = 24.0
    low: float | None = None
    high: float | None = None

    @field_validator("sigma")
    @classmethod
    def _sigma(cls, value: float | tuple[float, float]) -> float | tuple[float, float]:
        if _least(value) < 0:
            raise ValueError("a standard deviation is 0 or more")
        return value

    @field_validator("tau_h")
    @classmethod
    def _tau(cls, value: float | tuple[float, float]) -> float | tuple[float, float]:
        if _least(value) <= 0:
            raise ValueError("a correlation time is more than 0 h")
        return value

    @model_validator(mode="after")
    def _limits(self) -> ColumnNoise:
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low ({self.low:g}) should be less than high ({self.high:g})")
        return self


Variability = dict[str, ColumnNoise]
"""Noise by column of the weather file."""


@dataclass(frozen=True, slots=True, eq=False)
class NoisyWeather:
    """The columns that changed, each float64 (rows,) with four decimals, and the parameters that were drawn.

    Attributes:
        drawn: by column, `sigma`, `mu` and `tau_h`.
    """

    changed: dict[str, Floats]
    drawn: dict[str, dict[str, float]]


def ornstein_uhlenbeck(
    rng: np.random.Generator, n: int, sigma: float, mu: float, tau_h: float, dt_h: float = 1.0
) -> Floats:
    """`n` values, `dt_h` hours apart, of a process of mean `mu` and standard deviation `sigma`; float64 (n,).

    The exact update of D. T. Gillespie (1996), Phys. Rev. E 54, 2084: x[i+1] = mu + (x[i] - mu) a +
    sigma sqrt(1 - a^2) N(0, 1) with a = exp(-dt/tau), for any dt. The first value is drawn from N(mu, sigma^2),
    so each has that distribution, and values k steps apart correlate with a^k.

    The recursion is summed by doubling: after pass j, y[i] holds the shocks of the last 2^j steps, each times
    its power of a.
    """
    values = rng.standard_normal(n)
    values[1:] *= math.sqrt(-math.expm1(-2.0 * dt_h / tau_h))
    shift = 1
    while shift < n:
        values[shift:] += math.exp(-dt_h * shift / tau_h) * values[:-shift]
        shift *= 2
    return np.asarray(mu + sigma * values, dtype=np.float64)


# Which columns

_DRY, _DEW, _HUMIDITY = "dry_bulb_temperature", "dew_point_temperature", "relative_humidity"
_INFRARED = "horizontal_infrared_radiation_intensity"
_GLOBAL, _DIRECT, _DIFFUSE = "global_horizontal_radiation", "direct_normal_radiation", "diffuse_horizontal_radiation"
_BEYOND, _BEYOND_NORMAL = "extraterrestrial_horizontal_radiation", "extraterrestrial_direct_normal_radiation"
_SUN = (_GLOBAL, _DIRECT, _DIFFUSE)
_NO_NOISE = {
    _BEYOND: "it follows from place and date",
    _BEYOND_NORMAL: "it follows from the date",
    "present_weather_observation": "it is a flag",
}
_CONTRADICTIONS = ((_DEW, (_HUMIDITY,)), (_GLOBAL, (_DIRECT, _DIFFUSE)))


def checked(weather_noise: Mapping[str, ColumnNoise]) -> list[tuple[Column, ColumnNoise]]:
    """The columns with their noise, in the order of the file.

    Raises:
        UnknownName: no such column.
        InvalidConfig: a column twice, one that takes no noise, columns that follow from each other, or limits
            that leave nothing of the physical range.
    """
    found: dict[str, ColumnNoise] = {}
    for text, noise in weather_noise.items():
        column = find_column(text)
        if column.name in found:
            raise InvalidConfig(f"weather_noise names the column {column.name} twice, the second time as {text!r}")
        if column.name in _NO_NOISE:
            raise InvalidConfig(f"the column {column.name} takes no noise: {_NO_NOISE[column.name]}")
        low, high = _limits(column, noise)
        if low >= high:
            raise InvalidConfig(
                f"weather_noise of {column.name}: its limits leave nothing of {column.low:g} to {_high(column):g}"
            )
        found[column.name] = noise
    for one, others in _CONTRADICTIONS:
        both = [name for name in others if name in found]
        if one in found and both:
            raise InvalidConfig(f"noise on {one} and on {' and '.join(both)} contradict each other: leave one out")
    return [(COLUMNS[name], found[name]) for name in COLUMNS if name in found]


def _high(column: Column) -> float:
    return 100.0 if column.name == _HUMIDITY else column.high


def _limits(column: Column, noise: ColumnNoise) -> tuple[float, float]:
    low = column.low if noise.low is None else max(column.low, noise.low)
    return low, _high(column) if noise.high is None else min(_high(column), noise.high)


def _drawn(rng: np.random.Generator, value: float | tuple[float, float]) -> float:
    return float(rng.uniform(*value)) if isinstance(value, tuple) else float(value)


def with_noise(weather: Weather, weather_noise: Mapping[str, ColumnNoise], rng: np.random.Generator) -> NoisyWeather:
    """`weather` with noise on the columns of `weather_noise`, and what follows from it in others.

    One number is taken of `rng`. Each column has a generator of its own, made of that number and the column's
    place: the same settings give the same weather in whatever order they are written, and noise on one more
    column leaves that of the others as it was. Missing values stay missing. A column whose `sigma` and `mu`
    are 0 stays as it is, and nothing follows from it.

    Raises:
        UnknownName, InvalidConfig: see `checked`.
    """
    seed = int(rng.integers(2**63))
    drawn: dict[str, dict[str, float]] = {}
    hour = _Hours(weather)
    for column, noise in checked(weather_noise):
        own = np.random.default_rng([seed, column.index])
        sigma, mu, tau_h = (_drawn(own, value) for value in (noise.sigma, noise.mu, noise.tau_h))
        drawn[column.name] = {"sigma": sigma, "mu": mu, "tau_h": tau_h}
        if sigma or mu:
            added = ornstein_uhlenbeck(own, len(weather), sigma, mu, tau_h, weather.record_h)
            hour.add(column, added, _limits(column, noise))
    hour.settle_moisture()
    hour.settle_infrared()
    hour.settle_radiation()
    return NoisyWeather(hour.changed(), drawn)


class _Hours:
    """The columns of a file while they change; `new` has those that did."""

    def __init__(self, weather: Weather) -> None:
        self.weather = weather
        self.new: dict[str, Floats] = {}

    def old(self, name: str) -> Floats:
        return self.weather.column(name)

    def now(self, name: str) -> Floats:
        return self.new[name] if name in self.new else self.old(name)

    def known(self, *names: str) -> Mask:
        """Rows where none of the columns is missing."""
        return np.asarray(np.logical_and.reduce([self.old(name) < COLUMNS[name].missing for name in names]))

    def put(self, name: str, values: Floats, rows: Mask) -> None:
        self.new[name] = np.where(rows, values, self.now(name))

    def add(self, column: Column, added: Floats, limits: tuple[float, float]) -> None:
        values, rows = self.old(column.name) + added, self.known(column.name)
        if column.name == "wind_direction":
            values = np.mod(np.round(values, 4), 360.0)
        if column.name in _SUN:
            rows &= ~self.dark
        self.put(column.name, np.clip(values, *limits), rows)

    @property
    def seen(self) -> Mask:
        """Rows of which the file says how the sun stands: both extraterrestrial radiations are there.

        Some files have 0 there in all rows, and say nothing.
        """
        if not self.old(_BEYOND).any():
            return np.zeros(len(self.weather), dtype=np.bool_)
        return self.known(_BEYOND, _BEYOND_NORMAL)

    @property
    def dark(self) -> Mask:
        """Rows without sun; where the file does not say, those that have no radiation that is above 0."""
        none = np.logical_and.reduce([(self.old(name) <= 0) | ~self.known(name) for name in _SUN])
        return np.asarray(np.where(self.seen, self.old(_BEYOND) <= 0, none))

    def settle_moisture(self) -> None:
        """Dew point and relative humidity where dry bulb, dew point or relative humidity changed."""
        if not {_DRY, _DEW, _HUMIDITY} & set(self.new):
            return
        dry, rows = self.now(_DRY), self.known(_DRY, _DEW, _HUMIDITY)
        if _HUMIDITY in self.new:
            self.put(_DEW, np.minimum(dew_point(dry, self.now(_HUMIDITY)), dry), rows)
            return
        self.put(_DEW, np.minimum(self.now(_DEW), dry), self.known(_DRY, _DEW))
        self.put(_HUMIDITY, np.clip(relative_humidity(dry, self.now(_DEW)), 0.0, 100.0), rows)

    def settle_infrared(self) -> None:
        """Infrared times the ratio of the clear sky's after and before."""
        if not {_DRY, _DEW} & set(self.new) or _INFRARED in self.new:
            return
        ratio = clear_sky_infrared(self.now(_DRY), self.now(_DEW)) / clear_sky_infrared(self.old(_DRY), self.old(_DEW))
        self.put(_INFRARED, self.old(_INFRARED) * ratio, self.known(_DRY, _DEW, _INFRARED))

    def settle_radiation(self) -> None:
        """Limits of the radiation, and global against direct and diffuse."""
        if not set(_SUN) & set(self.new):
            return
        for name, beyond in ((_GLOBAL, _BEYOND), (_DIRECT, _BEYOND_NORMAL), (_DIFFUSE, _BEYOND)):
            if name in self.new:
                most = np.maximum(self.old(beyond), self.old(name))
                self.put(name, np.minimum(self.now(name), most), self.seen & self.known(name))
        rows = self.known(*_SUN) & ~self.dark
        if _GLOBAL in self.new:
            self._split(rows)
        else:
            total = self.now(_DIFFUSE) + self.now(_DIRECT) * self._cosine()
            self.put(_GLOBAL, total, rows)

    def _split(self, rows: Mask) -> None:
        """Direct and diffuse by the ratio of global; where there was none, all of it is diffuse."""
        before, after = self.old(_GLOBAL), self.new[_GLOBAL]
        ratio = after / np.where(before > 0, before, 1.0)
        most = np.where(self.seen, self.old(_BEYOND_NORMAL), np.inf)
        self.put(_DIRECT, np.where(before > 0, np.minimum(self.old(_DIRECT) * ratio, most), 0.0), rows)
        self.put(_DIFFUSE, np.where(before > 0, self.old(_DIFFUSE) * ratio, after), rows)

    def _cosine(self) -> Floats:
        """Of the zenith angle, 0 to 1: horizontal over normal outside the atmosphere.

        Where the file does not say these, from its own global, direct and diffuse.
        """
        normal, direct = self.old(_BEYOND_NORMAL), self.old(_DIRECT)
        given = self.old(_BEYOND) / np.where(normal > 0, normal, 1.0)
        implied = (self.old(_GLOBAL) - self.old(_DIFFUSE)) / np.where(direct > 0, direct, 1.0)
        return np.clip(np.where(self.seen, given, np.where(direct > 0, implied, 0.0)), 0.0, 1.0)

    def changed(self) -> dict[str, Floats]:
        """With four decimals, as they are written; rows that kept their value keep it to the bit."""
        found = {}
        for name in COLUMNS:
            if name in self.new and (differs := self.new[name] != self.old(name)).any():
                found[name] = np.where(differs, np.round(self.new[name], 4), self.old(name))
        return found
