"""Checks of a district's file that need no plant: names, inputs, loops; and the order of a step."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from zenostat.cosim.file import RESERVED, Connection, DistrictFile, kind_of, read_district
from zenostat.cosim.graph import Graph, components, find_cycle, graph_of, is_loop, levels
from zenostat.topics import keys
from zenostat.topics.errors import did_you_mean
from zenostat.topics.model_file import FileErrors

MAX_POINT_NAME = 128
"""Longest name of a point; see `zenostat.topics.messages.base.SafeName`."""
MAX_NAME = 100
"""Longest name of a connection or a loop, which are parts of the names of points."""

_KINDS = "`building` with `weather`, `scenario`, `plant`, `fmu`, `grid`, `district`, `market` or `node`"


@dataclass(frozen=True, slots=True)
class Block:
    """Plants that step together: one, or those of a loop that is solved.

    Attributes:
        levels: groups of plants that can run side by side, in the order in which each has its inputs, those of solved
            connections apart.
        solved: indices of the solved connections between them, one of each entry of the file; empty for a plant
            without a loop.
        name: of the loop; empty for a plant without one.
    """

    levels: tuple[tuple[str, ...], ...]
    solved: tuple[int, ...] = ()
    name: str = ""

    @property
    def plants(self) -> tuple[str, ...]:
        """The plants in this order."""
        return tuple(plant for level in self.levels for plant in level)


@dataclass(frozen=True, slots=True)
class Topology:
    """The order of a step.

    Attributes:
        groups: blocks that can run side by side, in the order in which they depend on each other.
    """

    groups: tuple[tuple[Block, ...], ...]

    @property
    def loops(self) -> tuple[Block, ...]:
        """The blocks that are solved."""
        return tuple(block for group in self.groups for block in group if block.solved)


def plant_of(point: str) -> str:
    """Return the plant of `PLANT.POINT`."""
    return point.partition(".")[0]


def check_file(file: DistrictFile) -> Topology:
    """Check all that does not depend on the plants' points, and return the order of a step.

    Raises:
        InvalidConfig: lists all errors with their lines.
    """
    errors = file.errors()
    _check_plants(file, errors)
    _check_start(file, errors)
    _check_names(file, errors)
    for connection in file.connections:
        _check_connection(file, connection, errors)
    _check_inputs(file, errors)
    _check_markets(file, errors)
    errors.raise_if_any()
    topology = _order(file, errors)
    errors.raise_if_any()
    return topology


def _check_plants(file: DistrictFile, errors: FileErrors) -> None:
    for name, plant in file.spec.plants.items():
        kinds, location = kind_of(plant), ("plants", name)
        if name in RESERVED:
            errors.add(location, f"a plant cannot have the name {name!r}, which the district's own points begin with")
        if kinds not in (("node",), ("market",)) and len(node := f"{file.spec.name}.{name}") > keys.MAX_NAME:
            text = f"plant {name!r}: its node would be named DISTRICT.PLANT, with {len(node)} characters of at most"
            errors.add(location, f"{text} {keys.MAX_NAME}; shorten its name or the district's")
        if len(kinds) != 1:
            text = f"is {' and '.join(kinds)} at once" if kinds else "says not what it is"
            errors.add(location, f"plant {name!r} {text}; expected one of {_KINDS}")
        elif (kinds == ("node",)) != (plant.connect is not None):
            errors.add(
                location, f"plant {name!r}: `node` and `connect` belong together: its name and the bus that has it"
            )
        elif kinds == ("node",) and (extra := sorted(_settings(file, name))):
            errors.add(location, f"plant {name!r} runs already, with settings of its own; leave out {', '.join(extra)}")
        elif plant.keys is not None and plant.node is None and plant.market is None:
            errors.add(
                (*location, "keys"), f"plant {name!r} is started on a bus of its own, without keys; leave them out"
            )


def _settings(file: DistrictFile, plant: str) -> set[str]:
    return set(file.raw[plant]) - {"node", "connect", "keys", "on_lost"}


def _check_start(file: DistrictFile, errors: FileErrors) -> None:
    """Report districts that have themselves as a plant, at any depth."""
    for name, plant in file.spec.plants.items():
        if plant.node == file.spec.name:
            errors.add(
                ("plants", name),
                f"the start is circular: plant {name!r} is the node {plant.node!r}, which is the name of this district",
            )
        if plant.district is not None:
            chain = _circle(resolve(file, plant.district), [file.path.resolve()])
            if chain:
                names = " starts ".join(path.name for path in chain)
                errors.add(("plants", name, "district"), f"the start is circular: {names}")


def _circle(path: Path, chain: list[Path]) -> list[Path]:
    path = path.resolve()
    if path in chain:
        return [*chain[chain.index(path) :], path] if path == chain[0] else []
    inner = read_district(path)
    for plant in inner.spec.plants.values():
        if plant.district is not None and (circle := _circle(resolve(inner, plant.district), [*chain, path])):
            return circle
    return []


def resolve(file: DistrictFile, path: Path) -> Path:
    """Return a path that the file names, which is relative to the file's folder."""
    return file.path.parent / path.expanduser()


def _check_names(file: DistrictFile, errors: FileErrors) -> None:
    names: list[str] = []
    for connection in file.connections:
        name, location = connection.name, connection.location
        if len(name) > MAX_NAME:
            errors.add(location, f"its name has {len(name)} characters; give it a `name` of at most {MAX_NAME}")
        if name in names:
            first = file.line_of(names.index(name))
            errors.add(location, f"line {first} has a connection of the same name {name!r}; give it another `name`")
        names.append(name)


def _check_connection(file: DistrictFile, connection: Connection, errors: FileErrors) -> None:
    location, spec = connection.location, connection.spec
    for field, point in (("from", connection.source), ("to", connection.target)):
        plant = plant_of(point)
        if plant not in file.spec.plants:
            errors.add((*location, field), f"{point}: no plant {plant!r}; {did_you_mean(plant, file.spec.plants)}")
    if spec.solve and spec.delay:
        errors.add(location, "a connection is delayed or solved, not both; leave out `delay` or `solve`")
    if spec.solve and spec.tolerance is None:
        errors.add(location, "a solved connection needs its greatest residual in the target's unit: `tolerance: 0.01`")
    if spec.tolerance is not None and not spec.solve:
        text = "only a solved connection has a tolerance; add `solve: true`, or leave it out"
        errors.add((*location, "tolerance"), text)
    if spec.initial is not None and not (spec.solve or spec.delay):
        errors.add((*location, "initial"), "only a delayed or solved connection has an initial value")
    if spec.low is not None and spec.high is not None and not spec.low < spec.high:
        errors.add(location, f"low {spec.low:g} is not below high {spec.high:g}")


def _check_inputs(file: DistrictFile, errors: FileErrors) -> None:
    """Report inputs with several sources that are not added."""
    by_target: dict[str, list[int]] = {}
    for index, connection in enumerate(file.connections):
        by_target.setdefault(connection.target, []).append(index)
    for target, indices in by_target.items():
        for index in indices[1:]:
            if not all(file.connections[i].spec.sum for i in indices):
                errors.add(
                    file.connections[index].location,
                    f"{target} has a source in line {file.line_of(indices[0])} already; "
                    "`sum: true` in both adds their values",
                )


def _check_markets(file: DistrictFile, errors: FileErrors) -> None:
    """Report bidders that the price does not reach, or that need other plants' values of the same step."""
    for name, plant in file.spec.plants.items():
        if plant.market is None:
            continue
        if extra := sorted(set(file.raw[name]) - {"market", "on_lost"}):
            errors.add(("plants", name), f"{name!r} is a market; leave out {', '.join(extra)}")
        direct = [c for c in file.connections if c.spec.delay is None]
        for number, bidder in enumerate(plant.market.bidders):
            location, other = ("plants", name, "market", "bidders", number), plant_of(bidder.demand)
            if other not in file.spec.plants or file.spec.plants[other].market is not None:
                plants = [p for p, spec in file.spec.plants.items() if spec.market is None]
                errors.add(location, f"{bidder.demand}: no plant {other!r}; {did_you_mean(other, plants)}")
                continue
            sources = [(plant_of(c.source), c.location) for c in direct if plant_of(c.target) == other]
            if name not in dict(sources):
                errors.add(location, f"the price does not reach {other!r}: a connection from {name}.price is missing")
            for source, line in sources:
                if source != name:
                    text = f"{other!r} bids before {source!r} is simulated; give this connection `delay: 1`"
                    errors.add(line, text)


def _order(file: DistrictFile, errors: FileErrors) -> Topology:
    connections = file.connections
    direct = [index for index, connection in enumerate(connections) if connection.spec.delay is None]

    def edges(indices: Sequence[int]) -> list[tuple[str, str]]:
        return [(plant_of(connections[i].source), plant_of(connections[i].target)) for i in indices]

    unsolved = [index for index in direct if not connections[index].spec.solve]
    torn = graph_of(file.spec.plants, edges(unsolved))
    if cycle := find_cycle(torn):
        _report_loop(file, cycle, unsolved, errors)
        return Topology(())
    graph = graph_of(file.spec.plants, edges(direct))
    order = components(graph)
    blocks: dict[tuple[str, ...], Block] = {}
    names = set[str]()
    for component in order:
        if is_loop(component, graph):
            name = _loop_name(component, names)
            names.add(name)
            blocks[tuple(component)] = _block(component, name, connections, direct, torn)
        else:
            blocks[tuple(component)] = Block((tuple(component),))
    in_loops = {connections[index].entry for block in blocks.values() for index in block.solved}
    for connection in connections:
        if connection.spec.solve and connection.entry not in in_loops:
            errors.add((*connection.location, "solve"), "this connection is part of no loop; leave out `solve`")
    for block in blocks.values():
        for name in block.plants if block.solved else ():
            if file.spec.plants[name].market is not None:
                text = f"the market {name!r} is part of a loop, which trials cannot solve; give it `delay: 1`"
                errors.add(connections[block.solved[0]].location, text)
    groups = levels(order, graph)
    return Topology(tuple(tuple(blocks[tuple(c)] for c in group) for group in groups))


def _loop_name(component: Sequence[str], used: Collection[str]) -> str:
    """Return the names of a loop's plants as one; a number follows where another loop has it."""
    base = "-".join(component)
    if len(base) > MAX_NAME:
        base = f"{component[0]}-and-{len(component) - 1}-more"
    name, number = base, 2
    while name in used:
        name, number = f"{base}-{number}", number + 1
    return name


def _block(
    component: Sequence[str], name: str, connections: Sequence[Connection], direct: Sequence[int], torn: Graph[str]
) -> Block:
    members = set(component)
    solved = [
        index
        for index in direct
        if connections[index].spec.solve
        and plant_of(connections[index].source) in members
        and plant_of(connections[index].target) in members
    ]
    entries = [connections[index].entry for index in solved]
    solved = [index for position, index in enumerate(solved) if entries.index(entries[position]) == position]
    inner = {plant: [successor for successor in torn[plant] if successor in members] for plant in component}
    groups = levels(components(inner), inner)
    return Block(tuple(tuple(plant for (plant,) in group) for group in groups), tuple(solved), name)


def _report_loop(file: DistrictFile, cycle: Sequence[str], indices: Sequence[int], errors: FileErrors) -> None:
    """Report a loop by its points, at the line of the first of its connections in the file."""
    connections, steps = file.connections, list[int]()
    for plant, successor in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
        steps.append(
            next(
                index
                for index in indices
                if plant_of(connections[index].source) == plant and plant_of(connections[index].target) == successor
            )
        )
    arrows = ", ".join(f"{connections[index].source} → {connections[index].target}" for index in steps)
    lines = " and ".join(dict.fromkeys(str(file.line_of(index)) for index in sorted(steps)))
    plural = "s" if len(steps) > 1 else ""
    errors.add(
        connections[min(steps)].location,
        f"a loop without delay or solution (line{plural} {lines}): {arrows}; give one of them `delay: 1`, or "
        "`solve: true` with a `tolerance`",
    )
