"""A number that moves one value by a step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from gymnasium.spaces import Discrete

from agent_sdk.wrappers.core import Values, View
from agent_sdk.wrappers.increments import Moving, refused
from agent_sdk.wrappers.names import places
from topics.errors import InvalidConfig


class DiscreteIncrementalAction(Moving):
    """`Discrete`: 0 changes nothing; 1 and 2 move the first action of `steps` up and down by its step; and so on.

    The values start from `initial` in each episode and stay within the actions' bounds.

    Args:
        steps: action to its step, in the action's unit.
        initial: the value of every action of the environment at an episode's begin; those without a step keep it.

    Raises:
        InvalidConfig: no such action, an action without initial value, one out of bounds, a step not above 0, or a
            wrapper within that takes actions out of their units. `InvalidAction` at a step: no such number.
    """

    def __init__(self, view: View, steps: Mapping[str, float], initial: Mapping[str, float]) -> None:
        super().__init__(view, initial)
        if missing := [name for name in self.names if name not in initial]:
            raise InvalidConfig(f"{view.who}: initial needs a value of {', '.join(missing)} too")
        moving = places(steps, list(initial), view.who, "action")
        if not steps or not all(0 < step < np.inf for step in steps.values()):
            raise InvalidConfig(f"{view.who}: give at least one action a step, each above 0")
        self._table = np.zeros((1 + 2 * len(steps), len(initial)))
        for row, (at, step) in enumerate(zip(moving, steps.values(), strict=True)):
            self._table[1 + 2 * row, at], self._table[2 + 2 * row, at] = step, -step
        self.action_space = Discrete(len(self._table))
        self.action_names = tuple(steps)

    def act(self, slots: list[int], actions: Values) -> Values:
        """See `Core`."""
        fits = actions.ndim == 1 and np.issubdtype(actions.dtype, np.integer)
        if not fits or not ((actions >= 0) & (actions < len(self._table))).all():
            raise refused(self.view.who, actions if self.view.vector else actions[0], self.action_space)
        told = np.empty((len(slots), len(self.names)), np.float32)
        told[:, self.at] = self.move(slots, self._table[actions])
        return told
