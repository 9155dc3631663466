"""Line plots of the monitor: what is in them, and that sparse lines are the same lines."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import builders
from support.monitor import office, rows, samples

from zenostat.metrics.comfort import default_comfort
from zenostat.metrics.roles import roles
from zenostat.topics.messages import Manifest
from zenostat.views.live.samples import BlockReader, SampleBlock
from zenostat.views.live.series import (
    MAX_SMOOTH_ROWS,
    Series,
    all_series,
    band_rows,
    significant_rows,
    temperature_range,
)
from zenostat.views.live.totals import Totals


def _block(manifest: Manifest, table: np.ndarray) -> SampleBlock:
    return BlockReader(manifest, default_comfort(manifest)).block(samples(manifest, table))


def _plots(manifest: Manifest) -> dict[str, Series]:
    return {plot.path: plot for plot in all_series(manifest, roles(manifest), has_comfort=True)}


@given(st.lists(st.sampled_from([0.0, 1.0, float("nan")]), min_size=1, max_size=40))
def test_rerun_series__rows_left_out_are_equal_to_both_neighbors_that_are_kept(values: list[float]) -> None:
    table = np.array(values)[:, None]
    kept = significant_rows(table)
    assert kept[0] == 0
    assert kept[-1] == len(table) - 1
    for row in set(range(len(table))) - set(kept.tolist()):
        for neighbor in (kept[kept < row][-1], kept[kept > row][0]):
            np.testing.assert_array_equal(table[row], table[neighbor])


def test_rerun_series__constant_line_is_two_rows() -> None:
    assert significant_rows(np.full((300, 3), 21.0)).tolist() == [0, 299]


def test_rerun_series__coldest_median_and_warmest_zone_ignore_unknown_zones() -> None:
    nan = float("nan")
    table = np.array([[20.0, 24.0, 22.0], [nan, 19.0, 23.0], [nan, nan, nan]])
    np.testing.assert_array_equal(temperature_range(table), [[20, 22, 24], [19, 21, 23], [nan, nan, nan]])


def test_rerun_series__meters_are_drawn_in_kilowatts() -> None:
    manifest = office()
    table = rows(2, electricity=[0.0, 9e6], cooling=[0.0, 3.6e6])  # J in a quarter of an hour
    block, plots = _block(manifest, table), _plots(manifest)
    totals = Totals(manifest, roles(manifest)).add(block)
    assert plots["end_uses"].title == "End uses (kW)"
    assert plots["end_uses"].names == ["Cooling"]
    assert plots["end_uses"].compute(block, totals)[1] == pytest.approx([4.0])
    assert plots["power"].names == ["Whole building"]
    assert plots["power"].compute(block, totals)[1] == pytest.approx([10.0])
    assert plots["energy"].compute(block, totals)[1] == pytest.approx([2.5])


def test_rerun_series__zones_have_their_labels_and_their_color_in_each_plot() -> None:
    plots = _plots(office())
    assert plots["temperatures"].names == ["Core", "Perimeter 1"]
    assert plots["temperatures"].colors == plots["occupants"].colors
    assert len(set(plots["temperatures"].colors)) == 2
    assert plots["outdoors"].names == ["Outdoors"]


def test_rerun_series__band_is_bold_while_any_zone_is_occupied() -> None:
    block = _block(office(), rows(3, core_occupants=[0, 2, 0]))
    nan = float("nan")
    np.testing.assert_array_equal(band_rows(block), [[nan, nan, 20, 26], [20, 26, 20, 26], [nan, nan, 20, 26]])


def test_rerun_series__band_has_no_limit_where_no_zone_has_one() -> None:
    block = _block(office(), rows(3))
    low, high = block.low.copy(), block.high.copy()
    low[1:, 0], low[2, 1], high[2] = -np.inf, -np.inf, np.inf
    nan = float("nan")
    limits = band_rows(replace(block, low=low, high=high))[:, 2:]
    np.testing.assert_array_equal(limits, [[20, 26], [20, 26], [nan, nan]])


def test_rerun_series__node_without_end_uses_has_its_other_fuels_beside_its_electric_power() -> None:
    manifest = builders.manifest(
        meters=[builders.meter("electricity"), builders.meter("gas", "NaturalGas:Facility")],
        actuators=[builders.actuator("heating_setpoint")],
    )
    plots = {plot.path: plot for plot in all_series(manifest, roles(manifest), has_comfort=False)}
    assert "end_uses" not in plots
    assert (plots["power"].title, len(plots["power"].names)) == ("Power (kW)", 2)
    assert plots["energy"].names == ["Whole building"]


def test_rerun_series__commands_are_drawn_apart_from_effective_values_with_gaps_where_they_were_relinquished() -> None:
    manifest = office()
    messages = samples(manifest, rows(2), effective=(20.0, 25.0), commanded=(21.0, float("nan")))
    messages.append(samples(manifest, rows(1), first=2)[0])  # a node that does not report its commands
    block = BlockReader(manifest, default_comfort(manifest)).block(messages)
    plots, totals = _plots(manifest), Totals(manifest, roles(manifest)).add(block)
    nan = float("nan")
    heating, cooling = [[21], [21], [nan]], [[nan]] * 3
    np.testing.assert_array_equal(plots["commands/0"].compute(block, totals), heating)
    np.testing.assert_array_equal(plots["commands/1"].compute(block, totals), cooling)
    np.testing.assert_array_equal(plots["actuators/0"].compute(block, totals), [[20]] * 3)
    np.testing.assert_array_equal(plots["actuators/1"].compute(block, totals), [[25]] * 3)
    for number, kind in enumerate(("heating", "cooling")):
        commands, effective = plots[f"commands/{number}"], plots[f"actuators/{number}"]
        assert commands.title == f"Commanded {kind} setpoints (°C)"
        assert (commands.names, commands.colors) == (effective.names, effective.colors)


def test_rerun_series__plant_without_zones_has_plots_by_unit() -> None:
    tank = builders.manifest(
        sensors=[
            builders.sensor("tank_level", "", unit="m").model_copy(update={"key": ""}),
            builders.sensor("inlet_level", "", unit="m").model_copy(update={"key": ""}),
            builders.sensor("flow", "", unit="m3/s").model_copy(update={"key": ""}),
        ],
        actuators=[builders.actuator("valve").model_copy(update={"unit": "fraction"})],
    )
    titles = [plot.title for plot in all_series(tank, roles(tank), has_comfort=False)]
    assert titles == ["Other points (m)", "Flow (m³/s)", "Commanded values", "Effective values"]


def test_rerun_series__energy_so_far_is_logged_at_few_steps_and_at_the_end() -> None:
    energy = _plots(office())["energy"]
    steps = np.arange(35041)
    rows = energy.rows(steps, np.zeros((len(steps), 1)), 35040)
    assert len(rows) <= MAX_SMOOTH_ROWS + 1
    assert rows[[0, -1]].tolist() == [0, 35040]
    assert energy.rows(steps[:97], np.zeros((97, 1)), 96).tolist() == list(range(97))
