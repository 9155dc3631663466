"""The weather that was drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.topics.arrays import Floats
from zenostat.views.report.figures.base import (
    LEGEND_ROW_PT,
    LONG_DAYS,
    Days,
    Figure,
    daily,
    draw,
    legend_above,
    legend_text,
    mark_days,
)
from zenostat.views.report.readings import read_lines
from zenostat.views.report.theme import LIGHT, series_color, series_dashes

_MAX_EPISODES = 6
_MAX_LABELS = 3


def weather(episodes: Sequence[tuple[str, EpisodeWeather]], begin: np.datetime64) -> Figure | None:
    """Outdoor temperature and solar radiation; episodes with the same weather are drawn once.

    Args:
        episodes: label and weather of each episode.
        begin: time at which the episodes begin.
    """
    distinct = _distinct(episodes)
    if not distinct:
        return None
    shown = distinct[:_MAX_EPISODES]
    days = max(len(series.temperature) * series.step_s / 86400.0 for _, series in shown)
    offset = float((begin - begin.astype("datetime64[D]").astype("datetime64[s]")) / np.timedelta64(1, "s")) / 86400.0
    has_solar = any(np.isfinite(series.solar).any() for _, series in shown)
    is_long = days > LONG_DAYS

    def fill(figure: Any) -> None:
        axes = figure.subplots(1 + has_solar, 1, sharex=True, squeeze=False, height_ratios=[1.5, 1.0][: 1 + has_solar])
        for place, (label, series) in enumerate(shown):
            where: Any = offset + (np.arange(len(series.temperature)) + 1) * series.step_s / 86400.0
            text = legend_text(label) if len(shown) > 1 else None
            _temperature(axes[0, 0], series.temperature, where, place, text, is_long=is_long, is_alone=len(shown) == 1)
            if has_solar:
                _solar(axes[1, 0], series, where, place, len(shown), is_long=is_long)
        axes[0, 0].set_ylabel("°C")
        labels = [label for label, _ in shown] if len(shown) > 1 else ["daily mean" if is_long else ""]
        read_lines(axes[0, 0], "°C", begin, labels)
        if has_solar:
            solar_unit = "kWh/m² a day" if is_long else "W/m²"
            axes[1, 0].set_ylabel(solar_unit)
            read_lines(axes[1, 0], solar_unit, begin, labels if len(shown) > 1 else [""])
            axes[1, 0].set_title("Global horizontal radiation")
            axes[1, 0].set_ylim(bottom=0.0)
        rows = legend_above(axes[0, 0]) if len(shown) > 1 else 0
        axes[0, 0].set_title("Outdoor temperature", pad=5.0 + LEGEND_ROW_PT * rows)
        mark_days(axes[-1, 0], begin, offset + days)

    data: dict[str, Sequence[Any]] = {}
    for label, series in distinct:
        data[f"{label}: outdoor temperature (degC)"] = series.temperature.tolist()
        data[f"{label}: global horizontal radiation (W/m2)"] = series.solar.tolist()
    content = ": daily mean and range of the temperature" if is_long else ", as drawn, noise included"
    caption = f"Of the whole run period{content}."
    if len(distinct) > len(shown):
        caption += f" The first {len(shown)} of {len(distinct)} different weathers are drawn."
    temperatures = np.concatenate([series.temperature for _, series in shown])
    alt = f"Outdoor temperature from {np.nanmin(temperatures):.1f} to {np.nanmax(temperatures):.1f} °C"
    solar = " and solar radiation" if has_solar else ""
    if not has_solar:
        caption += " Not measured: solar radiation."
    legend_in = LEGEND_ROW_PT / 72.0 * len(shown) if len(shown) > 1 else 0.0  # at most a row for each
    return Figure(
        "weather", "Weather", caption, f"{alt}{solar} over time.",
        draw("weather", 1.8 + 1.2 * has_solar + legend_in, fill),
        _same_length(data),
    )  # fmt: skip


def _distinct(episodes: Sequence[tuple[str, EpisodeWeather]]) -> list[tuple[str, EpisodeWeather]]:
    groups: dict[bytes, tuple[list[str], EpisodeWeather]] = {}
    for label, series in episodes:
        key = series.temperature.tobytes() + series.solar.tobytes()
        groups.setdefault(key, ([], series))[0].append(label)
    return [(_label(labels), series) for labels, series in groups.values()]


def _label(labels: Sequence[str]) -> str:
    """Return the label of episodes with the same weather: all of them, or the first and their number."""
    distinct = list(dict.fromkeys(labels))
    return ", ".join(distinct) if len(distinct) <= _MAX_LABELS else f"{distinct[0]} and {len(distinct) - 1} more"


def _temperature(
    axis: Any, values: Floats, where: Days, place: int, label: str | None, *, is_long: bool, is_alone: bool
) -> None:
    color = LIGHT["warm"] if is_alone else series_color(place)
    if not is_long:
        axis.plot(where, values, color=color, linestyle=series_dashes(place), label=label)
        return
    middle, low, mean, high = daily(values, where - 1e-6)
    axis.plot(middle, mean, color=color, linestyle=series_dashes(place), linewidth=1.1, label=label)
    if is_alone:
        axis.fill_between(middle, low, high, color=color, alpha=0.2, linewidth=0)


def _solar(axis: Any, series: EpisodeWeather, where: Days, place: int, count: int, *, is_long: bool) -> None:
    step_days = series.step_s / 86400.0
    color = LIGHT["solar"] if count == 1 else series_color(place)
    if is_long:
        middle, _, mean, _ = daily(series.solar, where - 1e-6)
        where, values = middle, mean * 24.0 / 1e3
    else:
        where, values = where - step_days / 2, series.solar
    if count == 1:
        axis.fill_between(where, 0.0, values, color=color, alpha=0.3, linewidth=0)
    axis.plot(where, values, color=color, linestyle=series_dashes(place), linewidth=1.0)


def _same_length(data: dict[str, Sequence[Any]]) -> dict[str, Sequence[Any]]:
    length = max(len(column) for column in data.values())
    return {"row": list(range(length))} | {
        name: [*column, *([float("nan")] * (length - len(column)))] for name, column in data.items()
    }
