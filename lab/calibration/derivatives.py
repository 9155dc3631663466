"""Derivatives of simulated values by the parameters, from simulations around a point; each twice, independently.

A building simulation is a smooth function of its parameters with some roughness: a thermostat or a coil switches a
timestep earlier, an iteration ends one pass sooner. A hundredth of a kelvin, divided by the step of a difference, can
exceed the derivative of a weak parameter, and its square never averages out: a parameter without any effect would seem
to be determined well. This is the bias of least squares with errors in the variables (W. A. Fuller, Measurement Error
Models, 1987, sections 1.1 and 1.4). Products of two estimates whose errors are independent have no such bias. With the
simulated values s at steps of h,

    inner = (s(h) - s(-h)) / (2 h)              outer = ((s(2 h) - s(h)) + (s(-h) - s(-2 h))) / (2 h)

are estimates over disjoint parts of the range. Their errors are independent if those of the increments are (as of an
event that moves by and by), and negatively correlated if those of the simulations are, so that information is never
overestimated on average. Their mean is the central difference over 4 h, whose error by curvature is of second order.
Near an end of a range, all steps are towards its middle: (s(h) - s(0)) / h and (s(2 h) - s(h)) / h.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from zenostat.lab.calibration.config import Calibration, Parameter
from zenostat.lab.calibration.measured import MeasuredData
from zenostat.lab.calibration.objective import Hours, compare
from zenostat.topics.arrays import Floats

STEP = 0.1
"""Step of the differences, as share of a range."""

_LEAST = 0.05
"""Least step in both directions; a point that is nearer to an end of a range has steps in one direction."""


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of a column's values by the parameters, on the scale of the search.

    Attributes:
        inner, outer: two independent estimates, shape (rows, parameters).
    """

    inner: Floats
    outer: Floats

    @property
    def mean(self) -> Floats:
        """Mean of both."""
        return (self.inner + self.outer) / 2.0


def steps(parameter: Parameter, value: float) -> tuple[float, ...]:
    """Return the steps from a value at which a model is simulated: -2 h, -h, h and 2 h, or h and 2 h near an end."""
    place = parameter.to_unit(value)
    half = min(place, 1.0 - place) / 2.0
    if half < _LEAST:
        step = STEP if place < 0.5 else -STEP
        return step, 2.0 * step
    step = min(STEP, half)
    return -2.0 * step, -step, step, 2.0 * step


def points(config: Calibration, center: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the values to simulate for the derivatives: two or four for each parameter."""
    return [
        {**center, name: parameter.from_unit(min(max(parameter.to_unit(center[name]) + step, 0.0), 1.0))}
        for name, parameter in config.parameters.items()
        for step in steps(parameter, center[name])
    ]


def derivatives(
    config: Calibration, data: MeasuredData, center: Mapping[str, float], at_center: Hours,
    at_points: Sequence[Hours | None],
) -> tuple[list[Derivatives], frozenset[str]]:  # fmt: skip
    """Return the derivatives of each column's values at its measured rows, and the parameters that have none.

    Args:
        config: the calibration.
        data: measured data.
        center: values at the point.
        at_center: simulated hours there.
        at_points: simulated hours with `points`; None where the simulation failed. If those on both sides have
            failed, the derivatives by the parameter are 0, so that the data do not determine it.
    """
    middle = [each.simulated for each in compare(data, at_center)]
    sides = iter([None if hours is None else [each.simulated for each in compare(data, hours)] for hours in at_points])
    pairs: list[list[tuple[Floats, Floats]]] = [[] for _ in middle]
    failing = set()
    for name, parameter in config.parameters.items():
        at_step = {step: next(sides) for step in steps(parameter, center[name])}
        taken = _complete_side({step for step, each in at_step.items() if each is not None}, at_step)
        if not taken:
            failing.add(name)
        for column, pair in enumerate(pairs):
            values = [each[column] for step in taken if (each := at_step[step]) is not None]
            zeros = np.zeros_like(middle[column])
            pair.append(_differences(taken, middle[column], values) if taken else (zeros, zeros))
    combined = [Derivatives(*(np.stack(each, axis=1) for each in zip(*pair, strict=True))) for pair in pairs]
    return combined, frozenset(failing)


def _complete_side(simulated: AbstractSet[float], taken: Iterable[float]) -> tuple[float, ...]:
    """Return all steps if all were simulated, else the two on one side, the nearer one first; none if both miss one."""
    ordered = sorted(taken, key=abs)
    sides = [[*taken], [step for step in ordered if step < 0.0], [step for step in ordered if step > 0.0]]
    return next((tuple(side) for side in sides if side and simulated >= set(side)), ())


def _differences(taken: Sequence[float], middle: Floats, values: Sequence[Floats]) -> tuple[Floats, Floats]:
    if len(taken) == 2:
        near, far = values
        return (near - middle) / taken[0], (far - near) / taken[0]
    far_below, below, above, far_above = values
    width = 2.0 * taken[2]
    return (above - below) / width, (far_above - above + below - far_below) / width
