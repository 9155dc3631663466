"""Record the samples of one episode in arrays, for reports and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.rewards import Reward
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.sample import SampleView
from zenostat.topics import codec
from zenostat.topics.errors import UsageError, ZenostatError
from zenostat.topics.messages import Manifest, WeatherSeries
from zenostat.topics.recording import WEATHER_COLUMNS


@dataclass(frozen=True, slots=True, eq=False)
class WeatherTrace:
    """The weather of one episode, as drawn and with its noise.

    Attributes:
        step_s: length of a row in seconds.
        temperature: outdoor air temperature at the end of each row, degC, shape (rows,); NaN where unknown.
        solar: global horizontal radiation in each row, W/m2, shape (rows,); NaN where unknown.
    """

    step_s: float
    temperature: NDArray[np.float64]
    solar: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeTrace:
    """The samples of one episode.

    Row k of each array belongs to the sample at `begin + k * manifest.step_s`; row 0 is the sample before the first
    recorded timestep. Rows of samples that were not received are NaN.

    Attributes:
        manifest: manifest of the node.
        begin: time of row 0, naive local standard time.
        values: fault-free values of all sensors, then meters, shape (steps + 1, points).
        effective: effective values of all actuators, shape (steps + 1, actuators); NaN where EnergyPlus reports none.
        source_index: value source of each actuator, an index into `sources`, shape (steps + 1, actuators).
        sources: names of the value sources; the first, `""`, is the baseline control.
        terms: reward terms of each timestep by name, each of shape (steps,); empty without a reward.
    """

    manifest: Manifest
    begin: datetime
    values: NDArray[np.float64]
    effective: NDArray[np.float64]
    source_index: NDArray[np.uint16]
    sources: tuple[str, ...]
    terms: dict[str, NDArray[np.float64]]

    @property
    def steps(self) -> int:
        """Number of timesteps."""
        return len(self.values) - 1

    @property
    def step_h(self) -> float:
        """Length of a timestep in hours."""
        return self.manifest.step_s / 3600.0

    @property
    def end(self) -> datetime:
        """Time of the last row."""
        return self.begin + self.steps * self.manifest.timestep

    def begins(self) -> list[datetime]:
        """Return the time at which each timestep begins, shape (steps,)."""
        return [self.begin + k * self.manifest.timestep for k in range(self.steps)]


class TraceRecorder:
    """Records the samples of an episode; a sample 0 starts again.

    Arrays for the whole episode are allocated with the first sample, so that a further sample only costs its copy.

    Args:
        manifest: manifest of the node.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._first = self._last = -1
        self._begin: datetime
        self._sources: dict[str, int] = {"": 0}
        self._message_sources: list[str] = [""]
        self._numbers = np.zeros(1, np.uint16)
        self._terms: dict[str, NDArray[np.float64]] = {}

    def add(self, sample: SampleView, terms: Mapping[str, Any] | None = None) -> None:
        """Add a sample, with the reward terms of the timestep that it closes."""
        step = sample.step
        if self._first < 0 or step == 0:
            self._start(sample)
        row = self._last = step - self._first
        self._values[row] = sample.fault_free_values
        message, manifest = sample.message, self._manifest
        if manifest.actuators:
            self._effective[row] = sample.effective
            if message.sources != self._message_sources:
                self._message_sources = list(message.sources)
                numbers = [self._sources.setdefault(name, len(self._sources)) for name in self._message_sources]
                self._numbers = np.array(numbers, np.uint16)
            shape = (manifest.slots, len(manifest.actuators))
            self._source_index[row] = self._numbers[codec.indices(message.source_index, shape, "source_index")][
                sample.slot
            ]
        for name, term in (terms or {}).items():
            if name not in self._terms:
                self._terms[name] = np.full(len(self._values) - 1, np.nan)
            self._terms[name][row - 1] = term

    def _start(self, sample: SampleView) -> None:
        manifest = self._manifest
        self._first, self._begin, self._terms = sample.step, sample.time, {}
        rows = manifest.steps - self._first + 1
        self._values = np.full((rows, len(manifest.names)), np.nan)
        self._effective = np.full((rows, len(manifest.actuators)), np.nan)
        self._source_index = np.zeros((rows, len(manifest.actuators)), np.uint16)

    def trace(self, source_names: Mapping[str, str] | None = None) -> EpisodeTrace:
        """Return the samples so far.

        Args:
            source_names: names to show instead of those of value sources on the bus.

        Raises:
            UsageError: no timestep has been recorded.
        """
        if self._last < 1:
            raise UsageError("no timestep was recorded")
        rows = slice(0, self._last + 1)
        sources = tuple((source_names or {}).get(name, name) for name in self._sources)
        return EpisodeTrace(
            self._manifest, self._begin, self._values[rows], self._effective[rows], self._source_index[rows],
            sources, {name: term[: self._last] for name, term in self._terms.items()},
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ControllerTrace:
    """Samples and weather of a controller's episodes, besides their metrics.

    Attributes:
        trace: samples of the first episode.
        weathers: weather of each episode; None where there is no weather file.
        reward: the environment's reward; None without one.
    """

    trace: EpisodeTrace
    weathers: tuple[WeatherTrace | None, ...] = ()
    reward: Reward | None = None


def weather_trace(series: WeatherSeries, span: timedelta) -> WeatherTrace:
    """Return the weather of an episode of length `span` from a node's reply to a query of `WEATHER_COLUMNS`."""
    table = np.frombuffer(series.values, "<f8").reshape(-1, len(series.columns))
    table = table[: max(round(span.total_seconds() / series.step_s), 1)]
    temperature, solar = table[:, 0].copy(), table[:, 1] * 3600.0 / series.step_s
    return WeatherTrace(series.step_s, temperature, solar)


def episode_weather(bus: Bus | None, manifest: Manifest, slot: int = 0) -> WeatherTrace | None:
    """Query the weather of the running episode; None without a bus, or for a plant that has no weather file."""
    if bus is None:
        return None
    try:
        series = bus.weather(manifest.node, WEATHER_COLUMNS, slot)
    except ZenostatError:
        return None
    return weather_trace(series, manifest.steps * manifest.timestep)
