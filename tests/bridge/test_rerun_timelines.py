"""States of zones over time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.rerun.timelines import comfort_states, comfort_styles


@pytest.mark.parametrize(
    ("deviation", "state"),
    [
        (0.0, "within"), (0.05, "within"), (-0.05, "within"), (0.06, "under 1 K above"), (1.0, "under 1 K above"),
        (1.01, "1 to 2 K above"), (2.0, "1 to 2 K above"), (4.0, "2 to 4 K above"), (4.1, "over 4 K above"),
        (-0.06, "under 1 K below"), (-1.0, "under 1 K below"), (-1.5, "1 to 2 K below"), (-4.0, "2 to 4 K below"),
        (-9.0, "over 4 K below"), (float("nan"), "unknown"),
    ],
)  # fmt: skip
def test_state_of_a_deviation(deviation: float, state: str) -> None:
    assert comfort_states(np.array([deviation]), np.array([True])).tolist() == [state]


@given(st.floats(-9, 9) | st.just(float("nan")), st.booleans())
def test_each_state_has_a_style(deviation: float, is_occupied: bool) -> None:
    (state,) = comfort_states(np.array([deviation]), np.array([is_occupied])).tolist()
    assert state in comfort_styles()


def test_unoccupied_zones_are_darker() -> None:
    styles = comfort_styles()
    for state, (_, color) in styles.items():
        if f"{state}, unoccupied" in styles:
            assert sum(styles[f"{state}, unoccupied"][1]) < sum(color)
