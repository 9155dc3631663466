"""matplotlib's artists of a picture, and the corners of what they draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.views.rendering.text import Color

Dash = Literal["-", "--"]
"""matplotlib's style of a line."""

WIDTH, HEIGHT = 960, 640
LEFT, RIGHT = 46, 700
"""Pixels between which the time axis extends; the legends are to the right of it."""

INK: Color = (0.13, 0.15, 0.18)
MUTED: Color = (0.42, 0.45, 0.50)
_GRID: Color = (0.89, 0.90, 0.91)
_BEHIND, _STRIPES, _AREA, _LINE, _DOT = 0.2, 0.1, 1.0, 3.0, 4.0


def grid(axes: Any) -> LineCollection:
    """Create the grid of a plot, without lines."""
    lines = LineCollection([], colors=[_GRID], linewidths=0.7, zorder=_BEHIND)
    axes.add_collection(lines, autolim=False)
    return lines


def grid_lines(
    x_limits: tuple[float, float], x_ticks: Sequence[float], y_limits: tuple[float, float], y_ticks: Sequence[float]
) -> list[list[tuple[float, float]]]:
    """Return the grid's lines at the ticks, with an edge at the left and at the bottom."""
    vertical = [[(x, y_limits[0]), (x, y_limits[1])] for x in (x_limits[0], *x_ticks)]
    return vertical + [[(x_limits[0], y), (x_limits[1], y)] for y in (y_limits[0], *y_ticks)]


def line(axes: Any, color: Color, dash: Dash, width: float, rank: int = 0, alpha: float = 1.0) -> Line2D:
    """Create a line without data."""
    drawn = Line2D(
        [], [], color=color, linestyle=dash, linewidth=width, alpha=alpha, solid_capstyle="butt",
        zorder=_LINE + 0.01 * rank,
    )  # fmt: skip
    return _added(axes, drawn)


def dot(axes: Any, color: Color, rank: int = 0) -> Line2D:
    """Create the marker of the latest value, without data; the edge of the plot does not cut it."""
    marker = Line2D(
        [], [], color=color, linestyle="none", marker="o", markersize=3.8, markeredgewidth=0.0, clip_on=False,
        zorder=_DOT + 0.01 * rank,
    )  # fmt: skip
    return _added(axes, marker)


def _added(axes: Any, drawn: Line2D) -> Line2D:
    is_clipped = drawn.get_clip_on()
    axes.add_line(drawn)
    drawn.set_clip_on(is_clipped)
    return drawn


def area(axes: Any, color: Color, alpha: float) -> Polygon:
    """Create a filled area without data."""
    patch = Polygon(np.zeros((1, 2)), closed=True, facecolor=(*color, alpha), linewidth=0.0, zorder=_AREA)
    axes.add_patch(patch)
    return patch


def stripes(axes: Any, color: Color, alpha: float) -> PolyCollection:
    """Create vertical stripes over the height of a plot, without data; their y extends from 0 to 1."""
    drawn = PolyCollection([], facecolors=[(*color, alpha)], linewidths=0.0, zorder=_STRIPES)
    drawn.set_transform(axes.get_xaxis_transform())
    axes.add_collection(drawn, autolim=False)
    return drawn


def swatch_line(figure: Any, x: float, y: float, length: float, color: Color, dash: Dash, width: float) -> Line2D:
    """Draw a line of a legend, `x` and `y` pixels from the upper left corner of the figure."""
    drawn = Line2D(
        [x / WIDTH, (x + length) / WIDTH], [1.0 - y / HEIGHT] * 2, color=color, linestyle=dash, linewidth=width,
        solid_capstyle="butt", transform=figure.transFigure,
    )  # fmt: skip
    figure.add_artist(drawn)
    return drawn


def swatch_area(figure: Any, x: float, y: float, length: float, color: Color, alpha: float) -> Rectangle:
    """Draw a rectangle of a legend, its middle `y` pixels from the upper edge of the figure."""
    half = 4.5
    patch = Rectangle(
        (x / WIDTH, 1.0 - (y + half) / HEIGHT), length / WIDTH, 2.0 * half / HEIGHT, facecolor=(*color, alpha),
        linewidth=0.0, transform=figure.transFigure,
    )  # fmt: skip
    figure.add_artist(patch)
    return patch


def corners(hours: Floats, values: Floats, *, held: bool) -> tuple[Floats, Floats]:
    """Return the corners of a curve; one that is `held` has each value from the previous sample to its own."""
    return (np.repeat(hours, 2)[1:-1], np.repeat(values[1:], 2)) if held else (hours, values)


def outline(hours: Floats, low: Floats, high: Floats, *, held: bool) -> Floats:
    """Return the corners of the area between two curves, shape (corners, 2), without samples that have no values."""
    (x, low), (_, high) = corners(hours, low, held=held), corners(hours, high, held=held)
    known = ~(np.isnan(low) | np.isnan(high))
    if not known.any():
        return np.zeros((1, 2))
    x, low, high = x[known], low[known], high[known]
    return np.column_stack([np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]])])


def stripe_corners(hours: Floats, on: NDArray[np.bool_]) -> list[list[tuple[float, float]]]:
    """Return a rectangle for each sequence of timesteps that are `on`, as corners of `stripes`."""
    switches = np.flatnonzero(np.diff(np.concatenate([[False], on[1:], [False]]).astype(np.int8)))
    return [
        [(hours[first], 0.0), (hours[last], 0.0), (hours[last], 1.0), (hours[first], 1.0)]
        for first, last in switches.reshape(-1, 2).tolist()
    ]
