"""Quantities of learning curves: means of episodes, evaluations and references."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from zenostat.topics.arrays import Floats

MEAN_OF = 100
"""Number of episodes in a moving mean, as stable-baselines3 logs it."""


class Evaluation(NamedTuple):
    """Values of the episodes that were evaluated at one training step."""

    step: float
    mean: float
    low: float
    high: float


def moving_mean(values: ArrayLike) -> Floats:
    """Return the mean of each value and those before it, at most `MEAN_OF`; shape (values,)."""
    sums = np.concatenate([[0.0], np.cumsum(np.asarray(values, np.float64))])
    ends = np.arange(1, len(sums))
    begins = np.maximum(ends - MEAN_OF, 0)
    means: Floats = (sums[ends] - sums[begins]) / (ends - begins)
    return means


def by_step(steps: Iterable[float | None], values: Iterable[float | None]) -> list[Evaluation]:
    """Return the mean and the extremes of the values of each step; those that are missing are left out."""
    groups: dict[float, list[float]] = {}
    for step, value in zip(steps, values, strict=True):
        if step is not None and value is not None:
            groups.setdefault(step, []).append(value)
    return [Evaluation(step, fmean(each), min(each), max(each)) for step, each in groups.items()]


def reference_means(path: Path, metric: str) -> dict[str, float]:
    """Return the mean of a metric by reference of a training, from `references.csv`.

    Cells that are no numbers are left out, such as those of metrics that a reference has not; empty if there is no
    such file or metric.
    """
    values: dict[str, list[float]] = {}
    with suppress(OSError), path.open(newline="", encoding="utf-8", errors="replace") as file:
        for row in csv.DictReader(file):
            with suppress(KeyError, TypeError, ValueError):  # a cell that is no number, or a line that is not complete
                value = float(row[metric])
                values.setdefault(row["controller"], []).append(value)
    return {name: fmean(each) for name, each in values.items()}
