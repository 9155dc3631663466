"""Adapter that turns the commands of a controller into actions of an environment."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, role_of
from zenostat.agent_sdk.controllers.base import (
    ControllerProtocol,
    Finder,
    Planner,
    PlanningController,
    PortableController,
    Values,
)
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidAction, InvalidConfig, did_you_mean
from zenostat.topics.messages import Action, Actuator, DiscreteAction, Manifest
from zenostat.topics.points import bounds, check_command, contains, describe_violation, value_index


class InexpressibleCommands(InvalidAction):
    """Commands that no action of the task can express: the controller does not fit the scenario."""


class Agent:
    """Run a controller over episodes, and return its commands as values or as actions of an environment.

        agent = Agent(RuleBasedController(env.unwrapped.manifest))
        env.reset(seed=0)
        env.step(agent.action(env.unwrapped.sample))

    Args:
        controller: a `Controller`, or anything that has `act(sample)`; its `begin(sample)`, if any, is called at the
            start of each episode.
        planner: the environment that the controller acts in; only a controller that plans, such as `oracle`, needs it.
        semantic: reads the building's semantic model; only a controller that asks it, such as `portable-setback`, needs
            it.

    Raises:
        InvalidConfig: the controller plans, and there is no planner; or it asks the semantic model, and there is none.
    """

    def __init__(
        self,
        controller: ControllerProtocol,
        planner: Planner | None = None,
        semantic: Callable[[], Finder] | None = None,
    ) -> None:
        self.controller, self._planner = controller, planner
        if isinstance(controller, PlanningController):
            if planner is None:
                raise InvalidConfig(
                    f"{type(controller).__name__} plans in branches of an environment, which is not there: use it in "
                    "zenostat evaluate, or as Agent(controller, env.unwrapped)"
                )
            controller.attach(planner)
        if isinstance(controller, PortableController):
            if semantic is None:
                raise ControllerMismatch(
                    f"{type(controller).__name__} asks a node for its semantic model, and commands single points: use "
                    "it in zenostat run"
                )
            controller.use_model(semantic())
        self._episode: int | None = None
        self._commanded: Values = {}

    def seed_episode(self, seed: int) -> None:
        """Let a controller that draws, such as a policy whose observation has forecast errors, draw from a seed.

        Args:
            seed: seed of the next episode.
        """
        if callable(seed_episode := getattr(self.controller, "seed_episode", None)):
            seed_episode(seed)

    def values(self, sample: SampleView) -> Values:
        """Return the commands for a sample by actuator, as `sample.send` accepts them; none if `act` returns None.

        Raises:
            InvalidAction: the controller returned something else than a mapping, or a value that is not finite.
        """
        if sample.step == 0 or sample.episode != self._episode:
            self._episode, self._commanded = sample.episode, {}
            begin = getattr(self.controller, "begin", None)
            if begin is not None:
                begin(sample)
        values, name = self.controller.act(sample), type(self.controller).__name__
        if not isinstance(values, Mapping | None):
            raise InvalidAction(
                f"{name}.act returned {values!r} in step {sample.step}; a mapping of actuators to values expected"
            )
        for actuator, value in (values or {}).items():
            check_command(f"{name}, step {sample.step}: {actuator}", value)
        return values or {}

    def action(self, sample: SampleView) -> Any:
        """Return the commands for a sample as an action; see `action_of`. Unnamed actuators keep their last command.

        What the wrappers of a trained policy set outside the actions is the environment's context.
        """
        values = self.values(sample)  # before the next line: a new episode clears `_commanded`
        set_context = getattr(self._planner, "set_context", None)
        if getattr(self.controller, "sets_context", False) and callable(set_context):
            known = {name for action in sample.manifest.task.actions for name in action.actuators}
            if context := {name: value for name, value in values.items() if name not in known}:
                set_context(context)
                values = {name: value for name, value in values.items() if name in known}
        self._commanded |= values
        return action_of(sample.manifest, self._commanded, sample)


def action_of(manifest: Manifest, values: Mapping[str, float | None], sample: SampleView | None = None) -> Any:
    """Convert values by actuator to an action of the task's space.

    Continuous: float32, shape (actions,). Discrete: the index of the nearest row of each discrete action; an int if
    the task has one discrete action, else int64, shape (discrete actions,). The nearest row minimizes the squared
    distance of the zone setpoints (K²); ties are resolved by the squared distance of the other actions, each scaled
    by its range, then by order. So matching a chilled water temperature never compromises comfort.

    A relative action is the mean offset of its actuators to their values under baseline control, which `sample` has,
    clipped to the action's bounds; 0 if they are relinquished. Values at a bound of their actuator, which may have been
    clipped, do not count; if all are at one, the action is the largest offset. So `values_of` gives the values again.

    Raises:
        InvalidConfig: an action is relative and there is no sample.
        InexpressibleCommands: no action can express the values: an actuator has no value or is relinquished, or belongs
            to no action; actuators of one action have different values; or (continuous) a value is out of bounds.
        InvalidAction: a value is not finite.
    """
    actions = manifest.task.actions
    known = [name for action in actions for name in action.actuators]
    for name in values:
        if name not in known:
            raise InexpressibleCommands(f"no action of the task sets {name!r}; {did_you_mean(name, known)}")
    targets = {
        action.name: _offset(action, values, sample) if action.relative else _value(action, values)
        for action in actions
    }
    if manifest.task.discrete_actions:
        actuators = {a.name: a for a in manifest.actuators}
        setpoints = [a.name for a in actions if role_of(a, actuators[a.actuators[0]]) in SETPOINTS]
        rows = [_nearest_row(choice, targets, setpoints) for choice in manifest.task.discrete_actions]
        return rows[0] if len(rows) == 1 else np.array(rows, np.int64)
    for action in actions:
        if not contains(action, targets[action.name]):
            raise InexpressibleCommands(describe_violation(action, targets[action.name]))
    return np.array([targets[action.name] for action in actions], np.float32)


def _offset(action: Action, values: Mapping[str, float | None], sample: SampleView | None) -> float:
    offsets, inner = [], []
    for actuator, own in _baseline(action, sample):
        value = values.get(actuator.name)
        offsets.append(0.0 if value is None else value - own)
        if value is None or value not in bounds(actuator):
            inner.append(offsets[-1])
    offset = sum(inner) / len(inner) if inner else max(offsets, key=abs)
    if not np.isfinite(offset):
        raise InvalidAction(f"{action.name} = {offset}; expected a finite number")
    low, high = bounds(action)
    return min(max(offset, low), high)


def _baseline(action: Action, sample: SampleView | None) -> list[tuple[Actuator, float]]:
    """Return each actuator of a relative action with its value under baseline control in the next timestep.

    Raises:
        InvalidConfig: there is no sample.
    """
    if sample is None:
        raise InvalidConfig(f"action {action.name!r} is relative to the building's own control; a sample is needed")
    actuators = {a.name: a for a in sample.manifest.actuators}
    points, index = sample.fault_free_values, value_index(sample.manifest)
    members = [actuators[name] for name in action.actuators]
    return [(actuator, float(points[index[str(actuator.baseline_sensor)]])) for actuator in members]


def _value(action: Action, values: Mapping[str, float | None]) -> float:
    distinct = {values.get(name) for name in action.actuators}
    if distinct == {None}:
        raise InexpressibleCommands(
            f"the controller leaves {action.name!r} to baseline control, but an action always sets a value; if it "
            "never sets one, remove it from the scenario's actuators (without any actuator, all is under baseline "
            "control); if it does at times, use relative actions, or compare recordings of `zenostat run`"
        )
    if len(distinct) > 1:
        differing = ", ".join(f"{name} = {values.get(name)}" for name in action.actuators[:5])
        raise InexpressibleCommands(
            f"the action {action.name!r} sets one value for all its actuators, but got {differing}"
        )
    value = distinct.pop()
    if value is None or not np.isfinite(value):
        raise InvalidAction(f"{action.name} = {value}; expected a finite number")
    return float(value)


def _nearest_row(choice: DiscreteAction, targets: Mapping[str, float], setpoints: Collection[str]) -> int:
    rows = np.array(choice.values, np.float64)
    span = np.ptp(rows, axis=0)
    distance = (rows - np.array([targets[name] for name in choice.actions])) ** 2
    is_setpoint = np.array([name in setpoints for name in choice.actions])
    comfort = distance[:, is_setpoint].sum(axis=1).round(9)
    others = (distance / np.where(span > 0.0, span, 1.0) ** 2)[:, ~is_setpoint].sum(axis=1)
    return int(np.lexsort((others, comfort))[0])


def values_of(manifest: Manifest, action: Any, sample: SampleView | None = None) -> Values:
    """Convert an action of the task's space to values by actuator; the inverse of `action_of`."""
    numbers = np.atleast_1d(np.asarray(action))
    by_action: dict[str, float] = {}
    if manifest.task.discrete_actions:
        for choice, index in zip(manifest.task.discrete_actions, numbers.tolist(), strict=True):
            by_action |= dict(zip(choice.actions, choice.values[int(index)], strict=True))
    else:
        by_action = dict(zip((entry.name for entry in manifest.task.actions), numbers.tolist(), strict=True))
    values: Values = {}
    for entry in manifest.task.actions:
        low, high = bounds(entry)
        number = min(max(by_action[entry.name], low), high)
        values |= at_offset(entry, number, sample) if entry.relative else dict.fromkeys(entry.actuators, number)
    return values


def at_offset(action: Action, offset: float, sample: SampleView | None) -> Values:
    """Return the values of a relative action's actuators; None for an offset of 0."""
    if not offset:
        return dict.fromkeys(action.actuators)
    values: Values = {}
    for actuator, own in _baseline(action, sample):
        low, high = bounds(actuator)
        values[actuator.name] = min(max(own + offset, low), high)
    return values
