"""Line plots of an electric grid: loading and voltage by line and bus, and who draws how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zenostat.metrics.labels import label
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest
from zenostat.views.display.colors import RGB, zone_color
from zenostat.views.live.samples import SampleBlock
from zenostat.views.live.series import Compute, Series

LOADING, VOLTAGE, DRAWN = "grid/loading", "grid/voltage", "grid/power"
GRID_PATHS = (LOADING, DRAWN, VOLTAGE)
"""Plots in the order of the tab."""

RATED: RGB = (220, 60, 60)
NET: RGB = (128, 128, 128)


@dataclass(frozen=True, slots=True)
class GridPoints:
    """The points of a grid, as indices into `Manifest.points`.

    Attributes:
        loadings: of lines and transformers, percent.
        voltages: of buses, per unit.
        powers: of what is connected, W; `signs` are -1 for what feeds in.
        exchange: import and export, W; None if one is missing.
    """

    loadings: tuple[int, ...]
    voltages: tuple[int, ...]
    powers: tuple[int, ...]
    signs: tuple[float, ...]
    exchange: tuple[int, int] | None


def grid_points(manifest: Manifest) -> GridPoints | None:
    """Return the points of the first grid among the plants of a node; None if there is none.

    A grid has sensors `LINE_loading` in percent and `BUS_voltage` per unit; see docs/grid.md.
    """
    units = {sensor.name: sensor.unit for sensor in manifest.sensors}
    places = {sensor.name: place for place, sensor in enumerate(manifest.sensors)}
    prefixes = [name.rpartition(".")[0] for name, unit in units.items() if name.endswith("_voltage") and unit == "pu"]
    if not prefixes:
        return None
    start = f"{prefixes[0]}." if prefixes[0] else ""
    own = [name for name in units if name.startswith(start) and "." not in name[len(start) :]]

    def ending(text: str, unit: str) -> list[str]:
        return [name for name in own if name.endswith(text) and units[name] == unit]

    powers = ending("_power", "W")
    is_fed = [f"{name.removesuffix('_power')}_available" in units for name in powers]
    exchange = [places.get(f"{start}{name}") for name in ("import", "export")]
    return GridPoints(
        tuple(places[name] for name in ending("_loading", "percent")),
        tuple(places[name] for name in ending("_voltage", "pu")),
        tuple(places[name] for name in powers),
        tuple(-1.0 if fed else 1.0 for fed in is_fed),
        None if None in exchange else (exchange[0], exchange[1]),  # type: ignore[arg-type]
    )


def grid_series(manifest: Manifest) -> list[Series]:
    """Return the plots of a node's grid; none if it has no grid."""
    points = grid_points(manifest)
    if points is None:
        return []
    series = []
    if points.loadings:
        compute = _loadings(points.loadings)
        series.append(_series(LOADING, "Loading (%)", manifest, points.loadings, "_loading", compute))
    if points.powers:
        series.append(_series(DRAWN, "Who draws how much (kW)", manifest, points.powers, "_power", _powers(points)))
    series.append(_series(VOLTAGE, "Voltage (p.u.)", manifest, points.voltages, "_voltage", _columns(points.voltages)))
    return series


def _series(path: str, title: str, manifest: Manifest, points: Sequence[int], ending: str, compute: Compute) -> Series:
    names = [label(manifest.points[i].name.rpartition(".")[2].removesuffix(ending)) for i in points]
    colors = [zone_color(place) for place in range(len(names))]
    widths = [2.0] * len(names)
    if path == LOADING:
        names, colors, widths = [*names, "Rated"], [*colors, RATED], [*widths, 1.0]
    if path == DRAWN:
        names, colors, widths = [*names, "From the grid above"], [*colors, NET], [*widths, 3.0]
    return Series(path, title, names, colors, compute=compute, widths=widths, is_step=True)


def _columns(points: Sequence[int]) -> Compute:
    columns = np.array(points, np.intp)
    return lambda block, _: block.values[:, columns]


def _loadings(points: Sequence[int]) -> Compute:
    columns = np.array(points, np.intp)

    def compute(block: SampleBlock, _: object) -> Floats:
        return np.column_stack([block.values[:, columns], np.full(len(block), 100.0)])

    return compute


def _powers(points: GridPoints) -> Compute:
    columns, signs = np.array(points.powers, np.intp), np.array(points.signs) * 1e-3

    def compute(block: SampleBlock, _: object) -> Floats:
        drawn = block.values[:, columns] * signs
        if points.exchange is None:
            return np.column_stack([drawn, np.full(len(block), np.nan)])
        import_w, export_w = (block.values[:, column] for column in points.exchange)
        return np.column_stack([drawn, (import_w - export_w) * 1e-3])

    return compute
