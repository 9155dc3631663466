"""The bounds of points and the index of points by name.

A bound of None in a message is no bound. In computations it is an infinity, or the largest finite number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import inf, isfinite
from numbers import Real
from sys import float_info
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidAction, UnknownName, ZenostatError, did_you_mean
from zenostat.topics.messages import Aggregation, Manifest, Meter, Sensor
from zenostat.topics.units import with_unit

LARGEST = float_info.max
"""The largest finite number: as a bound it admits any finite value, and neither infinity."""


class Bounded(Protocol):
    """A range of values; None is no bound."""

    @property
    def low(self) -> float | None:
        """The lowest value."""

    @property
    def high(self) -> float | None:
        """The highest value."""


class BoundedPoint(Bounded, Protocol):
    """A sensor, meter, actuator or action of a manifest."""

    @property
    def name(self) -> str:
        """Its name in the manifest."""

    @property
    def unit(self) -> str:
        """Unit of its values and bounds."""


def bounds(limits: Bounded, *, unbounded: float = inf) -> tuple[float, float]:
    """Return the bounds, with -`unbounded` and `unbounded` where there is none."""
    return (-unbounded if limits.low is None else limits.low, unbounded if limits.high is None else limits.high)


def bound_arrays(points: Sequence[Bounded], *, unbounded: float = inf) -> tuple[Floats, Floats]:
    """Return the lower and the upper bounds of several points, each of shape (points,); see `bounds`."""
    pairs = [bounds(point, unbounded=unbounded) for point in points]
    return np.array([low for low, _ in pairs], np.float64), np.array([high for _, high in pairs], np.float64)


def contains(limits: Bounded, value: float) -> bool:
    """Return whether a value is finite and within the bounds."""
    low, high = bounds(limits)
    return isfinite(value) and low <= value <= high


def check_command(name: str, value: object) -> None:
    """Raise `InvalidAction` unless an actuator's value is a finite number, or None."""
    is_text_or_bool = isinstance(value, bool | np.bool_ | str | bytes)
    try:
        is_valid = value is None or (not is_text_or_bool and isfinite(value))  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        is_valid = False
    if not is_valid:
        shown = value if isinstance(value, float) else repr(value)
        raise InvalidAction(f"{name} = {shown}; a finite number or None (relinquish) expected")


def check_order(limits: Bounded) -> None:
    """Raise `ValueError` unless the lower bound is below the upper one."""
    low, high = bounds(limits)
    if not low < high:
        raise ValueError(f"low {low:g} is not below high {high:g}")


def describe_bounds(point: BoundedPoint) -> str:
    """Describe the bounds: `15 to 22.5 degC`, `0 to inf kg/s`."""
    low, high = bounds(point)
    return with_unit(f"{low:g} to {high:g}", point.unit)


def describe_violation(point: BoundedPoint, value: object) -> str:
    """Describe a value that a point cannot have: `heating = 40; its bounds are 15 to 22.5 degC`.

    A value that differs from a bound after its first six digits has all digits, as have the bounds then.
    """
    if not isinstance(value, Real):
        return f"{point.name} = {value!r}; a number expected"
    low, high = bounds(point)
    number, described = f"{value:g}", describe_bounds(point)
    if number in (f"{low:g}", f"{high:g}"):
        number, first, last = (repr(float(each)).removesuffix(".0") for each in (value, low, high))
        described = with_unit(f"{first} to {last}", point.unit)
    return f"{point.name} = {number}; its bounds are {described}"


class PointIndex(dict[str, int]):
    """The index of each point by its name; an unknown name raises an error that suggests similar ones.

    An actuator whose name a sensor or a meter before it has is `actuator/{name}`.

    Args:
        names: the points' names, in order.
        kind: the kind of point, for the error.
        error: class of the error.
        connected: the sources of points that connections determine, which have no index, for the error.
    """

    def __init__(
        self,
        names: Iterable[str],
        kind: str,
        error: type[ZenostatError] = UnknownName,
        connected: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__()
        for index, name in enumerate(names):
            self[f"actuator/{name}" if name in self else name] = index
        self._kind, self._error, self._connected = kind, error, connected or {}

    def __missing__(self, name: str) -> int:
        """Raise the error of an unknown name."""
        raise self.unknown(name)

    def unknown(self, name: str) -> ZenostatError:
        """Return the error of an unknown name."""
        if name in self._connected:
            return self._error(f"{name!r} cannot be commanded: it is connected to {self._connected[name]}")
        return self._error(f"no {self._kind} {name!r}; {did_you_mean(name, self)}")

    def require(self, names: Iterable[str]) -> None:
        """Raise an error unless all names are known; the text has a line for each unknown one."""
        unknown = [str(self.unknown(name)) for name in names if name not in self]
        if unknown:
            raise self._error("\n".join(unknown))


def is_mean(point: Sensor | Meter) -> bool:
    """Whether a point is a mean over the timestep that has ended, rather than a value at its end or a total."""
    return isinstance(point, Sensor) and point.aggregation is Aggregation.MEAN


def value_index(manifest: Manifest) -> PointIndex:
    """Return the index of sensors and meters among the values of a sample."""
    return PointIndex(manifest.names, "sensor or meter")


def observed_indices(manifest: Manifest) -> NDArray[np.intp] | None:
    """Return the indices of an agent's observation among the values of a sample; None if it has all of them."""
    observed = [point.observed for point in manifest.points]
    return None if all(observed) else np.flatnonzero(observed)


def actuator_index(manifest: Manifest, error: type[ZenostatError] = UnknownName) -> PointIndex:
    """Return the index of actuators among the values of a command."""
    return PointIndex((actuator.name for actuator in manifest.actuators), "actuator", error, manifest.connected)
