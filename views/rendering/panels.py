"""Panels of a picture: curves over time with a legend beside them that has the latest values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.views.rendering import artists
from zenostat.views.rendering.artists import HEIGHT, INK, LEFT, MUTED, RIGHT, WIDTH, Dash
from zenostat.views.rendering.data import Window, highest, lowest, median
from zenostat.views.rendering.scale import format_range, format_tick, format_value, round_scale
from zenostat.views.rendering.text import Color, Pixels, Style, TextPainter

ROW_PX = 15
"""Pixels from one row of a legend to the next."""

_SWATCH_X, _SWATCH_PX, _LABEL_X, _VALUE_X = RIGHT + 14, 16, RIGHT + 36, WIDTH - 10
_FIRST_ROW_PX, _SPACE_PX = 6, 8
_TICK_PX = 26
"""Least distance of two ticks of an axis."""
_FONT_PT = 7.6
_HEADING, _ROW, _TICK = Style(_FONT_PT, "bold", INK), Style(_FONT_PT, "normal", INK), Style(_FONT_PT, "normal", MUTED)


Values = Callable[[Window], Floats]
"""Takes values from the samples, shape (samples,) or (samples, quantities)."""


@dataclass
class Row:
    """One row of a legend.

    Attributes:
        label: Its text.
        value: The latest value, at the right.
    """

    label: str
    value: str = ""


@dataclass
class Curve:
    """One line of a panel.

    Attributes:
        label: Text in the legend.
        color: Red, green, blue, 0 to 1.
        values: Its values, shape (samples,).
        held: Whether a value is valid for the whole timestep, so that it is drawn as steps.
        dash: matplotlib's line style.
        width: Line width in points.
        row: For one of several curves drawn one above the other: its row, counted from the top; else None.
        range: Lowest and highest value of a curve in a row.
        unit: Unit in the legend, where it is not the panel's.
    """

    label: str
    color: Color
    values: Values
    held: bool = False
    dash: Dash = "-"
    width: float = 1.4
    row: int | None = None
    range: tuple[float, float] = (0.0, 1.0)
    unit: str = ""

    def plotted(self, values: Floats) -> Floats:
        """Return the values on the panel's axis."""
        if self.row is None:
            return values
        low, high = self.range
        return -self.row - 0.9 + 0.8 * (values - low) / max(high - low, 1e-12)


@dataclass
class Spread:
    """Lowest, median and highest value of many similar quantities.

    Attributes:
        label: Text in the legend.
        color: Red, green, blue, 0 to 1.
        values: Their values, shape (samples, quantities).
        held: As for `Curve`.
    """

    label: str
    color: Color
    values: Values
    held: bool = False


@dataclass
class Panel:
    """One plot of the picture and its legend.

    Attributes:
        title: Name of the quantity.
        unit: Symbol of its unit; may be empty.
        curves, spreads: What it shows; the first curve is drawn last, on top of the others.
        weight: Share of the free height.
        from_zero: Whether the axis includes zero.
        is_filled: Whether the area between zero and the first curve is filled.
        min_span: Smallest extent of the axis; None is that of `round_scale`.
        is_integer: Whether its values are whole numbers.
        includes: Values that the axis always includes.
        total: The text at the right of the title.
        notes: Further rows of the legend, without a swatch.
        note_values: Their values.
    """

    title: str
    unit: str
    curves: Sequence[Curve] = ()
    spreads: Sequence[Spread] = ()
    weight: float = 1.0
    from_zero: bool = False
    is_filled: bool = False
    min_span: float | None = None
    is_integer: bool = False
    includes: tuple[float, ...] = ()
    total: Callable[[Window], str] = lambda _: ""
    notes: Sequence[str] = ()
    note_values: Callable[[Window], Sequence[str]] = lambda _: ()
    rows: list[Row] = field(default_factory=list, init=False)

    @property
    def row_count(self) -> int:
        """Number of rows of the legend, with its title."""
        return 1 + len(self.spreads) + len(self.curves) + len(self.notes)

    @property
    def has_rows(self) -> bool:
        """Whether each curve has a row of its own instead of a common axis."""
        return bool(self.curves) and self.curves[0].row is not None

    def attach(self, figure: Any, top: float, height: float) -> None:
        """Create the plot in a figure, `top` pixels from its upper edge."""
        rectangle = (LEFT / WIDTH, 1.0 - (top + height) / HEIGHT, (RIGHT - LEFT) / WIDTH, height / HEIGHT)
        self.axes = axes = figure.add_axes(rectangle)
        axes.set_axis_off()
        self.figure, self.top, self.height = figure, top, height
        self.rows = []
        self._grid = artists.grid(axes)
        self._areas = [artists.area(axes, spread.color, 0.22) for spread in self.spreads]
        self._medians = [artists.line(axes, spread.color, "-", 1.4) for spread in self.spreads]
        self._fill = artists.area(axes, self.curves[0].color, 0.16) if self.is_filled else None
        self._lines = [artists.line(axes, c.color, c.dash, c.width, rank=-i) for i, c in enumerate(self.curves)]
        self._dots = [artists.dot(axes, curve.color, rank=-i) for i, curve in enumerate(self.curves)]
        self._spread_rows = [self.add_row(spread.label, area=spread.color)[0] for spread in self.spreads]
        self._curve_rows, self._swatches = [], []
        for curve in self.curves:
            row, swatch = self.add_row(curve.label, color=curve.color, dash=curve.dash, width=curve.width)
            self._curve_rows.append(row)
            self._swatches.append(swatch)
        self._notes = [Row(text) for text in self.notes]
        self.rows += self._notes

    def add_row(
        self, text: str, *, area: Color | None = None, color: Color = INK, dash: Dash = "-", width: float = 1.4,
        alpha: float = 0.3,
    ) -> tuple[Row, Any]:  # fmt: skip
        """Add a row with a line or a filled area to the legend; return it and its swatch."""
        row, y = Row(text), self._row_y(len(self.rows) + 1)
        self.rows.append(row)
        if area is not None:
            return row, artists.swatch_area(self.figure, _SWATCH_X, y, _SWATCH_PX, area, alpha)
        return row, artists.swatch_line(self.figure, _SWATCH_X, y, _SWATCH_PX, color, dash, width)

    def _row_y(self, index: int) -> float:
        return self.top + _FIRST_ROW_PX + ROW_PX * index

    def update(self, window: Window) -> None:
        """Show the samples of `window`."""
        extremes: list[Floats] = [np.array(self.includes)]
        hours = window.hours
        for spread, patch, middle, row in zip(self.spreads, self._areas, self._medians, self._spread_rows, strict=True):
            table = spread.values(window)
            low, high = lowest(table), highest(table)
            patch.set_xy(artists.outline(hours, low, high, held=spread.held))
            middle.set_data(*artists.corners(hours, median(table), held=spread.held))
            row.value = format_range(low[-1], high[-1], self.unit)
            extremes += [low, high]
        for curve, drawn, dot, row in zip(self.curves, self._lines, self._dots, self._curve_rows, strict=True):
            values = curve.values(window)
            plotted = curve.plotted(values)
            drawn.set_data(*artists.corners(hours, plotted, held=curve.held))
            dot.set_data(hours[-1:], plotted[-1:])
            text = format_value(values[-1], curve.unit or self.unit, is_integer=self.is_integer)
            row.value = f"{text} {curve.unit}" if curve.unit else text
            extremes.append(plotted)
        if self._fill is not None:
            values = self.curves[0].values(window)
            self._fill.set_xy(artists.outline(hours, np.where(np.isnan(values), values, 0.0), values, held=True))
        for row, text in zip(self._notes, self.note_values(window), strict=False):
            row.value = text
        self._heading = f"{self.title} ({self.unit})" if self.unit else self.title, self.total(window)
        self._scale(np.concatenate(extremes), window)

    def _scale(self, values: Floats, window: Window) -> None:
        known = values[~np.isnan(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        most = max(3, int(self.height // _TICK_PX))
        bottom, top = -float(len(self.curves)), 0.0
        self._ticks = list[float]()
        if not self.has_rows:
            bottom, top, self._ticks = round_scale(low, high, self.min_span, most, from_zero=self.from_zero)
        self.axes.set(xlim=window.limits, ylim=(bottom, top))
        self._tick_y = [self.top + self.height * (top - tick) / (top - bottom) for tick in self._ticks]
        self._grid.set_segments(artists.grid_lines(window.limits, window.ticks, (bottom, top), self._ticks))

    def paint(self, picture: Pixels, text: TextPainter) -> None:
        """Paint ticks and legend into the picture of the figure."""
        for tick, y in zip(self._ticks, self._tick_y, strict=True):
            text.paint(picture, LEFT - 6, y, format_tick(tick), _TICK, "right")
        title, total = self._heading
        self._paint_row(picture, text, 0, _SWATCH_X, title, total, _HEADING)
        for index, row in enumerate(self.rows, start=1):
            self._paint_row(picture, text, index, _LABEL_X, row.label, row.value, _ROW)

    def _paint_row(
        self, picture: Pixels, text: TextPainter, index: int, x: int, label: str, value: str, style: Style
    ) -> None:
        y, room = self._row_y(index), float(_VALUE_X - x)
        if value:
            text.paint(picture, _VALUE_X, y, value, _ROW, "right")
            room -= text.width(value, _ROW) + _SPACE_PX
        text.paint(picture, x, y, text.shortened(label, style, room), style)
