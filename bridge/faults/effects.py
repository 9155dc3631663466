"""Effects of point faults on values: arrays of shape (slots, points of the fault)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.faults.random_streams import Distribution, RandomStream
from zenostat.bridge.faults.schedule import FaultSchedule
from zenostat.topics.arrays import Floats
from zenostat.topics.fault_plan import (
    Bias,
    Clip,
    Delay,
    Drift,
    Drop,
    Freeze,
    Gain,
    Noise,
    PointFault,
    Quantize,
    Spike,
    Stuck,
)


class Effect(ABC):
    """Effect of one fault on its columns.

    Args:
        row: index of the fault in `schedule`.
        columns: the columns that the fault affects.
        schedule: when the fault is active.
        step_h: length of a timestep in hours.
        new_stream: creates the stream of the fault's random numbers.

    Attributes:
        is_stateful: whether it must process the values of each step, also while it is not active.
        distribution: of its random numbers, of which there is one for each point at each step.
        memory: its state; the first axis is the slots.
    """

    is_stateful: ClassVar[bool] = False
    distribution: ClassVar[Distribution] = Distribution.UNIFORM

    def __init__(
        self,
        row: int,
        columns: NDArray[np.intp],
        schedule: FaultSchedule,
        step_h: float,
        new_stream: Callable[[Distribution], RandomStream],
    ) -> None:
        self.row, self.columns, self.schedule, self.step_h = row, columns, schedule, step_h
        self.fault: Any = schedule.faults[row]
        self.stream = new_stream(self.distribution)
        self.memory: Floats = np.full((len(schedule.at), *self._memory_shape()), np.nan)

    def _memory_shape(self) -> tuple[int, ...]:
        return (0,)

    @property
    def on(self) -> NDArray[np.bool_]:
        """Whether the fault is active, of shape (slots,)."""
        active: NDArray[np.bool_] = self.schedule.on[self.row]
        return active

    @property
    def since(self) -> NDArray[np.int64]:
        """Step of its onset, of shape (slots,)."""
        onset: NDArray[np.int64] = self.schedule.since[self.row]
        return onset

    @abstractmethod
    def disturb(self, values: Floats) -> Floats:
        """Return the values with the fault active in all slots; `values` are not changed."""


class _Bias(Effect):
    def disturb(self, values: Floats) -> Floats:
        return values + float(self.fault.offset)


class _Gain(Effect):
    def disturb(self, values: Floats) -> Floats:
        return values * float(self.fault.factor)


class _Drift(Effect):
    def disturb(self, values: Floats) -> Floats:
        hours = (self.schedule.at - self.since) * self.step_h
        return values + float(self.fault.rate_per_h) * hours[:, None]


class _Stuck(Effect):
    def disturb(self, values: Floats) -> Floats:
        return np.full_like(values, self.fault.value)


class _Missing(Effect):
    def disturb(self, values: Floats) -> Floats:
        return np.full_like(values, np.nan)


class _Quantize(Effect):
    def disturb(self, values: Floats) -> Floats:
        with np.errstate(over="ignore", invalid="ignore"):
            rounded: Floats = np.rint(values / self.fault.resolution) * self.fault.resolution
        return np.where(np.isfinite(rounded), rounded, values)  # a finer resolution than that of a float64


class _Clip(Effect):
    def disturb(self, values: Floats) -> Floats:
        return clipped(values, self.fault.low, self.fault.high)


class _Noise(Effect):
    distribution = Distribution.NORMAL

    def disturb(self, values: Floats) -> Floats:
        return values + float(self.fault.sigma) * self.stream.at(self.schedule.at)


class _Spike(Effect):
    """One uniform number determines both whether there is a spike and its sign."""

    def disturb(self, values: Floats) -> Floats:
        number, probability = self.stream.at(self.schedule.at), self.fault.probability
        is_down = (number < probability / 2) if self.fault.two_sided else np.False_
        shift = np.where(is_down, -self.fault.amplitude, self.fault.amplitude)
        return np.where(number < probability, values + shift, values)


class _Freeze(Effect):
    def _memory_shape(self) -> tuple[int, ...]:
        return (len(self.columns),)

    def disturb(self, values: Floats) -> Floats:
        starts = (self.schedule.at == self.since)[:, None]
        self.memory = np.where(starts, values, self.memory)
        return self.memory


class _HoldLast(Effect):
    """Keeps the last value: an actuator that receives no commands does not move."""

    is_stateful = True

    def _memory_shape(self) -> tuple[int, ...]:
        return (len(self.columns),)

    def disturb(self, values: Floats) -> Floats:
        self.memory = np.where(self.on[:, None], self.memory, values)
        return self.memory


class _Delay(Effect):
    """The memory is a ring buffer of the last steps."""

    is_stateful = True

    def _memory_shape(self) -> tuple[int, ...]:
        return (self.fault.steps + 1, len(self.columns))

    def disturb(self, values: Floats) -> Floats:
        slots, length = np.arange(len(values)), self.memory.shape[1]
        started = np.broadcast_to(self.schedule.at >= 0, slots.shape)  # there is no step before the episode starts
        self.memory[slots[started], np.broadcast_to(self.schedule.at % length, slots.shape)[started]] = values[started]
        delayed: Floats = self.memory[slots, (self.schedule.at + 1) % length]
        return delayed


def clipped(values: Floats, low: Any, high: Any) -> Floats:
    """Clip values to bounds (None: unbounded); values within the bounds and NaN are unchanged to the bit."""
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
    Quantize: _Quantize,
    Spike: _Spike,
    Clip: _Clip,
}
"""Effects of the kinds of faults on sensors and meters."""

ACTUATOR_EFFECTS: dict[type[PointFault], type[Effect]] = {**SENSOR_EFFECTS, Drop: _HoldLast}
"""Effects of the kinds of faults on actuators."""
