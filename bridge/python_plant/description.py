"""Load a class, check it and describe its points: in the plant's own process, before anything else starts."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import inf, isfinite
from pathlib import Path
from typing import Any

from topics.errors import InvalidConfig, ZenostatError, did_you_mean
from topics.keys import check_name

BEGIN = datetime(2001, 1, 1)
"""Default time of sample 0: a Monday, in a year without a leap day."""
DURATION_S = 86400.0
"""Default length of an episode."""
MAX_STEP_S = 86400.0

_EXAMPLE = 'for example sensors = {"temperature": ("degC", 0.0, 100.0)}'


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a plant: name, unit, bounds, and the value while nobody commands it."""

    name: str
    unit: str
    low: float | None = None
    high: float | None = None
    default: float | None = None


@dataclass(frozen=True, slots=True)
class ClassDescription:
    """What a plant's class declares. `forkable`, `has_state`: whether it can be copied by a fork, or by its state."""

    name: str
    step_s: float
    steps: int
    begin: str
    sensors: tuple[Point, ...]
    meters: tuple[Point, ...]
    actuators: tuple[Point, ...]
    time: tuple[str, ...]
    reward: dict[str, Any] | None
    forkable: bool
    has_state: bool


def split_name(plant: str) -> tuple[str, str]:
    """Return file or module, and class, of `tank.py:Tank` or `package.module:Tank`; raise `InvalidConfig`."""
    place, _, name = plant.rpartition(":")
    if not place or not name.isidentifier():
        raise InvalidConfig(f"plant {plant!r}: write it as FILE:CLASS or MODULE:CLASS, for example tank.py:Tank")
    return place, name


def load_class(plant: str) -> type[Any]:
    """Import the class of a plant.

    Raises:
        InvalidConfig: there is no such file, module or class.
        Exception: whatever the user's module raises when it is imported.
    """
    place, name = split_name(plant)
    module = _load_file(Path(place)) if place.endswith(".py") else _load_module(place)
    plant_class = getattr(module, name, None)
    if not isinstance(plant_class, type):
        classes = [n for n, o in vars(module).items() if isinstance(o, type) and o.__module__ == module.__name__]
        raise InvalidConfig(f"plant {plant!r}: no class {name!r} in {place}; {did_you_mean(name, classes)}")
    return plant_class


def _load_file(path: Path) -> Any:
    if not path.is_file():
        raise InvalidConfig(f"plant: no file {path}")
    sys.path.insert(0, str(path.parent.absolute()))  # as for a script: modules beside the file can be imported
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # for pickles of its classes
    spec.loader.exec_module(module)
    return module


def _load_module(name: str) -> Any:
    sys.path.insert(0, str(Path.cwd()))
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not name.startswith(error.name):
            raise
        raise InvalidConfig(f"plant: no module {name!r}; name a file as FILE.py:CLASS") from None


def create(plant: str, arguments: Mapping[str, Any]) -> Any:
    """Return an instance of a plant's class.

    Raises:
        InvalidConfig: there is no such class, or it does not take these arguments.
        Exception: whatever the user's code raises.
    """
    cls = load_class(plant)
    try:
        inspect.signature(cls).bind(**arguments)
    except TypeError as error:
        raise InvalidConfig(f"plant {plant!r}: {error}; its arguments: {inspect.signature(cls)}") from None
    return cls(**arguments)


def describe(plant: Any) -> ClassDescription:
    """Check a plant and describe it.

    Raises:
        InvalidConfig: lists everything that is missing or wrong.
    """
    name, errors = type(plant).__name__, list[str]()
    step_s = _number(plant, "step_s", errors, None)
    if step_s is not None and not 0.0 < step_s <= MAX_STEP_S:
        errors.append(f"step_s = {step_s:g}: the length of a timestep in seconds, above 0 and at most {MAX_STEP_S:g}")
    duration_s = _number(plant, "duration_s", errors, DURATION_S)
    steps = 0
    if step_s and duration_s is not None and 0.0 < step_s <= MAX_STEP_S:
        steps = round(duration_s / step_s)
        if steps < 1 or abs(steps * step_s - duration_s) > 1e-9 * duration_s:
            errors.append(f"duration_s = {duration_s:g}: a positive multiple of step_s = {step_s:g}")
    sensors = _points(plant, "sensors", errors, required=True)
    meters = _points(plant, "meters", errors)
    actuators = _points(plant, "actuators", errors, required=True, has_default=True)
    measured = [point.name for point in (*sensors, *meters)]
    errors += [f"{name!r} is both a sensor and a meter" for name in dict.fromkeys(measured) if measured.count(name) > 1]
    errors += [f"has no method {method}" for method in ("reset(seed)", "step(commands)") if not _has(plant, method)]
    has_save, has_restore = _has(plant, "save"), _has(plant, "restore")
    if has_save is not has_restore:
        errors.append(f"has {'save' if has_save else 'restore'}() without {'restore(state)' if has_save else 'save()'}")
    begin = _begin(plant, errors)
    if errors:
        raise InvalidConfig("\n".join(f"plant {name}: {error}" for error in errors))
    assert step_s is not None
    return ClassDescription(
        name=re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower(),
        step_s=step_s,
        steps=steps,
        begin=begin.isoformat(),
        sensors=sensors,
        meters=meters,
        actuators=actuators,
        time=tuple(getattr(plant, "time", ())),
        reward=getattr(plant, "reward", None),
        forkable=bool(getattr(plant, "forkable", False)),
        has_state=has_save,
    )


def _has(plant: Any, method: str) -> bool:
    return callable(getattr(plant, method.partition("(")[0], None))


def _number(plant: Any, name: str, errors: list[str], default: float | None) -> float | None:
    value = getattr(plant, name, default)
    if value is None:
        errors.append(f"has no attribute {name}, for example {name} = 60.0")
    elif isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        errors.append(f"{name} = {value!r}: a number of seconds expected")
    else:
        return float(value)
    return None


def _begin(plant: Any, errors: list[str]) -> datetime:
    begin = getattr(plant, "begin", BEGIN)
    if isinstance(begin, str):
        try:
            begin = datetime.fromisoformat(begin)
        except ValueError:
            errors.append(f"begin = {begin!r}: a datetime or a text like '2026-01-01T00:00' expected")
            return BEGIN
    if not isinstance(begin, datetime) or begin.tzinfo is not None:
        errors.append(f"begin = {begin!r}: a datetime without a time zone expected")
        return BEGIN
    return begin


def _points(
    plant: Any, attribute: str, errors: list[str], *, required: bool = False, has_default: bool = False
) -> tuple[Point, ...]:
    specs = getattr(plant, attribute, None)
    if specs is None and not required:
        return ()
    if not isinstance(specs, Mapping):
        missing = f"has no attribute {attribute}" if specs is None else f"{attribute} is no mapping"
        errors.append(f"{missing}; a mapping from names to units and bounds, {_EXAMPLE}")
        return ()
    points = []
    for name, spec in specs.items():
        try:
            points.append(_point(name, spec, has_default=has_default))
        except (ValueError, ZenostatError) as error:
            errors.append(f"{attribute}[{name!r}]: {error}")
    return tuple(points)


def _point(name: Any, spec: Any, *, has_default: bool) -> Point:
    check_name(str(name), "a point's name")
    parts = (spec,) if isinstance(spec, str) else spec
    most = 4 if has_default else 3
    if not isinstance(parts, Sequence) or not 1 <= len(parts) <= most or not isinstance(parts[0], str):
        form = "(unit, low, high, default)" if has_default else "(unit, low, high)"
        raise ValueError(f"{spec!r}: a unit, or {form} expected")
    low, high, default = [*(_bound(value) for value in parts[1:]), None, None, None][:3]
    if low is not None and high is not None and not low < high:
        raise ValueError(f"low {low:g} is not below high {high:g}")
    if default is not None and not (-inf if low is None else low) <= default <= (inf if high is None else high):
        raise ValueError(f"the default {default:g} is out of bounds")
    return Point(str(name), parts[0], low, high, default)


def _bound(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f"{value!r}: a finite number or None expected")
    return float(value)
