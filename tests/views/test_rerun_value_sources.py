"""Sources of each actuator's value, by column."""

import numpy as np

from zenostat.views.live.row_picture import Columns
from zenostat.views.live.value_sources import SourceColumns


def test_rerun_value_sources__short_override_is_seen_in_a_year_wherever_the_blocks_are_cut() -> None:
    """A year has 26 timesteps a column: the override of one timestep is the color of its column, and of no other."""
    for cut in (1, 27, 30, 52):
        sources = SourceColumns(1, Columns(35040))
        names = np.full((78, 1), "rbc", object)
        names[30] = "operator"
        steps = np.arange(78)
        sources.add(steps[:cut], names[:cut])
        sources.add(steps[cut:], names[cut:])
        assert [list(sources.names)[sources.shown[0, column]] for column in range(3)] == ["rbc", "operator", "rbc"]
        assert (sources.shown[:, 3:] == -1).all()


def test_rerun_value_sources__nobody_is_baseline_control() -> None:
    sources = SourceColumns(2, Columns(10))
    sources.add(np.arange(2), np.array([["", "rbc"], ["rbc", ""]], object))
    names = list(sources.names)
    shown = [[names[index] for index in row] for row in sources.shown[:, :2]]
    assert shown == [["baseline control", "rbc"], ["rbc", "baseline control"]]
