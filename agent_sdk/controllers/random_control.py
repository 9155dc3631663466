"""Controller with random values."""

from __future__ import annotations

import numpy as np

from zenostat.agent_sdk.controllers.agent import at_offset
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest


class RandomController(Controller):
    """Draw each action uniformly within its bounds, and each discrete action uniformly from its choices.

    All actuators of an action get the same value. Heating and cooling setpoints cannot cross if their bounds do not
    overlap, as is the case for bounds derived from a model.

    Args:
        manifest: manifest of the node.
        seed: seed of the sequence, which continues from one episode to the next.

    Raises:
        InvalidConfig: an action has neither bounds nor discrete choices.
    """

    def __init__(self, manifest: Manifest, *, seed: int | None = None) -> None:
        super().__init__(manifest)
        if seed is not None and (not isinstance(seed, int) or seed < 0):
            raise InvalidConfig(f"seed = {seed!r}; expected an integer of at least 0")
        self._random = np.random.default_rng(seed)
        discrete = {name for choice in manifest.task.discrete_actions for name in choice.actions}
        continuous = [action for action in manifest.task.actions if action.name not in discrete]
        for action in continuous:
            if action.low is None or action.high is None:
                raise ControllerMismatch(f"{action.name!r} has no bounds to draw from: add bounds in the scenario")
        self._ranges = [(action.name, action.low, action.high) for action in continuous]

    def act(self, sample: SampleView) -> Values:
        """Return the next values of the sequence."""
        drawn: dict[str, float] = {}
        for choice in self.manifest.task.discrete_actions:
            row = choice.values[self._random.integers(len(choice.values))]
            drawn.update(zip(choice.actions, row, strict=True))
        for name, low, high in self._ranges:
            assert low is not None
            assert high is not None
            drawn[name] = float(self._random.uniform(low, high))
        values: Values = {}
        for action in self.manifest.task.actions:
            value = drawn[action.name]
            values |= at_offset(action, value, sample) if action.relative else dict.fromkeys(action.actuators, value)
        return values
