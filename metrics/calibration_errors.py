"""Errors of simulated against measured values, and the criteria of ASHRAE Guideline 14 for calibrated simulations.

    NMBE     = 100 % * sum(m - s) / ((n - p) * mean(m))
    CV(RMSE) = 100 % * sqrt(sum((m - s)^2) / (n - p)) / mean(m)

with n measured values m, simulated values s, and p = 1 for a calibrated simulation (ASHRAE Guideline 14-2014, section
5.2.11.3, and Guideline 14-2002, section 5.2.11; the common mistakes in their use: Ruiz and Bandera, Energies 10 (2017)
1587). A positive NMBE means that the model underestimates. Limits: CV(RMSE) 30 % and NMBE 10 % of hourly values, 15 %
and 5 % of monthly values. The guideline has none for temperatures, whose mean depends on the zero of the scale: they
are rated by RMSE and mean bias themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from zenostat.topics.arrays import Floats


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the errors of a calibrated model in percent of the measured mean."""

    cv_rmse_percent: float
    nmbe_percent: float


HOURLY, MONTHLY = Limits(30.0, 10.0), Limits(15.0, 5.0)


@dataclass(frozen=True, slots=True)
class FitErrors:
    """Errors of simulated values.

    Attributes:
        count: number of values n.
        mean: mean of the measured values.
        rmse, mbe: root-mean-square error and mean bias m - s, with n - p in the denominator; NaN if n is not above p.
    """

    count: int
    mean: float
    rmse: float
    mbe: float

    @property
    def cv_rmse_percent(self) -> float:
        """CV(RMSE) in percent of the measured mean; NaN if that is 0."""
        return 100.0 * self.rmse / self.mean if self.mean else math.nan

    @property
    def nmbe_percent(self) -> float:
        """NMBE in percent of the measured mean; NaN if that is 0."""
        return 100.0 * self.mbe / self.mean if self.mean else math.nan

    def is_within(self, limits: Limits) -> bool:
        """Whether both errors are within their limits."""
        return abs(self.cv_rmse_percent) <= limits.cv_rmse_percent and abs(self.nmbe_percent) <= limits.nmbe_percent


def fit_errors(measured: Floats, simulated: Floats, adjustable: int = 1) -> FitErrors:
    """Return the errors of simulated values.

    Args:
        measured: shape (n,); finite.
        simulated: shape (n,); finite.
        adjustable: p, the number by which n is reduced.
    """
    count = len(measured)
    if not count:
        return FitErrors(0, math.nan, math.nan, math.nan)
    differences, free = measured - simulated, count - adjustable
    mean = float(np.mean(measured))
    if free <= 0:
        return FitErrors(count, mean, math.nan, math.nan)
    return FitErrors(count, mean, math.sqrt(float(np.sum(differences**2)) / free), float(np.sum(differences)) / free)
