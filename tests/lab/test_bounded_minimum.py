"""Minima of quadratic functions within bounds, against the conditions of Karush, Kuhn and Tucker."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from zenostat.lab.calibration.bounded_minimum import bounded_minimum


@pytest.mark.parametrize("seed", range(200))
def test_bounded_minimum__meets_the_conditions_of_an_optimum(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 9))
    rank = int(random.integers(1, count + 1))
    factors = random.normal(size=(count, rank)) * 10.0 ** random.uniform(-2, 2, size=(count, 1))
    curvature, gradient = factors @ factors.T, factors @ random.normal(size=rank)
    low, high = -random.uniform(0.0, 1.0, count), random.uniform(0.0, 1.0, count)
    if seed % 4 == 0:
        low[0] = 0.0  # a parameter that begins at an end of its range
    x = bounded_minimum(curvature, gradient, low, high)
    assert np.all((low <= x) & (x <= high))
    slope, size = gradient - curvature @ x, np.abs(gradient).max()
    inside = (x > low) & (x < high)
    assert_allclose(slope[inside] / size, 0.0, atol=1e-4)
    assert np.all(slope[x <= low] <= 1e-4 * size)
    assert np.all(slope[x >= high] >= -1e-4 * size)


def test_bounded_minimum__is_that_without_bounds_where_these_are_far() -> None:
    curvature, gradient = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([1.0, -1.0])
    far = np.full(2, 100.0)
    assert_allclose(bounded_minimum(curvature, gradient, -far, far), [0.8, -0.6], rtol=1e-12)


def test_bounded_minimum__goes_along_a_bound_where_clipping_would_not() -> None:
    # Of two parameters that hardly differ, the optimum is far beyond the range: 10.5 and -9.5. Clipped, it would be
    # (1, -1), at which the function is 0.05 higher than along the bound of the first, where only the sum counts.
    curvature, gradient = np.array([[1.01, 1.0], [1.0, 1.01]]), np.array([1.105, 0.905])
    ones = np.ones(2)
    x = bounded_minimum(curvature, gradient, -ones, ones)

    def value(at: np.ndarray) -> float:
        return float(at @ curvature @ at / 2.0 - gradient @ at)

    assert_allclose(x, [1.0, (0.905 - 1.0) / 1.01], rtol=1e-12)
    assert value(x) < value(np.array([1.0, -1.0])) - 0.01
