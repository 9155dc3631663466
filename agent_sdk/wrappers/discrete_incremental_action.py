"""A wrapper whose discrete actions change one value by one step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium.spaces import Discrete

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, Values
from agent_sdk.wrappers.incremental import IncrementalLogic, invalid_action
from agent_sdk.wrappers.names import indices_of
from topics.errors import InvalidConfig


class _Logic(IncrementalLogic):
    def __init__(
        self, view: EnvView, steps: Mapping[str, float | Sequence[float]], initial: Mapping[str, float]
    ) -> None:
        super().__init__(view, initial)
        if missing := [name for name in self.names if name not in initial]:
            raise InvalidConfig(f"{view.wrapper_name}: initial also needs a value for {', '.join(missing)}")
        indices = indices_of(steps, list(initial), view.wrapper_name, "action")
        if not steps:
            raise InvalidConfig(f"{view.wrapper_name}: steps has to name at least one action")
        rows = [np.zeros(len(initial))]
        for index, (name, value) in zip(indices, steps.items(), strict=True):
            sizes = _sizes(value, f"{view.wrapper_name}: {name}")
            for size in (*sizes, *(-size for size in sizes)):
                rows.append(np.zeros(len(initial)))
                rows[-1][index] = size
        self._table = np.array(rows)
        self.action_space = Discrete(len(self._table))
        self.action_names = tuple(steps)

    def act(self, slots: list[int], actions: Values) -> Values:
        is_valid = actions.ndim == 1 and np.issubdtype(actions.dtype, np.integer)
        if not is_valid or not ((actions >= 0) & (actions < len(self._table))).all():
            raise invalid_action(self.view.wrapper_name, actions if self.view.vector else actions[0], self.action_space)
        inner = np.empty((len(slots), len(self.names)), np.float32)
        inner[:, self.indices] = self.move(slots, self._table[actions])
        return inner


def _sizes(value: float | Sequence[float], label: str) -> list[float]:
    try:
        sizes = [float(size) for size in (value if isinstance(value, Sequence | np.ndarray) else [value])]
    except (TypeError, ValueError):
        sizes = []
    if not sizes or not all(0 < size < np.inf for size in sizes) or len(set(sizes)) < len(sizes):
        raise InvalidConfig(f"{label}: a step above 0, or several different ones, expected; got {value!r}")
    return sizes


class DiscreteIncrementalAction(BuildingWrapper):
    """Take discrete actions: 0 changes nothing, each other number changes one action by one step.

    The numbers from 1 on increase the first action of `steps` by each of its steps, then decrease it by each; the
    numbers of the other actions follow. The values start at `initial` in each episode and stay within the actions'
    bounds.

    Args:
        steps: the step or steps by action, in the action's unit: with `[0.5, 1.0, 1.5, 2.0]` for each of two setpoints
            there are 17 choices.
        initial: the value of every action of the environment at an episode's start; those without a step keep it.

    Raises:
        InvalidConfig: there is no such action, an initial value is missing or out of bounds, a step is not above 0 or
            listed twice, or an inner wrapper changes the units of actions. `InvalidAction` at a step: there is no such
            choice.
    """

    logic = _Logic
