"""A picture of a history: lines over simulated time, a panel for each unit."""

from __future__ import annotations

import io
from typing import Any

from zenostat.bridge.client.history import History
from zenostat.metrics.labels import label, unit_label
from zenostat.topics.extras import import_extra
from zenostat.views.report.figures.base import draw, legend_above
from zenostat.views.report.theme import LIGHT, series_color, series_dashes

_DPI = 110
_PANEL_IN = 2.3


def draw_history(history: History) -> bytes:
    """Return a PNG file; the same history gives the same file. Not for several threads at a time."""
    dates = import_extra("matplotlib.dates", "mcp", "a plot")
    units: dict[str, list[int]] = {}
    for column, unit in enumerate(history.units):
        units.setdefault(unit, []).append(column)

    def fill(figure: Any) -> None:
        axes = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (unit, columns) in zip(axes, units.items(), strict=True):
            for place, column in enumerate(columns):
                color = series_color(place + 1)
                if history.stride > 1 and history.lows is not None and history.highs is not None:
                    lows, highs = history.lows[:, column], history.highs[:, column]
                    axis.fill_between(history.time, lows, highs, color=color, alpha=0.2)
                name = label(history.points[column])
                axis.plot(history.time, history.values[:, column], color=color, ls=series_dashes(place + 1), label=name)
            axis.set_ylabel(unit_label(unit))
            legend_above(axis)
        locator = dates.AutoDateLocator()
        axes[-1].xaxis.set_major_locator(locator)
        axes[-1].xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))

    figure = draw("history", _PANEL_IN * len(units) + 0.4, fill)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=_DPI, facecolor=LIGHT["page"], metadata={"Software": None})
    return file.getvalue()
