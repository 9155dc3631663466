"""Common parts of figures: data, axes over time, legends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zenostat.metrics.labels import MONTHS, date_label
from zenostat.topics.arrays import Floats
from zenostat.views.report.quantities import Quantities, Times
from zenostat.views.report.theme import FULL_IN, series_color, series_dashes, style

Days = Floats
LONG_DAYS = 45
"""Runs of more days are drawn by day or month."""
ENERGY_TICKS = "{x:,.10g}"
"""Format of ticks of energy, which may be of any size."""


@dataclass(frozen=True)
class Curve:
    """One controller in the figures.

    Attributes:
        name: its label.
        place: its place among the controllers, from 0.
        quantities: quantities of its first episode.
        source: its name among the value sources.
    """

    name: str
    place: int
    quantities: Quantities
    source: str = ""

    @property
    def color(self) -> str:
        """Color of its lines and bars."""
        return series_color(self.place)

    @property
    def dashes(self) -> Any:
        """Line style."""
        return series_dashes(self.place)


@dataclass(frozen=True)
class Figure:
    """A figure and the data that it shows.

    Attributes:
        name: name of its files, and of its anchor on a page.
        title: heading on a page.
        caption: what a reader has to know to read it.
        alt: what it shows, in a sentence, for those who do not see it.
        drawing: the Matplotlib figure.
        data: columns of the data behind it, all of one length.
        is_tabular: whether a page shows the data as a table too.
    """

    name: str
    title: str
    caption: str
    alt: str
    drawing: Any
    data: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    is_tabular: bool = False


def draw(name: str, height_in: float, fill: Callable[[Any], None]) -> Any:
    """Return a Matplotlib figure that `fill` draws into."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Drawing

    with rc_context(style(name)):
        figure = Drawing(figsize=(FULL_IN, height_in))
        fill(figure)
    return figure


def day_numbers(times: Times, first: np.datetime64) -> Days:
    """Return times as days since the midnight before `first`."""
    midnight = first.astype("datetime64[D]").astype("datetime64[s]")
    days: Days = (times.astype("datetime64[s]") - midnight) / np.timedelta64(1, "s") / 86400.0
    return days


def mark_days(axis: Any, first: np.datetime64, days: float) -> None:
    """Label an axis of days since the midnight before `first`, over a period of `days`."""
    start = first.astype("datetime64[D]")
    last = start + int(np.ceil(days))
    if days > LONG_DAYS:
        months = np.arange(start.astype("datetime64[M]"), last.astype("datetime64[M]") + 1)
        ticks = [
            (float((month.astype("datetime64[D]") - start).astype(int)), _month(month, months[0])) for month in months
        ]
        ticks = [(place, text) for place, text in ticks if -0.5 <= place < days]
    else:
        every = max(int(np.ceil(days / 9)), 1)
        every = 7 if 3 < every < 7 else every
        ticks = [(float(day), date_label((start + day).item())) for day in range(0, int(np.ceil(days)), every)]
    axis.set_xticks([place for place, _ in ticks], [text for _, text in ticks], ha="left")
    for label in axis.get_xticklabels():
        label.set_horizontalalignment("left")
    axis.set_xlim(0.0, max(days, 1.0 / 24))


def _month(month: np.datetime64, first: np.datetime64) -> str:
    date: Any = month.item()
    name = MONTHS[date.month - 1]
    return f"{name} {date.year}" if date.month == 1 and month != first else name


def period_label(day: np.datetime64) -> str:
    """Return the label of a month or a day."""
    date: Any = day.item()
    return MONTHS[date.month - 1] if day.dtype == "datetime64[M]" else date_label(date)


_MOST_COLUMNS = 4

LEGEND_ROW_PT = 13.0
"""Height of a row of a legend, points."""


def legend_text(name: str) -> str:
    """Return a name as the label of a line or bar; Matplotlib's legends leave out those that begin with `_`."""
    return f"\N{ZERO WIDTH SPACE}{name}" if name.startswith("_") else name


def legend_above(axis: Any, **settings: Any) -> int:
    """Put the legend above the axes, left, in as many rows as its texts need, and return their number.

    A legend that is wider than its figure would leave no room for the axes: long texts are cut, and there are fewer
    columns.
    """
    handles, labels = axis.get_legend_handles_labels()
    if not handles:
        return 0
    available_in = axis.figure.get_figwidth() - _LEGEND_MARGIN_IN
    shown = [_cut(label, available_in - _HANDLE_IN) for label in labels]
    widest_in = max(text_width(text) for text in shown) + _HANDLE_IN
    columns = max(min(_MOST_COLUMNS, int(available_in / widest_in)), 1)
    axis.legend(
        handles, shown, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.2,
        handlelength=1.8, columnspacing=1.6, borderpad=0.2, **settings,
    )  # fmt: skip
    return -(-len(shown) // columns)


def _cut(text: str, width_in: float) -> str:
    """Return the text, or its beginning if it is wider."""
    most = int(width_in / text_width("0"))
    return text if len(text) <= most else f"{text[: most - 1]}\N{HORIZONTAL ELLIPSIS}"


_HANDLE_IN = 0.45
_LEGEND_MARGIN_IN = 0.8
"""Width of a legend's line with its spaces, and of what stands beside the axes."""


def quiet(axis: Any) -> None:
    """Remove grid, spines and ticks."""
    axis.grid(visible=False)
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)


def daily(values: Floats, days: Days) -> tuple[Days, Floats, Floats, Floats]:
    """Return the middle of each day, and the lowest, mean and highest value in it; NaN where there is none."""
    numbers = np.floor(days + 1e-9).astype(int)
    every = np.arange(numbers[0], numbers[-1] + 1)
    known = np.isfinite(values)
    places = numbers[known] - numbers[0]
    counts = np.bincount(places, minlength=len(every))
    low, high = np.full(len(every), np.inf), np.full(len(every), -np.inf)
    np.minimum.at(low, places, values[known])
    np.maximum.at(high, places, values[known])
    sums = np.bincount(places, weights=values[known], minlength=len(every))
    means = np.divide(sums, counts, out=np.full(len(every), np.nan), where=counts > 0)
    low[counts == 0] = high[counts == 0] = np.nan
    return every + 0.5, low, means, high


def ink_on(color: Sequence[int]) -> str:
    """Return the text color, black or white, that reads better on a color."""
    from zenostat.views.display.colors import contrast

    return "#ffffff" if contrast(color, (255, 255, 255)) >= contrast(color, (0, 0, 0)) / 1.35 else "#000000"


def text_width(text: str) -> float:
    """Estimate the width of a text of the figures' size, inch."""
    return 0.062 * len(text)
