"""The plots of electric grids: which points they show, in which units and with which signs."""

import numpy as np
import pytest
from support import builders
from support.monitor import samples

from zenostat.metrics.roles import roles
from zenostat.topics.messages import Manifest, Sensor
from zenostat.views.live.grid_series import DRAWN, GRID_PATHS, LOADING, VOLTAGE, grid_series
from zenostat.views.live.samples import BlockReader
from zenostat.views.live.totals import Totals

POINTS = {
    "house.temperature": "degC", "g.street_voltage": "pu", "g.cable_loading": "percent", "g.import": "W",
    "g.export": "W", "g.house_power": "W", "g.roof_power": "W", "g.roof_available": "W", "h.other_power": "W",
}  # fmt: skip
ROW = [21.0, 0.98, 40.0, 0.0, 1500.0, 2500.0, 4000.0, 4000.0, 9.0]


def district(prefix: str = "g.") -> Manifest:
    names = {name.replace("g.", prefix): unit for name, unit in POINTS.items()}
    return builders.manifest(sensors=[Sensor(name=name, unit=unit) for name, unit in names.items()])


@pytest.mark.parametrize("prefix", ["g.", ""])
def test_grid_series__who_draws_and_who_feeds_in(prefix: str) -> None:
    """PV is below zero, and so is the exchange with the grid above while power is fed in."""
    manifest = district(prefix)
    plots = {plot.path: plot for plot in grid_series(manifest)}
    assert tuple(plots) == GRID_PATHS
    block = BlockReader(manifest, None).block(samples(manifest, np.array([ROW, ROW])))
    totals = Totals(manifest, roles(manifest)).add(block)
    assert list(plots[DRAWN].names) == ["House", "Roof", "From the grid above"]
    assert plots[DRAWN].compute(block, totals)[-1].tolist() == pytest.approx([2.5, -4.0, -1.5])
    assert list(plots[LOADING].names) == ["Cable", "Rated"]
    assert plots[LOADING].compute(block, totals)[-1].tolist() == [40.0, 100.0]
    assert plots[VOLTAGE].compute(block, totals)[-1].tolist() == [0.98]


def test_grid_series__node_without_a_grid_has_none() -> None:
    assert grid_series(builders.manifest(sensors=[builders.sensor("zone")])) == []
