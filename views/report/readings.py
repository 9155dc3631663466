"""Values behind the axes of a figure, in a few letters each, for the script of a page that shows them at the pointer.

A figure's code names what can be read (`read_lines`, `read_cells`); `readings` returns it as JSON for the page. Values
are stored as fractions of their range: 4,094 steps of 12 bits, times in those of 24 bits.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.views.report.quantities import Times
from zenostat.views.report.theme import LIGHT

CODE = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"
"""A letter is a number from 0 to 63."""
_MIN_REPEATS = 4
_VARIABLES = {color: f"var(--{name})" for name, color in LIGHT.items()}
_READ = "_zenostat_readings"


@dataclass(frozen=True)
class Series:
    """Values over the axis of a line, or over days and hours (`x` is empty then).

    Attributes:
        label: name of the line.
        color: its color; "" for none.
        x: places on the axis, rising, shape (values,).
        y: values, shape (values,) or (days, 24); NaN where there is none.
        is_step: whether a value holds until the next place.
        texts: if given, values are places in this list of texts.
    """

    label: str
    color: str
    x: Floats
    y: Floats
    is_step: bool = False
    texts: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Reading:
    axis: Any
    unit: str
    begin: str
    series: list[Series] = field(default_factory=list)


def read_series(axis: Any, unit: str, series: Sequence[Series], first: np.datetime64 | None = None) -> None:
    """Let a page show these values of an axis.

    Args:
        axis: the Matplotlib axes.
        unit: unit of the values.
        series: the values.
        first: the axis counts days since the midnight before this time; None: it is a share in percent.
    """
    begin = "" if first is None else str(first.astype("datetime64[D]"))
    readings: list[_Reading] = axis.figure.__dict__.setdefault(_READ, [])
    axis.set_gid(f"reading-{len(readings)}")
    readings.append(_Reading(axis, unit, begin, list(series)))


def read_lines(axis: Any, unit: str, first: np.datetime64 | None = None, labels: Sequence[str] = ()) -> None:
    """Let a page show the values of all lines of an axis, with the lines' own labels if none are given."""
    lines = []
    for place, line in enumerate(axis.get_lines()):
        own = line.get_label()
        label = labels[place] if labels else "" if own.startswith("_") else own
        places, values = (np.asarray(data, float) for data in line.get_data())
        is_step = line.get_drawstyle() == "steps-post"
        lines.append(Series(label, line.get_color(), places, values, is_step))
    read_series(axis, unit, lines, first)


def read_cells(axis: Any, unit: str, label: str, days: Times, grid: Floats) -> None:
    """Let a page show the cells of a carpet, shape (days, 24)."""
    read_series(axis, unit, [Series(label, "", np.empty(0), grid)], days[0])


def readings(figure: Any) -> str:
    """Return what can be read in a drawn Matplotlib figure as JSON that may stand in HTML; "" for nothing."""
    entries = [_entry(reading) for reading in figure.__dict__.get(_READ, [])]
    text = json.dumps(entries, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return text if entries else ""


def _entry(reading: _Reading) -> dict[str, Any]:
    axis = reading.axis
    box, (width, height) = axis.get_position(), 72.0 * axis.figure.get_size_inches()
    edges = (box.x0 * width, (1.0 - box.y1) * height, box.x1 * width, (1.0 - box.y0) * height)
    return {
        "box": [round(float(edge), 2) for edge in edges],
        "span": [float(limit) for limit in axis.get_xlim()],
        "begin": reading.begin,
        "title": axis.get_title(loc="left"),
        "unit": reading.unit,
        "series": [_series(series) for series in reading.series],
    }


def _series(series: Series) -> dict[str, Any]:
    entry: dict[str, Any] = {"label": series.label, "color": _VARIABLES.get(series.color, series.color)}
    if series.x.size:
        entry["x"] = _places(series.x)
    entry["y"] = _packed(series.y.ravel(), 2)
    return entry | ({"step": 1} if series.is_step else {}) | ({"texts": series.texts} if series.texts else {})


def _places(x: Floats) -> list[Any]:
    """Return the first place and the distance of the others if that is the same for all, else packed places."""
    gaps = np.diff(x)
    if gaps.size and np.allclose(gaps, gaps[0], rtol=1e-6):
        return [float(x[0]), float(gaps.mean())]
    return _packed(x, 4)


def _packed(values: Floats, letters: int) -> list[Any]:
    """Return the lowest and highest value, and each value in letters; what repeats has its number between asterisks."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    top = 64**letters - 2
    scaled = (values - low) / ((high - low) or 1.0) * top
    levels = np.where(np.isfinite(scaled), np.rint(np.nan_to_num(scaled)), top + 1).astype(int).tolist()
    parts = []
    for level, equal in groupby(levels):
        code = "".join(CODE[level >> 6 * place & 63] for place in reversed(range(letters)))
        count = len(list(equal))
        parts.append(f"{code}*{count}*" if count >= _MIN_REPEATS else code * count)
    return [low, high, "".join(parts)]
