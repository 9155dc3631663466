"""Actions of a task, from actuators: one for each, of named groups, and in equal steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from zenostat.topics.energyplus_names import COOLING_SETPOINT, THERMOSTAT
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.keys import check_name, safe_name
from zenostat.topics.messages import Action, Actuator, DiscreteAction
from zenostat.topics.points import contains, describe_bounds

T = TypeVar("T")


def default_actions(actuators: Sequence[Actuator], control: str, errors: list[str]) -> tuple[Action, ...]:
    """Return an action for each actuator; with control `building`, one for each kind of thermostat setpoint."""
    if control != "building":
        return tuple(_combine(a.name, [a]) for a in actuators)
    kinds: dict[str, list[Actuator]] = {}
    for actuator in actuators:
        if actuator.component_type == THERMOSTAT:
            kinds.setdefault(safe_name(actuator.control_type), []).append(actuator)
    for actuator in actuators:
        if actuator.component_type != THERMOSTAT and actuator.name in kinds:
            errors.append(f"actuator {actuator.name!r} has the name of all thermostats together; rename it")
        elif actuator.component_type != THERMOSTAT:
            kinds[actuator.name] = [actuator]
    actions = tuple(_combine(name, members) for name, members in kinds.items())
    for action in actions:
        errors += _bound_errors(action)
    return actions


def named_actions(
    groups: Mapping[str, Sequence[str]],
    actuators: Sequence[Actuator],
    errors: list[str],
    bounds: Mapping[str, tuple[float | None, float | None]] = MappingProxyType({}),
) -> tuple[Action, ...]:
    """Return the actions that set these groups of actuators, within `bounds` if given, without those with errors."""
    by_name, owner = {a.name: a for a in actuators}, dict[str, str]()
    actions = []
    for name, group in groups.items():
        try:
            check_name(name, "the action's name")
        except InvalidConfig as error:
            errors.append(str(error))
            continue
        members = []
        for actuator in group:
            if actuator not in by_name:
                errors.append(f"action {name!r}: there is no actuator {actuator!r}; {did_you_mean(actuator, by_name)}")
            elif actuator in owner:
                errors.append(f"action {name!r}: the actuator {actuator!r} belongs to action {owner[actuator]!r}")
            else:
                owner[actuator] = name
                members.append(by_name[actuator])
        if not group:
            errors.append(f"action {name!r} has no actuators; name at least one")
        elif len(members) == len(group):
            action = _combine(name, members)
            low, high = bounds.get(name, (None, None))
            errors += _bound_errors(action, low, high)
            own = {"low": action.low if low is None else low, "high": action.high if high is None else high}
            actions.append(action.model_copy(update=own))
    return tuple(actions)


def equal_steps(
    actions: Sequence[Action], actuators: Sequence[Actuator], control: str, count: int, errors: list[str]
) -> tuple[DiscreteAction, ...]:
    """Divide each group of actions into equal steps: heating setpoints upwards, cooling setpoints downwards."""
    by_name = {a.name: a for a in actuators}
    groups: dict[str, list[Action]] = {}
    for action in actions:
        first = by_name[action.actuators[0]]
        paired = first.component_type == THERMOSTAT and control != "point"
        group = ("all" if control == "building" else first.key) if paired else action.name
        groups.setdefault(f"{first.component_type}/{group}", []).append(action)
        if action.low is None or action.high is None:
            errors.append(f"action {action.name!r} has no bounds for equal steps; add bounds or list its choices")
    if errors:
        return ()
    return tuple(_choice(members, by_name, count) for members in groups.values())


def _choice(members: Sequence[Action], by_name: dict[str, Actuator], count: int) -> DiscreteAction:
    columns = []
    for action in members:
        assert action.low is not None
        assert action.high is not None
        steps = np.linspace(action.low, action.high, count)
        downwards = by_name[action.actuators[0]].control_type == COOLING_SETPOINT
        columns.append(steps[::-1] if downwards else steps)
    rows = tuple(tuple(row) for row in np.column_stack(columns).tolist())
    return DiscreteAction(actions=tuple(a.name for a in members), values=rows)


def _combine(name: str, members: Sequence[Actuator]) -> Action:
    lows, highs = _not_none(a.low for a in members), _not_none(a.high for a in members)
    low, high = max(lows) if lows else None, min(highs) if highs else None
    return Action(name=name, unit=members[0].unit, low=low, high=high, actuators=tuple(a.name for a in members))


def _not_none(values: Iterable[T | None]) -> list[T]:
    return [value for value in values if value is not None]


def _bound_errors(action: Action, low: float | None = None, high: float | None = None) -> list[str]:
    errors = []
    for side, bound in (("low", low), ("high", high)):
        if bound is not None and not contains(action, bound):
            limits = describe_bounds(action)
            errors.append(f"action {action.name!r}: {side} {bound:g} is outside its actuators' {limits}")
    lower, upper = action.low if low is None else low, action.high if high is None else high
    if lower is not None and upper is not None and not lower < upper:
        errors.append(f"action {action.name!r}: its lower bound {lower:g} is not below its upper bound {upper:g}")
    return errors
