"""Colors of zones over time."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.monitor import BEGIN

from zenostat.views.live.building_view import PERIOD_S, QUANTUM_K, ColorChanges

SERIES = st.lists(st.floats(-6, 6) | st.just(float("nan")), min_size=1, max_size=60)


def _times(count: int, step_s: int) -> np.ndarray:
    return BEGIN + np.arange(count) * np.timedelta64(step_s, "s")


@given(SERIES, st.integers(1, 59))
def test_rerun_building_view__color_shown_is_that_of_the_sample_whatever_the_blocks_are(
    values: list[float], cut: int
) -> None:
    deviations, times = np.array(values)[:, None], _times(len(values), PERIOD_S)
    whole, parts = ColorChanges(1).select(times, deviations), ColorChanges(1)
    (first,), (second,) = (parts.select(times[part], deviations[part]) for part in (slice(cut), slice(cut, None)))
    (rows, shown) = whole[0]
    np.testing.assert_array_equal(rows, np.concatenate([first[0], second[0] + min(cut, len(values))]))
    np.testing.assert_array_equal(shown, np.concatenate([first[1], second[1]]))
    for row, value in enumerate(values):
        color = shown[np.searchsorted(rows, row, side="right") - 1]
        assert np.isnan(color) if np.isnan(value) else abs(color - value) <= QUANTUM_K / 2 + 1e-9


def test_rerun_building_view__equal_colors_are_one() -> None:
    ((rows, shown),) = ColorChanges(1).select(_times(5, 900), np.array([[0.0], [0.02], [1.0], [1.1], [0.0]]))
    assert rows.tolist() == [0, 2, 4]
    assert shown.tolist() == [0.0, 1.0, 0.0]


def test_rerun_building_view__short_timesteps_have_one_color_in_a_quarter_of_an_hour() -> None:
    ((rows, _),) = ColorChanges(1).select(_times(61, 60), np.arange(61.0)[:, None])
    assert rows.tolist() == [0, 15, 30, 45, 60]


def test_rerun_building_view__slightly_outside_is_not_shown_as_within() -> None:
    ((_, shown),) = ColorChanges(1).select(_times(3, 900), np.array([[0.0], [0.1], [-0.1]]))
    assert shown[0] == 0.0
    assert shown[1] > 0.0 > shown[2]
