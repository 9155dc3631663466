"""Reward and its terms over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zenostat.metrics.labels import label
from zenostat.views.report.figures.base import Curve, Figure, day_numbers, draw, legend_text, mark_days
from zenostat.views.report.readings import read_lines

_TOTAL = ""
"""Key of the sum of all terms, which no term has."""
_TEXTS = {_TOTAL: "reward", "reward": "reward term"}
_MAX_PANELS = 4
_MAX_CURVE_POINTS = 400


def reward(curves: Sequence[Curve]) -> Figure | None:
    """Cumulative reward and terms; None if no reward was recorded."""
    curves = [curve for curve in curves if curve.quantities.trajectory.terms]
    if not curves:
        return None
    sums = []
    for curve in curves:
        terms = {name: np.nancumsum(term) for name, term in curve.quantities.trajectory.terms.items()}
        total = {_TOTAL: np.sum(list(terms.values()), axis=0)}
        sums.append(total | (terms if len(terms) > 1 else {}))
    names = list(dict.fromkeys(name for entry in sums for name in entry))
    first = min(curve.quantities.begins[0] for curve in curves)
    longest = max(curves, key=lambda curve: len(curve.quantities.begins))
    panels = names[:_MAX_PANELS]

    def fill(figure: Any) -> None:
        axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for axis, name in zip(axes, panels, strict=True):
            for curve, entry in zip(curves, sums, strict=True):
                if name not in entry:
                    continue
                days = day_numbers(curve.quantities.begins, first) + curve.quantities.step_h / 24.0
                keep = np.unique(np.linspace(0, len(days) - 1, _MAX_CURVE_POINTS).astype(int))
                axis.plot(
                    days[keep],
                    entry[name][keep],
                    color=curve.color,
                    linestyle=curve.dashes,
                    label=legend_text(curve.name),
                )
            axis.set_title(label(_TEXTS.get(name, name)))
            length = day_numbers(longest.quantities.begins[-1:], first)[0] + longest.quantities.step_h / 24.0
            mark_days(axis, first, length)
            ticks = axis.get_xticks()
            every = max(-(-len(ticks) * len(panels) // 9), 1)
            axis.set_xticks(ticks[::every], [text.get_text() for text in axis.get_xticklabels()][::every], ha="left")
            axis.yaxis.set_major_formatter("{x:,.6g}")
            read_lines(axis, "", first)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=4, handlelength=1.8)

    data: dict[str, Sequence[Any]] = {"begin": [str(time) for time in longest.quantities.begins]}
    for curve, entry in zip(curves, sums, strict=True):
        for name, values in entry.items():
            data[f"{curve.name}: {_TEXTS.get(name, name)}"] = [
                *values.tolist(),
                *([float("nan")] * (len(data["begin"]) - len(values))),
            ]
    totals = "; ".join(f"{curve.name} {entry[_TOTAL][-1]:,.1f}" for curve, entry in zip(curves, sums, strict=True))
    return Figure(
        "reward", "Reward and its terms", "Sum since the beginning of the episode; higher is better.",
        f"Lines of the cumulative reward: {totals}.", draw("reward", 2.2, fill), data,
    )  # fmt: skip
