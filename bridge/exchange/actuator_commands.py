"""What is commanded to the actuators: values at 16 levels, within their bounds, some of them for a time.

Rules without I/O. Shapes are (slots, actuators).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.exchange.claims import ClaimHolder
from bridge.exchange.priority_array import PriorityArray
from topics import codec
from topics.errors import BadMessage, did_you_mean
from topics.messages import Actuator, Command, CommandOp, Write
from topics.units import with_unit

_SMALL = 8
"""Values that are looked at one by one in less time than it takes to make arrays of them."""


@dataclass(frozen=True, slots=True)
class Expiry:
    """A single point that is released when so much simulated time has passed since all slots began."""

    at_s: float
    priority: int
    actuator: int
    source: str


@dataclass(frozen=True, slots=True)
class CommandSnapshot:
    """What was commanded up to a sample and holds on: a part of a snapshot."""

    array: PriorityArray
    expiries: tuple[Expiry, ...] = ()
    timesteps: int = 0

    def of_slot(self, slot: int, slots: int) -> CommandSnapshot:
        """What holds in one slot, for each of `slots` new ones."""
        return CommandSnapshot(self.array.of_slot(slot, slots), self.expiries, self.timesteps)


class ActuatorCommands:
    """Of one node.

    Args:
        actuators: in manifest order.
        slots: engines in the node.

    Attributes:
        array: who commands what, at which level.
        size: bytes of the values of all actuators of all slots.
        timesteps: that have passed since all slots began: the clock of what is written for a time.
    """

    def __init__(self, actuators: tuple[Actuator, ...], slots: int) -> None:
        self._actuators, self._shape = actuators, (slots, len(actuators))
        most = float(np.finfo(np.float64).max)  # an unbounded actuator takes any finite value
        low = [-most if a.low is None else a.low for a in actuators]
        high = [most if a.high is None else a.high for a in actuators]
        self._bounds = np.tile(np.array([low, high]).reshape(2, -1), slots)
        self._clipped = np.empty(self._bounds.shape[1])
        self._few = len(low) * slots <= _SMALL
        self._low, self._high = low * slots, high * slots
        self._index = {a.name: i for i, a in enumerate(actuators)}
        self._expiries: list[Expiry] = []
        self.array = PriorityArray(*self._shape)
        self.size = self._clipped.nbytes
        self.timesteps = 0

    def clear(self) -> None:
        """Releases everything, for a new episode."""
        self.array.clear()
        self._expiries, self.timesteps = [], 0

    def capture(self) -> CommandSnapshot:
        """What holds now."""
        return CommandSnapshot(self.array.copy(), tuple(self._expiries), self.timesteps)

    def restore(self, held: CommandSnapshot) -> None:
        """Has that hold again."""
        self.array.restore(held.array)
        self._expiries, self.timesteps = [*held.expiries], held.timesteps

    # A controller's command

    def put_fast(self, claimant: ClaimHolder, raw: bytes) -> bool:
        """Sets all actuators of all slots to raw values, if it is plain that they are within bounds; whether it was.

        False also for some that are (of many, -0.0 at a bound of 0): `put` looks at them closely.
        """
        if self._few:
            for value, low, high in zip(memoryview(raw).cast("d"), self._low, self._high, strict=True):
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
        """Sets and releases what a command says, in the slots that it answers.

        Raises:
            BadMessage: wrong sizes, a value out of bounds or not finite, or an actuator that was not claimed; nothing
                is changed.
        """
        values = codec.floats(command.values, self._shape, "values")
        whole = len(answered) == self._shape[0]
        if command.operations is None and claimant.covers_all and whole:
            self._check(values)
            self.array.put_all(claimant.priority, claimant.source, command.values)
            return
        mask = self._mask(claimant, command)
        if not whole:
            mask = np.where(np.isin(np.arange(self._shape[0]), answered)[:, None], mask, np.uint8(CommandOp.KEEP))
        self._check(np.where(mask == CommandOp.SET, values, self._bounds[0].reshape(self._shape)))
        self.array.put(
            claimant.priority, claimant.source, np.where(mask == CommandOp.SET, values, np.nan), mask != CommandOp.KEEP
        )

    def _mask(self, claimant: ClaimHolder, command: Command) -> NDArray[np.uint8]:
        if command.operations is None:
            mask = np.full(self._shape, CommandOp.SET, np.uint8)
        else:
            mask = codec.uint8s(command.operations, self._shape, "operations")
        if mask.size and mask.max() > CommandOp.RELINQUISH:
            raise BadMessage(f"operations has {int(mask.max())}; 0 keeps, 1 sets, 2 releases")
        if (mask[:, ~claimant.mask] != CommandOp.KEEP).any():
            _, index = np.argwhere((mask != CommandOp.KEEP) & ~claimant.mask)[0]
            raise BadMessage(f"{self._actuators[index].name!r} is not among the actuators it claimed")
        return mask

    def _check(self, values: NDArray[np.float64]) -> None:
        low, high = self._bounds.reshape(2, *self._shape)
        wrong = ~((values >= low) & (values <= high))  # true for NaN
        if wrong.any():
            slot, index = np.argwhere(wrong)[0]
            raise BadMessage(self._out_of_bounds(int(index), float(values[slot, index])))

    def _out_of_bounds(self, index: int, value: float) -> str:
        actuator = self._actuators[index]
        low, high = (str(b) if b is not None else "unbounded" for b in (actuator.low, actuator.high))
        return f"{actuator.name} = {with_unit(f'{value:g}', actuator.unit)}; its bounds are {low} to {high}"

    # Single points

    def find(self, name: str, write: Write) -> int:
        """The index of the actuator that is written.

        Raises:
            BadMessage: there is none of that name, or the value is out of its bounds.
        """
        if name not in self._index:
            raise BadMessage(f"no actuator {name!r}; {did_you_mean(name, self._index)}")
        index = self._index[name]
        if write.value is not None:
            low, high = self._bounds[:, index]
            if not low <= write.value <= high:
                raise BadMessage(self._out_of_bounds(index, write.value))
        return index

    def write(self, index: int, write: Write, source: int, elapsed_s: float) -> str:
        """Sets or releases one actuator of all slots; says so in words."""
        occupied = self.array.occupied(write.priority, index)
        self.array.put_one(write.priority, source, index, np.nan if write.value is None else write.value)
        self._expiries = [e for e in self._expiries if (e.priority, e.actuator) != (write.priority, index)]
        actuator = self._actuators[index]
        if write.value is None:
            priority = f"at priority {write.priority}"
            return f"{actuator.name} {'released' if occupied else 'had nothing to release'} {priority}"
        if write.duration_s is not None:
            self._expiries.append(Expiry(elapsed_s + write.duration_s, write.priority, index, write.source))
        return f"{actuator.name} = {with_unit(f'{write.value:g}', actuator.unit)} at priority {write.priority}"

    def drop_superseded_expiries(self, claimant: ClaimHolder) -> None:
        """What was written for a time where somebody claims holds no longer than the claim says."""
        priority, allowed = claimant.priority, claimant.mask
        self._expiries = [e for e in self._expiries if not (e.priority == priority and allowed[e.actuator])]

    @property
    def has_expiries(self) -> bool:
        """Whether anything was written for a time."""
        return bool(self._expiries)

    def expire(self, elapsed_s: float) -> list[tuple[str, str]]:
        """Releases what was written for a time that is over: for each what is to be said, and who had written it."""
        over = [e for e in self._expiries if e.at_s <= elapsed_s]
        self._expiries = [e for e in self._expiries if e.at_s > elapsed_s]
        for e in over:
            self.array.put_one(e.priority, 0, e.actuator, np.nan)
        return [(f"{self._actuators[e.actuator].name} released at priority {e.priority}", e.source) for e in over]
