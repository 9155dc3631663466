"""What an actuator changes: the same hours of a building, held and left alone, compared sample by sample."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from topics.messages import Actuator, Manifest, Sensor

Side = Literal["low", "high"]

_ROUNDING = 1e-9
"""Of a point's size: what differs by less may be another order of the same sums."""
_REPEATED = 1e-6
"""Of a held value's size: a sensor that is this near to it in every sample repeats it."""
_ASKED_FOR = ("setpoint", "schedule value")
"""In names of EnergyPlus's variables that say what is asked for, not what is."""


@dataclass(frozen=True, slots=True)
class HoldExperiment:
    """One branch in which an actuator was held, and the one beside it that was left alone.

    Attributes:
        side: which of its values was held.
        value: that value, in the actuator's unit.
        time: where both began.
        points: shape (timesteps, points), of the branch that was held; of fewer timesteps if EnergyPlus gave up.
        reference: the same of the other one.
        effective: shape (timesteps,), what the actuator really was; NaN where EnergyPlus does not tell.
        failure: why EnergyPlus gave up; empty if it did not.
    """

    side: Side
    value: float
    time: datetime
    points: NDArray[np.float64]
    reference: NDArray[np.float64]
    effective: NDArray[np.float64]
    failure: str = ""


@dataclass(frozen=True, slots=True)
class PointResponse:
    """A point that feels an actuator.

    Attributes:
        point: its name.
        unit: its unit.
        difference: the largest absolute difference from what it was without, in that unit.
        share: that as a share of the range in which the point moved in all that was simulated.
        side: the actuator was held low or high.
        value: what it was held at.
        time: of the branch.
        after_min: how long after the branch's begin the difference was largest, in simulated minutes.
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
    """What holding one actuator changes.

    Attributes:
        actuator: its name.
        unit: its unit.
        low, high: the least and greatest value that it was held at.
        responses: points that differ beyond rounding, what moves most in its own range first; none: it has no effect.
        first_min: the end of the first timestep at which one of them differs, simulated minutes after the branch's
            begin; the soonest of all branches. None if there are none.
        identical: no point but `pass_through` differs in any bit, in any branch.
        pass_through: sensors that only repeat what the actuator is set to.
        tracked: whether EnergyPlus says that it was what it was held at, always; None where it does not tell.
        notes: what is known that works against it, and branches in which EnergyPlus gave up.
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
    """The least and the greatest value of each point in all that was simulated."""

    def __init__(self, points: int) -> None:
        self._low, self._high = np.full(points, np.inf), np.full(points, -np.inf)

    def add(self, values: NDArray[np.float64]) -> None:
        """Values of shape (points,) or (timesteps, points)."""
        for row in values.reshape(-1, len(self._low)):
            np.fmin(self._low, row, out=self._low)
            np.fmax(self._high, row, out=self._high)

    @property
    def spans(self) -> NDArray[np.float64]:
        """Shape (points,), in the points' units."""
        spans: NDArray[np.float64] = self._high - self._low
        return spans


def effect_of(
    manifest: Manifest,
    actuator: Actuator,
    held: Sequence[HoldExperiment],
    compared: Sequence[int],
    spans: NDArray[np.float64],
) -> Effect:
    """Compares all branches of one actuator.

    Args:
        manifest: of the node.
        actuator: the one that was held.
        held: its branches.
        compared: positions of the points that count.
        spans: shape (points,), see `Ranges`.
    """
    echoes = [i for i in compared if i < len(manifest.sensors) and _repeats(manifest.sensors[i], i, actuator, held)]
    counted = [i for i in compared if i not in echoes]
    minutes = 60 / manifest.steps_per_hour
    units = [sensor.unit for sensor in manifest.sensors] + [meter.unit for meter in manifest.meters]
    felt = [
        found
        for i in counted
        if (found := _largest(manifest.names[i], units[i], i, held, spans[i], minutes)) is not None
    ]
    firsts = [first for one in held if (first := _first(one, counted)) is not None]
    return Effect(
        actuator=actuator.name,
        unit=actuator.unit,
        low=min(one.value for one in held),
        high=max(one.value for one in held),
        responses=tuple(sorted(felt, key=lambda one: (-one.share, one.point))),
        first_min=(min(firsts) + 1) * minutes if firsts else None,
        identical=not any(_unlike(one)[:, counted].any() for one in held),
        pass_through=tuple(manifest.names[i] for i in echoes),
        tracked=_obeyed(held),
        notes=tuple(_notes(manifest, actuator, held)),
    )


def _pair(one: HoldExperiment) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return one.points, one.reference[: len(one.points)]


def _unlike(one: HoldExperiment) -> NDArray[np.bool_]:
    points, alone = _pair(one)
    unlike: NDArray[np.bool_] = (points != alone) & ~(np.isnan(points) & np.isnan(alone))
    return unlike


def _differences(one: HoldExperiment) -> NDArray[np.float64]:
    """Shape (timesteps, points); 0 where it is of rounding's size."""
    points, alone = _pair(one)
    size = np.maximum(np.abs(points), np.abs(alone))
    apart = np.abs(points - alone)
    return np.where(_unlike(one) & (apart > _ROUNDING * size), apart, 0.0)


def _first(one: HoldExperiment, counted: Sequence[int]) -> int | None:
    timesteps = np.flatnonzero(_differences(one)[:, counted].any(axis=1))
    return int(timesteps[0]) if len(timesteps) else None


def _largest(
    point: str, unit: str, index: int, held: Iterable[HoldExperiment], span: float, minutes: float
) -> PointResponse | None:
    found: PointResponse | None = None
    for one in held:
        apart = _differences(one)[:, index]
        at = int(apart.argmax()) if len(apart) else 0
        if len(apart) and apart[at] > (found.difference if found else 0.0):
            far = float(apart[at])
            found = PointResponse(
                point, unit, far, far / float(span), one.side, one.value, one.time, (at + 1) * minutes
            )
    return found


def _repeats(sensor: Sensor, index: int, actuator: Actuator, held: Iterable[HoldExperiment]) -> bool:
    """Whether a sensor tells of the command and not of the building."""
    if sensor.variable == actuator.feedback and sensor.key.casefold() == actuator.key.casefold():
        return True
    if not any(text in sensor.variable.casefold() for text in _ASKED_FOR):
        return False
    told = [(one.points[:, index], one.value) for one in held if len(one.points)]
    return bool(told) and all(np.allclose(values, value, rtol=_REPEATED, atol=_REPEATED) for values, value in told)


def _obeyed(held: Iterable[HoldExperiment]) -> bool | None:
    told = [(one.effective, one.value) for one in held if len(one.effective)]
    if not told or any(np.isnan(effective).any() for effective, _ in told):
        return None
    return all(np.allclose(effective, value, rtol=_REPEATED, atol=_REPEATED) for effective, value in told)


def _notes(manifest: Manifest, actuator: Actuator, held: Sequence[HoldExperiment]) -> Iterable[str]:
    """What is known of the model, and what became of the branches."""
    yield from (text for text in manifest.warnings if repr(actuator.name) in text)
    if _obeyed(held) is False:
        yield "EnergyPlus says that it was something else than what it was held at: something else sets it, too"
    failures: dict[tuple[Side, str], int] = {}
    for one in held:
        if one.failure:
            failures[one.side, one.failure] = failures.get((one.side, one.failure), 0) + 1
    for (side, failure), count in failures.items():
        yield f"EnergyPlus gave up in {count} of the branches that held it {side}: {failure}"
