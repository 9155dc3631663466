"""Intervals of a calibration against theory: coverage of the truth, and derivatives of a model that is not smooth."""

from __future__ import annotations

import math
from datetime import date
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.calibration_model import SERIES, WINTER, LinearModel, write_measured

from zenostat.lab.calibration.config import read_calibration
from zenostat.lab.calibration.derivatives import Derivatives, derivatives, points
from zenostat.lab.calibration.determination import linearize
from zenostat.lab.calibration.headings import read_headings
from zenostat.lab.calibration.measured import read_measured
from zenostat.lab.calibration.objective import Compared

Floats = NDArray[np.float64]

ROWS = 336
HOURS = np.arange(ROWS)
IS_DAY = (HOURS % 24 >= 8) & (HOURS % 24 < 18)
COLD = 2.0 + np.cos((HOURS % 24 - 5) * math.pi / 12.0) + 6.0 * (HOURS % 24 == 7)
SLOPES = np.stack([COLD * 3.0, np.where(IS_DAY, 5.0, 0.2), np.where(IS_DAY, 0.6, 3.0)], axis=1)
TRUE = 4.0 + SLOPES @ np.array([0.6, 0.4, 0.5])
NORMAL_95 = 1.959963984540054


def compared(measured: Floats, simulated: Floats) -> list[Compared]:
    column: Any = SimpleNamespace(header="energy", settings=SimpleNamespace(weight=1.0))
    return [Compared(column, tuple(range(len(measured))), measured, simulated)]


def test_linearize__confidence_intervals_contain_the_truth_in_95_percent() -> None:
    """With noise that grows with the value, as of meters: 2,000 measurements of a linear model of three parameters."""
    rng = np.random.Generator(np.random.PCG64(3))
    scales = {"energy": (0.3 * float(TRUE.mean()), 0.1 * float(TRUE.mean()))}
    inside = np.zeros(3)
    for _ in range(2000):
        measured = TRUE * (1.0 + 0.05 * rng.standard_normal(ROWS))
        # the step to the optimum, and the covariance there
        step = linearize(compared(measured, TRUE), [Derivatives(SLOPES, SLOPES)], scales, 1).step
        linear = linearize(compared(measured, TRUE + SLOPES @ step), [Derivatives(SLOPES, SLOPES)], scales, 1)
        assert np.abs(linear.step).max() < 0.01
        inside += np.abs(step) <= NORMAL_95 * np.sqrt(np.diag(linear.covariance))
    # three standard deviations of a share of 2,000 are 1.5 %
    assert inside / 2000 == pytest.approx(np.full(3, 0.95), abs=0.015)


def test_linearize__roughness_of_the_model_is_no_information() -> None:
    """A parameter without effect, whose simulations differ a little at random, is not determined."""
    rng = np.random.Generator(np.random.PCG64(4))
    scales = {"energy": (0.3 * float(TRUE.mean()), 0.1 * float(TRUE.mean()))}
    measured = TRUE * (1.0 + 0.05 * rng.standard_normal(ROWS))
    deviations = []
    for _ in range(40):
        inner, outer = (np.column_stack([SLOPES, 0.5 * rng.standard_normal(ROWS)]) for _ in range(2))
        linear = linearize(compared(measured, TRUE), [Derivatives(inner, outer)], scales, 1)
        deviations.append(math.sqrt(linear.covariance[3, 3]))
    same = linearize(compared(measured, TRUE), [Derivatives(inner, inner)], scales, 1)
    assert math.sqrt(same.covariance[3, 3]) < 0.1  # the square of one estimate determines it
    assert np.median(deviations) > 0.8 / math.sqrt(12.0)  # and the product of two nothing: it is uniform in its range


@pytest.mark.parametrize(("place", "count"), [(0.5, 4), (0.12, 4), (0.05, 2), (0.0, 2), (1.0, 2)])
def test_derivatives__of_a_quadratic_model_are_exact_in_the_middle_of_a_range(
    tmp_path: Any, place: float, count: int
) -> None:
    class Quadratic(LinearModel):
        def simulate(self, values: Any, days: tuple[date, date]) -> Floats:
            return np.asarray(super().simulate({"offset": values["offset"] ** 2}, days), np.float64)

    config = read_calibration({
        "timestamps": "end", "periods": [WINTER], "trials": 1, "output": str(tmp_path / "out"),
        "parameters": {"offset": {"edit": "heating_setpoint", "low": 1.0, "high": 3.0}},
    })  # fmt: skip
    file = write_measured(tmp_path / "measured.csv")
    data = read_measured(file, config, read_headings(file, config)[1], SERIES, -7.0)
    value = 1.0 + 2.0 * place
    sides = points(config, {"offset": value})
    assert len(sides) == count
    assert all(1.0 <= each["offset"] <= 3.0 for each in sides)
    hours = [{WINTER: Quadratic().simulate(each, WINTER)} for each in ({"offset": value}, *sides)]
    (energy, room), failing = derivatives(config, data, {"offset": value}, hours[0], hours[1:])
    assert not failing
    assert not energy.inner.any()
    assert not energy.outer.any()
    slope = 2.0 * value * 2.0  # of the square, per range
    away = 0.0 if count == 4 else 0.2 if place < 0.5 else -0.2  # the middle of the steps, in units of the range
    assert room.mean == pytest.approx(np.full((72, 1), slope + 4.0 * away), rel=1e-9)
