"""From an agent's action to a value for each actuator, checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import isfinite
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent_sdk.envs import spaces
from topics.errors import InvalidAction, did_you_mean
from topics.messages import Action, CommandOp, DiscreteAction, Manifest
from topics.units import with_unit

_FEW = 8


class Actions:
    """The actions of a node's task.

    Attributes:
        space: `Box`, float32, shape (actions,), or `DiscreteSpec`, or `MultiDiscrete`.
        operations: what a command does to each actuator, raw; None if they set all.
    """

    def __init__(self, manifest: Manifest) -> None:
        task = manifest.task
        self.space = spaces.action_space(manifest)
        self._actions = task.actions
        self._choices = [_Table(choice, task.actions) for choice in task.discrete_actions]
        self._low = np.array([-np.inf if a.low is None else a.low for a in task.actions])
        self._high = np.array([np.inf if a.high is None else a.high for a in task.actions])
        if isinstance(self.space, spaces.Floats):
            low, high = np.minimum(self.space.low, self._low), np.maximum(self.space.high, self._high)
            self._least, self._most = low - _slack(low), high + _slack(high)
        action_of = {name: i for i, action in enumerate(task.actions) for name in action.actuators}
        # What an action is compared with number by number, if they are few: that takes less time than arrays do.
        self._floor, self._ceiling = _finite(self._low), _finite(self._high)
        self._bounds = list(zip(self._floor.tolist(), self._ceiling.tolist(), strict=True))
        self._few = len(self._bounds) <= _FEW
        self._fan = np.array([action_of.get(a.name, 0) for a in manifest.actuators], np.intp)
        self._one_each = self._fan.tolist() == list(range(len(task.actions)))
        left = [a.name for a in manifest.actuators if a.name not in action_of]
        self._actuators, self._left = manifest.actuators, left
        kept = [CommandOp.KEEP if a.name in left else CommandOp.SET for a in manifest.actuators]
        self.operations = bytes(kept) if left else None

    @property
    def names(self) -> list[str]:
        """Names of the actions, in order."""
        return [action.name for action in self._actions]

    def values(self, action: ArrayLike) -> NDArray[np.float64]:
        """A value for each actuator, shape (actuators,), in manifest order and units.

        Raises:
            InvalidAction: a wrong shape, out of bounds, not finite, or no such choice.
        """
        chosen = self._chosen(action) if self._choices else self._checked(action)
        if self._one_each:
            return chosen
        return chosen[self._fan] if len(self._actions) else np.zeros(len(self._fan))

    def commanded(self, values: NDArray[np.float64], operations: bytes | None) -> NDArray[np.float64]:
        """The values of a command as an info has them: NaN for actuators that it does not set; shape as `values`."""
        if operations is None:
            return values
        return np.where(np.frombuffer(operations, np.uint8).reshape(values.shape) == CommandOp.SET, values, np.nan)

    def rows(self, actions: ArrayLike, slots: int, unread: Collection[int] = ()) -> NDArray[np.float64]:
        """The same of several slots at once: shape (slots, actuators).

        Args:
            actions: as the batched space has them; shape (slots, actions), or (slots,) of one discrete choice.
            slots: how many.
            unread: slots whose actions nobody reads, whatever they are; zeros.

        Raises:
            InvalidAction: as `values` does; the text names the slot.
        """
        chosen = self._chosen_rows(actions, slots, unread) if self._choices else self._checked(actions, slots, unread)
        if not self._one_each:
            chosen = chosen[:, self._fan] if len(self._actions) else np.zeros((slots, len(self._fan)))
        if unread:
            chosen[list(unread)] = 0.0
        return chosen

    def context(self, values: Mapping[str, float | None]) -> dict[int, float | None]:
        """By position, values of actuators that are in no action.

        Raises:
            InvalidAction: an unknown actuator, one that an action sets, or a value out of its bounds or not finite.
        """
        found: dict[int, float | None] = {}
        for name, value in values.items():
            if name not in self._left:
                raise InvalidAction(f"{name!r} is no actuator beside the actions; {did_you_mean(name, self._left)}")
            index = next(i for i, a in enumerate(self._actuators) if a.name == name)
            actuator = self._actuators[index]
            low = -np.inf if actuator.low is None else actuator.low
            high = np.inf if actuator.high is None else actuator.high
            if value is not None and not (isinstance(value, Real) and isfinite(value) and low <= value <= high):
                raise InvalidAction(
                    f"{name} = {value!r}; its bounds are {with_unit(f'{low:g} to {high:g}', actuator.unit)}"
                )
            found[index] = value
        return found

    def _checked(
        self, action: ArrayLike, slots: int | None = None, unread: Collection[int] = ()
    ) -> NDArray[np.float64]:
        """The action, or a row of each slot's."""
        values = as_array(action, np.float64)
        shape = self._low.shape if slots is None else (slots, *self._low.shape)
        if values.shape != shape:
            named = ", ".join(self.names) or "the building's own control"
            raise InvalidAction(f"action of shape {values.shape}; {shape} expected: {named}")
        if slots is None and self._few and self._plainly_inside(values):
            return values.copy()  # infos keep it
        if (np.minimum(np.maximum(values, self._floor), self._ceiling) == values).all():  # NaN is not
            return values.copy()
        inside = self._inside(values)
        if unread:
            inside[list(unread)] = True
        if not inside.all():
            raise InvalidAction(self._fault(values, inside))
        checked: NDArray[np.float64] = np.clip(values, self._low, self._high)
        return checked

    def _plainly_inside(self, values: NDArray[np.float64]) -> bool:
        for value, (low, high) in zip(values.tolist(), self._bounds, strict=True):  # noqa: SIM110  # no generator
            if not low <= value <= high:
                return False
        return True

    def _inside(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        # An action that was rescaled in float32 ends a few units in the last place beside a bound: the bound is meant.
        inside: NDArray[np.bool_] = np.isfinite(values) & (values >= self._least) & (values <= self._most)
        return inside  # an unbounded action takes any finite value

    def _fault(self, values: NDArray[np.float64], inside: NDArray[np.bool_]) -> str:
        faults = []
        for *slot, index in np.argwhere(~inside).tolist():
            action = self._actions[index]
            bounds = with_unit(f"{self._low[index]:g} to {self._high[index]:g}", action.unit)
            faults.append(f"{_of(slot)}{action.name} = {values[*slot, index]:g}; its bounds are {bounds}")
        return "; ".join(faults)

    def _chosen(self, action: ArrayLike) -> NDArray[np.float64]:
        picked: NDArray[Any] = np.atleast_1d(as_array(action, None))
        if picked.shape != (len(self._choices),) or not np.issubdtype(picked.dtype, np.integer):
            raise InvalidAction(f"action {action!r}; {self.space} expected")
        values = np.empty(len(self._actions))
        for table, index in zip(self._choices, picked.tolist(), strict=True):
            if not 0 <= index < len(table.rows):
                raise InvalidAction(table.fault(index))
            values[table.columns] = table.rows[index]
        return values

    def _chosen_rows(self, actions: ArrayLike, slots: int, unread: Collection[int]) -> NDArray[np.float64]:
        picked = as_array(actions, None)
        shape = (slots, *(self.space.shape or ()))
        if picked.shape != shape or not np.issubdtype(picked.dtype, np.integer):
            raise InvalidAction(f"action {actions!r}; {self.space} expected of each of {slots} slots")
        picked = picked.reshape(slots, len(self._choices))
        if unread:
            picked = picked.copy()
            picked[list(unread)] = 0
        values = np.empty((slots, len(self._actions)))
        for table, chosen in zip(self._choices, picked.T, strict=True):
            wrong = (chosen < 0) | (chosen >= len(table.rows))
            if wrong.any():
                slot = int(wrong.argmax())
                raise InvalidAction(_of([slot]) + table.fault(int(chosen[slot])))
            values[:, table.columns] = table.rows[chosen]
        return values


def _of(slot: list[int]) -> str:
    return f"slot {slot[0]}: " if slot else ""


def _slack(bound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Four units in the last place of float32 at a bound."""
    size: NDArray[np.float64] = np.spacing(np.where(np.isfinite(bound), np.abs(bound), 1.0).astype(np.float32))
    return 4.0 * size.astype(np.float64)


def _finite(bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    most = np.finfo(np.float64).max
    finite: NDArray[np.float64] = np.clip(bounds, -most, most)
    return finite


def as_array(action: ArrayLike, kind: type[np.float64] | None) -> NDArray[Any]:
    """An action as an array of float64, or of its own type.

    Raises:
        InvalidAction: not numbers, complex ones, or values that a mask hides.
    """
    if type(action) is not np.ndarray and np.ma.is_masked(action):
        raise InvalidAction(f"action {action!r} has masked values; a number for each expected")
    try:
        values = np.asarray(action)
        if values.dtype.kind == "c":  # NumPy would drop the imaginary part
            raise InvalidAction(f"action {action!r} is complex; real numbers expected")
        return np.asarray(values, kind)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"action {action!r} is no array of numbers: {error}") from None


class _Table:
    """One discrete dimension: the positions of its actions, and a row of values for each choice."""

    def __init__(self, choice: DiscreteAction, actions: tuple[Action, ...]) -> None:
        places = {action.name: i for i, action in enumerate(actions)}
        self.names = choice.actions
        self.columns = np.array([places[name] for name in choice.actions], np.intp)
        self.rows = np.array(choice.values, np.float64)

    def fault(self, index: int) -> str:
        """What is wrong with a choice that is not there."""
        return f"choice {index} of {', '.join(self.names)}; 0 to {len(self.rows) - 1} expected"
