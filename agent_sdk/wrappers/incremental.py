"""Wrappers whose actions change values within bounds instead of setting them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray
from typing_extensions import override

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.gymnasium_wrappers import Trait, wrappers_with
from zenostat.agent_sdk.wrappers.names import indices_of, reject_wrappers, require_mapping
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidAction, InvalidConfig

NOT_IN_UNITS = (*wrappers_with(Trait.ACTION_UNITS), "IncrementalAction", "DiscreteIncrementalAction")
"""Wrappers whose actions are not the values of the wrapped environment's actions."""


def incremented(values: Floats, increments: Floats, low: Floats, high: Floats) -> Floats:
    """Return the values after increments, clipped to their bounds, shapes (…, n)."""
    return np.clip(values + increments, low, high)


def rounded(increments: Floats, steps: Floats, max_increments: Floats) -> Floats:
    """Round increments to the nearest multiple of their step, half to even; a step of 0 leaves them unchanged."""
    divisors = np.where(steps > 0, steps, 1.0)
    largest = np.floor(max_increments / divisors + 1e-9)
    return np.where(steps > 0, np.clip(np.round(increments / divisors), -largest, largest) * divisors, increments)


class _IncrementalLogic(WrapperLogic):
    """Base of the incremental wrappers: named actions have values, which are `initial` at each episode's start."""

    def __init__(self, view: EnvView, initial: Mapping[str, float]) -> None:
        super().__init__(view)
        reject_wrappers(
            view.env, NOT_IN_UNITS, view.wrapper_name + " changes values in their units; apply it before {}"
        )
        require_mapping(initial, f"{view.wrapper_name}: initial", "{action: value}")
        names = view.action_names
        if not isinstance(view.action_space, Box) or view.action_space.shape != (len(names),):
            raise InvalidConfig(
                f"{view.wrapper_name} needs a value for each of {', '.join(names)}, not {view.action_space}"
            )
        self.inner: Box[Any] = view.action_space
        self.names = names
        self.indices = indices_of(initial, names, view.wrapper_name, "action")
        self.low, self.high = (bound[self.indices].astype(np.float64) for bound in (self.inner.low, self.inner.high))
        for name, value in initial.items():
            if not isinstance(value, Real):
                raise InvalidConfig(f"{view.wrapper_name}: initial: {name}: a number expected, got {value!r}")
        self._initial = np.array(list(initial.values()), np.float64)
        self._check(initial)
        self._values = np.tile(self._initial, (view.slots, 1))
        self._moved = self._values.copy()

    def _check(self, initial: Mapping[str, float]) -> None:
        inside = (self._initial >= self.low) & (self._initial <= self.high)
        errors = [
            f"{self.view.wrapper_name}: {name} starts at {value:g}, outside its bounds {low:g} to {high:g}"
            for (name, value), low, high, is_inside in zip(initial.items(), self.low, self.high, inside, strict=True)
            if not is_inside
        ]
        if errors:
            raise InvalidConfig("\n".join(errors))

    @override
    def start(self, start: ResetBatch) -> Values:
        self._values[start.slots] = self._initial
        return start.observations

    def move(self, slots: list[int], increments: Floats) -> NDArray[np.float32]:
        """Return the values after the increments, shape (rows, named actions); `step` keeps them."""
        moved = self._moved[slots] = incremented(self._values[slots], increments, self.low, self.high)
        # Clip after the conversion to float32: rounding may exceed a bound that is not a float32.
        return np.clip(moved.astype(np.float32), self.inner.low[self.indices], self.inner.high[self.indices])

    @override
    def step(self, step: StepBatch) -> tuple[Values, Values]:
        self._values[step.slots] = self._moved[step.slots]
        return step.observations, step.rewards

    @override
    def get_state(self) -> list[dict[str, Any]]:
        return [{"values": row} for row in self._values.tolist()]

    @override
    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        rows = np.array([state["values"] for state in slots], np.float64)
        self._values[:] = rows.reshape(self._values.shape)


def _invalid_action(wrapper_name: str, action: Any, expected: Any) -> InvalidAction:
    """Return the error for an action outside the wrapper's space."""
    return InvalidAction(f"{wrapper_name}: action {np.asarray(action).tolist()} is not in {expected}")


class _IncrementalActionLogic(_IncrementalLogic):
    def __init__(
        self, view: EnvView, increments: Mapping[str, float | Sequence[float]], initial: Mapping[str, float]
    ) -> None:
        require_mapping(increments, f"{view.wrapper_name}: increments", "{action: largest increment}")
        require_mapping(initial, f"{view.wrapper_name}: initial", "{action: value}")
        if set(increments) != set(initial):
            raise InvalidConfig(f"{view.wrapper_name}: increments and initial have to name the same actions")
        indices_of(increments, view.action_names, view.wrapper_name, "action")
        super().__init__(view, {name: initial[name] for name in increments})
        pairs = [_increment_and_step(value, f"{view.wrapper_name}: {name}") for name, value in increments.items()]
        self._max, self._steps = np.array(pairs).reshape(-1, 2).T
        low, high = self.inner.low.astype(np.float32), self.inner.high.astype(np.float32)
        low[self.indices], high[self.indices] = -self._max, self._max
        self._space = self.action_space = Box(low, high, dtype=np.float32)
        self.action_names = self.names

    def act(self, slots: list[int], actions: Values) -> Values:
        inner = actions.astype(np.float32)
        low, high = self._space.low, self._space.high
        if inner.shape[1:] != low.shape or not ((inner >= low) & (inner <= high) & np.isfinite(inner)).all():
            raise _invalid_action(self.view.wrapper_name, actions if self.view.vector else actions[0], self._space)
        inner[:, self.indices] = self.move(
            slots, rounded(inner[:, self.indices].astype(np.float64), self._steps, self._max)
        )
        return inner


def _increment_and_step(value: Any, label: str) -> tuple[float, float]:
    try:
        increment, step = value if isinstance(value, Sequence) else (value, 0.0)
        is_valid = 0 < increment < np.inf and 0 <= step <= increment
    except (TypeError, ValueError):
        is_valid = False
    if not is_valid:
        raise InvalidConfig(
            f"{label}: got {value!r}; the largest increment has to be above 0 and its step not above the increment"
        )
    return float(increment), float(step)


class IncrementalAction(BuildingWrapper):
    """Take named actions as increments of their previous values, in the action's unit; other actions are unchanged.

    The values start at `initial` in each episode and stay within the actions' bounds.

    Args:
        increments: the largest increment by action, or (largest increment, step), in which case increments are rounded
            to the nearest multiple of the step, half to even.
        initial: the value of each of these actions at an episode's start.

    Raises:
        InvalidConfig: there is no such action, an initial value is missing or out of bounds, or an inner wrapper
            changes the units of actions. `InvalidAction` at a step: the action is not in the space; nothing was
            simulated.
    """

    logic = _IncrementalActionLogic


class _DiscreteIncrementalActionLogic(_IncrementalLogic):
    def __init__(
        self, view: EnvView, steps: Mapping[str, float | Sequence[float]], initial: Mapping[str, float]
    ) -> None:
        require_mapping(steps, f"{view.wrapper_name}: steps", "{action: step or steps}")
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
        if actions.shape == (1, 1) and not self.view.vector:  # one number, as an environment of discrete actions takes
            actions = actions[0]
        is_valid = actions.ndim == 1 and np.issubdtype(actions.dtype, np.integer)
        if not is_valid or not ((actions >= 0) & (actions < len(self._table))).all():
            raise _invalid_action(
                self.view.wrapper_name, actions if self.view.vector else actions[0], self.action_space
            )
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

    logic = _DiscreteIncrementalActionLogic
