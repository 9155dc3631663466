"""Figures of energy and power."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, log10
from typing import Any

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.views.display.colors import end_use_color, hex_color
from zenostat.views.report.figures.base import (
    ENERGY_TICKS,
    Curve,
    Figure,
    draw,
    ink_on,
    legend_above,
    legend_text,
    period_label,
    quiet,
    text_width,
)
from zenostat.views.report.quantities import EndUseEnergy, by_period, load_duration
from zenostat.views.report.readings import read_lines
from zenostat.views.report.theme import LIGHT

_MAX_CURVE_POINTS = 500
_REMAINDER_SHARE = 0.005
_MIN_SHARE = 1e-6
"""Share of the energy below which an end use is not used."""
_PLOT_IN = 6.2
"""Width of the bars of all end uses together, inch, to decide which labels fit."""


def end_uses(curves: Sequence[Curve]) -> Figure | None:
    """Energy by end use: one stacked bar for each controller; None if no end use is measured."""
    tables = [_end_use_table(curve) for curve in curves]
    keys = list(dict.fromkeys((use.label, use.fuel) for table in tables for use in table))
    if not keys:
        return None
    colors = {(use.label, use.fuel): end_use_color(use.label, use.fuel) for table in tables for use in table}
    kwh = np.array(
        [
            [sum(float(np.nansum(use.kwh)) for use in table if (use.label, use.fuel) == key) for key in keys]
            for table in tables
        ]
    )
    used = np.flatnonzero(kwh.max(axis=0) > _MIN_SHARE * kwh.sum(axis=1).max())
    keys, kwh = [keys[place] for place in used], kwh[:, used]
    order = np.argsort([key[1] != "electricity" for key in keys], kind="stable")
    keys, kwh = [keys[place] for place in order], kwh[:, order]
    fuels = {fuel for _, fuel in keys}
    labels = [use if len(fuels) == 1 or fuel == "electricity" else f"{use} ({fuel})" for use, fuel in keys]
    longest = kwh.sum(axis=1).max()
    digits = max(2 - floor(log10(longest)), 0) if longest > 0.0 else 0  # three significant ones of the longest bar

    def fill(figure: Any) -> None:
        axis = figure.subplots()
        for row in range(len(curves)):
            left = 0.0
            for place, key in enumerate(keys):
                value = kwh[row, place]
                axis.barh(
                    row, value, left=left, height=0.62, color=hex_color(colors[key]), edgecolor=LIGHT["page"],
                    linewidth=0.8, label=labels[place] if row == 0 else None,
                )  # fmt: skip
                text = f"{value:,.{digits}f}"
                if value / longest * _PLOT_IN > text_width(text) + 0.08:
                    axis.text(
                        left + value / 2, row, text, ha="center", va="center_baseline", color=ink_on(colors[key])
                    )  # fmt: skip
                left += value
            axis.text(left + longest * 0.012, row, f"{left:,.{digits}f} kWh", va="center_baseline", fontweight="bold")
        axis.set_yticks(range(len(curves)), [curve.name for curve in curves])
        axis.tick_params(axis="y", labelcolor=LIGHT["ink"], labelsize=8.5)
        axis.set_xlim(0.0, longest * 1.14)
        axis.set_xticks([])
        axis.invert_yaxis()
        quiet(axis)
        axis.legend(
            loc="upper left", bbox_to_anchor=(0.0, -0.02), ncols=5, handlelength=0.9, handleheight=0.9,
            columnspacing=1.4, borderpad=0.2,
        )  # fmt: skip

    data: dict[str, Sequence[Any]] = {"end use": labels}
    for row, curve in enumerate(curves):
        data[f"{curve.name} (kWh)"] = kwh[row].tolist()
    best = "; ".join(f"{curve.name} {kwh[row].sum():,.{digits}f} kWh" for row, curve in enumerate(curves))
    drawing = draw("end-uses", 0.55 + 0.42 * len(curves) + 0.2 * ((len(keys) + 4) // 5), fill)
    return Figure(
        "end-uses", "Energy by end use", "Site energy of the run period, kWh.", f"Stacked bars of energy: {best}.",
        drawing, data, is_tabular=True,
    )  # fmt: skip


def _end_use_table(curve: Curve) -> tuple[EndUseEnergy, ...]:
    """Return the end uses, with what the facility's meter counts beyond them."""
    quantities = curve.quantities
    uses = quantities.end_uses
    facility = quantities.energy_kwh.get("electricity")
    if facility is None or not uses:
        return uses
    rest = facility - sum((use.kwh for use in uses if use.fuel == "electricity"), np.zeros_like(facility))
    if np.nansum(rest) < _REMAINDER_SHARE * np.nansum(facility):
        return uses
    return (*uses, EndUseEnergy("other electricity", "electricity", rest))


def duration(curves: Sequence[Curve]) -> Figure | None:
    """Load duration: the power that is exceeded in each share of the time; None if no power is measured."""
    powers = [
        (curve, power)
        for curve in curves
        if (power := curve.quantities.power_kw) is not None and np.isfinite(power).any()
    ]
    if not powers:
        return None
    lines = [(curve, *load_duration(power)) for curve, power in powers]

    def fill(figure: Any) -> None:
        axis = figure.subplots()
        for curve, share, falling in lines:
            keep = np.unique(np.linspace(0, len(share) - 1, _MAX_CURVE_POINTS).astype(int))
            drawstyle = "default" if len(keep) < len(share) else "steps-post"
            axis.plot(
                share[keep], falling[keep], color=curve.color, linestyle=curve.dashes, drawstyle=drawstyle,
                label=f"{legend_text(curve.name)}, peak {falling[0]:,.1f} kW",
            )  # fmt: skip
        axis.set_xlim(0, 100)
        axis.set_ylim(0, max(falling[0] for _, _, falling in lines) * 1.05 or 1.0)
        axis.set_xticks([0, 25, 50, 75, 100], ["0 %", "25 %", "50 %", "75 %", "100 %"])
        axis.set_ylabel("kW")
        axis.set_xlabel("share of the time in which the power is at least as high")
        legend_above(axis)
        read_lines(axis, "kW", labels=[curve.name for curve, *_ in lines])

    label = powers[0][0].quantities.power_label
    keep = np.linspace(0, 100, 101)
    data: dict[str, Sequence[Any]] = {"share of the time (%)": keep.tolist()}
    for curve, share, falling in lines:
        places = np.minimum((keep / 100 * (len(share) - 1)).astype(int), len(share) - 1)
        data[f"{curve.name} (kW)"] = falling[places].tolist()
    peaks = "; ".join(f"{curve.name}: peak {falling[0]:,.1f} kW" for curve, _, falling in lines)
    return Figure(
        "load-duration", "Load duration",
        f"{label}, mean power of each timestep, sorted. The area below a line is the energy.",
        f"Falling curves of electric power over the share of the time. {peaks}.",
        draw("load-duration", 2.6, fill), data,
    )  # fmt: skip


def periods(curves: Sequence[Curve]) -> Figure | None:
    """Energy of each month or day, by fuel; None if no energy is measured."""
    fuels = [
        fuel
        for fuel in dict.fromkeys(fuel for curve in curves for fuel in curve.quantities.energy_kwh)
        if not fuel.startswith("hvac_") and any(np.nansum(_energy(curve, fuel)) > 0 for curve in curves)
    ] or [name for name in ("hvac_electricity",) if any(name in curve.quantities.energy_kwh for curve in curves)]
    if not fuels:
        return None
    longest = max(curves, key=lambda curve: len(curve.quantities.begins)).quantities.begins
    starts, _ = by_period(np.zeros(len(longest)), longest)
    is_monthly = starts.dtype == "datetime64[M]"
    sums = {
        fuel: [_padded(by_period(_energy(curve, fuel), curve.quantities.begins)[1], len(starts)) for curve in curves]
        for fuel in fuels
    }

    def fill(figure: Any) -> None:
        axes = figure.subplots(len(fuels), 1, sharex=True, squeeze=False)[:, 0]
        width = 0.8 / len(curves)
        for axis, fuel in zip(axes, fuels, strict=True):
            for row, curve in enumerate(curves):
                axis.bar(
                    np.arange(len(starts)) + (row - (len(curves) - 1) / 2) * width, sums[fuel][row], width * 0.92,
                    color=curve.color, label=legend_text(curve.name),
                )  # fmt: skip
            axis.set_ylabel(f"{fuel_label(fuel)}, kWh")
            axis.yaxis.set_major_formatter(ENERGY_TICKS)
            axis.margins(x=0.01)
        every = max(len(starts) // 12, 1)
        axes[-1].set_xticks(range(0, len(starts), every), [period_label(day) for day in starts[::every]])
        legend_above(axes[0])

    data: dict[str, Sequence[Any]] = {"month" if is_monthly else "day": [str(day) for day in starts]}
    for fuel in fuels:
        for row, curve in enumerate(curves):
            data[f"{curve.name}: {fuel_label(fuel)} (kWh)"] = sums[fuel][row].tolist()
    unit = "month" if is_monthly else "day"
    return Figure(
        f"energy-by-{unit}", f"Energy by {unit}", "Site energy, kWh.",
        f"Bars of energy for each {unit} and controller.", draw("periods", 0.4 + 1.75 * len(fuels), fill), data,
        is_tabular=True,
    )  # fmt: skip


def fuel_label(fuel: str) -> str:
    """Return the name of a fuel as text."""
    return fuel.replace("hvac", "HVAC").replace("_", " ")


def _energy(curve: Curve, fuel: str) -> Floats:
    quantities = curve.quantities
    return quantities.energy_kwh.get(fuel, np.zeros(len(quantities.begins)))


def _padded(values: Floats, length: int) -> Floats:
    return np.pad(values, (0, max(length - len(values), 0)))[:length]
