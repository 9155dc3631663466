"""Conversions between timesteps: the mean keeps the sum, lines stay lines."""

from math import lcm

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.cosim.file import Resample
from zenostat.cosim.resampling import Resampler

COUNTS = st.integers(1, 6)


@given(COUNTS, COUNTS, st.data())
def test_mean__integral_is_kept(inputs: int, outputs: int, data: st.DataObject) -> None:
    values = np.array(data.draw(st.lists(st.floats(-1e3, 1e3), min_size=inputs, max_size=inputs)))
    result = Resampler(Resample.MEAN, inputs, outputs)(values, 0.0)
    assert result.shape == (outputs,)
    assert result.mean() == pytest.approx(values.mean(), abs=1e-9)


@given(COUNTS, COUNTS, st.data())
def test_mean__equals_the_mean_of_a_common_grid(inputs: int, outputs: int, data: st.DataObject) -> None:
    values = np.array(data.draw(st.lists(st.floats(-1e3, 1e3), min_size=inputs, max_size=inputs)))
    grid = np.repeat(values, lcm(inputs, outputs) // inputs)
    expected = grid.reshape(outputs, -1).mean(axis=1)
    assert Resampler(Resample.MEAN, inputs, outputs)(values, 0.0) == pytest.approx(expected, abs=1e-9)


@given(COUNTS, COUNTS, st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_interpolate__a_line_is_its_value_in_the_middle_of_each_timestep(
    inputs: int, outputs: int, slope: float, begin: float
) -> None:
    values = begin + slope * (np.arange(inputs) + 1.0) / inputs
    expected = begin + slope * (np.arange(outputs) + 0.5) / outputs
    assert Resampler(Resample.INTERPOLATE, inputs, outputs)(values, begin) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("inputs", "outputs", "expected"),
    [(1, 4, [0, 0, 0, 0]), (4, 1, [3]), (3, 2, [1, 2]), (2, 3, [0, 1, 1]), (2, 2, [0, 1])],
)
def test_hold__latest_value_at_the_end_of_each_timestep(inputs: int, outputs: int, expected: list[int]) -> None:
    values = np.arange(inputs, dtype=float)
    assert Resampler(Resample.HOLD, inputs, outputs)(values, -1.0).tolist() == expected
