"""Load a class, check it and describe its points: in the plant's own process, before anything else starts."""

from __future__ import annotations

import importlib
import inspect
import json
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from math import inf, isfinite, nan
from numbers import Real
from pathlib import Path
from typing import Any, TypeGuard

from pydantic import ValidationError

from zenostat.bridge.runtime.source_loader import load_file, make_importable
from zenostat.bridge.runtime.user_code import describe_user_error
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, ZenostatError, did_you_mean
from zenostat.topics.keys import check_name
from zenostat.topics.messages import Aggregation, ElectricGrid, TimeField
from zenostat.topics.user_file import check_user_file

BEGIN = datetime(2001, 1, 1)
"""Default time of sample 0: a Monday, in a year without a leap day."""
DURATION_S = 86400.0
"""Default length of an episode."""
MAX_STEP_S = 86400.0

_EXAMPLE = 'for example sensors = {"temperature": ("degC", 0.0, 100.0)}'


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a plant: name, unit, bounds, the value while nobody commands it, and a sensor's aggregation."""

    name: str
    unit: str
    low: float | None = None
    high: float | None = None
    default: float | None = None
    aggregation: Aggregation = Aggregation.INSTANT


@dataclass(frozen=True, slots=True)
class ClassDescription:
    """Declarations of a plant's class.

    Attributes:
        file: that defines the class; empty if it is not known.
        files: further files that define what is simulated, by role.
        warnings: texts for the manifest.
        begins_alike: whether all episodes begin alike.
        diagram: fields of `zenostat.topics.messages.ElectricGrid`, of a plant that is an electric grid.
        actions: actuators that are an agent's actions.
        forkable, has_state: whether it can be copied by a fork, or by its state.
        has_close: whether it has something to release at its end.
        has_warnings: whether it has warnings of its timesteps.
        copy_error: why a plant of the product's cannot be copied.
    """

    name: str
    file: str
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
    has_close: bool
    files: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    begins_alike: bool = False
    actions: tuple[str, ...] = ()
    diagram: dict[str, Any] | None = None
    copy_error: str = ""
    has_warnings: bool = False


def split_name(plant: str) -> tuple[str, str]:
    """Return file or module, and class, of `tank.py:Tank` or `package.module:Tank`; raise `InvalidConfig`."""
    place, _, name = plant.rpartition(":")
    if not place or (place.startswith(".") and not place.endswith(".py")) or not name.isidentifier():
        raise InvalidConfig(f"plant {plant!r}: write it as FILE:CLASS or MODULE:CLASS, for example tank.py:Tank")
    return place, name


def load_class(plant: str, *, own_class: bool = False) -> type[Any]:
    """Import the class of a plant; `own_class` rejects one that is not defined there.

    Raises:
        InvalidConfig: there is no such file, module or class.
        Exception: whatever the user's module raises when it is imported.
    """
    place, name = split_name(plant)
    try:
        module = _load_file(Path(place)) if place.endswith(".py") else _load_module(place)
    except SyntaxError as error:
        raise InvalidConfig(f"loading {place} failed: {describe_user_error(error)}") from None
    plant_class = getattr(module, name, None)
    if not isinstance(plant_class, type):
        classes = [n for n, o in vars(module).items() if isinstance(o, type) and o.__module__ == module.__name__]
        raise InvalidConfig(f"plant {plant!r}: no class {name!r} in {place}; {did_you_mean(name, classes)}")
    if own_class and plant_class.__module__ != module.__name__:
        raise InvalidConfig(
            f"plant {plant!r}: {place} does not define {name!r}, but imports it from {plant_class.__module__}; name "
            "the file that defines it"
        )
    return plant_class


def _load_file(path: Path) -> Any:
    check_user_file(path, expected="a Python file")
    make_importable(path.parent.absolute())
    return load_file(_module_name(path.stem), path)


def _module_name(stem: str) -> str:
    """Return a name that replaces no other module, of the standard library for example, and that pickles can have."""
    if stem.isidentifier() and stem not in sys.modules and stem not in sys.stdlib_module_names:
        return stem
    return f"plant_{re.sub(r'[^0-9A-Za-z_]', '_', stem)}"


def _load_module(name: str) -> Any:
    make_importable(Path.cwd())
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise
        raise InvalidConfig(f"plant: no module {name!r}; name a file as FILE.py:CLASS") from None


def create(plant: str, arguments: Mapping[str, Any], *, own_class: bool = False) -> Any:
    """Return an instance of a plant's class.

    Args:
        plant: `FILE.py:CLASS` or `MODULE:CLASS`.
        arguments: of the class.
        own_class: reject a class that the file or the module only imports, before it is called.

    Raises:
        InvalidConfig: there is no such class, or it does not take these arguments.
        Exception: whatever the user's code raises.
    """
    cls = load_class(plant, own_class=own_class)
    try:
        signature = inspect.signature(cls)
    except ValueError:  # a class of a compiled module
        return cls(**arguments)
    try:
        signature.bind(**arguments)
    except TypeError as error:
        raise InvalidConfig(f"plant {plant!r}: {error}; its arguments: {signature}") from None
    return cls(**arguments)


def describe(plant: Any) -> ClassDescription:
    """Check a plant and describe it.

    Raises:
        InvalidConfig: lists everything that is missing or wrong.
    """
    name, errors = type(plant).__name__, list[str]()
    step_s, steps, begin = _run_period(plant, errors)
    sensors = _points(plant, "sensors", errors, required=True, fourth="aggregation")
    meters = _points(plant, "meters", errors)
    actuators = _points(plant, "actuators", errors, required=True, fourth="default")
    if sensors == meters == () and not errors:
        errors.append(f"measures nothing: at least one sensor or meter expected, {_EXAMPLE}")
    both = sorted({point.name for point in sensors} & {point.name for point in meters})
    errors += [f"{point!r} is both a sensor and a meter" for point in both]
    time, reward = _time(plant, errors), _reward(plant, errors)
    forkable, begins_alike = _flag(plant, "forkable", errors), _flag(plant, "begins_alike", errors)
    actions = _actions(plant, [point.name for point in actuators], errors)
    model_name, warnings, files = _model_name(plant, errors), _warnings(plant, errors), _files(plant, errors)
    has_state, diagram = _check_methods(plant, errors), _diagram(plant, errors)
    if errors:
        raise InvalidConfig("\n".join(f"plant {name}: {error}" for error in errors))
    return ClassDescription(
        name=model_name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower(),
        file=str(getattr(sys.modules.get(type(plant).__module__), "__file__", None) or ""),
        step_s=step_s,
        steps=steps,
        begin=begin.isoformat(),
        sensors=sensors,
        meters=meters,
        actuators=actuators,
        time=time,
        reward=reward,
        forkable=forkable,
        has_state=has_state,
        has_close=_has(plant, "close"),
        files=files,
        warnings=warnings,
        begins_alike=begins_alike,
        actions=actions,
        diagram=diagram,
        copy_error=str(getattr(plant, "copy_error", "")),
        has_warnings=_has(plant, "drain_warnings"),
    )


def _actions(plant: Any, actuators: Sequence[str], errors: list[str]) -> tuple[str, ...]:
    """Return the actuators that are an agent's actions; by default all."""
    actions = getattr(plant, "actions", None)
    if actions is None:
        return tuple(actuators)
    if not isinstance(actions, list | tuple) or not all(isinstance(name, str) for name in actions):
        errors.append(f"actions = {actions!r}: a list of actuators' names expected")
        return ()
    errors += [
        f"actions: no actuator {name!r}; {did_you_mean(name, actuators)}" for name in actions if name not in actuators
    ]
    errors += _repeated("actions", actions)
    return tuple(actions)


def _repeated(attribute: str, names: Sequence[str]) -> list[str]:
    """Return an error for each name that a list has more than once."""
    return [f"{attribute}: {name!r} occurs {count} times" for name, count in Counter(names).items() if count > 1]


def _diagram(plant: Any, errors: list[str]) -> dict[str, Any] | None:
    """Return the one-line diagram of a plant that is an electric grid."""
    diagram = getattr(plant, "diagram", None)
    if diagram is None:
        return None
    try:
        return ElectricGrid.model_validate(diagram).model_dump()
    except ValidationError as error:
        errors.append(f"diagram: {describe_validation_errors(error)}")
        return None


def _flag(plant: Any, name: str, errors: list[str]) -> bool:
    value = getattr(plant, name, False)
    if not isinstance(value, bool):
        errors.append(f"{name} = {value!r}: True or False expected")
    return value is True


def _model_name(plant: Any, errors: list[str]) -> str:
    name = getattr(plant, "model_name", "")
    if not isinstance(name, str):
        errors.append(f"model_name = {name!r}: a text expected")
        return ""
    return name


def _warnings(plant: Any, errors: list[str]) -> tuple[str, ...]:
    texts = getattr(plant, "warnings", ())
    if not are_texts(texts):
        errors.append(f"warnings = {texts!r}: a list of texts expected")
        return ()
    return tuple(texts)


def _files(plant: Any, errors: list[str]) -> dict[str, str]:
    """Return the files of a plant, of which each must exist: a recording has their digests."""
    files = getattr(plant, "files", {})
    if not isinstance(files, Mapping) or not all(isinstance(part, str) for pair in files.items() for part in pair):
        errors.append(
            f"files = {files!r}: a mapping from roles to paths expected, for example {{'prices': 'prices.csv'}}"
        )
        return {}
    errors += [f"files[{role!r}]: no file {path}" for role, path in files.items() if not Path(path).is_file()]
    if "class" in files:
        errors.append("files: 'class' is the role of the class's own file; choose another one")
    return {role: str(Path(path).absolute()) for role, path in files.items()}


def _run_period(plant: Any, errors: list[str]) -> tuple[float, int, datetime]:
    """Return length and number of timesteps, and the time of sample 0."""
    begin = _begin(plant, errors)
    step_s = _number(plant, "step_s", errors)
    duration_s = _number(plant, "duration_s", errors, DURATION_S)
    if step_s is None:
        return 0.0, 0, begin
    if not 0.0 < step_s <= MAX_STEP_S:
        errors.append(f"step_s = {step_s:g}: the length of a timestep in seconds, above 0 and at most {MAX_STEP_S:g}")
    elif timedelta(seconds=step_s).total_seconds() != step_s:
        errors.append(f"step_s = {step_s!r}: a whole number of microseconds expected, for example {step_s:.3f}")
    elif duration_s is not None:
        return step_s, _steps(step_s, duration_s, begin, errors), begin
    return step_s, 0, begin


def _steps(step_s: float, duration_s: float, begin: datetime, errors: list[str]) -> int:
    steps = round(duration_s / step_s)
    if steps < 1 or abs(steps * step_s - duration_s) > 1e-9 * duration_s:
        errors.append(f"duration_s = {duration_s:g}: a positive multiple of step_s = {step_s:g} expected")
        return 0
    try:
        begin + timedelta(seconds=duration_s)
    except OverflowError:
        errors.append(f"duration_s = {duration_s:g}: an episode from {begin:%Y-%m-%d} would end after the year 9999")
    return steps


def _number(plant: Any, name: str, errors: list[str], default: float | None = None) -> float | None:
    value = getattr(plant, name, default)
    if value is None and default is None:
        errors.append(f"has no attribute {name}, for example {name} = 60.0")
    elif not _is_finite(value):
        errors.append(f"{name} = {value!r}: a number of seconds expected")
    else:
        return float(value)
    return None


def measured_number(value: Any) -> float:
    """Return a value of a sensor or meter as a number; NaN if it is no finite number: a text is none."""
    try:
        number = nan if isinstance(value, str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        return nan
    return number if isfinite(number) else nan


def are_texts(texts: Any) -> TypeGuard[Sequence[str]]:
    """Return whether this is a list of texts, as warnings are."""
    return isinstance(texts, list | tuple) and all(isinstance(text, str) for text in texts)


def _is_finite(value: Any) -> TypeGuard[float]:
    """Return whether a value is a finite number, of Python or NumPy."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)
    except OverflowError:  # a large integer
        return False


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


def _time(plant: Any, errors: list[str]) -> tuple[str, ...]:
    time = getattr(plant, "time", ())
    known = [str(field) for field in TimeField]
    if isinstance(time, str) or not isinstance(time, Sequence):
        errors.append(f"time = {time!r}: a tuple of time features expected, for example ('hour',)")
        return ()
    errors += [
        f"time: no time feature {name!r}; {did_you_mean(str(name), known)}" for name in time if name not in known
    ]
    errors += _repeated("time", [str(name) for name in time])
    return tuple(map(str, time))


def _reward(plant: Any, errors: list[str]) -> dict[str, Any] | None:
    reward = getattr(plant, "reward", None)
    if reward is None:
        return None
    try:
        if isinstance(reward, Mapping) and isinstance(reward.get("kind"), str):
            return dict(json.loads(json.dumps(dict(reward), allow_nan=False)))
    except (TypeError, ValueError):
        pass
    errors.append(f"reward = {reward!r}: a mapping with its kind and parameters expected")
    return None


def _check_methods(plant: Any, errors: list[str]) -> bool:
    """Check the methods of a plant; return whether it can save its state."""
    required = [("reset", "seed"), ("step", "commands")]
    errors += [f"has no method {method}({argument})" for method, argument in required if not _has(plant, method)]
    has_save, has_restore = _has(plant, "save"), _has(plant, "restore")
    if has_save is not has_restore:
        errors.append(f"has {'save' if has_save else 'restore'}() without {'restore(state)' if has_save else 'save()'}")
    for method, argument in (*required, ("save", ""), ("restore", "state"), ("close", ""), ("drain_warnings", "")):
        if _has(plant, method) and not _takes(getattr(plant, method), 1 if argument else 0):
            errors.append(f"{method}{_signature(getattr(plant, method))}: {method}({argument}) expected")
    return has_save and has_restore


def _has(plant: Any, method: str) -> bool:
    return callable(getattr(plant, method, None))


def _takes(method: Any, count: int) -> bool:
    try:
        inspect.signature(method).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # a method of a compiled module
        return True
    return not inspect.iscoroutinefunction(method)


def _signature(method: Any) -> str:
    return f"{inspect.signature(method)}{', which is a coroutine' if inspect.iscoroutinefunction(method) else ''}"


def _points(
    plant: Any, attribute: str, errors: list[str], *, required: bool = False, fourth: str = ""
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
            points.append(_point(name, spec, fourth))
        except (ValueError, ZenostatError) as error:
            errors.append(f"{attribute}[{name!r}]: {error}")
    return tuple(points)


def _point(name: Any, spec: Any, fourth: str) -> Point:
    """Return a point; the fourth part of its specification is an actuator's default, or a sensor's aggregation."""
    if not isinstance(name, str):
        raise ValueError("a name is a text")
    check_name(name, "a point's name")
    parts = (spec,) if isinstance(spec, str) else spec
    form = ("unit", "low", "high", *([fourth] if fourth else []))
    if not isinstance(parts, Sequence) or not 1 <= len(parts) <= len(form) or not isinstance(parts[0], str):
        raise ValueError(f"{spec!r}: a unit, or ({', '.join(form)}) expected")
    bounds, last = parts[1:3], parts[3:]
    low, high = [*(_bound(value) for value in bounds), None, None][:2]
    if low is not None and high is not None and not low < high:
        raise ValueError(f"low {low:g} is not below high {high:g}")
    if last and fourth == "aggregation":
        return Point(name, parts[0], low, high, aggregation=_aggregation(last[0]))
    default = _bound(last[0]) if last else None
    if default is not None and not (-inf if low is None else low) <= default <= (inf if high is None else high):
        raise ValueError(f"the default {default:g} is out of bounds")
    return Point(name, parts[0], low, high, default)


def _aggregation(value: Any) -> Aggregation:
    if value not in list(Aggregation):
        raise ValueError(f"no aggregation {value!r}; there are: {', '.join(Aggregation)}")
    return Aggregation(value)


def _bound(value: Any) -> float | None:
    if value is None:
        return None
    if not _is_finite(value):
        raise ValueError(f"{value!r}: a finite number or None expected")
    return float(value)
