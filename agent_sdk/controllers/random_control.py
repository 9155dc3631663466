"""A controller that draws."""

from __future__ import annotations

import numpy as np

from agent_sdk.bus.sample import SampleView
from agent_sdk.controllers.base import Controller, Values
from agent_sdk.controllers.parameters import ControllerMismatch
from topics.errors import InvalidConfig
from topics.messages import Manifest


class RandomController(Controller):
    """Draws each action uniformly from its bounds, or one of the task's choices where it has some.

    Heating and cooling setpoints cannot cross as long as their bounds meet, as those found in a model do. All
    actuators of an action get the same value.

    Args:
        manifest: of the node.
        seed: the same seed, the same values; the sequence goes on from one episode to the next.

    Raises:
        InvalidConfig: an action without bounds or choices.
    """

    def __init__(self, manifest: Manifest, *, seed: int | None = None) -> None:
        super().__init__(manifest)
        if seed is not None and (not isinstance(seed, int) or seed < 0):
            raise InvalidConfig(f"seed = {seed!r}; a whole number of at least 0 expected")
        self._random = np.random.default_rng(seed)
        chosen = {name for choice in manifest.task.discrete_actions for name in choice.actions}
        drawn = [action for action in manifest.task.actions if action.name not in chosen]
        for action in drawn:
            if action.low is None or action.high is None:
                raise ControllerMismatch(
                    f"nothing can be drawn for {action.name!r}: give the action bounds in the scenario"
                )
        self._actuators = {action.name: action.actuators for action in manifest.task.actions}
        self._ranges = [(action.name, action.low, action.high) for action in drawn]

    def act(self, sample: SampleView) -> Values:  # noqa: ARG002
        """The next values of the sequence."""
        drawn: dict[str, float] = {}
        for choice in self.manifest.task.discrete_actions:
            row = choice.values[self._random.integers(len(choice.values))]
            drawn.update(zip(choice.actions, row, strict=True))
        for name, low, high in self._ranges:
            assert low is not None
            assert high is not None
            drawn[name] = float(self._random.uniform(low, high))
        return {actuator: value for name, value in drawn.items() for actuator in self._actuators[name]}
