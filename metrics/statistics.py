"""Statistics of metrics over episodes."""

from __future__ import annotations

import importlib
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class MetricSummary:
    """Statistics of a metric over the episodes of a controller.

    Attributes:
        count: number of episodes.
        mean: mean over the episodes.
        deviation: sample standard deviation (divided by count - 1); None for one episode, or if the mean is not finite.
        interval: 95 % confidence interval of the mean (Student's t); None as the deviation, or without SciPy.
    """

    count: int
    mean: float
    deviation: float | None
    interval: tuple[float, float] | None

    @property
    def half_width(self) -> float | None:
        """Half of the interval: what tables and reports show after ±."""
        return None if self.interval is None else (self.interval[1] - self.interval[0]) / 2


def summarize(values: Sequence[Any]) -> MetricSummary:
    """Return the statistics of at least one value."""
    count, mean = len(values), statistics.fmean(values)
    if count == 1 or not math.isfinite(mean):
        return MetricSummary(count, mean, None, None)
    deviation = statistics.stdev(values)
    quantile = _student_quantile(count - 1)
    half_width = None if quantile is None else quantile * deviation / count**0.5
    return MetricSummary(count, mean, deviation, None if half_width is None else (mean - half_width, mean + half_width))


def _student_quantile(degrees_of_freedom: int) -> float | None:
    """Return the 97.5 % quantile of Student's t distribution; None without SciPy."""
    try:
        return float(importlib.import_module("scipy.stats").t.ppf(0.975, degrees_of_freedom))
    except ImportError:
        return None
