"""Energy of each month or day by end use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.views.display.colors import end_use_color, hex_color
from zenostat.views.report.figures.base import ENERGY_TICKS, Curve, Figure, draw, period_label
from zenostat.views.report.quantities import EndUseEnergy, Times, by_period

_COLUMNS = 2


def end_uses_by_period(curves: Sequence[Curve]) -> Figure | None:
    """Stacked bars of the end uses of each month, or day; None if no end use is measured, or for a single period."""
    tables = [(curve, curve.quantities.end_uses) for curve in curves if curve.quantities.end_uses]
    if not tables:
        return None
    keys = list(dict.fromkeys((use.label, use.fuel) for _, uses in tables for use in uses))
    colors = {
        (use.label, use.fuel): hex_color(end_use_color(use.label, use.fuel)) for _, uses in tables for use in uses
    }
    sums = [(curve, *_sums(curve, uses, keys)) for curve, uses in tables]
    longest = max((starts for _, starts, _ in sums), key=len)
    if len(longest) < 2:
        return None
    labels = [use if fuel == "electricity" else f"{use} ({fuel})" for use, fuel in keys]
    rows = -(-len(sums) // _COLUMNS)

    def fill(figure: Any) -> None:
        columns = min(len(sums), _COLUMNS)
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axis, (curve, starts, kwh) in zip(axes, sums, strict=False):
            below = np.zeros(len(starts))
            for place, key in enumerate(keys):
                axis.bar(
                    np.arange(len(starts)), kwh[:, place], 0.8, bottom=below, color=colors[key], label=labels[place]
                )
                below = below + kwh[:, place]
            axis.set_title(curve.name)
            axis.yaxis.set_major_formatter(ENERGY_TICKS)
            every = max(-(-len(longest) // (12 // columns)), 1)
            axis.set_xticks(range(0, len(longest), every), [period_label(day) for day in longest[::every]])
        for axis in axes[len(sums) :]:
            axis.set_visible(False)
        axes[0].set_ylabel("kWh")
        figure.legend(
            *axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=5, handlelength=0.9,
            handleheight=0.9, columnspacing=1.4, borderpad=0.2,
        )  # fmt: skip

    unit = "month" if longest.dtype == "datetime64[M]" else "day"
    data: dict[str, Sequence[Any]] = {unit: [str(day) for day in longest]}
    for curve, starts, kwh in sums:
        rest = [float("nan")] * (len(longest) - len(starts))
        data |= {f"{curve.name}: {label} (kWh)": [*kwh[:, p].tolist(), *rest] for p, label in enumerate(labels)}
    height_in = 0.3 + 1.8 * rows + 0.2 * (-(-len(keys) // 5))
    return Figure(
        f"end-uses-by-{unit}", f"End uses by {unit}", "Site energy by end use, kWh.",
        f"Stacked bars of the end uses of each {unit}, for each controller.",
        draw("end-uses-by-period", height_in, fill), data, is_tabular=True,
    )  # fmt: skip


def _sums(curve: Curve, uses: Sequence[EndUseEnergy], keys: Sequence[tuple[str, str]]) -> tuple[Times, Floats]:
    """Return the periods and the energy of each end use in them, kWh, shape (periods, uses)."""
    begins = curve.quantities.begins
    starts, _ = by_period(np.zeros(len(begins)), begins)
    kwh = np.zeros((len(starts), len(keys)))
    for use in uses:
        kwh[:, keys.index((use.label, use.fuel))] += by_period(use.kwh, begins)[1]
    return starts, kwh
