"""Commanded values of the actuators: at 16 priorities, within their bounds, optionally with an expiry.

No I/O. Arrays have the shape (slots, actuators).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.exchange.claims import ClaimHolder
from zenostat.bridge.exchange.priority_array import PRIORITIES, PriorityArray
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import ANONYMOUS, Actuator, Command, CommandOp, Write
from zenostat.topics.points import LARGEST, PointIndex, bound_arrays, contains, describe_violation
from zenostat.topics.units import with_unit

_SMALL = 32
"""Largest number of values for which a Python loop is faster than NumPy."""

_ROUNDING = 1e-12
"""Part of the simulated time by which a sum of timesteps and the same duration may differ."""

_SHORTEST_S = 1e-3
"""Duration of a written value that is to have an effect: less than a timestep, and more than rounding."""


@dataclass(frozen=True, slots=True)
class Expiry:
    """A written value that is relinquished once so much simulated time has passed since all slots started."""

    at_s: float
    priority: int
    actuator: int
    source: str

    def is_due(self, elapsed_s: float) -> bool:
        """Return whether it has expired after so much simulated time."""
        return self.at_s <= elapsed_s * (1.0 + _ROUNDING)


@dataclass(frozen=True, slots=True)
class CommandSnapshot:
    """The commanded values that are in effect at a sample, and the claims of their controllers; part of a snapshot."""

    array: PriorityArray
    expiries: tuple[Expiry, ...] = ()
    timesteps: int = 0
    commanded: bytes = b""
    source_index: bytes = b""
    holders: tuple[ClaimHolder, ...] = ()

    def of_slot(self, slot: int, slots: int) -> CommandSnapshot:
        """Return a snapshot for `slots` new slots, all with the commands of one slot, without claims."""
        row = slice(slot * self.array.shape[1], (slot + 1) * self.array.shape[1])
        commanded = self.commanded[8 * row.start : 8 * row.stop] * slots
        sources = self.source_index[2 * row.start : 2 * row.stop] * slots
        return CommandSnapshot(self.array.of_slot(slot, slots), self.expiries, self.timesteps, commanded, sources)


class ActuatorCommands:
    """Command state of one node: priorities, bounds, expiries.

    Args:
        actuators: in manifest order.
        slots: number of engines in the node.
        connected: as in the manifest.

    Attributes:
        array: values and sources at each priority.
        size: bytes of the values of all actuators of all slots.
        timesteps: timesteps since all slots started; the clock of expiries.
    """

    def __init__(self, actuators: tuple[Actuator, ...], slots: int, connected: Mapping[str, str]) -> None:
        self._actuators, self._shape = actuators, (slots, len(actuators))
        self._bounds = np.tile(np.stack(bound_arrays(actuators, unbounded=LARGEST)), slots)
        self._clipped = np.empty(self._bounds.shape[1])
        self._is_small = len(self._clipped) <= _SMALL
        self._low, self._high = self._bounds.tolist()
        self._unpack = Struct(f"<{len(self._clipped)}d").unpack
        self._index = PointIndex((a.name for a in actuators), "actuator", BadMessage, connected)
        self._expiries: list[Expiry] = []
        self.array = PriorityArray(*self._shape)
        self.size = self._clipped.nbytes
        self.timesteps = 0

    def clear(self) -> None:
        """Relinquish everything, for a new episode."""
        self.array.clear()
        self._expiries, self.timesteps = [], 0

    def capture(self) -> CommandSnapshot:
        """Return the current commands."""
        return CommandSnapshot(self.array.copy(), tuple(self._expiries), self.timesteps)

    def restore(self, snapshot: CommandSnapshot) -> None:
        """Restore captured commands."""
        self.array.restore(snapshot.array)
        self._expiries, self.timesteps = [*snapshot.expiries], snapshot.timesteps

    # A controller's command

    def put_fast(self, claimant: ClaimHolder, raw: bytes) -> bool:
        """Set all actuators of all slots to raw values after a fast check of the bounds; return whether it passed.

        The check may fail for values that are valid (-0.0 at a bound of 0); `put` checks them exactly.
        """
        if self._is_small:
            for value, low, high in zip(self._unpack(raw), self._low, self._high):  # noqa: B905  # slower if strict
                if not low <= value <= high:  # NaN is not
                    return False
        else:
            low, high = self._bounds
            clipped = self._clipped
            np.fmin(np.fmax(np.frombuffer(raw), low, out=clipped), high, out=clipped)
            if clipped.tobytes() != raw:
                return False
        self.array.put_all(claimant.priority, claimant.source, raw)
        return True

    def put(self, claimant: ClaimHolder, command: Command, answered: Sequence[int]) -> None:
        """Apply a command in the slots that it answers.

        Raises:
            BadMessage: wrong sizes, a value out of bounds or not finite, or an actuator that the controller has not
                claimed; nothing is changed.
        """
        values, operations = self._checked(claimant, command, answered)
        if operations is None:
            self.array.put_all(claimant.priority, claimant.source, command.values)
            return
        self.array.put(
            claimant.priority,
            claimant.source,
            np.where(operations == CommandOp.SET, values, np.nan),
            operations != CommandOp.KEEP,
        )

    def check(self, claimant: ClaimHolder, command: Command) -> None:
        """Raise `BadMessage` as `put` would for a command that answers all slots; change nothing."""
        self._checked(claimant, command, range(self._shape[0]))

    def _checked(
        self, claimant: ClaimHolder, command: Command, answered: Sequence[int]
    ) -> tuple[Floats, NDArray[np.uint8] | None]:
        """Return values and operations of a valid command; no operations if it sets all actuators of all slots."""
        values = codec.floats(command.values, self._shape, "values")
        all_slots = len(answered) == self._shape[0]
        if command.operations is None and claimant.covers_all and all_slots:
            self._check(values)
            return values, None
        operations = self._operations(claimant, command)
        if not all_slots:
            is_answered = np.isin(np.arange(self._shape[0]), answered)[:, None]
            operations = np.where(is_answered, operations, np.uint8(CommandOp.KEEP))
        is_set = operations == CommandOp.SET
        self._check(np.where(is_set, values, self._bounds[0].reshape(self._shape)))
        return values, operations

    def _operations(self, claimant: ClaimHolder, command: Command) -> NDArray[np.uint8]:
        if command.operations is None:
            operations = np.full(self._shape, CommandOp.SET, np.uint8)
        else:
            operations = codec.uint8s(command.operations, self._shape, "operations")
        if operations.size and operations.max() > CommandOp.RELINQUISH:
            raise BadMessage(f"operations has {int(operations.max())}; 0 keeps, 1 sets, 2 relinquishes")
        if (operations[:, ~claimant.mask] != CommandOp.KEEP).any():
            _, index = np.argwhere((operations != CommandOp.KEEP) & ~claimant.mask)[0]
            raise BadMessage(f"{self._actuators[index].name!r} is not among the actuators that it claimed")
        return operations

    def _check(self, values: Floats) -> None:
        low, high = self._bounds.reshape(2, *self._shape)
        invalid = ~((values >= low) & (values <= high))  # true for NaN
        if invalid.any():
            slot, index = np.argwhere(invalid)[0]
            raise BadMessage(describe_violation(self._actuators[index], values[slot, index]))

    # Writes of single points

    def find(self, name: str, write: Write) -> int:
        """Return the index of the actuator to write.

        Raises:
            BadMessage: there is no actuator of that name, or the value is out of its bounds.
        """
        index = self._index[name]
        if write.value is not None and not contains(self._actuators[index], write.value):
            raise BadMessage(describe_violation(self._actuators[index], write.value))
        return index

    def write(self, index: int, write: Write, source: int, elapsed_s: float) -> str:
        """Set or relinquish one actuator in all slots; return a description."""
        occupied = self.array.occupied(write.priority, index)
        self.array.put_one(write.priority, source, index, np.nan if write.value is None else write.value)
        self._expiries = [e for e in self._expiries if (e.priority, e.actuator) != (write.priority, index)]
        actuator = self._actuators[index]
        if write.value is None:
            priority = f"at priority {write.priority}"
            return f"{actuator.name} {'relinquished' if occupied else 'had nothing to relinquish'} {priority}"
        if write.duration_s is not None:
            self._expiries.append(
                Expiry(elapsed_s + max(write.duration_s, _SHORTEST_S), write.priority, index, write.source)
            )
        return f"{actuator.name} = {with_unit(f'{write.value:g}', actuator.unit)} at priority {write.priority}"

    def drop_own_expiries(self, claimant: ClaimHolder) -> None:
        """Drop the expiries of what a controller has written itself, at the priority and actuators of its claim.

        Those of others hold until it sets these actuators.
        """
        self._expiries = [
            e
            for e in self._expiries
            if (e.priority, e.source) != (claimant.priority, claimant.name) or not claimant.mask[e.actuator]
        ]

    def relinquish_sources(self, names: Collection[str]) -> list[str]:
        """Relinquish all values of some sources, in all slots; return the names of the actuators that had any."""
        self._expiries = [e for e in self._expiries if e.source not in names]
        changed = self.array.relinquish_sources(names)
        return [actuator.name for actuator, had_value in zip(self._actuators, changed, strict=True) if had_value]

    @property
    def has_expiries(self) -> bool:
        """Whether any written value has an expiry."""
        return bool(self._expiries)

    def remaining_s(self, elapsed_s: float) -> bytes:
        """Return raw float64 of shape (actuators, 16): seconds until each value expires, NaN for never.

        It is empty if no value expires.
        """
        if not self._expiries:
            return b""
        remaining = np.full((self.array.shape[1], PRIORITIES), np.nan, "<f8")
        for e in self._expiries:
            if self._is_in_force(e):
                remaining[e.actuator, e.priority - 1] = e.at_s - elapsed_s
        return remaining.tobytes()

    def expire(self, elapsed_s: float) -> list[tuple[str, str]]:
        """Relinquish written values that have expired; return a description and the source of each."""
        expired = [e for e in self._expiries if e.is_due(elapsed_s) and self._is_in_force(e)]
        self._expiries = [e for e in self._expiries if not e.is_due(elapsed_s)]
        for e in expired:
            where = np.arange(self.array.shape[1]) == e.actuator
            self.array.relinquish(e.priority, [self.array.names.index(e.source or ANONYMOUS)], where)
        return [
            (f"{self._actuators[e.actuator].name} relinquished at priority {e.priority}", e.source) for e in expired
        ]

    def _is_in_force(self, expiry: Expiry) -> bool:
        """Return whether the value is still the written one, and not that of a controller that has set it since."""
        names, source = self.array.names, expiry.source or ANONYMOUS
        return source in names and self.array.has(expiry.priority, names.index(source), expiry.actuator)
