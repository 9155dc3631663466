"""Figures of a calibration: curves of each column, and the profile of each parameter."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import date, timedelta
from functools import partial
from typing import Any

import numpy as np

from zenostat.lab.calibration.calibrate import CalibrationResult
from zenostat.lab.calibration.measured import bounds
from zenostat.lab.calibration.objective import Compared
from zenostat.topics.units import unit_label
from zenostat.views.report.figures.base import draw, legend_above, mark_days
from zenostat.views.report.theme import LIGHT

_COLUMNS = 3
_HIGHEST = 6.0
"""Errors above this multiple of the lowest one are outside a profile."""


def figures(result: CalibrationResult, units: Mapping[str, str]) -> dict[str, tuple[str, str, Any]]:
    """Return title, caption and Matplotlib figure by name."""
    drawn: dict[str, tuple[str, str, Any]] = {}
    for number, column in enumerate(result.data.columns):
        name = f"curves-{re.sub(r'[^a-z0-9]+', '-', column.header.lower()).strip('-')}"
        caption = f"{column.header}: measured, and simulated before and after the calibration"
        if result.config.held_out:
            caption += "; the shaded days are held out"
        panels = len(result.config.periods) + len(result.config.held_out)
        drawn[name] = (
            column.header, caption + ".",
            draw(name, 0.5 + 1.7 * panels, partial(_curves, result=result, number=number)),
        )  # fmt: skip
    rows = -(-len(result.config.parameters) // _COLUMNS)
    drawn["profiles"] = (
        "Profiles",
        "Error of each trial by the value of a parameter, and the lowest error in each part of its range. The shaded "
        "interval is that of the table, the dashed line the margin within which trials count as equally good"
        + (
            ", the dotted line the truth."
            if any(p.truth is not None for p in result.config.parameters.values())
            else "."
        ),
        draw("profiles", 2.4 * rows, lambda figure: _profiles(figure, result, units)),
    )
    return drawn


def _curves(figure: Any, result: CalibrationResult, number: int) -> None:
    config = result.config
    periods = [(days, "") for days in config.periods] + [(days, "held-out ") for days in config.held_out]
    axes = np.ravel(figure.subplots(len(periods), 1, squeeze=False))
    for place, (axis, (days, prefix)) in enumerate(zip(axes, periods, strict=True)):
        before, after = (result.fits[f"{prefix}{name}"].compared[number] for name in ("before", "after"))
        _lines(axis, result, days, before, after)
        if prefix:
            axis.set_facecolor(LIGHT["panel"])
        axis.set_ylabel(unit_label(before.column.unit))
        if place == 0:
            legend_above(axis)


def _lines(axis: Any, result: CalibrationResult, days: tuple[date, date], before: Compared, after: Compared) -> None:
    begin, end = bounds(days)
    data = result.data
    chosen = [place for place, row in enumerate(before.rows) if begin <= data.begins[row] and data.ends[row] <= end]
    times = np.array(
        [(data.begins[row] - begin + (data.ends[row] - data.begins[row]) / 2) / timedelta(days=1)
         for row in (before.rows[place] for place in chosen)]
    )  # fmt: skip
    distances = np.diff(times)
    gaps = np.flatnonzero(distances > 1.5 * np.median(distances)) + 1 if distances.size else np.zeros(0, int)
    for label, values, color, width in (
        ("before", before.simulated[chosen], "series-3", 0.9),
        ("after", after.simulated[chosen], "series-2", 1.1),
        ("measured", before.measured[chosen], "ink", 0.8),
    ):
        axis.plot(np.insert(times, gaps, np.nan), np.insert(values, gaps, np.nan), color=LIGHT[color], linewidth=width,
                  linestyle="solid" if label != "measured" else (0, (1, 1)), label=label)  # fmt: skip
    mark_days(axis, np.datetime64(begin, "s"), (end - begin) / timedelta(days=1))


def _profiles(figure: Any, result: CalibrationResult, units: Mapping[str, str]) -> None:
    config = result.config
    columns = min(len(result.parameters), _COLUMNS)
    axes = np.ravel(figure.subplots(-(-len(result.parameters) // columns), columns, sharey=True, squeeze=False))
    errors = np.array([error for _, error in result.trials])
    lowest = float(errors.min())
    for axis, each in zip(axes, result.parameters, strict=False):
        parameter = config.parameters[each.name]
        axis.axvspan(each.low, each.high, color=LIGHT["occupied" if each.is_determined else "grid"], linewidth=0)
        axis.plot([values[each.name] for values, _ in result.trials], errors, "o", markersize=2.5, alpha=0.5,
                  color=LIGHT["series-1"])  # fmt: skip
        axis.plot(*zip(*each.profile, strict=True), color=LIGHT["series-2"], linewidth=1.1)
        axis.axhline(lowest * (1.0 + config.margin), color=LIGHT["muted"], linestyle=(0, (4, 2)), linewidth=0.8)
        axis.axvline(each.value, color=LIGHT["series-2"], linewidth=0.9)
        if parameter.truth is not None:
            axis.axvline(parameter.truth, color=LIGHT["series-3"], linestyle=(0, (1, 1)), linewidth=1.4)
        axis.set_xlim(*parameter.ends)
        if parameter.log:
            axis.set_xscale("log")
            ticks = [parameter.from_unit(place) for place in (0.0, 0.25, 0.5, 0.75, 1.0)]
            axis.set_xticks(ticks, [f"{tick:.2g}" for tick in ticks])
            axis.set_xticks([], minor=True)
        unit = unit_label(units.get(each.name, "1"))
        axis.set_xlabel(f"{each.name} ({unit})" if unit else each.name)
        axis.set_ylim(0.0, min(_HIGHEST * lowest, float(errors.max()) * 1.05))
    for axis in axes[len(result.parameters) :]:
        axis.set_visible(False)
    for axis in axes[::columns]:
        axis.set_ylabel("error")
