"""Parameters of controllers, checked: each mistake is one sentence that names what would be right."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from topics.errors import InvalidConfig, did_you_mean
from topics.messages import Action, Actuator, Manifest
from topics.units import with_unit

T = TypeVar("T")


class ControllerMismatch(InvalidConfig):
    """A node that lacks what a controller needs, however its parameters are; `evaluate` goes on without it."""


def number(what: str, value: object, *, least: float = -math.inf, most: float = math.inf) -> float:
    """`value` as a finite number from `least` to `most`.

    Raises:
        InvalidConfig: it is none, or outside.
    """
    fits = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if fits and least <= value <= most:  # type: ignore[operator]
        return float(value)  # type: ignore[arg-type]
    if math.isinf(least) and math.isinf(most):
        wanted = "a number"
    elif math.isinf(most):
        wanted = f"a number of at least {least:g}"
    elif math.isinf(least):
        wanted = f"a number of at most {most:g}"
    else:
        wanted = f"a number from {least:g} to {most:g}"
    raise InvalidConfig(f"{what} = {value!r}; {wanted} expected")


def bounds(point: Action | Actuator) -> tuple[float, float]:
    """Its bounds; infinite where it has none."""
    return (-math.inf if point.low is None else point.low, math.inf if point.high is None else point.high)


def named(manifest: Manifest, values: Mapping[str, object]) -> dict[str, float]:
    """Values by the name of an action or an actuator, as values by actuator.

    Raises:
        InvalidConfig: no such name, no number, out of bounds, or an actuator that is named twice.
    """
    points: dict[str, Action | Actuator] = {a.name: a for a in manifest.actuators}
    points |= {a.name: a for a in manifest.task.actions}
    found: dict[str, float] = {}
    for name, given in values.items():
        if name not in points:
            raise InvalidConfig(
                f"node {manifest.node!r} has no action or actuator {name!r}; {did_you_mean(name, points)}"
            )
        point = points[name]
        value, (low, high) = number(name, given), bounds(point)
        if not low <= value <= high:
            raise InvalidConfig(f"{name} = {value:g}; its bounds are {with_unit(f'{low:g} to {high:g}', point.unit)}")
        for actuator in point.actuators if isinstance(point, Action) else (name,):
            if actuator in found:
                raise InvalidConfig(f"{actuator!r} is set twice, the second time by {name!r}")
            found[actuator] = value
    return found


def make_controller(made_by: Callable[..., T], manifest: Manifest, parameters: Mapping[str, Any]) -> T:
    """A controller of a node with these parameters.

    Raises:
        InvalidConfig: a parameter that it does not take, or one that it needs and is missing; or the node lacks what
            it needs.
    """
    name = getattr(made_by, "__name__", str(made_by))
    takes = list(inspect.signature(made_by).parameters.values())[1:]
    known = [p.name for p in takes if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)]
    if not any(p.kind is p.VAR_KEYWORD for p in takes):
        for unknown in set(parameters) - set(known):
            raise InvalidConfig(f"{name} takes no parameter {unknown!r}; {did_you_mean(unknown, known)}")
    missing = [p.name for p in takes if p.name in known and p.default is p.empty and p.name not in parameters]
    if missing:
        raise InvalidConfig(f"{name} needs {_listed(missing)}: --set {missing[0]}=..., or {missing[0]}= in Python")
    return made_by(manifest, **parameters)


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
