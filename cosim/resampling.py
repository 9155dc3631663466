"""Values of one timestep as values of another one, within a step of the district that both divide."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, fsum

import numpy as np

from zenostat.cosim.file import Resample
from zenostat.topics.arrays import Floats

TICK_S = 1e-6
"""Timesteps are whole numbers of microseconds."""


def whole_steps(duration_s: float, step_s: float) -> int:
    """Return the number of whole timesteps in a time: ten of 0.1 s in 1 s, whose quotient floors to 9."""
    return round(duration_s / TICK_S) // round(step_s / TICK_S)


class Resampler:
    """Converts the values of a step of the district from one timestep to another.

    Each value belongs to the timestep that it ends. The results are exact sums (`math.fsum`), equal on any machine.

    Args:
        kind: hold, mean or interpolate.
        inputs: timesteps of the source in a step of the district.
        outputs: those of the target.

    Attributes:
        is_identity: whether values remain as they are.
    """

    def __init__(self, kind: Resample, inputs: int, outputs: int) -> None:
        self.is_identity = inputs == outputs and kind is not Resample.INTERPOLATE
        self._columns: list[int] = []
        self._weights: list[list[float]] = []
        if kind is Resample.HOLD:
            self._columns = [ceil(Fraction((j + 1) * inputs, outputs)) - 1 for j in range(outputs)]
        elif kind is Resample.MEAN:
            self._weights = [
                [0.0, *(float(_overlap(i, inputs, j, outputs)) for i in range(inputs))] for j in range(outputs)
            ]
        else:
            self._weights = [[float(_hat(i, inputs, j, outputs)) for i in range(inputs + 1)] for j in range(outputs)]

    def __call__(self, values: Floats, previous: float) -> Floats:
        """Return the values of the target's timesteps, shape (outputs,).

        Args:
            values: of the source's timesteps, shape (inputs,).
            previous: the source's value before them, for interpolation.
        """
        if self.is_identity:
            return values
        if self._columns:
            return values[self._columns]
        row = [previous, *values.tolist()]
        return np.array([fsum(w * v for w, v in zip(weights, row, strict=True) if w) for weights in self._weights])


def _overlap(source: int, inputs: int, target: int, outputs: int) -> Fraction:
    """Return the part of a target's timestep in which a source's timestep lies."""
    low = max(Fraction(source, inputs), Fraction(target, outputs))
    high = min(Fraction(source + 1, inputs), Fraction(target + 1, outputs))
    return max(high - low, Fraction(0)) * outputs


def _hat(sample: int, inputs: int, target: int, outputs: int) -> Fraction:
    """Return the mean, over a target's timestep, of the function that is 1 at a sample and 0 at the others."""
    low, high, total = Fraction(target, outputs), Fraction(target + 1, outputs), Fraction(0)
    for begin, rises in ((Fraction(sample - 1, inputs), True), (Fraction(sample, inputs), False)):
        a, b = max(low, begin), min(high, begin + Fraction(1, inputs))
        if a < b:
            middle = ((a + b) / 2 - begin) * inputs  # the function is linear there
            total += (b - a) * (middle if rises else 1 - middle)
    return total * outputs
