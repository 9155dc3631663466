"""Draw the weather of an episode and write its input files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from models.building.model import Building, for_episode, write
from models.scenario.run_period import Period
from models.scenario.schema import Order
from models.weather import design_days, epw
from models.weather.design_days import Site
from models.weather.header import Header
from models.weather.noise import Variability, with_noise


@dataclass(frozen=True, slots=True)
class WeatherSource:
    """A weather file with its location and design days; `site` None means the model's own."""

    name: str
    path: Path
    header: Header
    site: Site | None


@dataclass(frozen=True, slots=True)
class WeatherDraw:
    """The random part of an episode: the index of its weather file, and the seed of its noise."""

    source: int = 0
    noise: int = 0


class WeatherSampler:
    """Draws the weather of each episode. The same seed gives the same draws; without a seed they differ between runs.

    Args:
        sources: number of weather files.
        order: `random`, or `sequence`, which restarts with the first after each seed.
        noisy: whether the weather has noise.
    """

    def __init__(self, sources: int, order: Order, *, noisy: bool) -> None:
        self._sources, self._order, self._noisy = sources, order, noisy
        self.seed(None)

    @property
    def constant(self) -> bool:
        """Whether each episode has the same weather."""
        return self._sources == 1 and not self._noisy

    def seed(self, seed: int | None) -> None:
        """Restart the sequence of draws."""
        source_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
        self._source_rng = np.random.Generator(np.random.PCG64(source_seed))
        self._noise_rng = np.random.Generator(np.random.PCG64(noise_seed))
        self._episode = 0

    def next(self) -> WeatherDraw:
        """Return the next draw. Each number has its own generator, so more weather files do not change the noise."""
        source, noise = int(self._source_rng.integers(self._sources)), int(self._noise_rng.integers(1 << 63))
        if self._order == "sequence":
            source = self._episode % self._sources
        self._episode += 1
        return WeatherDraw(source, noise if self._noisy else 0)


@dataclass(frozen=True, slots=True)
class EpisodeFiles:
    """EnergyPlus's input files for an episode, and the parameters of its weather noise."""

    model: Path
    weather: Path
    noise_parameters: dict[str, float] = field(default_factory=dict)


class EpisodeFactory:
    """Prepares the files of episodes of one building and run period."""

    def __init__(
        self,
        building: Building,
        period: Period,
        sources: Sequence[WeatherSource],
        weather_noise: Variability,
        *,
        outputs: bool,
    ) -> None:
        self._building, self._period, self._sources = building, period, sources
        self._weather_noise, self._output_variables = weather_noise, outputs
        self._weathers: dict[int, epw.Weather] = {}

    def prepare(self, draw: WeatherDraw, folder: Path, noisy_weather: Path) -> EpisodeFiles:
        """Write an episode's model into `folder` and, if there is noise, its weather to `noisy_weather`."""
        source = self._sources[draw.source]
        objects = for_episode(self._building, self._period, outputs=self._output_variables)
        if source.site is not None:
            objects = design_days.apply(objects, source.site)
        model = write(objects, folder)
        if not self._weather_noise:
            return EpisodeFiles(model, source.path)
        if draw.source not in self._weathers:
            self._weathers[draw.source] = epw.read(source.path)
        weather = self._weathers[draw.source]
        noisy = with_noise(weather, self._weather_noise, np.random.Generator(np.random.PCG64(draw.noise)))
        epw.write(weather, noisy_weather, noisy.columns)
        parameters = {
            f"{column}.{name}": value for column, values in noisy.parameters.items() for name, value in values.items()
        }
        return EpisodeFiles(model, noisy_weather, parameters)


FORECAST_HORIZON = timedelta(days=7)
"""Time after an episode's end for which its weather is available to forecasts."""


def series(path: Path, period: Period, columns: Sequence[str]) -> tuple[NDArray[np.float64], float]:
    """Return weather columns from the first day of a run period to a week after its last, in EnergyPlus's order.

    Returns:
        values, shape (rows, columns), NaN where missing, each at the end of its interval; and the interval in seconds.

    Raises:
        UnknownName: there is no such column.
    """
    selected = [epw.find_column(name) for name in columns]
    weather = epw.read(path)
    days: dict[tuple[int, int], list[int]] = {}
    for row, (_, month, day, _, _) in enumerate(weather.times.tolist()):
        days.setdefault((month, day), []).append(row)
    rows: list[int] = []
    day = period.begin
    while day <= period.end + FORECAST_HORIZON and (day.month, day.day) in days:
        rows += days[day.month, day.day]
        day += timedelta(days=1)
    values = np.column_stack([weather.column(column.name)[rows] for column in selected])
    missing = np.array([column.missing for column in selected])
    return np.where(values >= missing, np.nan, values), 3600.0 * weather.record_h
