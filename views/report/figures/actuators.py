"""The timeline of setpoints and actuators, and who set them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zenostat.metrics.labels import label, unit_label
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import THERMOSTAT
from zenostat.views.report.figures.base import (
    LONG_DAYS,
    Curve,
    Figure,
    daily,
    day_numbers,
    draw,
    legend_text,
    mark_days,
)
from zenostat.views.report.readings import Series, read_lines, read_series
from zenostat.views.report.theme import LIGHT, series_color

BASELINE = "the building's own control"
_MAX_PANELS = 8
_Groups = dict[tuple[str, str], Floats]
"""Values of shape (steps, points) by title and unit."""


def timeline(curves: Sequence[Curve]) -> Figure | None:
    """Setpoints and actuators over time, with the source of their values; None if there are none."""
    tables = [_groups(curve) for curve in curves]
    groups = [_known(table) for table in tables]
    titles = list(dict.fromkeys(title for group in groups for title in group))
    if not titles:
        return None
    shown = titles[:_MAX_PANELS]
    first = min(curve.quantities.begins[0] for curve in curves)
    days = max(_edges(curve, first)[-1] for curve in curves)
    is_long = days > LONG_DAYS
    strips_in = 0.17 * len(curves) + 0.1

    def fill(figure: Any) -> None:
        heights = [1.0] * len(shown) + [strips_in]
        axes = figure.subplots(len(heights), 1, sharex=True, gridspec_kw={"height_ratios": heights})
        for axis, title in zip(axes, shown, strict=False):
            for curve, group in zip(curves, groups, strict=True):
                if title in group:
                    _line(axis, curve, group[title], _edges(curve, first), is_long=is_long)
            axis.set_title(title[0])
            axis.set_ylabel(unit_label(title[1]))
            axis.margins(y=0.12)
            read_lines(axis, unit_label(title[1]), first)
        lines = {line.get_label(): line for axis in axes[:-1] for line in axis.get_lines()}
        figure.legend(lines.values(), lines, loc="outside upper left", ncols=4, handlelength=1.8)
        _strips(figure, axes[-1], curves, first, is_long=is_long)
        mark_days(axes[-1], first, days)

    return Figure(
        "actuators", "Setpoints and actuators", _caption(titles, _incomplete(tables), is_long=is_long),
        f"Lines over time of {', '.join(title for title, _ in shown)}, and who set them.",
        draw("actuators", 1.05 + 1.12 * len(shown) + strips_in, fill), _columns(curves, groups),
    )  # fmt: skip


def _caption(titles: Sequence[tuple[str, str]], incomplete: Sequence[str], *, is_long: bool) -> str:
    line = "Line: daily mean" if is_long else "Line: mean"
    rest = ", ".join(title for title, _ in titles[_MAX_PANELS:])
    hidden = f" Not drawn: {rest}." if rest else ""
    hidden += f" Left out where no value is known: {', '.join(incomplete)}." if incomplete else ""
    period = " and of the day" if is_long else ""
    return f"{line}; the shaded range is that of all zones or actuators{period}. Below: who set the actuators.{hidden}"


def _columns(curves: Sequence[Curve], groups: Sequence[_Groups]) -> dict[str, Sequence[Any]]:
    """Return the lowest, mean and highest value of each group in each timestep."""
    longest = max((curve.quantities.begins for curve in curves), key=len)
    data: dict[str, Sequence[Any]] = {"begin": [str(time) for time in longest]}
    for curve, group in zip(curves, groups, strict=True):
        for (title, unit), values in group.items():
            kinds = dict(zip(("lowest", "mean", "highest"), _range(values), strict=True))
            if values.shape[1] == 1:
                kinds = {"": values[:, 0]}
            for kind, column in kinds.items():
                padded = np.pad(column, (0, len(longest) - len(column)), constant_values=np.nan)
                suffix = f", {kind}" if kind else ""
                data[f"{curve.name}: {title}{suffix} ({unit_label(unit) or 'no unit'})"] = padded.tolist()
    return data


def _groups(curve: Curve) -> _Groups:
    """Return the values of setpoints and of the other actuators, which are grouped by their kind; NaN: not known."""
    trajectory, roles = curve.quantities.trajectory, curve.quantities.roles
    groups: _Groups = {}
    thermostats = set()
    for title, kind in (("Cooling setpoints", "cooling"), ("Heating setpoints", "heating")):
        columns = []
        for zone in roles.zones:
            sensor, actuator = getattr(zone, f"{kind}_setpoint"), getattr(zone, f"{kind}_actuator")
            if actuator is not None:
                thermostats.add(actuator)
            if sensor is not None:
                columns.append(trajectory.fault_free_values[1:, sensor])
            elif actuator is not None:
                columns.append(trajectory.effective[1:, actuator])
        if columns:
            groups[title, "degC"] = np.column_stack(columns)
    others: dict[tuple[str, str], list[Floats]] = {}
    for place, actuator in enumerate(trajectory.manifest.actuators):
        if place in thermostats:
            continue
        is_kind = actuator.component_type and actuator.component_type != THERMOSTAT
        alike = [a for a in trajectory.manifest.actuators if a.control_type == actuator.control_type]
        title = label(actuator.control_type) if is_kind and len(alike) > 1 else label(actuator.name)
        others.setdefault((title, actuator.unit), []).append(trajectory.effective[1:, place])
    return groups | {key: np.column_stack(columns) for key, columns in others.items()}


def _known(groups: _Groups) -> _Groups:
    """Return the points of which some value is known; of an actuator, it may be known only while it is commanded."""
    known = {key: values[:, np.isfinite(values).any(axis=0)] for key, values in groups.items()}
    return {key: values for key, values in known.items() if values.size}


def _incomplete(tables: Sequence[_Groups]) -> list[str]:
    """Return the titles of groups with values that are not known."""
    return list(dict.fromkeys(key[0] for table in tables for key in table if not np.isfinite(table[key]).all()))


def _range(values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the lowest, mean and highest known value of each timestep; NaN where there is none."""
    known = np.isfinite(values)
    counts = known.sum(axis=1)
    sums = np.where(known, values, 0.0).sum(axis=1)
    mean = np.divide(sums, counts, out=np.full(len(values), np.nan), where=counts > 0)
    return np.fmin.reduce(values, axis=1), mean, np.fmax.reduce(values, axis=1)


def _edges(curve: Curve, first: np.datetime64) -> Floats:
    quantities = curve.quantities
    days = day_numbers(quantities.begins, first)
    return np.append(days, days[-1] + quantities.step_h / 24.0)


def _line(axis: Any, curve: Curve, values: Floats, edges: Floats, *, is_long: bool) -> None:
    lowest, means, highest = _range(values)
    if is_long:
        _, low, _, _ = daily(lowest, edges[:-1])
        middle, _, mean, _ = daily(means, edges[:-1])
        _, _, _, high = daily(highest, edges[:-1])
        axis.plot(middle, mean, color=curve.color, linestyle=curve.dashes, label=legend_text(curve.name))
        axis.fill_between(middle, low, high, color=curve.color, alpha=0.16, linewidth=0)
        return
    where, mean = _runs(edges, means)
    axis.plot(
        where, mean, color=curve.color, linestyle=curve.dashes, drawstyle="steps-post", linewidth=1.3,
        label=legend_text(curve.name),
    )  # fmt: skip
    where, low, high = _runs(edges, lowest, highest)
    if (high > low).any():
        axis.fill_between(where, low, high, step="post", color=curve.color, alpha=0.16, linewidth=0)


def source_shares(curve: Curve) -> dict[str, Floats]:
    """Return the share of the actuators that each source set in each timestep; the baseline control is `""`."""
    trajectory = curve.quantities.trajectory
    if not trajectory.manifest.actuators:
        return {"": np.ones(trajectory.steps)}
    index = trajectory.source_index[1:]
    return {
        name: (index == place).mean(axis=1) for place, name in enumerate(trajectory.sources) if (index == place).any()
    }


def _strips(figure: Any, axis: Any, curves: Sequence[Curve], first: np.datetime64, *, is_long: bool) -> None:
    """Draw a strip for each controller, divided among the sources."""
    from matplotlib.patches import Patch

    sources = [source_shares(curve) for curve in curves]
    series = [
        _main_source(curve, shares, first, is_long=is_long) for curve, shares in zip(curves, sources, strict=True)
    ]
    read_series(axis, "", series, first)
    names = list(dict.fromkeys(name for source in sources for name in source))
    colors = {"": LIGHT["line"]} | {curve.source: curve.color for curve in curves}
    for place, name in enumerate(name for name in names if name not in colors):
        colors[name] = series_color(len(curves) + place)
    for row, (curve, shares) in enumerate(zip(curves, sources, strict=True)):
        base = np.zeros(len(curve.quantities.begins))
        for name in (name for name in names if name in shares):
            top = base + shares[name]
            where, low, high = (_by_day if is_long else _runs)(_edges(curve, first), base, top)
            axis.fill_between(
                where, row + 0.1 + 0.8 * low, row + 0.1 + 0.8 * high, step="post", color=colors[name], linewidth=0
            )
            base = top
    labels = {"": BASELINE} | {curve.source: curve.name for curve in curves}
    patches = [Patch(color=colors[name], label=f"set by {labels.get(name, name)}") for name in names]
    figure.legend(handles=patches, loc="outside lower left", ncols=4, handlelength=0.9, handleheight=0.9)
    axis.set_ylim(len(curves), 0)
    axis.set_yticks([row + 0.5 for row in range(len(curves))], [curve.name for curve in curves])
    axis.grid(visible=False)
    axis.spines["left"].set_visible(False)


def _main_source(curve: Curve, shares: Mapping[str, Floats], first: np.datetime64, *, is_long: bool) -> Series:
    """Return the source of most actuators in each timestep or day, for the values at the pointer."""
    edges = _edges(curve, first)
    parts = list(shares.values())
    if is_long:
        days = [daily(share, edges[:-1]) for share in parts]
        edges = np.append(days[0][0] - 0.5, days[0][0][-1] + 0.5)
        parts = [mean for _, _, mean, _ in days]
    where, most = _runs(edges, np.argmax(np.nan_to_num(parts), axis=0).astype(float))
    texts = tuple(f"set by {_source_label(curve, name)}" for name in shares)
    return Series(curve.name, curve.color, where, most, is_step=True, texts=texts)


def _source_label(curve: Curve, name: str) -> str:
    return {"": BASELINE, curve.source: curve.name}.get(name, name)


def _runs(edges: Floats, *series: Floats) -> list[Floats]:
    """Return the edges and values where any of the values changes, and the last edge, to be drawn as steps."""
    changes = np.any([np.diff(values) != 0 for values in series], axis=0)
    kept = np.flatnonzero(np.append(True, changes))
    return [np.append(edges[kept], edges[-1]), *(np.append(values[kept], values[-1]) for values in series)]


def _by_day(edges: Floats, low: Floats, top: Floats) -> list[Floats]:
    """Return the days and the mean of the values in them, where they change."""
    middle, _, bottom, _ = daily(low, edges[:-1])
    _, _, upper, _ = daily(top, edges[:-1])
    return _runs(np.append(middle - 0.5, middle[-1] + 0.5), bottom, upper)
