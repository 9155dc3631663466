"""The carpet: the value farthest from the band in each column, and its colors."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zenostat.views.display.colors import comfort_color
from zenostat.views.live.carpet import Carpet, picture
from zenostat.views.live.row_picture import EMPTY, MAX_COLUMNS, Columns

NOBODY = np.zeros((26, 2), bool)


def test_rerun_carpet__column_has_the_deviation_that_is_farthest_from_the_band() -> None:
    carpet = Carpet(2, Columns(35040))
    assert carpet.deviations.shape[1] <= MAX_COLUMNS
    steps = np.arange(26)
    assert set(Columns(35040).of(steps).tolist()) == {0}
    deviations = np.zeros((26, 2))
    deviations[3, 0], deviations[7, 0], deviations[9, 1] = 1.5, -2.5, 0.5
    carpet.add(steps[:8], deviations[:8], NOBODY[:8])
    carpet.add(steps[8:], deviations[8:], NOBODY[8:])
    assert carpet.deviations[:, 0].tolist() == [-2.5, 0.5]
    assert np.isnan(carpet.deviations[:, 1:]).all()


def test_rerun_carpet__column_with_occupied_samples_has_the_farthest_of_these() -> None:
    carpet, deviations, is_occupied = Carpet(2, Columns(35040)), np.zeros((26, 2)), NOBODY.copy()
    deviations[:4, 0] = -4.0, 1.0, 0.5, 3.0
    is_occupied[1:3, 0] = True
    for cut in (slice(0, 2), slice(2, None)):
        carpet.add(np.arange(26)[cut], deviations[cut], is_occupied[cut])
    assert carpet.deviations[:, 0].tolist() == [1.0, 0.0]
    assert carpet.is_occupied[:, 0].tolist() == [True, False]


@given(st.integers(1, 100_000))
def test_rerun_carpet__each_step_has_a_column(steps: int) -> None:
    columns = Columns(steps)
    places = columns.of(np.array([0, steps // 2, steps])).tolist()
    assert 0 == places[0] <= places[1] <= places[2] == columns.count - 1 < MAX_COLUMNS


def test_rerun_carpet__unknown_is_replaced_by_what_comes() -> None:
    carpet, occupied = Carpet(1, Columns(10)), np.array([[True]])
    carpet.add(np.array([0]), np.array([[np.nan]]), occupied)
    carpet.add(np.array([0]), np.array([[0.0]]), ~occupied)
    assert carpet.deviations[0, 0] == 0.0


def test_rerun_carpet__pixels_have_the_colors_of_the_comfort_scale_and_are_dark_while_unoccupied() -> None:
    deviations = np.array([[3.0, np.nan], [-1.0, -1.0]])
    pixels = picture(deviations, np.array([[True, True], [True, False]]))
    assert tuple(pixels[0, 0]) == comfort_color(3.0)
    assert tuple(pixels[1, 0]) == comfort_color(-1.0)
    assert tuple(pixels[0, 1]) == EMPTY
    assert pixels[1, 1].sum() < 0.6 * pixels[1, 0].sum()
