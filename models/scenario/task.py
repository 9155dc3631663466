"""Build an agent's task: the dimensions of its action, each with its actuators, and its discrete choices."""

from __future__ import annotations

from collections.abc import Sequence

from zenostat.models.points.selection import Points
from zenostat.models.scenario.schema import Scenario
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Action, Actuator, DiscreteAction, Task, TerminationLimit
from zenostat.topics.points import PointIndex, contains, describe_bounds
from zenostat.topics.task_actions import default_actions, equal_steps, named_actions


def task_of(scenario: Scenario, points: Points) -> Task:
    """Return the task of a scenario for these points.

    Raises:
        InvalidConfig: unknown actuators, invalid bounds, or choices outside the action's bounds; lists all errors.
    """
    errors: list[str] = []
    actions = _relative(scenario, _actions(scenario, points.actuators, errors), errors)
    choices: tuple[DiscreteAction, ...] = ()
    if isinstance(scenario.discrete, int) and not errors:
        choices = equal_steps(actions, points.actuators, scenario.control, scenario.discrete, errors)
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
        return default_actions(actuators, scenario.control, errors)
    bounds = {name: (spec.low, spec.high) for name, spec in scenario.actions.items()}
    return named_actions({name: spec.actuators for name, spec in scenario.actions.items()}, actuators, errors, bounds)


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


def _choice_errors(choices: Sequence[DiscreteAction], actions: Sequence[Action], invalid: set[str]) -> list[str]:
    """Return the errors of the choices; actions in `invalid` have errors themselves, and are only known to exist."""
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
