"""Colors and typography of figures and pages, light and dark.

Figures are drawn with the light colors. On a page each of these colors becomes a CSS variable, so that the browser's
preference for dark pages applies to figures too.
"""

from __future__ import annotations

from typing import Any

LIGHT = {
    "page": "#ffffff", "ink": "#1b2430", "muted": "#5a6675", "line": "#c9d0d8", "grid": "#e6eaee", "panel": "#f4f6f8",
    "series-1": "#66707e", "series-2": "#0b6bcb", "series-3": "#c2500a", "series-4": "#1b7f4d", "series-5": "#8446c4",
    "series-6": "#946a00", "warm": "#c8470f", "cool": "#2063c4", "solar": "#a87400", "occupied": "#eef1d9",
}  # fmt: skip
"""Colors by name of the CSS variable, on light pages; all differ, and text colors have a contrast of at least 4.5."""

DARK = {
    "page": "#12161c", "ink": "#e7ebf0", "muted": "#a0abb8", "line": "#46505c", "grid": "#2a323b", "panel": "#1b2129",
    "series-1": "#9ba7b5", "series-2": "#5aa9f5", "series-3": "#f0894a", "series-4": "#4fbf88", "series-5": "#b98cec",
    "series-6": "#d3a83a", "warm": "#f0824e", "cool": "#6ba4f2", "solar": "#d9a83c", "occupied": "#272c1e",
}  # fmt: skip
"""Colors on dark pages."""

SERIES = tuple(LIGHT[f"series-{number}"] for number in range(1, 7))
DASHES: tuple[Any, ...] = ("solid", "solid", (0, (5, 2)), (0, (1, 1.4)), (0, (6, 2, 1, 2)), (0, (3, 1.5)))
"""Line styles of the controllers, so that lines can also be told apart without colors."""

FULL_IN, HALF_IN = 8.6, 4.2
"""Widths of figures, inch: a page's full width, and half of it."""


def series_color(place: int) -> str:
    """Return the color of the controller at this place, from 0; the first is usually the baseline control."""
    return SERIES[place % len(SERIES)]


def series_dashes(place: int) -> Any:
    """Return the line style of the controller at this place."""
    return DASHES[place % len(DASHES)]


def style(salt: str) -> Any:
    """Return Matplotlib's settings of a figure; `salt` makes the ids within its SVG unique and reproducible."""
    return {
        "font.family": "sans-serif",
        "font.sans-serif": ["DejaVu Sans"],
        "font.size": 8.0,
        "axes.titlesize": 8.5,
        "axes.titleweight": "normal",
        "axes.titlelocation": "left",
        "axes.titlepad": 5.0,
        "axes.titlecolor": LIGHT["ink"],
        "axes.labelsize": 8.0,
        "axes.labelcolor": LIGHT["muted"],
        "axes.edgecolor": LIGHT["line"],
        "axes.facecolor": "none",
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.grid.axis": "y",
        "axes.axisbelow": True,
        "grid.color": LIGHT["grid"],
        "grid.linewidth": 0.7,
        "xtick.color": LIGHT["line"],
        "ytick.color": LIGHT["line"],
        "xtick.labelcolor": LIGHT["muted"],
        "ytick.labelcolor": LIGHT["muted"],
        "xtick.labelsize": 7.5,
        "ytick.labelsize": 7.5,
        "xtick.major.size": 3.0,
        "ytick.major.size": 0.0,
        "text.color": LIGHT["ink"],
        "text.parse_math": False,  # names may contain dollar signs
        "legend.frameon": False,
        "legend.fontsize": 8.0,
        "lines.linewidth": 1.3,
        "lines.solid_joinstyle": "round",
        "patch.linewidth": 0.0,
        "figure.facecolor": "none",
        "savefig.facecolor": "none",
        "figure.constrained_layout.use": True,
        "image.composite_image": False,
        "path.simplify": True,
        "path.simplify_threshold": 0.2,
        "svg.fonttype": "none",
        "svg.hashsalt": salt,
        "axes.unicode_minus": True,
    }
