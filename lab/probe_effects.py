"""Effect of an actuator: comparison of branches that hold it with a reference branch, sample by sample."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Actuator, Manifest, Sensor

Side = Literal["low", "high"]

_ROUNDING = 1e-9
"""Relative difference that may come from another order of summation."""
_PASS_THROUGH = 1e-6
"""Relative tolerance for a sensor that passes the held value through."""
_COMMANDED_VARIABLES = ("setpoint", "schedule value")
"""Parts of names of EnergyPlus variables that report a command instead of a measurement."""


@dataclass(frozen=True, slots=True)
class HoldExperiment:
    """A branch in which an actuator was held, with its reference branch.

    Attributes:
        side: whether it was held low or high.
        value: the held value, in the actuator's unit.
        time: simulated time at which both branches started.
        points: values with the actuator held, shape (timesteps, points); fewer timesteps if EnergyPlus failed.
        reference: values of the reference branch, shape (timesteps, points).
        effective: effective value of the actuator, shape (timesteps,); NaN where EnergyPlus does not report it.
        failure: error of EnergyPlus; empty if there was none.
    """

    side: Side
    value: float
    time: datetime
    points: Floats
    reference: Floats
    effective: Floats
    failure: str = ""


@dataclass(frozen=True, slots=True)
class PointResponse:
    """Response of one point to one actuator.

    Attributes:
        point: name of the point.
        unit: unit of the point.
        difference: largest absolute difference from the reference, in this unit.
        share: the difference divided by the range of the point in all simulated timesteps.
        side: whether the actuator was held low or high.
        value: the held value.
        time: simulated time at which the branch started.
        after_min: simulated minutes from the start of the branch to the largest difference.
    """

    point: str
    unit: str
    difference: float
    share: float
    side: Side
    value: float
    time: datetime
    after_min: float


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of one actuator.

    Attributes:
        actuator: name of the actuator.
        unit: unit of the actuator.
        low, high: minimum and maximum of the held values.
        responses: points that differ beyond rounding, by descending share of their range; empty: no effect.
        first_min: simulated minutes from the start of a branch to the end of the first timestep in which any point
            differs, minimum over all branches; None without any response.
        identical: whether all points except `pass_through` are equal to the bit in all branches.
        pass_through: sensors that only report the commanded value.
        tracked: whether the effective value was always the held value; None if EnergyPlus does not report it.
        notes: warnings about the actuator, and branches in which EnergyPlus failed.
    """

    actuator: str
    unit: str
    low: float
    high: float
    responses: tuple[PointResponse, ...]
    first_min: float | None
    identical: bool
    pass_through: tuple[str, ...]
    tracked: bool | None
    notes: tuple[str, ...]


class Ranges:
    """Minimum and maximum of each point over all simulated timesteps."""

    def __init__(self, points: int) -> None:
        self._low, self._high = np.full(points, np.inf), np.full(points, -np.inf)

    def add(self, values: Floats) -> None:
        """Add values of shape (points,) or (timesteps, points)."""
        for row in values.reshape(-1, len(self._low)):
            np.fmin(self._low, row, out=self._low)
            np.fmax(self._high, row, out=self._high)

    @property
    def spans(self) -> Floats:
        """Maximum minus minimum, shape (points,), in the points' units."""
        spans: Floats = self._high - self._low
        return spans


def effect_of(
    manifest: Manifest,
    actuator: Actuator,
    experiments: Sequence[HoldExperiment],
    compared: Sequence[int],
    spans: Floats,
) -> Effect:
    """Compare all branches of one actuator with their references.

    Args:
        manifest: manifest of the node.
        actuator: the held actuator.
        experiments: its branches.
        compared: indices of the points to compare.
        spans: range of each point, shape (points,); see `Ranges`.
    """
    pass_through = [
        i
        for i in compared
        if i < len(manifest.sensors) and _passes_through(manifest.sensors[i], i, actuator, experiments)
    ]
    independent = [i for i in compared if i not in pass_through]
    minutes = manifest.step_s / 60.0
    units = [point.unit for point in manifest.points]
    responses = [
        response
        for i in independent
        if (response := _largest(manifest.names[i], units[i], i, experiments, spans[i], minutes)) is not None
    ]
    first_steps = [step for branch in experiments if (step := _first_step(branch, independent)) is not None]
    return Effect(
        actuator=actuator.name,
        unit=actuator.unit,
        low=min(branch.value for branch in experiments),
        high=max(branch.value for branch in experiments),
        responses=tuple(sorted(responses, key=lambda response: (-response.share, response.point))),
        first_min=(min(first_steps) + 1) * minutes if first_steps else None,
        identical=not any(_is_different(branch)[:, independent].any() for branch in experiments),
        pass_through=tuple(manifest.names[i] for i in pass_through),
        tracked=_is_tracked(experiments),
        notes=tuple(_notes(manifest, actuator, experiments)),
    )


def _pair(branch: HoldExperiment) -> tuple[Floats, Floats]:
    return branch.points, branch.reference[: len(branch.points)]


def _is_different(branch: HoldExperiment) -> NDArray[np.bool_]:
    points, reference = _pair(branch)
    different: NDArray[np.bool_] = (points != reference) & ~(np.isnan(points) & np.isnan(reference))
    return different


def _differences(branch: HoldExperiment) -> Floats:
    """Return absolute differences, shape (timesteps, points); 0 where they may come from rounding."""
    points, reference = _pair(branch)
    magnitude = np.maximum(np.abs(points), np.abs(reference))
    difference = np.abs(points - reference)
    return np.where(_is_different(branch) & (difference > _ROUNDING * magnitude), difference, 0.0)


def _first_step(branch: HoldExperiment, points: Sequence[int]) -> int | None:
    timesteps = np.flatnonzero(_differences(branch)[:, points].any(axis=1))
    return int(timesteps[0]) if len(timesteps) else None


def _largest(
    point: str, unit: str, index: int, experiments: Iterable[HoldExperiment], span: float, minutes: float
) -> PointResponse | None:
    largest: PointResponse | None = None
    for branch in experiments:
        differences = _differences(branch)[:, index]
        step = int(differences.argmax()) if len(differences) else 0
        if len(differences) and differences[step] > (largest.difference if largest else 0.0):
            difference, after_min = float(differences[step]), (step + 1) * minutes
            share = difference / float(span)
            largest = PointResponse(point, unit, difference, share, branch.side, branch.value, branch.time, after_min)
    return largest


def _passes_through(sensor: Sensor, index: int, actuator: Actuator, experiments: Iterable[HoldExperiment]) -> bool:
    """Whether a sensor reports the command and not the building's response."""
    if sensor.variable == actuator.feedback and sensor.key.casefold() == actuator.key.casefold():
        return True
    if not any(text in sensor.variable.casefold() for text in _COMMANDED_VARIABLES):
        return False
    pairs = [(branch.points[:, index], branch.value) for branch in experiments if len(branch.points)]
    return bool(pairs) and all(
        np.allclose(values, value, rtol=_PASS_THROUGH, atol=_PASS_THROUGH) for values, value in pairs
    )


def _is_tracked(experiments: Iterable[HoldExperiment]) -> bool | None:
    pairs = [(branch.effective, branch.value) for branch in experiments if len(branch.effective)]
    if not pairs or any(np.isnan(effective).any() for effective, _ in pairs):
        return None
    return all(np.allclose(effective, value, rtol=_PASS_THROUGH, atol=_PASS_THROUGH) for effective, value in pairs)


def _notes(manifest: Manifest, actuator: Actuator, experiments: Sequence[HoldExperiment]) -> Iterable[str]:
    """Yield the model's warnings about the actuator, and what went wrong in its branches."""
    yield from (text for text in manifest.warnings if repr(actuator.name) in text)
    if _is_tracked(experiments) is False:
        yield "the effective value differs from the held value: something else sets the actuator as well"
    failures: dict[tuple[Side, str], int] = {}
    for branch in experiments:
        if branch.failure:
            failures[branch.side, branch.failure] = failures.get((branch.side, branch.failure), 0) + 1
    for (side, failure), count in failures.items():
        yield f"EnergyPlus failed in {count} of the branches that held it {side}: {failure}"
