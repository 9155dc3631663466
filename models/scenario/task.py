"""What an agent decides: the dimensions of its action, each with its actuators, and its discrete choices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np

from models.points.selection import THERMOSTAT, Points
from models.scenario.schema import Scenario
from topics.errors import InvalidConfig, did_you_mean
from topics.keys import check_name, safe_name
from topics.messages import Action, Actuator, DiscreteAction, Task, TerminationLimit
from topics.units import with_unit

T = TypeVar("T")


def task_of(scenario: Scenario, points: Points) -> Task:
    """The task that a scenario sets on these points.

    Raises:
        InvalidConfig: actions of unknown actuators, bounds that cannot be, choices that leave the action's bounds;
            all faults at once.
    """
    faults: list[str] = []
    if scenario.actions is None:
        actions = _found(scenario, points.actuators, faults)
    else:
        actions = _named(scenario, points.actuators, faults)
    choices: tuple[DiscreteAction, ...] = ()
    if isinstance(scenario.discrete, int) and not faults:
        choices = _steps(actions, points.actuators, scenario, faults)
    elif isinstance(scenario.discrete, tuple):
        choices = tuple(DiscreteAction(actions=c.actions, values=c.values) for c in scenario.discrete)
        faulty = set(scenario.actions or ()) - {a.name for a in actions}
        faults += _choice_faults(choices, actions, faulty)
    names = [sensor.name for sensor in points.sensors] + [meter.name for meter in points.meters]
    for number, limit in enumerate(scenario.terminate):
        for name in limit.points:
            if name not in names:
                faults.append(f"terminate.{number}: there is no sensor or meter {name!r}; {did_you_mean(name, names)}")
    if faults:
        raise InvalidConfig("\n".join(faults))
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


def _found(scenario: Scenario, actuators: Sequence[Actuator], faults: list[str]) -> tuple[Action, ...]:
    """An action for each actuator; with `control: building` one for each kind of thermostat setpoint."""
    if scenario.control != "building":
        return tuple(_joined(a.name, [a]) for a in actuators)
    kinds: dict[str, list[Actuator]] = {}
    for actuator in actuators:
        if actuator.component_type == THERMOSTAT:
            kinds.setdefault(safe_name(actuator.control_type), []).append(actuator)
    for actuator in actuators:
        if actuator.component_type != THERMOSTAT and actuator.name in kinds:
            faults.append(f"actuator {actuator.name!r} is called as all thermostats together are; name it otherwise")
        elif actuator.component_type != THERMOSTAT:
            kinds[actuator.name] = [actuator]
    actions = tuple(_joined(name, members) for name, members in kinds.items())
    for action in actions:
        faults += _bound_faults(action, None, None)
    return actions


def _joined(name: str, members: Sequence[Actuator]) -> Action:
    lows, highs = _known(a.low for a in members), _known(a.high for a in members)
    low, high = max(lows) if lows else None, min(highs) if highs else None
    return Action(name=name, unit=members[0].unit, low=low, high=high, actuators=tuple(a.name for a in members))


def _known(values: Iterable[T | None]) -> list[T]:
    return [value for value in values if value is not None]


def _named(scenario: Scenario, actuators: Sequence[Actuator], faults: list[str]) -> tuple[Action, ...]:
    by_name, taken = {a.name: a for a in actuators}, dict[str, str]()
    actions = []
    for name, spec in (scenario.actions or {}).items():
        try:
            check_name(name, "the action's name")
        except InvalidConfig as fault:
            faults.append(str(fault))
            continue
        members = []
        for actuator in spec.actuators:
            if actuator not in by_name:
                faults.append(f"action {name!r}: there is no actuator {actuator!r}; {did_you_mean(actuator, by_name)}")
            elif actuator in taken:
                faults.append(f"action {name!r}: the actuator {actuator!r} belongs to action {taken[actuator]!r}")
            else:
                taken[actuator] = name
                members.append(by_name[actuator])
        if len(members) == len(spec.actuators):
            action = _joined(name, members)
            faults += _bound_faults(action, spec.low, spec.high)
            low, high = (
                own if said is None else said for own, said in ((action.low, spec.low), (action.high, spec.high))
            )
            actions.append(action.model_copy(update={"low": low, "high": high}))
    return tuple(actions)


def _bound_faults(action: Action, low: float | None, high: float | None) -> list[str]:
    faults = []
    for what, said in (("low", low), ("high", high)):
        if said is not None and not _inside(said, action):
            faults.append(f"action {action.name!r}: {what} {said:g} is outside its actuators' {_range(action)}")
    least, most = action.low if low is None else low, action.high if high is None else high
    if least is not None and most is not None and not least < most:
        faults.append(f"action {action.name!r}: its lower bound {least:g} is not below its upper bound {most:g}")
    return faults


def _inside(value: float, action: Action) -> bool:
    return (action.low is None or value >= action.low) and (action.high is None or value <= action.high)


def _range(action: Action) -> str:
    low = "-inf" if action.low is None else f"{action.low:g}"
    high = "inf" if action.high is None else f"{action.high:g}"
    return with_unit(f"{low} to {high}", action.unit)


def _steps(
    actions: Sequence[Action], actuators: Sequence[Actuator], scenario: Scenario, faults: list[str]
) -> tuple[DiscreteAction, ...]:
    """Equal steps over each group of actions: heating setpoints upwards, cooling setpoints downwards."""
    assert isinstance(scenario.discrete, int)
    by_name = {a.name: a for a in actuators}
    groups: dict[str, list[Action]] = {}
    for action in actions:
        first = by_name[action.actuators[0]]
        paired = first.component_type == THERMOSTAT and scenario.control != "point"
        group = ("all" if scenario.control == "building" else first.key) if paired else action.name
        groups.setdefault(f"{first.component_type}/{group}", []).append(action)
        if action.low is None or action.high is None:
            faults.append(f"action {action.name!r} has no bounds to step between; give it some, or name its choices")
    if faults:
        return ()
    return tuple(_choice(members, by_name, scenario.discrete) for members in groups.values())


def _choice(members: Sequence[Action], by_name: dict[str, Actuator], count: int) -> DiscreteAction:
    columns = []
    for action in members:
        assert action.low is not None
        assert action.high is not None
        steps = np.linspace(action.low, action.high, count)
        downwards = by_name[action.actuators[0]].control_type == "Cooling Setpoint"
        columns.append(steps[::-1] if downwards else steps)
    rows = tuple(tuple(row) for row in np.column_stack(columns).tolist())
    return DiscreteAction(actions=tuple(a.name for a in members), values=rows)


def _choice_faults(choices: Sequence[DiscreteAction], actions: Sequence[Action], faulty: set[str]) -> list[str]:
    """What is wrong with choices; of `faulty` actions nothing is known but that they are there."""
    by_name, faults, seen = {a.name: a for a in actions}, [], list[str]()
    for number, choice in enumerate(choices):
        where = f"discrete.{number}"
        unknown = [name for name in choice.actions if name not in by_name]
        faults += [f"{where}: there is no action {n!r}; {did_you_mean(n, by_name)}" for n in unknown if n not in faulty]
        for name in choice.actions:
            if name in seen:
                faults.append(f"{where}: action {name!r} has its choices already")
            seen.append(name)
        for index, row in enumerate(choice.values):
            if len(row) != len(choice.actions):
                faults.append(f"{where}: row {index} has {len(row)} values for {len(choice.actions)} actions")
            elif not unknown:
                faults += _row_faults(f"{where}: row {index}", row, [by_name[name] for name in choice.actions])
    missing = [name for name in by_name if name not in seen]
    if missing:
        faults.append(f"discrete: no choices for {', '.join(missing)}")
    return faults


def _row_faults(where: str, row: Sequence[float], actions: Sequence[Action]) -> list[str]:
    return [
        f"{where}: {action.name} = {value:g} is outside {_range(action)}"
        for value, action in zip(row, actions, strict=True)
        if not _inside(value, action)
    ]
