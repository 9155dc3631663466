"""Units of SSP files and their FMUs: conversions by the definitions in these, and between the units that are known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from zenostat.plants.fmi.variables import UNIT_NAMES
from zenostat.plants.ssp.archive import NAMESPACES
from zenostat.topics.units import conversion

_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


class Definition(NamedTuple):
    """A unit by SI base units: a value in these is factor * value + offset.

    Attributes:
        exponents: of the base units.
        factor, offset: to the base units.
    """

    exponents: tuple[int, ...]
    factor: float
    offset: float


class Unit(NamedTuple):
    """A unit.

    Attributes:
        name: on the bus; empty: none.
        definition: in the file that uses it; None if this has none.
    """

    name: str
    definition: Definition | None = None


def definitions(root: Any, space: str) -> dict[str, Definition]:
    """Return the units that a document defines, by their names on the bus.

    Args:
        root: element that has the units.
        space: prefix of its namespace.
    """
    units = {}
    for unit in root.iterfind(f"{space}:Units/ssc:Unit", NAMESPACES):
        base = unit.find("ssc:BaseUnit", NAMESPACES)
        exponents = tuple(int(base.get(name, 0)) for name in _EXPONENTS)
        units[bus_name(unit.get("name"))] = Definition(
            exponents, float(base.get("factor", 1.0)), float(base.get("offset", 0.0))
        )
    return units


def fmu_definitions(description: Any) -> dict[str, Definition]:
    """Return the units that a model description of FMPy defines, by their names on the bus."""
    units = {}
    for unit in description.unitDefinitions:
        if (base := unit.baseUnit) is not None:
            exponents = tuple(int(getattr(base, name)) for name in _EXPONENTS)
            units[bus_name(unit.name)] = Definition(exponents, float(base.factor), float(base.offset))
    return units


def bus_name(name: str) -> str:
    """Return the name of a unit on the bus; empty for a number without a unit."""
    text = UNIT_NAMES.get(name, name)
    return "" if text == "1" else text


def defined(name: str, *sources: Mapping[str, Definition]) -> Unit:
    """Return a unit with its definition in the first source that has one."""
    return Unit(name, next((source[name] for source in sources if name in source), None))


def convert(source: Unit, target: Unit) -> tuple[float, float] | None:
    """Return factor and offset from one unit to another; None if they measure different quantities or are unknown."""
    (exponents, factor, offset), (wanted, divisor, base) = (
        unit.definition or Definition((), 1.0, 0.0) for unit in (source, target)
    )
    if source.name != target.name and exponents and exponents == wanted:
        return factor / divisor, (offset - base) / divisor
    return conversion(source.name, target.name)
