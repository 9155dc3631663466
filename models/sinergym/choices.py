"""Convert the choices of Sinergym's discrete action spaces to choices of a scenario."""

from __future__ import annotations

from collections.abc import Mapping

from zenostat.models.scenario.schema import ActuatorSpec, DiscreteActionSpec
from zenostat.models.sinergym.literals import DiscreteSpec, MultiDiscrete, Offsets, Rows, Table
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.points import bounds

_Values = tuple[tuple[float, ...], ...]


def choice_specs(
    discrete: DiscreteSpec | MultiDiscrete, table: Table, actuators: Mapping[str, ActuatorSpec]
) -> tuple[DiscreteActionSpec, ...]:
    """Return one `DiscreteActionSpec` for all actuators of a `DiscreteSpec`, or one for each of a `MultiDiscrete`.

    Raises:
        InvalidConfig: the table does not match the space or the actuators, or has values outside their bounds; the text
            has all errors, joined by `; `.
    """
    names = list(actuators)
    if isinstance(discrete, DiscreteSpec):
        specs = [DiscreteActionSpec(actions=tuple(names), values=_joint(discrete, table, len(names)))]
    else:
        columns = _separate(discrete, table, len(names))
        specs = [DiscreteActionSpec(actions=(name,), values=rows) for name, rows in zip(names, columns, strict=True)]
    if outside := [error for choice in specs for error in _outside(choice, actuators)]:
        raise InvalidConfig("; ".join(outside))
    return tuple(specs)


def _joint(discrete: DiscreteSpec, table: Table, actuators: int) -> _Values:
    if not isinstance(table, Rows):
        raise InvalidConfig(f"Discrete({discrete.n}) needs a table of values, but there are only offsets")
    if len(table.values) != discrete.n:
        raise InvalidConfig(f"Discrete({discrete.n}) has {discrete.n} choices, but its table has {len(table.values)}")
    if wrong := sorted({len(row) for row in table.values} - {actuators}):
        raise InvalidConfig(f"its table has rows of {wrong[0]} values, but there are {actuators} actuators")
    return table.values


def _separate(discrete: MultiDiscrete, table: Table, actuators: int) -> list[_Values]:
    source = f"MultiDiscrete({list(discrete.nvec)})"
    if not isinstance(table, Offsets):
        raise InvalidConfig(f"{source} has a choice for each actuator, but its table has one for all of them together")
    if len(discrete.nvec) != actuators:
        raise InvalidConfig(f"{source} has {len(discrete.nvec)} dimensions, but there are {actuators} actuators")
    offsets = dict(table.offsets)
    if beyond := [index for index in offsets if index >= actuators]:
        raise InvalidConfig(f"its table adds to dimension {beyond[0]}, but there are {actuators}")
    return [tuple((k + offsets.get(index, 0.0),) for k in range(n)) for index, n in enumerate(discrete.nvec)]


def _outside(choice: DiscreteActionSpec, actuators: Mapping[str, ActuatorSpec]) -> list[str]:
    """Return errors for the values of a choice that are outside the bounds of their actuators."""
    return [
        f"choice {number} sets {name} to {value:g}, outside {low:g} to {high:g} of action_space"
        for number, row in enumerate(choice.values)
        for name, value in zip(choice.actions, row, strict=True)
        for low, high in [bounds(actuators[name])]
        if not low <= value <= high
    ]
