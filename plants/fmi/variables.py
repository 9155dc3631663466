"""Points of an FMU: its variables with their names on the bus, units, bounds and start values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import isfinite, prod
from typing import Any

from zenostat.topics.errors import InvalidConfig, did_you_mean

NUMERIC = {
    "Real", "Integer", "Boolean", "Enumeration", "Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32",
    "UInt32", "Int64", "UInt64",
}  # fmt: skip
"""Types of FMI whose values are numbers."""
FLOATING = {"Real", "Float32", "Float64"}
_EXACT_BITS = 53
"""Whole numbers up to this number of bits are exact as the values of points, which are float64."""
_UNBOUNDED = 1e60
"""Modelica's infinity, which its tools export as a bound."""
UNIT_NAMES = {"": "1", "-": "1", "%": "percent"}
"""Names on the bus of units that have another one in FMUs."""
_VALUE, _ACTIVATION = "_u", "_activate"
_MAX_NAME = 96
"""Longest name of a point: those of a bus have up to 128 characters, in a district together with that of the plant."""


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of an FMU with the names of its elements on the bus.

    Attributes:
        name: in the FMU.
        reference: its value reference.
        kind: the type in the names of FMPy's functions, such as `Float64`.
        points: names of its elements on the bus, in FMI's order (row-major); a scalar has one.
        start: start values of its elements; none of an output.
        activation: of an overwrite block, the variable that activates this one.
    """

    name: str
    reference: int
    kind: str
    points: tuple[str, ...]
    unit: str
    low: float | None
    high: float | None
    start: tuple[float, ...]
    activation: Variable | None = None

    @property
    def is_floating(self) -> bool:
        """Whether its values are floating-point numbers."""
        return self.kind in FLOATING

    @property
    def is_fixed(self) -> bool:
        """Whether its bounds leave one value."""
        return self.low is not None and self.low == self.high


def point_name(name: str) -> str:
    """Return a variable's name as that of a point: `T[2]` becomes `T.2`, `der(T)` `der.T`, and `'-x'` `x`.

    Of a long name the first 96 characters remain.
    """
    text = re.sub(r"[\[(,]", ".", name)
    text = re.sub(r"[\])'\s]", "", text)
    text = re.sub(r"[^0-9A-Za-z_.-]", "_", text)
    return re.sub(r"\.{2,}", ".", text).lstrip("-.")[:_MAX_NAME].rstrip(".") or "_"


class PointNames:
    """Names of points, each of which is used once."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def is_free(self, name: str) -> bool:
        """Return whether a variable's name is not used by another one."""
        return point_name(name) not in self._used

    def add(self, name: str) -> str:
        """Return a variable's name as that of a point; a number follows where another variable has it."""
        base = text = point_name(name)
        number = 2
        while text in self._used:
            text, number = f"{base[: _MAX_NAME - 8]}_{number}", number + 1
        self._used.add(text)
        return text


def outputs(description: Any, observed: Sequence[str], names: PointNames) -> list[Variable]:
    """Return the numeric outputs of an FMU, and further variables that are to be observed.

    Args:
        description: FMPy's model description.
        observed: names of further variables.
        names: names of points so far.

    Raises:
        InvalidConfig: there is no such variable, or it is an input or not a number; or a bound is none.
    """
    by_name = {variable.name: variable for variable in description.modelVariables}
    for name in observed:
        if name not in by_name:
            raise InvalidConfig(f"observe: the FMU has no variable {name!r}; {did_you_mean(name, list(by_name))}")
        if by_name[name].type not in NUMERIC:
            raise InvalidConfig(f"observe: {name!r} is a {by_name[name].type}; a number or a Boolean expected")
        if by_name[name].causality == "input":
            raise InvalidConfig(f"observe: {name!r} is an input; its value is the effective one of its actuator")
    chosen = [v for v in by_name.values() if v.type in NUMERIC and (v.causality == "output" or v.name in observed)]
    return [_variable(variable, description, names) for variable in chosen]


def inputs(description: Any, starts: dict[str, Any], names: PointNames) -> list[Variable]:
    """Return the numeric inputs of an FMU.

    A Real `x_u` with a Boolean `x_activate`, which are the inputs of BOPTEST's overwrite blocks, is one variable `x`:
    it is activated while it is commanded.

    Args:
        description: FMPy's model description.
        starts: start values that replace those of the description, by the name of the variable.
        names: names of points so far.

    Raises:
        InvalidConfig: a bound or a start value is not a number.
    """
    variables = {v.name: v for v in description.modelVariables if v.causality == "input" and v.type in NUMERIC}
    pairs = dict(_pairs(variables))
    result = []
    for name, variable in variables.items():
        if name in pairs.values():
            continue
        activation = variables[pairs[name]] if name in pairs else None
        stem = name.removesuffix(_VALUE) if activation is not None else name
        if activation is not None and not names.is_free(stem):
            stem = name
        partner = None if activation is None else _variable(activation, description, PointNames(), starts)
        result.append(_variable(variable, description, names, starts, stem, partner))
    return result


def _pairs(variables: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for name, variable in variables.items():
        partner = name.removesuffix(_VALUE) + _ACTIVATION
        if not name.endswith(_VALUE) or variable.type not in FLOATING or variable.shape or partner not in variables:
            continue
        if variables[partner].type == "Boolean" and not variables[partner].shape:
            yield name, partner


def _variable(
    variable: Any,
    description: Any,
    names: PointNames,
    starts: dict[str, Any] | None = None,
    stem: str = "",
    activation: Variable | None = None,
) -> Variable:
    low, high = bounds(variable) if starts is None else settable_bounds(variable)
    shape = tuple(int(size) for size in variable.shape or ())
    elements = [""] if not shape else [f"[{','.join(map(str, i))}]" for i in product(*(range(1, n + 1) for n in shape))]
    start = () if starts is None else _start_values(variable, starts.get(variable.name, variable.start), (low, high))
    if len(start) not in (0, 1, prod(shape)):
        raise InvalidConfig(f"{variable.name}: its start has {len(start)} values; {prod(shape)} expected")
    return Variable(
        name=variable.name,
        reference=variable.valueReference,
        kind=_function_type(variable.type, description),
        points=tuple(names.add(f"{stem or variable.name}{element}") for element in elements),
        unit=unit(variable),
        low=low,
        high=high,
        start=start * prod(shape) if len(start) == 1 else start,
        activation=activation,
    )


def _function_type(kind: str, description: Any) -> str:
    if kind != "Enumeration":
        return kind
    return "Integer" if description.fmiVersion == "2.0" else "Int64"


def _start_values(variable: Any, start: Any, limits: tuple[float | None, float | None]) -> tuple[float, ...]:
    """Return start values as numbers; a variable without one begins with 0, or the bound that is nearest to it."""
    if start is None:
        low, high = limits
        return (low if low is not None and low > 0.0 else high if high is not None and high < 0.0 else 0.0,)
    parts: Iterable[Any] = start if isinstance(start, list | tuple) else str(start).split()
    return tuple(_number_of(variable, "start", part) for part in parts)


def number(value: Any) -> float:
    """Return a value of a model description as a number: `true` is 1.

    Raises:
        TypeError, ValueError: it is not a number.
    """
    words = {"true": 1.0, "false": 0.0}
    return words[value.lower()] if isinstance(value, str) and value.lower() in words else float(value)


def _number_of(variable: Any, attribute: str, value: Any) -> float:
    """Return the value of a variable's attribute as a number."""
    try:
        return number(value)
    except (TypeError, ValueError):
        raise InvalidConfig(f"{variable.name}: its {attribute} is {value!r}; a number expected") from None


def bounds(variable: Any) -> tuple[float | None, float | None]:
    """Return the bounds of a variable, or those of its declared type; None where there is none.

    Raises:
        InvalidConfig: a bound is not a number.
    """
    if variable.type == "Boolean":
        return 0.0, 1.0
    declared = variable.declaredType
    if variable.type == "Enumeration" and declared is not None and declared.items:
        items = [_number_of(variable, "enumeration", item.value) for item in declared.items]
        return min(items), max(items)
    return _bound(variable, "min"), _bound(variable, "max")


def settable_bounds(variable: Any) -> tuple[float | None, float | None]:
    """Return the bounds of a variable within those of its type: FMI's functions cut a number off that exceeds these.

    Raises:
        InvalidConfig: a bound is not a number.
    """
    low, high = bounds(variable)
    if variable.type in FLOATING or variable.type in ("Boolean", "Enumeration"):
        return low, high
    bits = 32 if variable.type == "Integer" else int(variable.type.strip("UInt"))
    is_unsigned = variable.type.startswith("U")
    end = 2.0 ** min(bits if is_unsigned else bits - 1, _EXACT_BITS)
    least, most = 0.0 if is_unsigned else -end, end - 1.0
    return least if low is None else max(low, least), most if high is None else min(high, most)


def _bound(variable: Any, side: str) -> float | None:
    text = getattr(variable, side) or getattr(variable.declaredType, side, None)
    value = None if text is None else _number_of(variable, side, text)
    return value if value is not None and isfinite(value) and abs(value) < _UNBOUNDED else None


def unit(variable: Any) -> str:
    """Return the unit of a variable, or that of its declared type, by its name on the bus."""
    if variable.type == "Boolean":
        return "on_off"
    name = variable.unit or getattr(variable.declaredType, "unit", None) or ""
    return UNIT_NAMES.get(name, name)
