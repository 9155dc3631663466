"""What the choices of a discrete action space of Sinergym mean, as choices of a scenario."""

from __future__ import annotations

from collections.abc import Mapping

from models.scenario.schema import ActuatorSpec, DiscreteActionSpec
from models.sinergym.literals import DiscreteSpec, MultiDiscrete, Offsets, Rows, Table
from topics.errors import InvalidConfig

_Values = tuple[tuple[float, ...], ...]


def choice_specs(
    discrete: DiscreteSpec | MultiDiscrete, table: Table, actuators: Mapping[str, ActuatorSpec]
) -> tuple[DiscreteActionSpec, ...]:
    """One `DiscreteActionSpec` over all actuators for a `DiscreteSpec`, one for each of them for a `MultiDiscrete`.

    Raises:
        InvalidConfig: the table does not fit the space or the actuators, or leaves their bounds; all faults, joined
            by `; `.
    """
    names = list(actuators)
    if isinstance(discrete, DiscreteSpec):
        found = [DiscreteActionSpec(actions=tuple(names), values=_joint(discrete, table, len(names)))]
    else:
        columns = _separate(discrete, table, len(names))
        found = [DiscreteActionSpec(actions=(name,), values=rows) for name, rows in zip(names, columns, strict=True)]
    if outside := [fault for choice in found for fault in _outside(choice, actuators)]:
        raise InvalidConfig("; ".join(outside))
    return tuple(found)


def _joint(discrete: DiscreteSpec, table: Table, actuators: int) -> _Values:
    if not isinstance(table, Rows):
        raise InvalidConfig(f"Discrete({discrete.n}) needs a table of values, and there are only numbers to add")
    if len(table.values) != discrete.n:
        raise InvalidConfig(f"Discrete({discrete.n}) has {discrete.n} choices, and its table {len(table.values)}")
    if wrong := sorted({len(row) for row in table.values} - {actuators}):
        raise InvalidConfig(f"its table has rows of {wrong[0]} values, and there are {actuators} actuators")
    return table.values


def _separate(discrete: MultiDiscrete, table: Table, actuators: int) -> list[_Values]:
    said = f"MultiDiscrete({list(discrete.nvec)})"
    if not isinstance(table, Offsets):
        raise InvalidConfig(f"{said} has a choice for each actuator, and its table one for all of them at once")
    if len(discrete.nvec) != actuators:
        raise InvalidConfig(f"{said} has {len(discrete.nvec)} dimensions, and there are {actuators} actuators")
    added = dict(table.added)
    if beyond := [index for index in added if index >= actuators]:
        raise InvalidConfig(f"its table adds to dimension {beyond[0]}, and there are {actuators}")
    return [tuple((k + added.get(index, 0.0),) for k in range(n)) for index, n in enumerate(discrete.nvec)]


def _outside(choice: DiscreteActionSpec, actuators: Mapping[str, ActuatorSpec]) -> list[str]:
    """The values of a choice that leave the bounds of their actuators."""
    return [
        f"choice {number} sets {name} to {value:g}, outside {actuator.low:g} to {actuator.high:g} of action_space"
        for number, row in enumerate(choice.values)
        for name, value in zip(choice.actions, row, strict=True)
        if (actuator := actuators[name]).low is not None
        and actuator.high is not None
        and not actuator.low <= value <= actuator.high
    ]
