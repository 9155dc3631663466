"""What one episode simulates: its weather, drawn and disturbed, and its files."""

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
    """A weather file, with the location and design days that belong to it (None: the model's own)."""

    name: str
    path: Path
    header: Header
    site: Site | None


@dataclass(frozen=True, slots=True)
class WeatherDraw:
    """What is random of an episode: which of the weather files, and the seed of its noise."""

    source: int = 0
    noise: int = 0


class WeatherSampler:
    """A draw for each episode. The same seed gives the same draws; without one they differ from run to run.

    Args:
        sources: number of weather files.
        order: `random`, or `sequence` (from the first again after each seed).
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
        """Begins anew."""
        which, noise = np.random.SeedSequence(seed).spawn(2)
        self._which, self._noise = (
            np.random.Generator(np.random.PCG64(which)),
            np.random.Generator(np.random.PCG64(noise)),
        )
        self._episode = 0

    def next(self) -> WeatherDraw:
        """The next episode's. Each number has a generator of its own: more weathers leave the noise as it was."""
        source, noise = int(self._which.integers(self._sources)), int(self._noise.integers(1 << 63))
        if self._order == "sequence":
            source = self._episode % self._sources
        self._episode += 1
        return WeatherDraw(source, noise if self._noisy else 0)


@dataclass(frozen=True, slots=True)
class EpisodeFiles:
    """What EnergyPlus reads in an episode, and the parameters of its weather's noise."""

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
        self._variability, self._output_dir = weather_noise, outputs
        self._read: dict[int, epw.Weather] = {}

    def prepare(self, draw: WeatherDraw, folder: Path, disturbed_weather: Path) -> EpisodeFiles:
        """Writes the model of an episode into `folder`, and its weather, if there is noise, to the other path."""
        source = self._sources[draw.source]
        objects = for_episode(self._building, self._period, outputs=self._output_dir)
        if source.site is not None:
            objects = design_days.apply(objects, source.site)
        model = write(objects, folder)
        if not self._variability:
            return EpisodeFiles(model, source.path)
        if draw.source not in self._read:
            self._read[draw.source] = epw.read(source.path)
        found = with_noise(self._read[draw.source], self._variability, np.random.Generator(np.random.PCG64(draw.noise)))
        epw.write(self._read[draw.source], disturbed_weather, found.changed)
        drawn = {f"{column}.{name}": value for column, values in found.drawn.items() for name, value in values.items()}
        return EpisodeFiles(model, disturbed_weather, drawn)


AHEAD = timedelta(days=7)
"""How far beyond its end an episode's weather is known to forecasts."""


def series(path: Path, period: Period, columns: Sequence[str]) -> tuple[NDArray[np.float64], float]:
    """Columns of a weather file from the first day of a run period to a week after its last, as EnergyPlus reads it.

    Returns:
        values, shape (rows, columns), NaN where missing, each at the end of its interval; and the interval in seconds.

    Raises:
        UnknownName: no such column.
    """
    found = [epw.find_column(name) for name in columns]
    read = epw.read(path)
    days: dict[tuple[int, int], list[int]] = {}
    for row, (_, month, day, _, _) in enumerate(read.times.tolist()):
        days.setdefault((month, day), []).append(row)
    rows: list[int] = []
    day = period.begin
    while day <= period.end + AHEAD and (day.month, day.day) in days:
        rows += days[day.month, day.day]
        day += timedelta(days=1)
    values = np.column_stack([read.column(column.name)[rows] for column in found])
    missing = np.array([column.missing for column in found])
    return np.where(values >= missing, np.nan, values), 3600.0 * read.record_h
