"""A controller as an agent: its answers as the actions of an environment."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.action_roles import SETPOINTS, role_of
from agent_sdk.controllers.base import ControllerProtocol, Values
from agent_sdk.controllers.parameters import bounds
from topics.errors import InvalidAction, did_you_mean
from topics.messages import Action, DiscreteAction, Manifest
from topics.units import with_unit


class Agent:
    """Drives a controller through episodes: begins it at each, and gives its answers as values or as actions.

        agent = Agent(RuleBasedController(env.unwrapped.manifest))
        env.reset(seed=0)
        env.step(agent.action(env.unwrapped.sample))

    Args:
        controller: a `Controller`, or anything that has `act(sample)`; `begin(sample)` is called where it has one.
    """

    def __init__(self, controller: ControllerProtocol) -> None:
        self.controller = controller
        self._episode: int | None = None
        self._held: Values = {}

    def values(self, sample: SampleView) -> Values:
        """The answer to a sample, by actuator; `sample.send` takes it."""
        if sample.step == 0 or sample.episode != self._episode:
            self._episode, self._held = sample.episode, {}
            begin = getattr(self.controller, "begin", None)
            if begin is not None:
                begin(sample)
        return self.controller.act(sample)

    def action(self, sample: SampleView) -> Any:
        """The answer to a sample as an action; see `action_of`. What it does not name stays as it was."""
        answer = self.values(sample)  # which may begin an episode, and with it a new `_held`
        self._held |= answer
        return action_of(sample.manifest, self._held)


def action_of(manifest: Manifest, values: Mapping[str, float | None]) -> Any:
    """Values by actuator as an action of the task's space.

    Continuous: float32, shape (actions,). Discrete: for each of the task's choices the row that is nearest; an int
    where the task has one dimension of choices, else int64, shape (choices,). Nearest are the rows whose room
    setpoints are (squares of K, summed); among equals that whose other actions are, each measured in the range of
    its rows; and the first of those. So a data centre's chilled water never costs it its comfort.

    Raises:
        InvalidAction: what no action can say: an actuator without a value or released, one that is in no action,
            actuators of one action with different values, or (continuous) a value out of bounds.
    """
    actions = manifest.task.actions
    known = [name for action in actions for name in action.actuators]
    for name in values:
        if name not in known:
            raise InvalidAction(
                f"no action sets {name!r}, so an action cannot say its value; {did_you_mean(name, known)}"
            )
    wanted = {action.name: _value(action, values) for action in actions}
    if manifest.task.discrete_actions:
        actuators = {a.name: a for a in manifest.actuators}
        rooms = [a.name for a in actions if role_of(a, actuators[a.actuators[0]]) in SETPOINTS]
        picked = [_nearest(choice, wanted, rooms) for choice in manifest.task.discrete_actions]
        return picked[0] if len(picked) == 1 else np.array(picked, np.int64)
    for action in actions:
        low, high = bounds(action)
        if not low <= wanted[action.name] <= high:
            limits = with_unit(f"{low:g} to {high:g}", action.unit)
            raise InvalidAction(f"{action.name} = {wanted[action.name]:g}; its bounds are {limits}")
    return np.array([wanted[action.name] for action in actions], np.float32)


def _value(action: Action, values: Mapping[str, float | None]) -> float:
    found = {values.get(name) for name in action.actuators}
    if found == {None}:
        raise InvalidAction(
            f"the controller leaves {action.name!r} to the building, and an action sets it always; leave it out of the "
            f"scenario's actuators (none at all are the building's own control)"
        )
    if len(found) > 1:
        said = ", ".join(f"{name} = {values.get(name)}" for name in action.actuators[:5])
        raise InvalidAction(f"the action {action.name!r} sets its actuators to one value, and here they differ: {said}")
    value = found.pop()
    if value is None or not np.isfinite(value):
        raise InvalidAction(f"{action.name} = {value}; a finite number expected")
    return float(value)


def _nearest(choice: DiscreteAction, wanted: Mapping[str, float], rooms: Collection[str]) -> int:
    rows = np.array(choice.values, np.float64)
    span = np.ptp(rows, axis=0)
    away = (rows - np.array([wanted[name] for name in choice.actions])) ** 2
    first = np.array([name in rooms for name in choice.actions])
    comfort = away[:, first].sum(axis=1).round(9)
    rest = (away / np.where(span > 0.0, span, 1.0) ** 2)[:, ~first].sum(axis=1)
    return int(np.lexsort((rest, comfort))[0])
