"""Figures of a benchmark's results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from zenostat.lab.benchmark.definition import BUILDINGS
from zenostat.lab.benchmark.results import Results
from zenostat.lab.benchmark.scores import Interval, Scores, relative_linear, score_rows
from zenostat.topics.extras import import_extra
from zenostat.views.report.figures.base import draw
from zenostat.views.report.svg import save
from zenostat.views.report.theme import LIGHT

_LOWEST = -0.6
"""Scores below are drawn as an arrow with their number, so that one bad controller does not hide the rest."""


def write_figures(results: Results, folder: Path) -> list[Path]:
    """Write `scores` and `buildings` as SVG and PNG files, and return the paths of the PNG files.

    Raises:
        InvalidConfig: Matplotlib is not installed; or see `score_rows`.
    """
    import_extra("matplotlib", "plots", "figures")
    scores = score_rows(results.rows.values())
    linear = score_rows(results.rows.values(), relative_linear)
    buildings = list(scores[0].buildings)
    height_in = 0.8 + 0.24 * len(scores)
    names = [of.controller for of in scores][::-1]
    figures: dict[str, tuple[float, Callable[[Any], None]]] = {
        "scores": (height_in, lambda figure: _fill_scores(figure, names, scores, linear)),
        "buildings": (
            (height_in + 0.2) * math.ceil(len(buildings) / 3),
            lambda figure: _fill_buildings(figure, names, scores, buildings),
        ),
    }
    folder.mkdir(parents=True, exist_ok=True)
    return [save(draw(name, height, fill), folder, name)[1] for name, (height, fill) in figures.items()]


def _fill_scores(figure: Any, names: Sequence[str], scores: Sequence[Scores], linear: Sequence[Scores]) -> None:
    axes = figure.subplots(1, 2, sharey=True)
    for axis, title, of_reward in zip(axes, ("occupied cost", "linear reward"), (scores, linear), strict=True):
        intervals = {of.controller: of.overall for of in of_reward}
        _draw_intervals(axis, names, intervals, _limits(intervals.values()))
        axis.set_title(title)
        axis.set_xlabel("score (0: baseline control)")


def _fill_buildings(figure: Any, names: Sequence[str], scores: Sequence[Scores], buildings: Sequence[str]) -> None:
    columns = min(len(buildings), 3)
    axes = figure.subplots(math.ceil(len(buildings) / columns), columns, sharey=True, squeeze=False).ravel()
    episodes = {(of.controller, building): of.episodes(building) for of in scores for building in buildings}
    best = max(values.max() for values in episodes.values())
    limits = _limits((interval for of in scores for interval in of.buildings.values()), best)
    for axis, building in zip(axes, buildings, strict=False):
        _draw_intervals(axis, names, {of.controller: of.buildings[building] for of in scores}, limits)
        for of in scores:
            if of.buildings[building].value < _LOWEST:
                continue
            values = episodes[of.controller, building]
            shown = values[values >= _LOWEST]
            places = [names.index(of.controller)] * len(shown)
            axis.plot(shown, places, "o", color=LIGHT["series-1"], markersize=2.2, alpha=0.6, zorder=1)
        axis.set_title(BUILDINGS.get(building, building))
    for axis in axes[len(buildings) :]:
        axis.set_visible(False)
    figure.supxlabel(
        "score (0: baseline control; points: episodes, means over trainings)", fontsize=8.0, color=LIGHT["muted"]
    )


def _limits(intervals: Iterable[Interval], best: float = 0.05) -> tuple[float, float]:
    """Return the limits of an axis, on which 0, `best` and the ends of all intervals have a place."""
    known = [value for i in intervals for value in (i.value, i.low, i.high) if not math.isnan(value)]
    low, high = max(min(*known, -0.05), _LOWEST), max(*known, best)
    return low - 0.06 * (high - low), high + 0.06 * (high - low)


def _draw_intervals(
    axis: Any, names: Sequence[str], intervals: Mapping[str, Interval], limits: tuple[float, float]
) -> None:
    """Draw a line for each controller, the last one at the top."""
    axis.axvline(0.0, color=LIGHT["line"], linewidth=0.9, zorder=0)
    for place, name in enumerate(names):
        interval = intervals[name]
        color = LIGHT["series-1"] if name == "baseline" else LIGHT["series-2"]
        if interval.value < _LOWEST:
            axis.plot([_LOWEST], [place], "<", color=LIGHT["series-3"], markersize=5)
            axis.text(
                _LOWEST + 0.03, place, f"{interval.value:.1f}", color=LIGHT["series-3"], fontsize=7.5, va="center"
            )
            continue
        if not math.isnan(interval.low):
            ends = [max(interval.low, _LOWEST), interval.high]
            axis.plot(ends, [place, place], color=color, linewidth=4.0, alpha=0.35, solid_capstyle="butt")
        axis.plot([interval.value], [place], "|", color=color, markersize=9, markeredgewidth=2.0)
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(-0.6, len(names) - 0.4)
    axis.set_xlim(*limits)
    axis.grid(visible=True, axis="x")
    axis.grid(visible=False, axis="y")
