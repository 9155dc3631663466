"""Carpets: hours of the day over days, one panel for each controller, on one color scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.views.display.colors import COMFORT_RANGE_K, comfort_colors
from zenostat.views.report.figures.base import Curve, Figure, draw, mark_days
from zenostat.views.report.quantities import Times, by_hour
from zenostat.views.report.readings import read_cells
from zenostat.views.report.theme import LIGHT

_COLUMNS = 2
_UNOCCUPIED = 0.35
"""Opacity of hours without occupants."""
_FULL_K = 2.0
"""Deviation from which on colors are opaque; smaller ones show the ground, light or dark."""
_SCALE = "inferno"


def electricity(curves: Sequence[Curve]) -> Figure | None:
    """Electric power in each hour of each day; None if no power is measured."""
    grids = []
    for curve in curves:
        power = curve.quantities.power_kw
        if power is not None:
            grids.append((curve, *by_hour(power, curve.quantities.begins, curve.quantities.trajectory.manifest.step_s)))
    if not grids:
        return None
    top = max(float(np.nanmax(grid)) for _, _, grid in grids) or 1.0

    def colors(place: int) -> NDArray[np.uint8]:
        from matplotlib import colormaps

        grid = grids[place][2]
        rgba: NDArray[np.uint8] = colormaps[_SCALE](np.nan_to_num(grid) / top, bytes=True)
        rgba[np.isnan(grid), 3] = 0
        return rgba

    label = curves[0].quantities.power_label
    drawing = _carpets("carpet-electricity", grids, colors, (0.0, top), "kW")
    return Figure(
        "carpet-electricity", label, "Mean power of each hour of each day in kW; one color scale for all.",
        f"Carpet of electric power over the hours of each day, up to {top:,.0f} kW.", drawing,
        _columns([(curve, days, grid) for curve, days, grid in grids], "kW"),
    )  # fmt: skip


def zone(curves: Sequence[Curve], label: str, number: int) -> Figure | None:
    """Deviation of one zone's temperature from the comfort band in each hour of each day."""
    grids, tints = [], []
    for curve in curves:
        comfort = curve.quantities.comfort
        if comfort is None or label not in comfort.labels:
            continue
        place = comfort.labels.index(label)
        begins, step_s = curve.quantities.begins, curve.quantities.trajectory.manifest.step_s
        days, deviation = by_hour(comfort.deviation[:, place], begins, step_s)
        _, occupied = by_hour(comfort.occupied[:, place].astype(float), begins, step_s)
        rgba = tint(deviation)
        rgba[..., 3] *= np.where(np.nan_to_num(occupied) > 0, 1.0, _UNOCCUPIED)
        grids.append((curve, days, deviation))
        tints.append(rgba)
    if not grids:
        return None
    name = f"carpet-zone-{number}"
    has_occupants = any(comfort.has_occupants for curve, *_ in grids if (comfort := curve.quantities.comfort))
    faint = " Faint: nobody there." if has_occupants else ""
    limits = (-COMFORT_RANGE_K, COMFORT_RANGE_K)
    drawing = _carpets(name, grids, tints.__getitem__, limits, "K")
    return Figure(
        name, f"{label}: deviation from comfort",
        "Mean deviation from the comfort band in each hour in K: blue below, orange above, blank within."
        f"{faint}",
        f"Carpet of the deviation of {label} from the comfort band over the hours of each day.", drawing,
        _columns(grids, "K"),
    )  # fmt: skip


def tint(deviation: Floats) -> Floats:
    """Return red, green, blue and opacity, 0 to 1, of deviations from the comfort band; nothing within it."""
    size = np.clip(np.nan_to_num(np.abs(deviation)) / _FULL_K, 0.0, 1.0)
    strong = np.sign(deviation) * np.maximum(np.abs(deviation), _FULL_K)
    alpha = np.where(size > 0.0, 0.25 + 0.75 * size, 0.0)
    return np.concatenate([comfort_colors(strong) / 255.0, alpha[..., None]], axis=-1)


def _carpets(
    name: str, panels: Sequence[tuple[Curve, Times, Floats]], colors: Any, limits: tuple[float, float], unit: str
) -> Any:
    rows = -(-len(panels) // _COLUMNS)
    columns = min(len(panels), _COLUMNS)

    def fill(figure: Any) -> None:
        axes = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for place, (axis, (curve, days, grid)) in enumerate(zip(axes, panels, strict=False)):
            axis.imshow(
                colors(place).transpose(1, 0, 2), origin="lower", aspect="auto", interpolation="none",
                extent=(0, len(days), 0, 24),
            )  # fmt: skip
            axis.set_title(curve.name)
            axis.set_facecolor(LIGHT["panel"])
            axis.set_yticks([0, 6, 12, 18, 24], ["0 h", "6", "12", "18", "24"])
            mark_days(axis, days[0], len(days))
            axis.grid(visible=False)
            axis.spines[:].set_visible(False)
            read_cells(axis, unit, curve.name, days, grid)
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        _color_bar(figure, axes, limits, unit)

    return draw(name, 0.45 + 1.45 * rows, fill)


def _color_bar(figure: Any, axes: Any, limits: tuple[float, float], unit: str) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colors: Any = colormaps[_SCALE].resampled(64)
    if unit == "K":
        ramp = np.linspace(*limits, 65)
        colors = ListedColormap(tint(ramp))
    bar = figure.colorbar(
        ScalarMappable(Normalize(*limits), colors), ax=list(axes), aspect=14, pad=0.012, fraction=0.03, label=unit
    )
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0)


def _columns(grids: Sequence[tuple[Curve, Times, Floats]], unit: str) -> dict[str, Sequence[Any]]:
    longest = max((days for _, days, _ in grids), key=len)
    cells = [f"{day} {hour:02}:00" for day in longest for hour in range(24)]
    data: dict[str, Sequence[Any]] = {"hour": cells}
    for curve, _, grid in grids:
        values = grid.ravel().tolist()
        data[f"{curve.name} ({unit})"] = values + [float("nan")] * (len(cells) - len(values))
    return data
