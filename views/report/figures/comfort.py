"""Figures of comfort: degree-hours by zone, and the zones' ranking."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.topics.plurals import counted
from zenostat.views.report.figures.base import Curve, Figure, draw, legend_above, legend_text
from zenostat.views.report.theme import LIGHT

_MAX_ZONES = 24
_MIN_KH = 0.05


def rank_zones(curves: Sequence[Curve]) -> list[tuple[str, float]]:
    """Return zones by their degree-hours outside while occupied, of the controller where they are most; worst first."""
    worst: dict[str, float] = {}
    for curve in curves:
        comfort, hours = curve.quantities.comfort, curve.quantities.degree_hours
        if comfort is None or hours is None:
            continue
        for label, total in zip(comfort.labels, (hours[0] + hours[1]).tolist(), strict=True):
            worst[label] = max(worst.get(label, 0.0), total)
    return sorted(worst.items(), key=lambda pair: -pair[1])


def degree_hours(curves: Sequence[Curve]) -> Figure | None:
    """Degree-hours above and below the band while occupied, by zone; None without a comfort band."""
    curves = [curve for curve in curves if curve.quantities.comfort is not None]
    ranked = rank_zones(curves)
    if not ranked:
        return None
    shown = [label for label, total in ranked if total >= _MIN_KH][:_MAX_ZONES]
    above, below = zip(*(_of_zones(curve, [label for label, _ in ranked]) for curve in curves), strict=True)
    data: dict[str, Sequence[Any]] = {"zone": [label for label, _ in ranked]}
    for curve, high, low in zip(curves, above, below, strict=True):
        data[f"{curve.name}: above (K h)"] = high.tolist()
        data[f"{curve.name}: below (K h)"] = low.tolist()
    rest = len(ranked) - len(shown)
    hidden = f" {counted(rest, 'zone')} with less {'is' if rest == 1 else 'are'} in the table only." if rest else ""
    if not shown:
        return Figure(
            "degree-hours", "Degree-hours outside comfort, by zone",
            f"All zones were within the comfort band{_while(curves)}.", "", None, data, is_tabular=True,
        )  # fmt: skip

    def fill(figure: Any) -> None:
        axis = figure.subplots()
        height = 0.78 / len(curves)
        longest = max(float(max(high.max(), low.max())) for high, low in zip(above, below, strict=True))
        for row, curve in enumerate(curves):
            places = np.arange(len(shown)) + (row - (len(curves) - 1) / 2) * height
            axis.barh(places, above[row][: len(shown)], height * 0.9, color=curve.color, label=legend_text(curve.name))
            axis.barh(places, -below[row][: len(shown)], height * 0.9, color=curve.color)
        axis.axvline(0.0, color=LIGHT["muted"], linewidth=0.8)
        has_below = any(float(low.max()) >= _MIN_KH for low in below)
        coldest, warmest = (max(float(side.max()) for side in sides) for sides in (below, above))
        axis.set_xlim(-1.05 * coldest - 0.02 * longest if has_below else 0.0, 1.05 * max(warmest, 0.05 * longest))
        axis.xaxis.set_major_formatter(lambda value, _: f"{abs(value):,.6g}")
        axis.set_yticks(range(len(shown)), shown)
        axis.tick_params(axis="y", labelcolor=LIGHT["ink"])
        axis.set_ylim(len(shown) - 0.45, -0.55)
        axis.grid(visible=False, axis="y")
        axis.grid(visible=True, axis="x")
        axis.spines["left"].set_visible(False)
        axis.set_xlabel(
            "K h   (left of zero: too cold, right: too warm)" if has_below else "K h too warm; none too cold"
        )
        legend_above(axis)

    drawing = draw("degree-hours", 0.75 + len(shown) * max(0.2, 0.125 * len(curves)), fill)
    return Figure(
        "degree-hours", "Degree-hours outside comfort, by zone",
        f"Degree-hours outside the comfort band{_while(curves)}, zones sorted by the worst.{hidden}",
        f"Bars of degree-hours by zone; the worst is {shown[0]}.", drawing, data,
        is_tabular=True,
    )  # fmt: skip


def _while(curves: Sequence[Curve]) -> str:
    known = any(comfort.has_occupants for curve in curves if (comfort := curve.quantities.comfort) is not None)
    return " while occupied" if known else " (occupants are not measured)"


def _of_zones(curve: Curve, labels: Sequence[str]) -> tuple[Floats, Floats]:
    comfort, hours = curve.quantities.comfort, curve.quantities.degree_hours
    assert comfort is not None
    assert hours is not None
    places = {label: place for place, label in enumerate(comfort.labels)}
    above = np.array([hours[0][places[label]] if label in places else 0.0 for label in labels])
    below = np.array([hours[1][places[label]] if label in places else 0.0 for label in labels])
    return above, below
