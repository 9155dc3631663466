"""What each kind of fault makes of values: arrays of shape (slots, points of the fault)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bridge.faults.random_streams import Distribution, RandomStream
from bridge.faults.schedule import FaultSchedule
from topics.fault_plan import Bias, Clip, Delay, Drift, Drop, Freeze, Gain, Noise, PointFault, Quantize, Spike, Stuck

Floats = NDArray[np.float64]


class Effect(ABC):
    """One fault on its columns.

    Args:
        row: of the fault in `windows`.
        columns: of the whole array.
        new_draws: makes the stream of the fault's random numbers.

    Attributes:
        remembers: whether it must see the values of each step, also while it is off.
        law: what it draws; one number for each point at each step.
        memory: what it remembers; the first axis is the slots.
    """

    remembers: ClassVar[bool] = False
    law: ClassVar[Distribution] = Distribution.UNIFORM

    def __init__(
        self,
        row: int,
        columns: NDArray[np.intp],
        windows: FaultSchedule,
        step_h: float,
        new_draws: Callable[[Distribution], RandomStream],
    ) -> None:
        self.row, self.columns, self.windows, self.step_h = row, columns, windows, step_h
        self.fault: Any = windows.faults[row]
        self.draws = new_draws(self.law)
        self.memory: Floats = np.full((len(windows.at), *self._memory_shape()), np.nan)

    def _memory_shape(self) -> tuple[int, ...]:
        return (0,)

    @property
    def on(self) -> NDArray[np.bool_]:
        """Shape (slots,)."""
        found: NDArray[np.bool_] = self.windows.on[self.row]
        return found

    @property
    def since(self) -> NDArray[np.int64]:
        """Shape (slots,)."""
        found: NDArray[np.int64] = self.windows.since[self.row]
        return found

    @abstractmethod
    def disturb(self, values: Floats) -> Floats:
        """The disturbed values, as if the fault were on in all slots; `values` stay as they are."""


class _Bias(Effect):
    def disturb(self, values: Floats) -> Floats:
        return values + float(self.fault.offset)


class _Gain(Effect):
    def disturb(self, values: Floats) -> Floats:
        return values * float(self.fault.factor)


class _Drift(Effect):
    def disturb(self, values: Floats) -> Floats:
        hours = (self.windows.at - self.since) * self.step_h
        return values + float(self.fault.rate_per_h) * hours[:, None]


class _Stuck(Effect):
    def disturb(self, values: Floats) -> Floats:
        return np.full_like(values, self.fault.value)


class _Missing(Effect):
    """A point without a value."""

    def disturb(self, values: Floats) -> Floats:
        return np.full_like(values, np.nan)


class _Quantise(Effect):
    def disturb(self, values: Floats) -> Floats:
        rounded: Floats = np.rint(values / self.fault.resolution) * self.fault.resolution
        return rounded


class _Clip(Effect):
    def disturb(self, values: Floats) -> Floats:
        return clipped(values, self.fault.low, self.fault.high)


class _Noise(Effect):
    law = Distribution.NORMAL

    def disturb(self, values: Floats) -> Floats:
        return values + float(self.fault.sigma) * self.draws.at(self.windows.at)


class _Spike(Effect):
    """One uniform number tells whether there is a spike and, of those, which way: each half has the same chance."""

    def disturb(self, values: Floats) -> Floats:
        number, probability = self.draws.at(self.windows.at), self.fault.probability
        down = (number < probability / 2) if self.fault.two_sided else np.False_
        by = np.where(down, -self.fault.amplitude, self.fault.amplitude)
        return np.where(number < probability, values + by, values)


class _Freeze(Effect):
    def _memory_shape(self) -> tuple[int, ...]:
        return (len(self.columns),)

    def disturb(self, values: Floats) -> Floats:
        begins = (self.windows.at == self.since)[:, None]
        self.memory = np.where(begins, values, self.memory)
        return self.memory


class _HoldLast(Effect):
    """An actuator that hears nothing keeps what it heard last."""

    remembers = True

    def _memory_shape(self) -> tuple[int, ...]:
        return (len(self.columns),)

    def disturb(self, values: Floats) -> Floats:
        self.memory = np.where(self.on[:, None], self.memory, values)
        return self.memory


class _Delay(Effect):
    """The memory is a ring of the last steps."""

    remembers = True

    def _memory_shape(self) -> tuple[int, ...]:
        return (self.fault.steps + 1, len(self.columns))

    def disturb(self, values: Floats) -> Floats:
        slots, length = np.arange(len(values)), self.memory.shape[1]
        begun = np.broadcast_to(self.windows.at >= 0, slots.shape)  # before, there is no step that it is of
        self.memory[slots[begun], np.broadcast_to(self.windows.at % length, slots.shape)[begun]] = values[begun]
        former: Floats = self.memory[slots, (self.windows.at + 1) % length]
        return former


def clipped(values: Floats, low: Any, high: Any) -> Floats:
    """`values` within bounds (None: unbounded); those that are within stay as they are to the bit, NaN too."""
    if low is not None:
        values = np.where(values < low, low, values)
    if high is not None:
        values = np.where(values > high, high, values)
    return values


SENSOR_EFFECTS: dict[type[PointFault], type[Effect]] = {
    Bias: _Bias,
    Gain: _Gain,
    Drift: _Drift,
    Noise: _Noise,
    Freeze: _Freeze,
    Stuck: _Stuck,
    Drop: _Missing,
    Delay: _Delay,
    Quantize: _Quantise,
    Spike: _Spike,
    Clip: _Clip,
}
"""What a kind of fault does to sensors and meters."""

ACTUATOR_EFFECTS: dict[type[PointFault], type[Effect]] = {**SENSOR_EFFECTS, Drop: _HoldLast}
"""What it does to actuators."""
