"""Draw the weather of an episode and write its input files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from functools import lru_cache
from pathlib import Path

import numpy as np

from zenostat.models.building.model import Building, for_episode, write
from zenostat.models.run_period import Period
from zenostat.models.scenario.schema import NoiseStart, Order
from zenostat.models.weather import design_days, epw
from zenostat.models.weather.design_days import Site
from zenostat.models.weather.fixed_width import FixedWidthWeather
from zenostat.models.weather.header import Header
from zenostat.models.weather.noise import Variability, with_noise
from zenostat.models.weather.records import simulated_values
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig

_UNPREDICTABLE = 2
"""Consecutive resets with a seed after which the next weather is not predicted."""


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
        self._ahead: WeatherDraw | None = None
        self._consecutive_seeds = 0
        self._seed(None)

    @property
    def constant(self) -> bool:
        """Whether each episode has the same weather."""
        return self._sources == 1 and not self._noisy

    def draw(self, seed: int | None) -> WeatherDraw:
        """Return the draw of the next episode; a seed restarts the sequence."""
        self._consecutive_seeds = 0 if seed is None else self._consecutive_seeds + 1
        ahead, self._ahead = self._ahead, None
        if seed is not None:
            self._seed(seed)
        return self._next() if ahead is None or seed is not None else ahead

    def look_ahead(self) -> WeatherDraw | None:
        """Return the draw of the next episode without a seed; None where a seed is to be expected."""
        self._ahead = (self._ahead or self._next()) if self._consecutive_seeds < _UNPREDICTABLE else None
        return self._ahead

    def expect_seed(self) -> None:
        """Predict nothing before an episode has been drawn without a seed."""
        self._ahead, self._consecutive_seeds = None, _UNPREDICTABLE

    def _seed(self, seed: int | None) -> None:
        source_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
        self._source_rng = np.random.Generator(np.random.PCG64(source_seed))
        self._noise_rng = np.random.Generator(np.random.PCG64(noise_seed))
        self._episode = 0

    def _next(self) -> WeatherDraw:
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


FORECAST_HORIZON = timedelta(days=7)
"""Time after an episode's end for which its weather is available to forecasts."""


NOISE_FREE_DAYS = 2
"""Days of an episode without noise, if it starts on the third day."""


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
        requested: Sequence[tuple[str, str]] = (),
        noise_start: NoiseStart = "episode",
    ) -> None:
        self._building, self._period, self._sources = building, period, sources
        self._weather_noise, self._output_variables, self._noise_start = weather_noise, outputs, noise_start
        self._requested = requested
        self._weathers: dict[int, epw.Weather] = {}
        self._late_noise: dict[int, _LateNoise] = {}

    def prepare(self, draw: WeatherDraw, folder: Path, noisy_weather: Path) -> EpisodeFiles:
        """Write an episode's model into `folder` and, if there is noise, its weather to `noisy_weather`."""
        source = self._sources[draw.source]
        model = self._write_model(source, folder)
        if not self._weather_noise:
            return EpisodeFiles(model, source.path)
        return EpisodeFiles(model, noisy_weather, self.write_noise(draw, noisy_weather))

    def prepare_waiting(self, source: int, folder: Path, weather: Path) -> tuple[EpisodeFiles, int]:
        """Write the files of an engine that waits to be forked, if the noise starts on the third day.

        Returns:
            The files, with weather without noise, and the offset of the first row with noise in bytes.
        """
        late = self._late(source)
        late.file.write(weather, {})
        return EpisodeFiles(self._write_model(self._sources[source], folder), weather), late.offset

    def _write_model(self, source: WeatherSource, folder: Path) -> Path:
        objects = for_episode(self._building, self._period, outputs=self._output_variables, requested=self._requested)
        if source.site is not None:
            objects = design_days.apply(objects, source.site)
        return write(objects, folder)

    def write_noise(self, draw: WeatherDraw, path: Path) -> dict[str, float]:
        """Write the weather of an episode; return the parameters of its noise."""
        rng = np.random.Generator(np.random.PCG64(draw.noise))
        if self._noise_start == "episode":
            weather = self._weather(draw.source)
            noisy = with_noise(weather, self._weather_noise, rng)
            epw.write(weather, path, noisy.columns)
        else:
            late = self._late(draw.source)
            noisy = with_noise(late.weather, self._weather_noise, rng, from_zero=True)
            late.file.write(path, noisy.columns, late.first)
        return {
            f"{column}.{name}": value for column, values in noisy.parameters.items() for name, value in values.items()
        }

    def _weather(self, source: int) -> epw.Weather:
        if source not in self._weathers:
            self._weathers[source] = epw.read(self._sources[source].path)
        return self._weathers[source]

    def _late(self, source: int) -> _LateNoise:
        if source not in self._late_noise:
            path = self._sources[source].path
            self._late_noise[source] = _late_noise(path, path.stat().st_mtime_ns, self._period)
        return self._late_noise[source]


def first_noisy_row(weather: epw.Weather, period: Period) -> int:
    """Return the first row with noise, if it starts on the third day of a run period.

    Raises:
        InvalidConfig: EnergyPlus reads that row after the end of the file, from the file's beginning.
    """
    days, third_day = _days_of_rows(weather, period), period.begin + timedelta(days=NOISE_FREE_DAYS)
    begin, first = (_record_day(day, period) for day in (period.begin, third_day))
    if begin not in days or first not in days:
        return 0  # `check_covers` refuses the run period
    if first not in days[days.index(begin) :]:
        raise InvalidConfig(
            f"noise_start: third_day is not possible with a run period that begins on {period.begin:%m-%d}: the "
            f"weather file {weather.path.name} ends before the third day; begin on another day, or use noise_start: "
            "episode"
        )
    return days.index(first, days.index(begin))


def _days_of_rows(weather: epw.Weather, period: Period) -> list[tuple[int, ...]]:
    """Return month and day of each row, after its year if that counts."""
    return [period.record_day(year, month, day) for year, month, day, _, _ in weather.times.tolist()]


def _record_day(day: date, period: Period) -> tuple[int, ...]:
    return period.record_day(day.year, day.month, day.day)


def check_years(path: Path, name: str, period: Period) -> None:
    """Check that a weather file has the years of a run period in which they count.

    Raises:
        InvalidConfig: it lacks the first or the last day; or see `zenostat.models.weather.epw.read`.
    """
    if not period.by_year:
        return
    days = _days_of_rows(epw.read(path), period)
    for day in (period.begin, period.end):
        if _record_day(day, period) not in days:
            first, last = ("-".join(f"{part:02}" for part in each) for each in (days[0], days[-1]))
            raise InvalidConfig(
                f"the RunPeriod has treat_weather_as_actual, but the weather file {name} has no {day}: its records are "
                f"from {first} to {last}; write the days of the run period with one of its years"
            )


class _LateNoise:
    """A weather file whose noise starts on the third day of a run period, and ends a week after it.

    Attributes:
        file: the file with padded fields.
        first: the first row with noise.
        weather: the rows with noise, in the order in which they are simulated.
        offset: offset of the first row with noise in bytes.
    """

    def __init__(self, weather: epw.Weather, period: Period) -> None:
        self.file = FixedWidthWeather(weather)
        self.first = first_noisy_row(weather, period)
        days = _days_of_rows(weather, period)
        first_day, last_day = period.begin + timedelta(days=NOISE_FREE_DAYS), period.end + FORECAST_HORIZON
        last, after, again = _record_day(last_day, period), len(days), 0
        if (period.by_year or last_day.year == first_day.year) and last in days:
            after -= days[::-1].index(last)
        elif last_day.year > first_day.year and not period.by_year:
            # EnergyPlus reads the file again from its beginning.
            begin = days.index(_record_day(period.begin, period))
            before = days[:begin]
            again = begin - (before[::-1].index(last) if last in before else 0)
        after = after if after > self.first else len(days)
        rows = np.r_[self.first : after, :again]
        self.weather = replace(weather, rows=[weather.rows[row] for row in rows.tolist()], table=weather.table[:, rows])
        self.offset = int(self.file.row_offsets[self.first])


@lru_cache(maxsize=16)
def _late_noise(path: Path, mtime_ns: int, period: Period) -> _LateNoise:  # noqa: ARG001  # slots share what it returns
    return _LateNoise(epw.read(path), period)


def series(path: Path, period: Period, columns: Sequence[str]) -> tuple[Floats, float]:
    """Return weather columns from the first day of a run period to a week after its last, in EnergyPlus's order.

    Returns:
        values, shape (rows, columns), each at the end of its interval; and the interval in seconds. Where one is
        missing, it is what EnergyPlus takes in its place, and NaN in a column that EnergyPlus does not use.

    Raises:
        UnknownName: there is no such column.
    """
    selected = [epw.find_column(name) for name in columns]
    weather = epw.read(path)
    size = 24 * weather.header.records_per_hour
    days = _days_of_rows(weather, period)[::size]
    rows: list[int] = []
    day = period.begin
    # EnergyPlus begins with the first record of that month and day, unless the year counts, and goes on from there.
    place = days.index(_record_day(day, period))
    while day <= period.end + FORECAST_HORIZON:
        place += days[place % len(days)][-2:] == (2, 29) != (day.month, day.day)
        if days[place % len(days)] != _record_day(day, period):
            break
        rows += range(place % len(days) * size, (place % len(days) + 1) * size)
        place += 1
        day += timedelta(days=1)
    values = np.column_stack([simulated_values(weather, column.name, rows) for column in selected])
    return values, 3600.0 * weather.record_h
