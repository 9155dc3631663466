"""A number that moves one value by one of its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium.spaces import Discrete

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, Values
from agent_sdk.wrappers.incremental import IncrementalLogic, refused
from agent_sdk.wrappers.names import places
from topics.errors import InvalidConfig


class _Logic(IncrementalLogic):
    def __init__(
        self, view: EnvView, steps: Mapping[str, float | Sequence[float]], initial: Mapping[str, float]
    ) -> None:
        super().__init__(view, initial)
        if missing := [name for name in self.names if name not in initial]:
            raise InvalidConfig(f"{view.who}: initial needs a value of {', '.join(missing)} too")
        moving = places(steps, list(initial), view.who, "action")
        if not steps:
            raise InvalidConfig(f"{view.who}: give at least one action a step")
        rows = [np.zeros(len(initial))]
        for at, (name, given) in zip(moving, steps.items(), strict=True):
            sizes = _sizes(given, f"{view.who}: {name}")
            for size in (*sizes, *(-size for size in sizes)):
                rows.append(np.zeros(len(initial)))
                rows[-1][at] = size
        self._table = np.array(rows)
        self.action_space = Discrete(len(self._table))
        self.action_names = tuple(steps)

    def act(self, slots: list[int], actions: Values) -> Values:
        """See `WrapperLogic`."""
        fits = actions.ndim == 1 and np.issubdtype(actions.dtype, np.integer)
        if not fits or not ((actions >= 0) & (actions < len(self._table))).all():
            raise refused(self.view.who, actions if self.view.vector else actions[0], self.action_space)
        told = np.empty((len(slots), len(self.names)), np.float32)
        told[:, self.at] = self.move(slots, self._table[actions])
        return told


def _sizes(given: float | Sequence[float], who: str) -> list[float]:
    try:
        sizes = [float(size) for size in (given if isinstance(given, Sequence | np.ndarray) else [given])]
    except (TypeError, ValueError):
        sizes = []
    if not sizes or not all(0 < size < np.inf for size in sizes) or len(set(sizes)) < len(sizes):
        raise InvalidConfig(f"{who}: {given!r}; a step above 0, or several different ones, expected")
    return sizes


class DiscreteIncrementalAction(BuildingWrapper):
    """`DiscreteSpec`: 0 changes nothing, all other numbers move one action by a step.

    The numbers from 1 on move the first action of `steps` up by each of its steps, then down by each; then come those
    of the other actions. The values start from `initial` in each episode and stay within the actions' bounds.

    Args:
        steps: action to its step, or to several, in the action's unit: with `[0.5, 1.0, 1.5, 2.0]` for each of two
            setpoints there are 17 choices.
        initial: the value of every action of the environment at an episode's begin; those without a step keep it.

    Raises:
        InvalidConfig: no such action, an action without initial value, one out of bounds, a step not above 0 or given
            twice, or a wrapper within that takes actions out of their units. `InvalidAction` at a step: no such number.
    """

    logic = _Logic
