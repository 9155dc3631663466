"""Read an SSP file: its FMUs with their parameters, and the connections between them, without nested systems."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isclose
from pathlib import Path
from typing import Any, NamedTuple

from zenostat.plants.fmi.model import check_starts, read_model
from zenostat.plants.fmi.variables import PointNames, Variable, inputs, outputs, unit
from zenostat.plants.ssp import parameters
from zenostat.plants.ssp.archive import NAMESPACES, Archive, open_archive
from zenostat.plants.ssp.units import Definition, Unit, bus_name, convert, defined, definitions, fmu_definitions
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.units import conversion

_FMU_TYPE = "application/x-fmu-sharedlibrary"

Connector = tuple[parameters.Path, str]
"""Path of an element, and the name of one of its connectors."""


class Link(NamedTuple):
    """A connection between two points.

    Attributes:
        source, target: PLANT.POINT.
        unit: unit to which the source is converted first; empty: that of the target.
        factor, offset: applied after that.
    """

    source: str
    target: str
    unit: str
    factor: float
    offset: float


@dataclass(frozen=True)
class Component:
    """An FMU of a system.

    Attributes:
        name: of the plant.
        file: the FMU.
        interface: `CoSimulation` or `ModelExchange`; empty if the file does not say.
        starts: values of parameters, by the name of the variable.
    """

    name: str
    file: Path
    interface: str
    starts: Mapping[str, Any]


@dataclass(frozen=True)
class Structure:
    """The content of an SSP file.

    Attributes:
        name: of the system.
        components: its FMUs.
        links: connections between them, in the order of the components' inputs.
        step_s: step size of the master algorithm, in s; None if the file does not say.
        start_s, stop_s: begin and end of its default experiment, in s; None if the file does not say.
        notes: what of the file is not used, a sentence each.
    """

    name: str
    components: tuple[Component, ...]
    links: tuple[Link, ...]
    step_s: float | None
    start_s: float | None
    stop_s: float | None
    notes: tuple[str, ...]


def read_structure(path: Path, folder: Path, reserved: Collection[str] = ()) -> Structure:
    """Read an SSP file; nothing of it runs.

    Args:
        path: the file.
        folder: for copies of its FMUs.
        reserved: names that no plant may have.

    Raises:
        InvalidConfig: it is no SSP file of version 1.0, or has what is not supported; names the element and its line.
    """
    with open_archive(path) as archive:
        return _Reader(archive, folder, reserved).read()


class _Reader:
    """Reader of one file."""

    def __init__(self, archive: Archive, folder: Path, reserved: Collection[str]) -> None:
        self._archive, self._folder, self._reserved = archive, folder, reserved
        self._kinds: dict[Connector, str] = {}
        self._units: dict[Connector, str] = {}
        self._defined: dict[str, Definition] = {}
        self._fmu_defined: dict[parameters.Path, dict[str, Definition]] = {}
        self._fmus: dict[parameters.Path, Any] = {}
        self._systems: set[parameters.Path] = set()
        self._drivers: dict[Connector, tuple[Connector, Any]] = {}
        self._values: list[parameters.Parameter] = []
        self._notes: list[str] = []

    def read(self) -> Structure:
        root = self._archive.document("SystemStructure.ssd", "ssd")
        self._defined = definitions(root, "ssd")
        system = root.find("ssd:System", NAMESPACES)
        self._read_system(system, ())
        self._values += parameters.parameters(self._archive, system, (), self._notes)
        if not self._fmus:
            raise self._archive.error("the system has no components", system)
        names = _plant_names(self._fmus, self._reserved)
        starts = self._starts()
        components, points = [], dict[Connector, Variable]()
        for path, element in self._fmus.items():
            file = self._archive.unpack(element.get("source"), self._folder)
            interface = element.get("implementation", "any").replace("any", "")
            try:
                description = read_model(file, interface or None).description
            except InvalidConfig as error:
                text = str(error).replace(str(file), element.get("source"))
                raise self._archive.error(text, element) from None
            self._fmu_defined[path] = fmu_definitions(description)
            values = _start_values(description, starts.get(path, {}), ".".join(path))
            components.append(Component(names[path], file, interface, values))
            used = PointNames()
            for variable in (*outputs(description, (), used), *inputs(description, values, used)):
                points[path, variable.name] = variable
        experiment = root.find("ssd:DefaultExperiment", NAMESPACES)
        first, last = (None if experiment is None else experiment.get(f"{end}Time") for end in ("start", "stop"))
        return Structure(
            root.get("name"),
            tuple(components),
            tuple(self._links(names, points)),
            self._step_s(root),
            None if first is None else float(first),
            None if last is None else float(last),
            tuple(self._notes),
        )

    def _read_system(self, system: Any, path: parameters.Path) -> None:
        self._systems.add(path)
        self._read_connectors(system, path)
        for element in system.iterfind("ssd:Elements/*", NAMESPACES):
            child, kind = (*path, element.get("name")), element.tag.rpartition("}")[2]
            if child in self._systems or child in self._fmus:
                raise self._archive.error(f"another element has the name {element.get('name')!r}, too", element)
            if kind == "System":
                self._read_system(element, child)
            elif kind == "Component":
                if element.get("type", _FMU_TYPE) != _FMU_TYPE:
                    text = f"component {element.get('name')!r} is of the type {element.get('type')!r}; an FMU expected"
                    raise self._archive.error(text, element)
                self._fmus[child] = element
                self._read_connectors(element, child)
            else:
                raise self._archive.error(f"{kind} {element.get('name')!r} is not supported", element)
            # those of outer systems come later
            self._values += parameters.parameters(self._archive, element, child, self._notes)
        for connection in system.iterfind("ssd:Connections/ssd:Connection", NAMESPACES):
            self._read_connection(connection, path)

    def _read_connectors(self, element: Any, path: parameters.Path) -> None:
        for connector in element.iterfind("ssd:Connectors/ssd:Connector", NAMESPACES):
            self._kinds[path, connector.get("name")] = connector.get("kind")
            real = connector.find("ssc:Real", NAMESPACES)
            self._units[path, connector.get("name")] = "" if real is None else real.get("unit", "")

    def _read_connection(self, connection: Any, path: parameters.Path) -> None:
        """Note what drives the end of a connection; either of its ends may be the source."""
        ends: dict[bool, Connector] = {}
        for side in ("start", "end"):
            element, name = connection.get(f"{side}Element"), connection.get(f"{side}Connector")
            end = (path if element is None else (*path, element)), name
            if end not in self._kinds:
                known = [name for owner, name in self._kinds if owner == end[0]]
                owner = f"element {element!r}" if element else "the system"
                text = f"{owner} has no connector {name!r}; {did_you_mean(name, known)}"
                raise self._archive.error(text, connection)
            kind = self._kinds[end]
            if kind not in ("input", "output"):
                text = f"connector {name!r} is of the kind {kind!r}; input or output is supported"
                raise self._archive.error(text, connection)
            is_source = (kind == "input") == (end[0] == path)  # within a system, its own inputs are sources
            if is_source in ends:
                which = "sources" if is_source else "inputs"
                raise self._archive.error(f"{ends[is_source][1]!r} and {name!r} are both {which}", connection)
            ends[is_source] = end
        if ends[False] in self._drivers:
            text = f"{'.'.join([*ends[False][0], ends[False][1]])} has another connection already"
            raise self._archive.error(text, connection)
        self._drivers[ends[False]] = (ends[True], connection)

    def _links(self, names: Mapping[parameters.Path, str], points: Mapping[Connector, Variable]) -> Iterator[Link]:
        outer: dict[str, list[str]] = {}
        for target in self._drivers:
            if target[0] not in self._fmus:
                continue
            legs: list[tuple[Connector, Connector, Any]] = []  # from the target to the source
            source = target
            while source in self._drivers:
                end, (source, connection) = source, self._drivers[source]
                if any(end == passed for _, passed, _ in legs):
                    text = f"{'.'.join([*end[0], end[1]])} is driven by itself, through systems without a component"
                    raise self._archive.error(text, connection)
                legs.append((source, end, connection))
            entry = self._point(target, points, connection)
            target_name = f"{names[target[0]]}.{entry.points[0]}"
            if source[0] not in self._fmus:
                outer.setdefault(".".join([*source[0], source[1]]), []).append(target_name)
                continue
            start = self._point(source, points, connection)
            name = f"{names[source[0]]}.{start.points[0]}"
            if entry.activation is not None:
                text = f"the connection to {entry.name!r} of {'.'.join(target[0])!r} also sets "
                also = f"{entry.activation.name!r} to true: an overwrite block acts while its value is commanded"
                self._notes.append(text + also)
            yield Link(name, target_name, *self._transformed(legs, points))
        self._notes += [
            f"the system's input {name!r} is not connected: command {', '.join(targets)} instead"
            for name, targets in outer.items()
        ]

    def _transformed(
        self, legs: Sequence[tuple[Connector, Connector, Any]], points: Mapping[Connector, Variable]
    ) -> tuple[str, float, float]:
        """Return the unit, factor and offset of a link, through nested systems.

        Each connection converts the unit, unless it is suppressed or one of its ends has none, then it transforms. Of a
        chain the product is one conversion from the first unit to the last one, where one takes place that a district
        knows, and the rest.
        """
        units = [self._unit(legs[-1][0], points), *(self._unit(end, points) for _, end, _ in reversed(legs))]
        factor, offset, is_converted = 1.0, 0.0, False
        for (before, after), (_, _, connection) in zip(pairwise(units), reversed(legs), strict=True):
            own, more = parameters.transformation(self._archive, connection)
            scale, shift = 1.0, 0.0
            if not parameters.is_true(connection, "suppressUnitConversion") and before.name and after.name:
                scale, shift = self._converted(before, after, connection)
                is_converted = is_converted or before.name != after.name
            factor, offset = own * scale * factor, own * (scale * offset + shift) + more
        first, last = (points[end].unit for end in (legs[-1][0], legs[0][1]))
        whole = conversion(first, last) if is_converted else None
        if whole is None or first == last:
            return "" if first == last else first, factor, offset
        if len(legs) == 1 and isclose(scale, whole[0]) and isclose(shift, whole[1]):  # without a rounding error
            return "", own, more
        return "", factor / whole[0], offset - factor / whole[0] * whole[1]

    def _converted(self, before: Unit, after: Unit, connection: Any) -> tuple[float, float]:
        factors = convert(before, after)
        if factors is None:
            text = f"{before.name} is not converted to {after.name}: they are unlike, or one of them is not defined; "
            raise self._archive.error(f"{text}define both in Units, or set suppressUnitConversion", connection)
        return factors

    def _unit(self, connector: Connector, points: Mapping[Connector, Variable]) -> Unit:
        """Return the unit of a connector, or of its FMU's variable; without a name if it has none."""
        own, fmu = self._units.get(connector, ""), self._fmu_defined.get(connector[0], {})
        if own or connector not in points:
            return defined(bus_name(own), self._defined, fmu)
        return defined(bus_name(points[connector].unit), fmu, self._defined)

    def _point(self, connector: Connector, points: Mapping[Connector, Variable], connection: Any) -> Variable:
        variable = points.get(connector)
        if variable is None or len(variable.points) != 1:
            for (path, name), block in points.items():
                if path == connector[0] and block.activation is not None and block.activation.name == connector[1]:
                    text = f"{connector[1]!r} of {'.'.join(path)!r} cannot be connected: it is true while {name!r} is "
                    raise self._archive.error(f"{text}commanded, as in BOPTEST's overwrite blocks", connection)
            known = [name for path, name in points if path == connector[0]]
            text = f"the FMU of {'.'.join(connector[0])!r} has no scalar input or output {connector[1]!r}; "
            raise self._archive.error(text + did_you_mean(connector[1], known), connection)
        return variable

    def _starts(self) -> dict[parameters.Path, dict[str, parameters.Parameter]]:
        """Return the parameters by component; a later value replaces an earlier one."""
        starts: dict[parameters.Path, dict[str, parameters.Parameter]] = {}
        for value in self._values:
            owners = [path for path in self._fmus if value.name.startswith(".".join([*path, ""]))]
            if not owners:
                self._notes.append(f"the parameter {value.name!r} belongs to no component and is not used")
                continue
            path = max(owners, key=len)
            starts.setdefault(path, {})[value.name[len(".".join([*path, ""])) :]] = value
        return starts

    @staticmethod
    def _step_s(root: Any) -> float | None:
        """Return the step size in an annotation, such as that of OMSimulator; SSP itself has no field for it."""
        sizes = [master.get("stepSize") for master in root.iterfind(".//{*}FixedStepMaster")]
        try:
            return next(float(size) for size in sizes if size and float(size) > 0)
        except (StopIteration, ValueError):
            return None


def _plant_names(components: Mapping[parameters.Path, Any], reserved: Collection[str]) -> dict[parameters.Path, str]:
    """Return a name for each component's plant: its path, in letters that names of plants may have."""
    names: dict[parameters.Path, str] = {}
    for path in components:
        base = re.sub(r"[^A-Za-z0-9_\-]", "_", "_".join(path))[:56]
        base = f"_{base}" if not base or base in reserved or base[0] == "-" else base
        name, number = base, 2
        while name in names.values():
            name, number = f"{base}_{number}", number + 1
        names[path] = name
    return names


def _start_values(description: Any, values: Mapping[str, parameters.Parameter], component: str) -> dict[str, Any]:
    """Return the values of an FMU's parameters in the units of its variables.

    Raises:
        InvalidConfig: the FMU has no such variable, or it cannot have this value.
    """
    by_name = {variable.name: variable for variable in description.modelVariables}
    units, starts = fmu_definitions(description), dict[str, Any]()
    for name, parameter in values.items():
        value, variable = parameter.value, by_name.get(name)
        if variable is not None and parameter.unit.name and isinstance(value, float):
            own = defined(bus_name(unit(variable)), units)
            source = parameter.unit if parameter.unit.definition else defined(parameter.unit.name, units)
            factors = convert(source, own) if own.name else (1.0, 0.0)
            if factors is None:
                raise InvalidConfig(f"{component}: {name} is in {source.name}; the FMU has it in {own.name}")
            value = factors[0] * value + factors[1]
        if not isinstance(value, str) and (parameter.factor, parameter.offset) != (1.0, 0.0):
            value = parameter.factor * value + parameter.offset
        if variable is not None and parameter.is_item:
            items = {item.name: item.value for item in getattr(variable.declaredType, "items", None) or ()}
            if value not in items:
                raise InvalidConfig(f"{component}: {name} = {value!r}; {did_you_mean(str(value), list(items))}")
            value = float(items[str(value)])
        starts[name] = value
    try:
        check_starts(description, starts)
    except InvalidConfig as error:
        raise InvalidConfig(f"{component}: {error}") from None
    return starts
