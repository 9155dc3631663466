"""Intervals and correlations of parameters by measured data, and a step towards the optimum.

Around a point, simulated values are taken as linear in the parameters, on the scale of the search (0 to 1 in a range).
With residuals r, derivatives J and their means over the n rows of a column, the gradient of the squared objective is
-2 sum(w g r) with g = J / (n R^2) + mean(J) / (n B^2), where R and B are the RMSE and the mean bias that count as 1. So

    precision  = A inv(C) A + 12                A = sum(w g J')
    covariance = inv(precision)                 C = sum(w^2 g g' r^2 (1 + q) / (1 - q))
    step       = covariance A inv(C) sum(w g r)

which is the covariance of an M-estimator (Huber 1967, White 1980: errors of any variance, as those that grow with the
value) with the number of independent residuals n (1 - q) / (1 + q) of a series with the lag-1 autocorrelation q (Bayley
and Hammersley 1946), and with a uniform distribution over the range, of variance 1/12, before any measurement. The
products in A are those of two independent estimates of the derivatives, see `zenostat.lab.calibration.derivatives`; a
direction of the parameters in which they are not positive is not determined at all.

The interval of a parameter joins the 95 % confidence interval with the span of all trials whose error is at most the
best one's times 1 + margin. The confidence interval is that of the best values, of the optimum to which the step leads,
and of all between, since a search ends near an optimum only. A parameter is determined if the joined interval has at
most half of its range.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zenostat.lab.calibration.bounded_minimum import bounded_minimum
from zenostat.lab.calibration.config import Calibration, Parameter
from zenostat.lab.calibration.derivatives import Derivatives
from zenostat.lab.calibration.objective import Compared, Scales
from zenostat.topics.arrays import Floats

_NORMAL_95 = 1.959963984540054
_AT_END = 0.01
_CORRELATED = 0.9
_BINS = 12
_SINGULAR = 1e-9
"""Ratio of singular values below which a direction has no effect."""
_EXACT = 1e-3
"""Residuals as share of the RMSE that counts as 1, below which they tell nothing more."""


@dataclass(frozen=True)
class Determined:
    """Interval and verdict of a parameter.

    Attributes:
        value: best value.
        low, high: joined interval, within the range.
        spread: lowest and highest value of the trials within the margin.
        interval: 95 % confidence interval from the best value to the optimum of the linearized model, within the range.
        share: share of the range that the joined interval has, on the scale of the search.
        is_determined: whether that is small enough.
        is_at_end: whether the best value is at an end of the range.
        is_failing: whether the model cannot be simulated with values nearby.
        correlations: correlation with each other parameter.
        profile: for parts of the range, the middle and the lowest error of a trial there, of parts with trials.
    """

    name: str
    value: float
    low: float
    high: float
    spread: tuple[float, float]
    interval: tuple[float, float]
    share: float
    is_determined: bool
    is_at_end: bool
    is_failing: bool
    correlations: Mapping[str, float]
    profile: Sequence[tuple[float, float]]

    @property
    def confused_with(self) -> list[str]:
        """Parameters that can hardly be told apart from this one."""
        return [name for name, value in self.correlations.items() if abs(value) >= _CORRELATED]

    @property
    def verdict(self) -> str:
        """Verdict of the data on the parameter."""
        parts = ["determined" if self.is_determined else "not determined"]
        if self.is_at_end:
            parts.append("at an end of its range")
        if self.is_failing:
            parts.append("values nearby cannot be simulated")
        if self.confused_with:
            parts.append(f"hardly told apart from {', '.join(self.confused_with)}")
        return "; ".join(parts)

    def plain(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "value": self.value, "low": self.low, "high": self.high, "spread": list(self.spread),
            "interval": list(self.interval), "share": self.share, "determined": self.is_determined,
            "at_end": self.is_at_end, "correlations": dict(self.correlations), "verdict": self.verdict,
        }  # fmt: skip


@dataclass(frozen=True)
class Linearization:
    """The objective around a point of the search.

    Attributes:
        step: step to the optimum of the linearized model, given that each parameter is within its range before any
            measurement, shape (parameters,), on the scale of the search.
        covariance: covariance of the parameters there, shape (parameters, parameters).
        weighted: precision times step, shape (parameters,).
        curvature, gradient: half the second derivatives of the squared objective, and minus half the first ones. Their
            optimum is farther away, and the better one far from the optimum, where residuals are no noise.
    """

    step: Floats
    covariance: Floats
    weighted: Floats
    curvature: Floats
    gradient: Floats

    def bounded_steps(self, center: Floats) -> list[Floats]:
        """Return steps to the optimum within the ranges: with all that is known, from the measurement alone, and parts.

        Args:
            center: the point on the scale of the search, shape (parameters,).
        """
        low, high = -center, 1.0 - center
        newton = bounded_minimum(self.curvature, self.gradient, low, high)
        precision = np.asarray(np.linalg.inv(self.covariance), np.float64)
        known = bounded_minimum(precision, self.weighted, low, high)
        return [known, newton, newton / 2.0, newton / 4.0]


def linearize(
    compared: Sequence[Compared], derived: Sequence[Derivatives], scales: Scales, adjustable: int
) -> Linearization:
    """Return steps and covariance at a point; see the module.

    Args:
        compared: measured and simulated values of each column at the point.
        derived: derivatives of each column there, or at a point nearby.
        scales: RMSE and mean bias of each column that count as 1.
        adjustable: number that is subtracted from that of the rows, as in the objective.
    """
    count = derived[0].inner.shape[1]
    curvature, noise, gradient = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for each, slopes in zip(compared, derived, strict=True):
        residuals, free = each.measured - each.simulated, max(len(each.measured) - adjustable, 1)
        spread, bias = scales[each.column.header]
        weight = each.column.settings.weight
        inner, pull = (
            part / (free * spread**2) + part.sum(axis=0) / (free * bias) ** 2 for part in (slopes.inner, slopes.mean)
        )
        curvature += weight * inner.T @ slopes.outer
        gradient += weight * pull.T @ residuals
        squares = residuals**2 + (_EXACT * spread) ** 2
        noise += weight**2 * (pull * squares[:, None]).T @ pull * _dependence(each)
    curvature = _positive(curvature)
    gain = curvature @ np.linalg.pinv(noise, rcond=_SINGULAR, hermitian=True)
    covariance = np.asarray(np.linalg.inv(gain @ curvature + 12.0 * np.eye(count)), np.float64)
    weighted = np.asarray(gain @ gradient, np.float64)
    return Linearization(covariance @ weighted, covariance, weighted, curvature, gradient)


def _positive(curvature: Floats) -> Floats:
    """Return the nearest symmetric matrix without negative eigenvalues."""
    values, directions = np.linalg.eigh((curvature + curvature.T) / 2.0)
    return np.asarray((directions * np.maximum(values, 0.0)) @ directions.T, np.float64)


def _dependence(each: Compared) -> float:
    """Return the factor by which autocorrelated residuals raise the variance of their sum."""
    centered = each.measured - each.simulated
    centered = centered - centered.mean()
    total = float(np.sum(centered**2))
    lag = float(np.sum(centered[1:] * centered[:-1])) / total if total > 0.0 else 0.0
    lag = min(max(lag, 0.0), 0.99)
    return (1.0 + lag) / (1.0 - lag)


def stepped(config: Calibration, center: Mapping[str, float], step: Floats) -> dict[str, float]:
    """Return the values a step away from a point, the nearest ones that may be searched."""
    return {
        name: parameter.nearest(parameter.from_unit(min(max(parameter.to_unit(center[name]) + float(part), 0.0), 1.0)))
        for (name, parameter), part in zip(config.parameters.items(), step, strict=True)
    }


def determine(
    config: Calibration, best: Mapping[str, float], linear: Linearization,
    trials: Sequence[tuple[Mapping[str, float], float]], failing: Collection[str] = (),
) -> list[Determined]:  # fmt: skip
    """Return interval and verdict of each parameter.

    Args:
        config: the calibration.
        best: best values.
        linear: step and covariance at these.
        trials: values and error of each trial that was simulated to its end, and of the best values.
        failing: parameters that cannot be simulated with values nearby.
    """
    names, covariance = list(config.parameters), linear.covariance
    lowest = min(error for _, error in trials)
    good = [values for values, error in trials if error <= lowest * (1.0 + config.margin)]
    result = []
    for place, (name, parameter) in enumerate(config.parameters.items()):
        middle = parameter.to_unit(best[name])
        of_trials = [parameter.to_unit(values[name]) for values in good]
        spread = min(of_trials), max(of_trials)
        half = _NORMAL_95 * math.sqrt(max(float(covariance[place, place]), 0.0))
        optimum = min(max(middle + float(linear.step[place]), 0.0), 1.0)
        interval = max(min(middle, optimum) - half, 0.0), min(max(middle, optimum) + half, 1.0)
        joined = min(spread[0], interval[0]), max(spread[1], interval[1])
        share = joined[1] - joined[0]
        result.append(
            Determined(
                name, best[name], parameter.from_unit(joined[0]), parameter.from_unit(joined[1]),
                (parameter.from_unit(spread[0]), parameter.from_unit(spread[1])),
                (parameter.from_unit(interval[0]), parameter.from_unit(interval[1])),
                share, share <= config.determined, not _AT_END < middle < 1.0 - _AT_END, name in failing,
                _correlations(covariance, place, names), _profile(parameter, name, trials),
            )
        )  # fmt: skip
    return result


def _correlations(covariance: Floats, place: int, names: Sequence[str]) -> dict[str, float]:
    deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(np.float64).tiny))
    return {
        name: float(covariance[place, other] / (deviations[place] * deviations[other]))
        for other, name in enumerate(names) if other != place
    }  # fmt: skip


def _profile(
    parameter: Parameter, name: str, trials: Sequence[tuple[Mapping[str, float], float]]
) -> list[tuple[float, float]]:
    lowest: dict[int, float] = {}
    for values, error in trials:
        part = min(int(parameter.to_unit(values[name]) * _BINS), _BINS - 1)
        lowest[part] = min(error, lowest.get(part, error))
    return [(parameter.from_unit((part + 0.5) / _BINS), error) for part, error in sorted(lowest.items())]
