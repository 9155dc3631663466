"""Line charts for the terminal, of braille dots or, where the terminal has none, of asterisks.

A chart is a list of `rich.text.Text` lines. It needs no terminal: in a pipe, the same lines appear without color.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import ceil, floor, log10

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from zenostat.topics.arrays import Floats

COLORS = ("bright_cyan", "bright_yellow", "bright_magenta", "bright_green", "bright_red", "bright_blue")
"""Colors of the lines of a panel, in turn."""

_ACROSS, _DOWN = 2, 4
"""Dots in a character, across and down."""

_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bits of the dots of a braille character, in rows from the top."""

_OVERSAMPLING = 8
"""Points of a line that are evaluated per column of dots."""

_TIME_STEPS_S = (
    *(60, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200),
    *(86400 * days for days in (1, 2, 7, 14, 28, 56, 84, 168)),
)
_TIME_LABEL = 9
"""Columns per label of the time axis."""


@dataclass(frozen=True, slots=True)
class Line:
    """A line of a chart.

    Attributes:
        values: shape (samples,); NaN is a gap.
        lows, highs: the range that each value stands for, shape (samples,).
        color: a style of rich.
    """

    values: Floats
    lows: Floats
    highs: Floats
    color: str = ""


@dataclass(frozen=True, slots=True)
class Scale:
    """The vertical axis: its ends, and the distance of its labels."""

    low: float
    high: float
    step: float

    def label(self, value: float) -> str:
        """Return a value as the axis shows it."""
        digits = next((n for n in range(7) if abs(round(self.step, n) - self.step) < 1e-6 * self.step), None)
        if digits is not None and max(abs(self.low), abs(self.high)) < 1e9:
            return f"{value:,.{digits}f}"
        digits = floor(log10(max(abs(self.low), abs(self.high)) / self.step)) + 3  # of steps of 2.5, too
        return f"{value:.{digits}g}"

    def ticks(self) -> list[float]:
        """Return the values with labels, in ascending order."""
        return [self.low + self.step * k for k in range(round((self.high - self.low) / self.step) + 1)]


def scale_of(lines: Sequence[Line], rows: int) -> Scale:
    """Return a scale with round numbers that has room for all finite values, and about a label per two rows."""
    finite = [array[np.isfinite(array)] for line in lines for array in (line.values, line.lows, line.highs)]
    joined = np.concatenate(finite)
    low, high = (float(joined.min()), float(joined.max())) if joined.size else (0.0, 1.0)
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        margin = 0.05 * abs(low) or 0.5
        low, high = low - margin, high + margin
    step = _round_step((high - low) / max(2, rows // 2))
    return Scale(floor(low / step + 1e-9) * step, ceil(high / step - 1e-9) * step, step)


def _round_step(width: float) -> float:
    """Return 1, 2, 2.5 or 5 times a power of ten, at least `width`."""
    power = 10.0 ** floor(log10(width))
    return next(factor * power for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= width * (1 - 1e-9))


def chart(
    lines: Sequence[Line],
    times: Sequence[datetime],
    *,
    width: int,
    rows: int,
    scale: Scale,
    margin: int = 0,
    is_unicode: bool = True,
) -> list[Text]:
    """Draw lines over time.

    Args:
        lines: over the same samples; of two in one place, the later one gives the color.
        times: of the samples, at equal distances.
        width: characters per line of text, the axis included.
        rows: lines of text above the time axis.
        scale: of the values.
        margin: smallest width of the labels of the values, so that charts below each other have one time axis.
        is_unicode: whether the terminal has braille characters and box-drawing characters.
    """
    labels = _value_labels(scale, rows)
    margin = max(margin, label_width(scale))
    columns = max(10, width - margin - 2)
    cells, colors = _cells(lines, columns, rows, scale)
    axis, tick = ("│", "┤") if is_unicode else ("|", "+")
    result = []
    for row in range(rows):
        text = Text(f"{labels.get(row, ''):>{margin}} {tick if row in labels else axis}", style="dim")
        for bits, color in zip(cells[row].tolist(), colors[row].tolist(), strict=True):
            text.append(_character(bits, is_unicode=is_unicode), style=lines[color].color)
        text.rstrip()
        result.append(text)
    return result + _time_axis(times, columns, margin, is_unicode=is_unicode)


def label_width(scale: Scale) -> int:
    """Return the width of the widest label of an axis."""
    return max(len(scale.label(value)) for value in scale.ticks())


def _character(bits: int, *, is_unicode: bool) -> str:
    if not bits:
        return " "
    return chr(0x2800 + bits) if is_unicode else "*"


def _value_labels(scale: Scale, rows: int) -> dict[int, str]:
    """Return the label of each row that has one."""
    span = scale.high - scale.low
    return {
        min(rows - 1, int((scale.high - value) / span * (rows - 1) + 0.5)): scale.label(value)
        for value in scale.ticks()
    }


def _cells(lines: Sequence[Line], columns: int, rows: int, scale: Scale) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the bits of the dots of each character, and the number of its line, each of shape (rows, columns)."""
    cells, colors = np.zeros((rows, columns), np.int64), np.zeros((rows, columns), np.int64)
    height = rows * _DOWN
    for number, line in enumerate(lines):
        for x, low, high in _column_ranges(line, columns * _ACROSS):
            top, bottom = (_dot(value, scale, height) for value in (high, low))
            for y in range(top, bottom + 1):
                cells[y // _DOWN, x // _ACROSS] |= _BITS[y % _DOWN, x % _ACROSS]
                colors[y // _DOWN, x // _ACROSS] = number
    return cells, colors


def _dot(value: float, scale: Scale, height: int) -> int:
    return min(height - 1, max(0, round((scale.high - value) / (scale.high - scale.low) * (height - 1))))


def _column_ranges(line: Line, width: int) -> Iterator[tuple[int, float, float]]:
    """Yield each column of dots in which a line has values, with the lowest and the highest of them."""
    count = len(line.values)
    positions = np.arange(count) * ((width - 1) / max(1, count - 1))  # of the samples, in columns
    fine = np.linspace(0, width - 1, (width - 1) * _OVERSAMPLING + 1) if count > 1 else np.zeros(1)
    between = np.interp(fine, positions, line.values)
    lows, highs = np.full(width, np.nan), np.full(width, np.nan)
    for at, low, high in ((fine, between, between), (positions, line.lows, line.highs)):
        column = np.floor(at + 0.5).astype(np.intp).clip(0, width - 1)
        np.fmin.at(lows, column, low)
        np.fmax.at(highs, column, high)
    for column_number in np.flatnonzero(np.isfinite(lows) & np.isfinite(highs)).tolist():
        yield column_number, float(lows[column_number]), float(highs[column_number])


def _time_axis(times: Sequence[datetime], columns: int, margin: int, *, is_unicode: bool) -> list[Text]:
    """Return the line of the axis and the line of its labels."""
    corner, line, tick = ("└", "─", "┬") if is_unicode else ("+", "-", "+")
    axis, labels = [line] * columns, [" "] * (margin + 2 + columns)
    begin, span_s = times[0], (times[-1] - times[0]).total_seconds()
    step_s = next((s for s in _TIME_STEPS_S if span_s / s <= max(1, columns // _TIME_LABEL)), _TIME_STEPS_S[-1])
    midnight = begin.replace(hour=0, minute=0, second=0, microsecond=0)
    number = ceil((begin - midnight).total_seconds() / step_s)
    free = 0
    while (moment := midnight + timedelta(seconds=number * step_s)) <= times[-1]:
        number += 1
        column = round((moment - begin).total_seconds() / span_s * (columns - 1)) if span_s else 0
        axis[column] = tick
        text = f"{moment:%m-%d}" if moment.time() == datetime.min.time() else f"{moment:%H:%M}"
        place = min(max(0, margin + 2 + column - len(text) // 2), len(labels) - len(text))
        if place >= free:
            labels[place : place + len(text)] = text
            free = place + len(text) + 1
    return [Text(" " * (margin + 1) + corner + "".join(axis), style="dim"), Text("".join(labels).rstrip(), style="dim")]
