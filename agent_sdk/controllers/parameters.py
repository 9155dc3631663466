"""Validation of controller parameters, with errors that state what is expected."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from zenostat.bridge.runtime.user_code import refuse_exit
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Action, Actuator, Manifest
from zenostat.topics.points import contains, describe_violation

T = TypeVar("T")


class ControllerMismatch(InvalidConfig):
    """A node lacks points or actions that a controller needs, or a parameter is left out; `evaluate` skips it."""


def number(name: str, value: object, *, minimum: float = -math.inf, maximum: float = math.inf) -> float:
    """Check that a parameter is a finite number from `minimum` to `maximum`, and return it.

    Raises:
        InvalidConfig: it is not a number, or outside this range.
    """
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if is_number and minimum <= value <= maximum:  # type: ignore[operator]
        return float(value)  # type: ignore[arg-type]
    if math.isinf(minimum) and math.isinf(maximum):
        expected = "a number"
    elif math.isinf(maximum):
        expected = f"a number of at least {minimum:g}"
    elif math.isinf(minimum):
        expected = f"a number of at most {maximum:g}"
    else:
        expected = f"a number from {minimum:g} to {maximum:g}"
    raise InvalidConfig(f"{name} = {value!r}; expected {expected}")


def integer(name: str, value: object, *, minimum: int, maximum: int) -> int:
    """Check that a parameter is a whole number from `minimum` to `maximum`, and return it.

    Raises:
        InvalidConfig: it is not a number, not whole, or outside this range.
    """
    checked = number(name, value, minimum=minimum, maximum=maximum)
    if not checked.is_integer():
        raise InvalidConfig(f"{name} = {value!r}; expected a whole number from {minimum} to {maximum}")
    return int(checked)


def actuator_values(manifest: Manifest, values: Mapping[str, object]) -> dict[str, float]:
    """Convert values by the name of an action or an actuator to values by actuator.

    Raises:
        InvalidConfig: an unknown name, not a number, out of bounds, or an actuator that is set twice.
    """
    points: dict[str, Action | Actuator] = {a.name: a for a in manifest.actuators}
    points |= {a.name: a for a in manifest.task.actions}
    by_actuator: dict[str, float] = {}
    for name, setting in values.items():
        if name not in points:
            raise InvalidConfig(
                f"node {manifest.node!r} has no action or actuator {name!r}; {did_you_mean(name, points)}"
            )
        point = points[name]
        value = number(name, setting)
        if not contains(point, value):
            raise InvalidConfig(describe_violation(point, value))
        for actuator in point.actuators if isinstance(point, Action) else (name,):
            if actuator in by_actuator:
                raise InvalidConfig(f"{actuator!r} is set twice, the second time by {name!r}")
            by_actuator[actuator] = value
    return by_actuator


def make_controller(factory: Callable[..., T], manifest: Manifest, parameters: Mapping[str, Any]) -> T:
    """Create a controller of a node with parameters.

    Raises:
        ControllerMismatch: a required parameter is left out, or the node lacks what the controller needs.
        InvalidConfig: an unknown or invalid parameter, or the controller ended the program.
    """
    name = check_parameters(factory, parameters)
    signature = list(inspect.signature(factory).parameters.values())[1:]
    missing = [
        p.name
        for p in signature
        if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty and p.name not in parameters
    ]
    if missing:
        raise ControllerMismatch(f"{name} needs {_join(missing)}: --set {missing[0]}=..., or {missing[0]}= in Python")
    with refuse_exit(name):
        return factory(manifest, **parameters)


def with_parameters(factory: Callable[..., T], parameters: Mapping[str, Any]) -> Callable[..., T]:
    """Return a factory with other defaults of its parameters; the same one if there are none."""
    if not parameters:
        return factory
    changed = functools.partial(factory, **parameters)
    functools.update_wrapper(changed, factory, ("__name__", "__doc__"), ())
    del changed.__wrapped__  # type: ignore[attr-defined]  # `inspect.signature` would show its defaults
    return changed


def check_parameters(factory: Callable[..., Any], names: Iterable[str]) -> str:
    """Check that a controller has parameters of these names, and return its own name.

    Raises:
        InvalidConfig: it lacks one of them.
    """
    own_name = getattr(factory, "__name__", str(factory))
    signature = list(inspect.signature(factory).parameters.values())[1:]
    known = [p.name for p in signature if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)]
    if not any(p.kind is p.VAR_KEYWORD for p in signature):
        for unknown in sorted(set(names) - set(known)):
            raise InvalidConfig(f"{own_name} has no parameter {unknown!r}; {did_you_mean(unknown, known)}")
    return str(own_name)


def _join(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
