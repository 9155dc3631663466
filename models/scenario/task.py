"""Build an agent's task: the dimensions of its action, each with its actuators, and its discrete choices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np

from zenostat.models.points.selection import Points
from zenostat.models.scenario.schema import Scenario
from zenostat.topics.energyplus_names import COOLING_SETPOINT, THERMOSTAT
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.keys import check_name, safe_name
from zenostat.topics.messages import Action, Actuator, DiscreteAction, Task, TerminationLimit
from zenostat.topics.points import PointIndex, contains, describe_bounds

T = TypeVar("T")


def task_of(scenario: Scenario, points: Points) -> Task:
    """Return the task of a scenario for these points.

    Raises:
        InvalidConfig: unknown actuators, invalid bounds, or choices outside the action's bounds; lists all errors.
    """
    errors: list[str] = []
    actions = _relative(scenario, _actions(scenario, points.actuators, errors), errors)
    choices: tuple[DiscreteAction, ...] = ()
    if isinstance(scenario.discrete, int) and not errors:
        choices = _steps(actions, points.actuators, scenario, errors)
    elif isinstance(scenario.discrete, tuple):
        choices = tuple(DiscreteAction(actions=c.actions, values=c.values) for c in scenario.discrete)
        invalid = set(scenario.actions or ()) - {a.name for a in actions}
        errors += _choice_errors(choices, actions, invalid)
    names = [sensor.name for sensor in points.sensors] + [meter.name for meter in points.meters]
    index = PointIndex(names, "sensor or meter")
    for number, limit in enumerate(scenario.terminate):
        errors += [f"terminate.{number}: {index.unknown(name)}" for name in limit.points if name not in index]
    if errors:
        raise InvalidConfig("\n".join(errors))
    return Task(
        scenario=scenario.id,
        time=scenario.time,
        actions=actions,
        discrete_actions=choices,
        reward=scenario.reward,
        terminate=tuple(
            TerminationLimit(points=limit.points, low=limit.low, high=limit.high, duration_s=3600.0 * limit.duration_h)
            for limit in scenario.terminate
        ),
        wrappers=scenario.wrappers,
    )


def relative_actuators(scenario: Scenario, actuators: Sequence[Actuator]) -> list[str]:
    """Return the names of the actuators that a scenario sets relative to the building's own control."""
    actions = _relative(scenario, _actions(scenario, actuators, []), [])
    return [name for action in actions if action.relative for name in action.actuators]


def _actions(scenario: Scenario, actuators: Sequence[Actuator], errors: list[str]) -> tuple[Action, ...]:
    if scenario.actions is None:
        return _default_actions(scenario, actuators, errors)
    return _named_actions(scenario, actuators, errors)


def _relative(scenario: Scenario, actions: tuple[Action, ...], errors: list[str]) -> tuple[Action, ...]:
    """Return the actions, those with `relative` as offsets in K, or in the unit of their actuators."""
    relative, names = scenario.relative, [action.name for action in actions]
    if relative is None:
        return actions
    offsets = relative if isinstance(relative, dict) else dict.fromkeys(names, relative)
    errors += [f"relative: there is no action {n!r}; {did_you_mean(n, names)}" for n in offsets if n not in names]
    for name, spec in (scenario.actions or {}).items():
        if name in offsets and (spec.low is not None or spec.high is not None):
            errors.append(f"action {name!r} is relative: its bounds are those of `relative`; remove its low and high")

    def offset_of(action: Action) -> Action:
        bounds = offsets[action.name]
        low, high = bounds if isinstance(bounds, tuple) else (-bounds, bounds)
        unit = "K" if action.unit == "degC" else action.unit
        return action.model_copy(update={"unit": unit, "low": low, "high": high, "relative": True})

    return tuple(offset_of(action) if action.name in offsets else action for action in actions)


def _default_actions(scenario: Scenario, actuators: Sequence[Actuator], errors: list[str]) -> tuple[Action, ...]:
    """Return an action for each actuator; with `control: building`, one for each kind of thermostat setpoint."""
    if scenario.control != "building":
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
        errors += _bound_errors(action, None, None)
    return actions


def _combine(name: str, members: Sequence[Actuator]) -> Action:
    lows, highs = _not_none(a.low for a in members), _not_none(a.high for a in members)
    low, high = max(lows) if lows else None, min(highs) if highs else None
    return Action(name=name, unit=members[0].unit, low=low, high=high, actuators=tuple(a.name for a in members))


def _not_none(values: Iterable[T | None]) -> list[T]:
    return [value for value in values if value is not None]


def _named_actions(scenario: Scenario, actuators: Sequence[Actuator], errors: list[str]) -> tuple[Action, ...]:
    by_name, owner = {a.name: a for a in actuators}, dict[str, str]()
    actions = []
    for name, spec in (scenario.actions or {}).items():
        try:
            check_name(name, "the action's name")
        except InvalidConfig as error:
            errors.append(str(error))
            continue
        members = []
        for actuator in spec.actuators:
            if actuator not in by_name:
                errors.append(f"action {name!r}: there is no actuator {actuator!r}; {did_you_mean(actuator, by_name)}")
            elif actuator in owner:
                errors.append(f"action {name!r}: the actuator {actuator!r} belongs to action {owner[actuator]!r}")
            else:
                owner[actuator] = name
                members.append(by_name[actuator])
        if len(members) == len(spec.actuators):
            action = _combine(name, members)
            errors += _bound_errors(action, spec.low, spec.high)
            low = action.low if spec.low is None else spec.low
            high = action.high if spec.high is None else spec.high
            actions.append(action.model_copy(update={"low": low, "high": high}))
    return tuple(actions)


def _bound_errors(action: Action, low: float | None, high: float | None) -> list[str]:
    errors = []
    for side, bound in (("low", low), ("high", high)):
        if bound is not None and not contains(action, bound):
            limits = describe_bounds(action)
            errors.append(f"action {action.name!r}: {side} {bound:g} is outside its actuators' {limits}")
    lower, upper = action.low if low is None else low, action.high if high is None else high
    if lower is not None and upper is not None and not lower < upper:
        errors.append(f"action {action.name!r}: its lower bound {lower:g} is not below its upper bound {upper:g}")
    return errors


def _steps(
    actions: Sequence[Action], actuators: Sequence[Actuator], scenario: Scenario, errors: list[str]
) -> tuple[DiscreteAction, ...]:
    """Divide each group of actions into equal steps: heating setpoints upwards, cooling setpoints downwards."""
    assert isinstance(scenario.discrete, int)
    by_name = {a.name: a for a in actuators}
    groups: dict[str, list[Action]] = {}
    for action in actions:
        first = by_name[action.actuators[0]]
        paired = first.component_type == THERMOSTAT and scenario.control != "point"
        group = ("all" if scenario.control == "building" else first.key) if paired else action.name
        groups.setdefault(f"{first.component_type}/{group}", []).append(action)
        if action.low is None or action.high is None:
            errors.append(f"action {action.name!r} has no bounds for equal steps; add bounds or list its choices")
    if errors:
        return ()
    return tuple(_choice(members, by_name, scenario.discrete) for members in groups.values())


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


def _choice_errors(choices: Sequence[DiscreteAction], actions: Sequence[Action], invalid: set[str]) -> list[str]:
    """Return the errors of the choices; actions in `faulty` have errors themselves, and are only known to exist."""
    by_name, errors, seen = {a.name: a for a in actions}, [], list[str]()
    for number, choice in enumerate(choices):
        label = f"discrete.{number}"
        unknown = [name for name in choice.actions if name not in by_name]
        errors += [
            f"{label}: there is no action {n!r}; {did_you_mean(n, by_name)}" for n in unknown if n not in invalid
        ]
        for name in choice.actions:
            if name in seen:
                errors.append(f"{label}: action {name!r} already has choices")
            seen.append(name)
        for index, row in enumerate(choice.values):
            if len(row) != len(choice.actions):
                errors.append(f"{label}: row {index} has {len(row)} values for {len(choice.actions)} actions")
            elif not unknown:
                errors += _row_errors(f"{label}: row {index}", row, [by_name[name] for name in choice.actions])
    missing = [name for name in by_name if name not in seen]
    if missing:
        errors.append(f"discrete: no choices for {', '.join(missing)}")
    return errors


def _row_errors(label: str, row: Sequence[float], actions: Sequence[Action]) -> list[str]:
    return [
        f"{label}: {action.name} = {value:g} is outside {describe_bounds(action)}"
        for value, action in zip(row, actions, strict=True)
        if not contains(action, value)
    ]
