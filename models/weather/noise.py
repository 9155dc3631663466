"""Weather noise: an Ornstein-Uhlenbeck process on columns of a weather file, and the adjustment of dependent columns.

Dependent columns are adjusted so that every row stays physically consistent:

- Noise on the dry bulb keeps the moisture (the dew point, limited to the new dry bulb); relative humidity is
  recalculated.
- Noise on relative humidity recalculates the dew point, and noise on the dew point recalculates relative humidity. Both
  at once are not allowed.
- Horizontal infrared is scaled by the change of a clear sky's infrared, unless it has noise itself.
- Noise on direct or diffuse radiation recalculates global radiation; noise on global radiation scales direct and
  diffuse. Both at once are not allowed.
- Values are limited as in the EPW data dictionary, relative humidity to 100 %, and direct and diffuse radiation to the
  extraterrestrial radiation; wind direction wraps around. Rows without sun are unchanged.

EnergyPlus uses only direct and diffuse radiation, and ignores the sky cover where infrared is given, so illuminances
are unchanged and infrared does not depend on the sky cover.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, field_validator, model_validator

from zenostat.models.weather.epw import COLUMNS, Column, Weather, find_column
from zenostat.models.weather.psychrometrics import clear_sky_infrared, dew_point, relative_humidity
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.points import bounds, check_order

Mask = NDArray[np.bool_]


def _parse_range(value: Any) -> Any:
    numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
    if not all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers) or len(numbers) not in (1, 2):
        raise ValueError("expected a number or a range of two numbers [low, high]")
    if len(numbers) == 2 and numbers[0] > numbers[1]:
        raise ValueError(f"a range has its lower limit first: [{numbers[1]}, {numbers[0]}]")
    return numbers if len(numbers) == 2 else numbers[0]


Range = Annotated[float | tuple[float, float], BeforeValidator(_parse_range)]
"""A number, or a range `[low, high]` from which a number is drawn uniformly for each episode."""


def _minimum(value: float | tuple[float, float]) -> float:
    return value[0] if isinstance(value, tuple) else value


class ColumnNoise(BaseModel):
    """Noise on one column, in the column's unit.

    Attributes:
        sigma: standard deviation of the noise, at least 0.
        mu: mean of the noise.
        tau_h: correlation time in hours, after which the correlation has fallen to 1/e; more than 0.
        low, high: limits of the column's values, within the physical limits.
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
        if _minimum(value) < 0:
            raise ValueError("a standard deviation must be at least 0")
        return value

    @field_validator("tau_h")
    @classmethod
    def _tau(cls, value: float | tuple[float, float]) -> float | tuple[float, float]:
        if _minimum(value) <= 0:
            raise ValueError("a correlation time must be more than 0 h")
        return value

    @model_validator(mode="after")
    def _limits(self) -> ColumnNoise:
        check_order(self)
        return self


Variability = dict[str, ColumnNoise]
"""Noise by column of the weather file."""


@dataclass(frozen=True, slots=True, eq=False)
class NoisyWeather:
    """Weather columns with noise, and the noise parameters.

    Attributes:
        columns: the columns that changed, each float64 (rows,) with four decimals.
        parameters: drawn values of `sigma`, `mu` and `tau_h`, by column.
    """

    columns: dict[str, Floats]
    parameters: dict[str, dict[str, float]]


def ornstein_uhlenbeck(
    rng: np.random.Generator,
    n: int,
    sigma: float,
    mu: float,
    tau_h: float,
    dt_h: float = 1.0,
    *,
    from_zero: bool = False,
) -> Floats:
    """Draw `n` values, `dt_h` hours apart, of a process with mean `mu` and standard deviation `sigma`; float64 (n,).

    The update is the exact one of D. T. Gillespie (1996), Phys. Rev. E 54, 2084: x[i+1] = mu + (x[i] - mu) a +
    sigma sqrt(1 - a^2) N(0, 1) with a = exp(-dt/tau), for any dt. (An Euler step, as general packages for stochastic
    differential equations have it, is exact only for small dt.) The first value is drawn from N(mu, sigma^2), so each
    value has that distribution, and values k steps apart have the correlation a^k. With `from_zero` the process is 0
    one step before the first value: after k steps its mean is mu (1 - a^k), its variance sigma^2 (1 - a^2k).

    The recursion is summed by doubling: after pass j, y[i] contains the shocks of the last 2^j steps, each times its
    power of a.
    """
    values = rng.standard_normal(n)
    values[0 if from_zero else 1 :] *= math.sqrt(-math.expm1(-2.0 * dt_h / tau_h))
    shift = 1
    while shift < n:
        values[shift:] += math.exp(-dt_h * shift / tau_h) * values[:-shift]
        shift *= 2
    mean = -mu * np.expm1(-dt_h * np.arange(1, n + 1) / tau_h) if from_zero else mu
    return np.asarray(mean + sigma * values, dtype=np.float64)


# Which columns

_DRY, _DEW, _HUMIDITY = "dry_bulb_temperature", "dew_point_temperature", "relative_humidity"
_INFRARED = "horizontal_infrared_radiation_intensity"
_GLOBAL, _DIRECT, _DIFFUSE = "global_horizontal_radiation", "direct_normal_radiation", "diffuse_horizontal_radiation"
_EXTRATERRESTRIAL, _EXTRATERRESTRIAL_NORMAL = (
    "extraterrestrial_horizontal_radiation",
    "extraterrestrial_direct_normal_radiation",
)
_SUN = (_GLOBAL, _DIRECT, _DIFFUSE)
_NO_NOISE = {
    _EXTRATERRESTRIAL: "it depends only on place and date",
    _EXTRATERRESTRIAL_NORMAL: "it depends only on the date",
    "present_weather_observation": "it is a flag",
}
_CONTRADICTIONS = ((_DEW, (_HUMIDITY,)), (_GLOBAL, (_DIRECT, _DIFFUSE)))


def resolve_columns(weather_noise: Mapping[str, ColumnNoise]) -> list[tuple[Column, ColumnNoise]]:
    """Return the columns with their noise, in the order of the file.

    Raises:
        UnknownName: there is no such column.
        InvalidConfig: a column is named twice or cannot have noise, two columns depend on each other, or a column's
            limits exclude its whole physical range.
    """
    noise_by_column: dict[str, ColumnNoise] = {}
    for text, noise in weather_noise.items():
        column = find_column(text)
        if column.name in noise_by_column:
            raise InvalidConfig(f"weather_noise names the column {column.name} twice, the second time as {text!r}")
        if column.name in _NO_NOISE:
            raise InvalidConfig(f"the column {column.name} cannot have noise: {_NO_NOISE[column.name]}")
        low, high = _limits(column, noise)
        if low >= high:
            raise InvalidConfig(
                f"weather_noise of {column.name}: its limits exclude all of {column.low:g} to {_high(column):g}"
            )
        noise_by_column[column.name] = noise
    for column_name, dependent in _CONTRADICTIONS:
        conflicting = [name for name in dependent if name in noise_by_column]
        if column_name in noise_by_column and conflicting:
            raise InvalidConfig(
                f"noise on {column_name} and on {' and '.join(conflicting)} contradict each other: leave one out"
            )
    return [(COLUMNS[name], noise_by_column[name]) for name in COLUMNS if name in noise_by_column]


def _high(column: Column) -> float:
    return 100.0 if column.name == _HUMIDITY else column.high


def _limits(column: Column, noise: ColumnNoise) -> tuple[float, float]:
    low, high = bounds(noise)
    return max(column.low, low), min(_high(column), high)


def _draw(rng: np.random.Generator, value: float | tuple[float, float]) -> float:
    return float(rng.uniform(*value)) if isinstance(value, tuple) else float(value)


def with_noise(
    weather: Weather, weather_noise: Mapping[str, ColumnNoise], rng: np.random.Generator, *, from_zero: bool = False
) -> NoisyWeather:
    """Add noise to the columns in `weather_noise`, and adjust the columns that depend on them.

    One number is drawn from `rng`. Each column has its own generator, seeded with that number and the column's index,
    so the order of the settings has no effect, and noise on another column does not change that of the others. Missing
    values stay missing. A column whose `sigma` and `mu` are 0 is unchanged, and so are its dependent columns.
    `from_zero` is as of `ornstein_uhlenbeck`.

    Raises:
        UnknownName, InvalidConfig: see `resolve_columns`.
    """
    seed = int(rng.integers(2**63))
    parameters: dict[str, dict[str, float]] = {}
    table = _NoisyTable(weather)
    for column, noise in resolve_columns(weather_noise):
        own_rng = np.random.default_rng([seed, column.index])
        sigma, mu, tau_h = (_draw(own_rng, value) for value in (noise.sigma, noise.mu, noise.tau_h))
        parameters[column.name] = {"sigma": sigma, "mu": mu, "tau_h": tau_h}
        if sigma or mu:
            added = ornstein_uhlenbeck(own_rng, len(weather), sigma, mu, tau_h, weather.record_h, from_zero=from_zero)
            table.add(column, added, _limits(column, noise))
    table.adjust_moisture()
    table.adjust_infrared()
    table.adjust_radiation()
    return NoisyWeather(table.changed(), parameters)


class _NoisyTable:
    """The columns of a file while noise is added; `new` has the columns that changed."""

    def __init__(self, weather: Weather) -> None:
        self.weather = weather
        self.new: dict[str, Floats] = {}

    def original(self, name: str) -> Floats:
        return self.weather.column(name)

    def current(self, name: str) -> Floats:
        return self.new[name] if name in self.new else self.original(name)

    def known(self, *names: str) -> Mask:
        """Return the rows where none of the columns is missing."""
        return np.asarray(np.logical_and.reduce([self.original(name) < COLUMNS[name].missing for name in names]))

    def replace(self, name: str, values: Floats, rows: Mask) -> None:
        self.new[name] = np.where(rows, values, self.current(name))

    def add(self, column: Column, added: Floats, limits: tuple[float, float]) -> None:
        values, rows = self.original(column.name) + added, self.known(column.name)
        if column.name == "wind_direction":
            values = np.mod(np.round(values, 4), 360.0)
        if column.name in _SUN:
            rows &= ~self.dark
        self.replace(column.name, np.clip(values, *limits), rows)

    @property
    def sun_known(self) -> Mask:
        """Rows with a known position of the sun, where neither extraterrestrial radiation is missing.

        No row, if the file has 0 in all of them, as some files do.
        """
        if not self.original(_EXTRATERRESTRIAL).any():
            return np.zeros(len(self.weather), dtype=np.bool_)
        return self.known(_EXTRATERRESTRIAL, _EXTRATERRESTRIAL_NORMAL)

    @property
    def dark(self) -> Mask:
        """Rows without sun; where the sun's position is unknown, those without any radiation above 0."""
        no_radiation = np.logical_and.reduce([(self.original(name) <= 0) | ~self.known(name) for name in _SUN])
        return np.asarray(np.where(self.sun_known, self.original(_EXTRATERRESTRIAL) <= 0, no_radiation))

    def adjust_moisture(self) -> None:
        """Adjust dew point and relative humidity if dry bulb, dew point or relative humidity changed."""
        if not {_DRY, _DEW, _HUMIDITY} & set(self.new):
            return
        dry, rows = self.current(_DRY), self.known(_DRY, _DEW, _HUMIDITY)
        if _HUMIDITY in self.new:
            self.replace(_DEW, np.minimum(dew_point(dry, self.current(_HUMIDITY)), dry), rows)
            return
        self.replace(_DEW, np.minimum(self.current(_DEW), dry), self.known(_DRY, _DEW))
        self.replace(_HUMIDITY, np.clip(relative_humidity(dry, self.current(_DEW)), 0.0, 100.0), rows)

    def adjust_infrared(self) -> None:
        """Multiply infrared by the ratio of a clear sky's infrared after and before."""
        if not {_DRY, _DEW} & set(self.new) or _INFRARED in self.new:
            return
        ratio = clear_sky_infrared(self.current(_DRY), self.current(_DEW)) / clear_sky_infrared(
            self.original(_DRY), self.original(_DEW)
        )
        self.replace(_INFRARED, self.original(_INFRARED) * ratio, self.known(_DRY, _DEW, _INFRARED))

    def adjust_radiation(self) -> None:
        """Limit the radiation, and make global, direct and diffuse radiation consistent."""
        if not set(_SUN) & set(self.new):
            return
        for name, limit_name in (
            (_GLOBAL, _EXTRATERRESTRIAL),
            (_DIRECT, _EXTRATERRESTRIAL_NORMAL),
            (_DIFFUSE, _EXTRATERRESTRIAL),
        ):
            if name in self.new:
                limit = np.maximum(self.original(limit_name), self.original(name))
                self.replace(name, np.minimum(self.current(name), limit), self.sun_known & self.known(name))
        rows = self.known(*_SUN) & ~self.dark
        if _GLOBAL in self.new:
            self._split(rows)
        else:
            total = self.current(_DIFFUSE) + self.current(_DIRECT) * self._cosine()
            self.replace(_GLOBAL, total, rows)

    def _split(self, rows: Mask) -> None:
        """Scale direct and diffuse by the ratio of global; where global was 0, all of it becomes diffuse."""
        before, after = self.original(_GLOBAL), self.new[_GLOBAL]
        ratio = after / np.where(before > 0, before, 1.0)
        limit = np.where(self.sun_known, self.original(_EXTRATERRESTRIAL_NORMAL), np.inf)
        self.replace(_DIRECT, np.where(before > 0, np.minimum(self.original(_DIRECT) * ratio, limit), 0.0), rows)
        self.replace(_DIFFUSE, np.where(before > 0, self.original(_DIFFUSE) * ratio, after), rows)

    def _cosine(self) -> Floats:
        """Return the cosine of the zenith angle, 0 to 1: extraterrestrial horizontal over direct normal radiation.

        Where the file lacks these, it follows from the file's global, direct and diffuse radiation.
        """
        normal, direct = self.original(_EXTRATERRESTRIAL_NORMAL), self.original(_DIRECT)
        exact = self.original(_EXTRATERRESTRIAL) / np.where(normal > 0, normal, 1.0)
        implied = (self.original(_GLOBAL) - self.original(_DIFFUSE)) / np.where(direct > 0, direct, 1.0)
        return np.clip(np.where(self.sun_known, exact, np.where(direct > 0, implied, 0.0)), 0.0, 1.0)

    def changed(self) -> dict[str, Floats]:
        """Return the changed columns with four decimals, as written; rows with the same value keep it to the bit."""
        columns = {}
        for name in COLUMNS:
            if name in self.new and (differs := self.new[name] != self.original(name)).any():
                columns[name] = np.where(differs, np.round(self.new[name], 4), self.original(name))
        return columns
