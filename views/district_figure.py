"""A figure that compares runs of a district: the loading of its transformers, and who draws how much."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.metrics.labels import label
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra
from zenostat.views.live.grid_series import GridPoints, grid_points
from zenostat.views.report.theme import LIGHT, SERIES, style

_WIDTH_IN, _HEIGHT_IN, _DPI = 12.0, 6.4, 120


def draw_district(runs: Mapping[str, Trajectory], path: Path, limits: Mapping[str, float]) -> None:
    """Draw runs of the same district beside each other, and write a PNG file.

    Args:
        runs: by their titles.
        path: of the file.
        limits: of loadings, by point.

    Raises:
        InvalidConfig: the district has no grid, or Matplotlib is not installed.
    """
    with requires_extra("plots", "a figure", "Matplotlib"):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.dates import DateFormatter
        from matplotlib.figure import Figure
        from matplotlib.style import context
    formatter: Any = DateFormatter("%d %b\n%H:%M")  # type: ignore[no-untyped-call]
    points = {title: _points(run) for title, run in runs.items()}
    with context(style("district")):
        figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), dpi=_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        figure.set_facecolor(LIGHT["page"])
        axes = figure.subplots(2, len(runs), sharex="col", sharey="row", squeeze=False, height_ratios=(2, 3))
        for column, (title, run) in enumerate(runs.items()):
            top, bottom = axes[0][column], axes[1][column]
            _draw_loading(top, run, limits)
            top.set_title(title, fontsize=10.0)
            _draw_powers(bottom, run, points[title])
            bottom.xaxis.set_major_formatter(formatter)
        axes[0][0].set_ylabel("Loading, %")
        axes[1][0].set_ylabel("Power, kW")
        handles, names = axes[1][0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=min(len(names), 8), frameon=False)
        figure.savefig(path)


def _points(run: Trajectory) -> GridPoints:
    points = grid_points(run.manifest)
    if points is None:
        raise InvalidConfig(f"node {run.manifest.node!r} has no grid: no sensors of loading and voltage")
    return points


def _draw_loading(axes: Any, run: Trajectory, limits: Mapping[str, float]) -> None:
    highest = max((float(run[name].max()) for name in limits), default=0.0)
    axes.set_ylim(0.0, 1.25 * max(highest, *limits.values(), axes.get_ylim()[1] / 1.25))
    for place, (name, high) in enumerate(limits.items()):
        ratio = run[name]
        axes.step(run.time, ratio, where="pre", color=SERIES[1 + place], linewidth=1.4)
        axes.axhline(high, color=LIGHT["warm"], linewidth=1.0)
        axes.fill_between(
            run.time, high, np.maximum(ratio, high), step="pre", color=LIGHT["warm"], alpha=0.35, linewidth=0
        )
        above_h = float((ratio[1:] > high).sum()) * run.manifest.step_s / 3600.0
        text = f"{label(name.rpartition('.')[2])}: at most {ratio[1:].max():.0f} %, {above_h:g} h above {high:g} %"
        axes.text(0.01, 0.96 - 0.1 * place, text, transform=axes.transAxes, va="top", color=LIGHT["ink"])


def _draw_powers(axes: Any, run: Trajectory, points: GridPoints) -> None:
    """Stack what is drawn above zero and what is fed in below it; the line is the sum."""
    names = [label(run.manifest.points[i].name.rpartition(".")[2].removesuffix("_power")) for i in points.powers]
    powers = run.values[:, list(points.powers)].T * np.array(points.signs)[:, None] / 1e3
    above, below = np.zeros(len(run)), np.zeros(len(run))
    for place, (name, power) in enumerate(zip(names, powers, strict=True)):
        drawn, fed = np.maximum(power, 0.0), np.minimum(power, 0.0)
        color = _COLORS[place % len(_COLORS)]
        axes.fill_between(run.time, above, above + drawn, step="pre", color=color, alpha=0.8, linewidth=0, label=name)
        axes.fill_between(run.time, below, below + fed, step="pre", color=color, alpha=0.8, linewidth=0)
        above, below = above + drawn, below + fed
    axes.step(run.time, powers.sum(axis=0), where="pre", color=LIGHT["ink"], linewidth=1.2, label="Net")
    axes.axhline(0.0, color=LIGHT["line"], linewidth=0.7)


_COLORS = ("#0b6bcb", "#c2500a", "#8446c4", "#d9a83c", "#1b7f4d", "#e0607e", "#7a1f3d", "#5aa9f5", "#66707e")
