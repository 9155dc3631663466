"""Parameters of the components of an SSP file: their values by the component's path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from zenostat.plants.ssp.archive import NAMESPACES, STRUCTURE, Archive
from zenostat.plants.ssp.units import Definition, Unit, bus_name, defined, definitions
from zenostat.topics.errors import did_you_mean

Path = tuple[str, ...]
"""Names of the elements from the outermost system to an element, without that system's own name."""

_SET_TYPE = "application/x-ssp-parameter-set"


class Parameter(NamedTuple):
    """A value for a parameter.

    Attributes:
        name: path of the component and name of the variable, separated by dots.
        value: a number, a Boolean, a text, or the name of an item of an enumeration.
        unit: of a number; without a name: that of the variable.
        is_item: whether it is the name of an item.
        factor, offset: applied to a number once it has the unit of the variable.
    """

    name: str
    value: float | bool | str
    unit: Unit
    is_item: bool
    factor: float = 1.0
    offset: float = 0.0


def parameters(archive: Archive, element: Any, path: Path, notes: list[str]) -> Iterator[Parameter]:
    """Yield the parameters that the bindings of a component or a system set, in the order of the file.

    Args:
        archive: the file.
        element: the component or system.
        path: its path.
        notes: for what is not used, a sentence each.

    Raises:
        InvalidConfig: a binding cannot be read or is not supported.
    """
    for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
        if binding.get("type", _SET_TYPE) != _SET_TYPE:
            raise archive.error(f"parameters of the type {binding.get('type')!r}; {_SET_TYPE} expected", binding)
        document, values = _part(archive, binding, "ParameterValues/ssv:ParameterSet", binding.get("source"), "ssv")
        mapping = binding.find("ssd:ParameterMapping", NAMESPACES)
        prefix = ".".join([*path, ""]) + binding.get("prefix", "")
        entries, mapped = None, ""
        if mapping is not None:
            mapped, root = _part(archive, mapping, "ssm:ParameterMapping", mapping.get("source"), "ssm")
            entries = [] if root is None else root.findall("ssm:MappingEntry", NAMESPACES)
        units = {} if values is None else definitions(values, "ssv")
        items = [] if values is None else values.findall("ssv:Parameters/ssv:Parameter", NAMESPACES)
        names = [item.get("name") for item in items]
        notes += [
            f"{mapped} line {entry.sourceline}: {prefix}{entry.get('target')} is not set, as there is no parameter "
            f"{entry.get('source')!r}; {did_you_mean(entry.get('source'), names)}"
            for entry in entries or ()
            if entry.get("source") not in names
        ]
        for item in items:
            parameter = _parameter(archive, item, document, units)
            if entries is None:
                yield parameter._replace(name=prefix + parameter.name)
                continue
            for entry in entries:
                if entry.get("source") == parameter.name:
                    factor, offset = transformation(archive, entry, mapped)
                    if (factor, offset) != (1.0, 0.0) and isinstance(parameter.value, str):
                        raise archive.error(f"{parameter.name} is a text; it has no factor", entry, mapped)
                    unit = Unit("") if is_true(entry, "suppressUnitConversion") else parameter.unit
                    name = prefix + entry.get("target")
                    yield parameter._replace(name=name, unit=unit, factor=factor, offset=offset)


def _part(archive: Archive, element: Any, inline: str, source: str | None, kind: str) -> tuple[str, Any]:
    """Return the name of the document that has a part of a binding, and the part; None if there is none."""
    if element.get("sourceBase", "SSD") != "SSD":
        raise archive.error("sourceBase is 'component'; files within FMUs are not read", element)
    if source is not None:
        return source, archive.document(source, kind)
    part = element.find(inline if kind == "ssm" else f"ssd:{inline}", NAMESPACES)
    if part is not None:
        archive.check(part, kind)
    return STRUCTURE, part


def _parameter(archive: Archive, item: Any, document: str, units: Mapping[str, Definition]) -> Parameter:
    name = item.get("name")
    for kind in ("Real", "Integer", "Boolean", "String", "Enumeration"):
        value = item.find(f"ssv:{kind}", NAMESPACES)
        if value is not None:
            text = value.get("value")
            if kind in ("String", "Enumeration"):
                return Parameter(name, text, Unit(""), kind == "Enumeration")
            if kind == "Boolean":
                return Parameter(name, text in ("true", "1"), Unit(""), is_item=False)
            number = float(text) if kind == "Real" else int(text)
            return Parameter(name, number, defined(bus_name(value.get("unit", "")), units), is_item=False)
    raise archive.error(f"the parameter {name!r} is binary; numbers and texts are supported", item, document)


def transformation(archive: Archive, element: Any, document: str = STRUCTURE) -> tuple[float, float]:
    """Return factor and offset of a connection or a mapping; (1, 0) if it has none.

    Args:
        archive: the file.
        element: the connection or the entry of the mapping.
        document: the element's document.

    Raises:
        InvalidConfig: it is not linear.
    """
    for other in ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation"):
        if element.find(f"ssc:{other}", NAMESPACES) is not None:
            raise archive.error(f"{other} is not supported; LinearTransformation is", element, document)
    linear = element.find("ssc:LinearTransformation", NAMESPACES)
    return (1.0, 0.0) if linear is None else (float(linear.get("factor", 1.0)), float(linear.get("offset", 0.0)))


def is_true(element: Any, attribute: str) -> bool:
    """Return whether an attribute of an element is true; it is false by default."""
    return element.get(attribute, "false") in ("true", "1")
