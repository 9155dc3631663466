"""Convert an agent's action to a checked value for each actuator."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zenostat.agent_sdk.envs import spaces
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidAction, did_you_mean
from zenostat.topics.messages import Action, CommandOp, DiscreteAction, Manifest
from zenostat.topics.points import LARGEST, bound_arrays, contains, describe_violation, value_index

_SMALL = 8


class Actions:
    """The actions of a node's task.

    Attributes:
        space: `Box`, float32, shape (actions,), or `Discrete`, or `MultiDiscrete`.
        operations: A `CommandOp` byte for each actuator; None if the actions set all of them.
        is_relative: Whether an action is an offset to baseline control.
        is_scheduled: Whether all offsets are relative to schedules, whose values depend on time alone.
    """

    def __init__(self, manifest: Manifest) -> None:
        task = manifest.task
        self.space = spaces.action_space(manifest)
        self._actions = task.actions
        self._tables = [_ChoiceTable(discrete, task.actions) for discrete in task.discrete_actions]
        self._low, self._high = bound_arrays(task.actions)
        if isinstance(self.space, spaces.Floats):
            low, high = np.minimum(self.space.low, self._low), np.maximum(self.space.high, self._high)
            self._min, self._max = low - _slack(low), high + _slack(high)
        action_of = {name: i for i, action in enumerate(task.actions) for name in action.actuators}
        self._floor, self._ceiling = bound_arrays(task.actions, unbounded=LARGEST)
        # A small action is compared with these number by number, which takes less time than arrays do.
        self._bounds = list(zip(self._floor.tolist(), self._ceiling.tolist(), strict=True))
        self._is_small = len(self._bounds) <= _SMALL
        self._action_index = np.array([action_of.get(a.name, 0) for a in manifest.actuators], np.intp)
        self._is_identity = self._action_index.tolist() == list(range(len(task.actions)))
        unbound = [a.name for a in manifest.actuators if a.name not in action_of]
        self._actuators, self._unbound = {a.name: (i, a) for i, a in enumerate(manifest.actuators)}, unbound
        codes = [CommandOp.KEEP if a.name in unbound else CommandOp.SET for a in manifest.actuators]
        self.operations, self._codes = bytes(codes) if unbound else None, np.array(codes, np.uint8)
        self._offsets = _Offsets(manifest) if any(action.relative for action in task.actions) else None
        self.is_relative = self._offsets is not None
        self.is_scheduled = self._offsets is not None and self._offsets.is_scheduled

    @property
    def names(self) -> list[str]:
        """Names of the actions, in order."""
        return [action.name for action in self._actions]

    def values(self, action: ArrayLike) -> Floats:
        """Return a value for each actuator, shape (actuators,), in manifest order and units.

        Of a relative action it is the offset.

        Raises:
            InvalidAction: Wrong shape, out of bounds, not finite, or no such choice.
        """
        checked = self._from_choices(action) if self._tables else self._check(action)
        if self._is_identity:
            return checked
        return checked[self._action_index] if len(self._actions) else np.zeros(len(self._action_index))

    def command(
        self, action: ArrayLike, points: Floats, context: dict[int, float | None]
    ) -> tuple[Floats, bytes | None]:
        """Return the values of a command, shape (actuators,), and a `CommandOp` byte for each; None: all are set.

        Args:
            action: The agent's action.
            points: Fault-free values of sensors and meters, shape (points,): offsets are relative to them.
            context: Values of further actuators by position, as of `context`, which is consumed; None relinquishes one.
        """
        values = self.values(action)
        return values, self.complete(values[None], points[None], [context])

    def complete(self, values: Floats, points: Floats, contexts: Sequence[dict[int, float | None]]) -> bytes | None:
        """Complete the commands of several slots in place, and return their operations, as `command` for each.

        Args:
            values: As `values` or `rows` returned them, shape (slots, actuators).
            points: Shape (slots, points).
            contexts: A context for each slot.
        """
        if self._offsets is None and not any(contexts):
            return None if self.operations is None else self.operations * len(values)
        codes = np.tile(self._codes, (len(values), 1))
        if self._offsets is not None:
            self._offsets.add(values, codes, points)
        for slot, context in enumerate(contexts):
            for index, value in context.items():
                codes[slot, index] = CommandOp.RELINQUISH if value is None else CommandOp.SET
                values[slot, index] = 0.0 if value is None else value
            context.clear()
        return codes.tobytes()

    def commanded(self, values: Floats, operations: bytes | None) -> Floats:
        """Return the values of a command with NaN for actuators that no action sets; shape as `values`."""
        if operations is None:
            return values
        codes = np.frombuffer(operations, np.uint8).reshape(values.shape)
        return np.where((self._codes == CommandOp.SET) & (codes == CommandOp.SET), values, np.nan)

    def rows(self, actions: ArrayLike, slots: int, unread: Collection[int] = ()) -> Floats:
        """Return the values of several slots, shape (slots, actuators).

        Args:
            actions: Elements of the batched space, shape (slots, actions), or (slots,) for one discrete action.
            slots: Number of slots.
            unread: Slots whose actions are ignored, whatever they are; their values are zero.

        Raises:
            InvalidAction: As for `values`; the text names the slot.
        """
        checked = (
            self._rows_from_choices(actions, slots, unread) if self._tables else self._check(actions, slots, unread)
        )
        if not self._is_identity:
            checked = (
                checked[:, self._action_index] if len(self._actions) else np.zeros((slots, len(self._action_index)))
            )
        if unread:
            checked[list(unread)] = 0.0
        return checked

    def context(self, values: Mapping[str, float | None]) -> dict[int, float | None]:
        """Return, by position, values of actuators that belong to no action.

        Raises:
            InvalidAction: Unknown actuator, one that an action sets, or a value out of bounds or not finite.
        """
        if not isinstance(values, Mapping):
            raise InvalidAction(f"context {values!r}; values by actuator expected, such as {{'occupants': 1.0}}")
        context: dict[int, float | None] = {}
        for name, value in values.items():
            if name not in self._unbound:
                raise InvalidAction(
                    f"{name!r} is not an actuator outside the actions; {did_you_mean(name, self._unbound)}"
                )
            index, actuator = self._actuators[name]
            if value is not None and not (isinstance(value, Real) and contains(actuator, value)):
                raise InvalidAction(describe_violation(actuator, value))
            context[index] = value
        return context

    def _check(self, action: ArrayLike, slots: int | None = None, unread: Collection[int] = ()) -> Floats:
        """Return a copy of a continuous action within its bounds; of several slots, a row for each."""
        values = as_array(action, np.float64)
        shape = self._low.shape if slots is None else (slots, *self._low.shape)
        if values.shape != shape:
            names = ", ".join(self.names) or "no actions, baseline control only"
            raise InvalidAction(f"action of shape {values.shape}; {shape} expected: {names}")
        if slots is None and self._is_small and self._is_within_bounds(values):
            return values.copy()  # infos keep it
        if (np.minimum(np.maximum(values, self._floor), self._ceiling) == values).all():  # False for NaN
            return values.copy()
        inside = self._within_tolerance(values)
        if unread:
            inside[list(unread)] = True
        if not inside.all():
            raise InvalidAction(self._describe_violations(values, inside))
        clipped: Floats = np.clip(values, self._low, self._high)
        return clipped

    def _is_within_bounds(self, values: Floats) -> bool:
        for value, (low, high) in zip(values.tolist(), self._bounds, strict=True):  # noqa: SIM110  # a generator is slow
            if not low <= value <= high:
                return False
        return True

    def _within_tolerance(self, values: Floats) -> NDArray[np.bool_]:
        # Rescaling an action in float32 can miss a bound by a few units in the last place; the bound is meant.
        inside: NDArray[np.bool_] = np.isfinite(values) & (values >= self._min) & (values <= self._max)
        return inside  # for an unbounded action, any finite value

    def _describe_violations(self, values: Floats, inside: NDArray[np.bool_]) -> str:
        violations = []
        for *slot, index in np.argwhere(~inside).tolist():
            violation = describe_violation(self._actions[index], values[*slot, index])
            violations.append(_slot_prefix(slot) + violation)
        return "; ".join(violations)

    def _from_choices(self, action: ArrayLike) -> Floats:
        choices: NDArray[Any] = np.atleast_1d(as_array(action, None))
        if choices.shape != (len(self._tables),) or not np.issubdtype(choices.dtype, np.integer):
            raise InvalidAction(f"action {action!r}; {self.space} expected")
        values = np.empty(len(self._actions))
        for table, choice in zip(self._tables, choices.tolist(), strict=True):
            if not 0 <= choice < len(table.rows):
                raise InvalidAction(table.describe_invalid(choice))
            values[table.columns] = table.rows[choice]
        return values

    def _rows_from_choices(self, actions: ArrayLike, slots: int, unread: Collection[int]) -> Floats:
        choices = as_array(actions, None)
        shape = (slots, *(self.space.shape or ()))
        if choices.shape != shape or not np.issubdtype(choices.dtype, np.integer):
            raise InvalidAction(f"action {actions!r}; {self.space} expected of each of {slots} slots")
        choices = choices.reshape(slots, len(self._tables))
        if unread:
            choices = choices.copy()
            choices[list(unread)] = 0
        values = np.empty((slots, len(self._actions)))
        for table, column in zip(self._tables, choices.T, strict=True):
            invalid = (column < 0) | (column >= len(table.rows))
            if invalid.any():
                slot = int(invalid.argmax())
                raise InvalidAction(_slot_prefix([slot]) + table.describe_invalid(int(column[slot])))
            values[:, table.columns] = table.rows[column]
        return values


def named_values(manifest: Manifest, values: Floats, operations: bytes | None) -> dict[str, float | None]:
    """Return a command by actuator; None relinquishes one, and those that it keeps are not in it.

    Args:
        manifest: The node's manifest.
        values: A value for each actuator, shape (actuators,).
        operations: A `CommandOp` byte for each; None: all are set.
    """
    codes = operations or bytes([CommandOp.SET] * len(values))
    return {
        actuator.name: value if code == CommandOp.SET else None
        for actuator, value, code in zip(manifest.actuators, values.tolist(), codes, strict=True)
        if code != CommandOp.KEEP
    }


def _slot_prefix(slot: list[int]) -> str:
    return f"slot {slot[0]}: " if slot else ""


def _slack(bound: Floats) -> Floats:
    """Four units in the last place of float32 at a bound."""
    size: Floats = np.spacing(np.where(np.isfinite(bound), np.abs(bound), 1.0).astype(np.float32))
    return 4.0 * size.astype(np.float64)


def as_array(action: ArrayLike, dtype: type[np.float64] | None) -> NDArray[Any]:
    """Convert an action to an array of float64, or of its own type.

    Raises:
        InvalidAction: Not numbers, complex numbers, or masked values.
    """
    if type(action) is not np.ndarray and np.ma.is_masked(action):
        raise InvalidAction(f"action {action!r} has masked values; a number for each expected")
    try:
        values = np.asarray(action)
        if values.dtype.kind == "c":  # NumPy would drop the imaginary part
            raise InvalidAction(f"action {action!r} is complex; real numbers expected")
        return np.asarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"action {action!r} is not an array of numbers: {error}") from None


_ZERO = 4.0 * float(np.finfo(np.float32).eps)
"""Part of an action's range up to which an offset is zero: a scaled float32 action is no more exact than that."""


def _range(action: Action) -> float:
    """Return the range of an action; 0 without bounds."""
    return 0.0 if action.low is None or action.high is None else action.high - action.low


class _Offsets:
    """The actuators of relative actions, and the points of their values under baseline control."""

    def __init__(self, manifest: Manifest) -> None:
        task_actions = [action for action in manifest.task.actions if action.relative]
        relative = {name for action in task_actions for name in action.actuators}
        chosen = [(i, a) for i, a in enumerate(manifest.actuators) if a.name in relative]
        points = value_index(manifest)
        self._columns = np.array([i for i, _ in chosen], np.intp)
        self._points = np.array([points[str(a.baseline_sensor)] for _, a in chosen], np.intp)
        self._low, self._high = bound_arrays([a for _, a in chosen])
        ranges = {name: _range(action) for action in task_actions for name in action.actuators}
        self._resolution = np.array([_ZERO * ranges[a.name] for _, a in chosen])
        sensors = {sensor.name: sensor for sensor in manifest.sensors}
        self.is_scheduled = all(
            str(a.baseline_sensor) in sensors and sensors[str(a.baseline_sensor)].lead_s for _, a in chosen
        )

    def add(self, values: Floats, codes: NDArray[np.uint8], points: Floats) -> None:
        """Replace offsets by absolute values within the actuators' bounds, and those of 0 by relinquishing."""
        offsets, columns = values[:, self._columns], self._columns
        is_zero = np.abs(offsets) <= self._resolution
        absolute = np.clip(points[:, self._points] + offsets, self._low, self._high)
        values[:, columns] = np.where(is_zero, 0.0, absolute)
        codes[:, columns] = np.where(is_zero, CommandOp.RELINQUISH, CommandOp.SET)


class _ChoiceTable:
    """One discrete action: the positions of the actions that it sets, and a row of their values for each choice."""

    def __init__(self, discrete: DiscreteAction, actions: tuple[Action, ...]) -> None:
        positions = {action.name: i for i, action in enumerate(actions)}
        self.names = discrete.actions
        self.columns = np.array([positions[name] for name in discrete.actions], np.intp)
        self.rows = np.array(discrete.values, np.float64)

    def describe_invalid(self, choice: int) -> str:
        """Describe the error of an index without a row."""
        return f"choice {choice} of {', '.join(self.names)}; 0 to {len(self.rows) - 1} expected"
