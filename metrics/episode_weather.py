"""Weather of an episode: outdoor temperature and solar radiation, as drawn and with its noise."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta

import numpy as np

from zenostat.bridge.client.bus import Bus
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import ZenostatError
from zenostat.topics.messages import Manifest, WeatherSeries
from zenostat.topics.recording import WEATHER_COLUMNS, RecordedWeather


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeWeather:
    """The weather of one episode, as drawn and with its noise.

    Attributes:
        step_s: Length of a row in seconds.
        temperature: Outdoor air temperature at the end of each row, degC, shape (rows,); NaN where unknown.
        solar: Global horizontal radiation in each row, W/m2, shape (rows,); NaN where unknown.
    """

    step_s: float
    temperature: Floats
    solar: Floats


def read_weather(series: WeatherSeries | RecordedWeather, span: timedelta) -> EpisodeWeather:
    """Return the weather of an episode of length `span` from `WEATHER_COLUMNS` of a node's reply or a recording."""
    table = np.frombuffer(series.values, "<f8").reshape(-1, len(series.columns))
    table = table[: max(round(span.total_seconds() / series.step_s), 1)]
    # EnergyPlus takes the radiation of a row for W/m2, however many rows an hour has.
    return EpisodeWeather(series.step_s, table[:, 0].copy(), table[:, 1].copy())


def query_weather(bus: Bus | None, manifest: Manifest) -> EpisodeWeather | None:
    """Query the weather of the running episode; None without a bus, or for a plant that has no weather file."""
    if bus is None:
        return None
    try:
        series = bus.weather(manifest.node, WEATHER_COLUMNS)
    except ZenostatError:
        return None
    return read_weather(series, manifest.steps * manifest.timestep)
