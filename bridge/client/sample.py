"""A sample as a controller sees it: values by name, value sources, and a method to answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Protocol

from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import UsageError
from zenostat.topics.messages import Flag, Manifest, Sample, WeatherSeries
from zenostat.topics.points import PointIndex

_TRUNCATED, _FALLBACK = int(Flag.TRUNCATED), int(Flag.FALLBACK)


class Replier(Protocol):
    """Sends the answer to a sample, and knows the weather of its episode."""

    def send(self, values: Mapping[str, float | None] | Floats | None = None) -> None:
        """Answer the current sample."""

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Return columns of the weather of a slot's episode."""


class SampleView:
    """One slot of one sample. `sample["core_zn_air_temperature"]` is a value in the point's unit.

    Attributes:
        message: The sample message, with all slots.
        manifest: The node's manifest.
        slot: Number of the slot, from 0.
    """

    __slots__ = ("_index", "_link", "manifest", "message", "slot")

    def __init__(
        self, message: Sample, manifest: Manifest, index: PointIndex, link: Replier | None = None, slot: int = 0
    ) -> None:
        self.message, self.manifest, self.slot, self._index, self._link = message, manifest, slot, index, link

    def of_slot(self, slot: int) -> SampleView:
        """Return another slot of the same sample."""
        return SampleView(self.message, self.manifest, self._index, self._link, slot)

    @property
    def episode(self) -> int:
        """Number of the episode, from 0."""
        return self.message.episode[self.slot]

    @property
    def step(self) -> int:
        """Number of the sample in its episode; 0 is the state after warm-up."""
        return self.message.step[self.slot]

    @property
    def time(self) -> datetime:
        """Local standard time at the end of the timestep, naive."""
        return datetime.fromisoformat(self.message.time[self.slot])

    @property
    def truncated(self) -> bool:
        """Whether this is the episode's last sample, at the end of the run period."""
        return bool(self.message.flags[self.slot] & _TRUNCATED)

    @property
    def fallback(self) -> bool:
        """Whether the timestep that ends with this sample ran without a command of a required controller."""
        return bool(self.message.flags[self.slot] & _FALLBACK)

    @property
    def values(self) -> Floats:
        """Values of sensors, then meters, shape (points,), in manifest order and units."""
        return self._points(self.message.values, "values")

    @property
    def fault_free_values(self) -> Floats:
        """Values as the plant computed them: `values` without the faults that the node injects; same shape."""
        raw = self.message.fault_free_values
        return self._points(raw, "fault_free_values") if raw else self.values

    @property
    def effective(self) -> Floats:
        """Effective value of each actuator, shape (actuators,); NaN where the plant does not report it."""
        return self._actuators(self.message.effective, "effective")

    @property
    def baseline(self) -> Floats | None:
        """`values` of the same building under baseline control; None unless the node runs a baseline."""
        return self._points(self.message.baseline, "baseline") if self.manifest.baseline else None

    @property
    def baseline_effective(self) -> Floats | None:
        """Effective values that the baseline control sets in `baseline`; None unless the node runs a baseline."""
        return (
            self._actuators(self.message.baseline_effective, "baseline_effective") if self.manifest.baseline else None
        )

    @property
    def commanded(self) -> Floats:
        """The command in effect for each actuator, in manifest order; NaN: relinquished."""
        raw = self.message.commanded or codec.RELINQUISHED * (self.manifest.slots * len(self.manifest.actuators))
        return self._actuators(raw, "commanded")

    def _points(self, raw: bytes, field: str) -> Floats:
        return codec.row(raw, self.slot, self.manifest.slots, len(self._index), field)

    def _actuators(self, raw: bytes, field: str) -> Floats:
        return codec.row(raw, self.slot, self.manifest.slots, len(self.manifest.actuators), field)

    @property
    def value_source(self) -> dict[str, str]:
        """Value source of each actuator by name; `""` is the baseline control."""
        shape = (self.manifest.slots, len(self.manifest.actuators))
        sources = codec.indices(self.message.source_index, shape, "source_index")[self.slot]
        return {a.name: self.message.sources[i] for a, i in zip(self.manifest.actuators, sources.tolist(), strict=True)}

    def __getitem__(self, name: str) -> float:
        """Return the value of a sensor or meter; `UnknownName` lists similar names."""
        return float(self.values[self._index[name]])

    def as_dict(self) -> dict[str, float]:
        """Return the values of all sensors and meters by name."""
        return dict(zip(self._index, self.values.tolist(), strict=True))

    def send(self, values: Mapping[str, float | None] | Floats | None = None) -> None:
        """Answer this sample; see `ControllerLink.send`."""
        if self._link is None:
            raise UsageError("this sample was received by a listener; only a controller can answer")
        self._link.send(values)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of the weather of this sample's episode; see `ControllerLink.weather`.

        Raises:
            UsageError: The sample was received by a listener.
            UnknownName: There is no such column.
        """
        if self._link is None:
            raise UsageError("this sample was received by a listener; only a controller can ask for its weather")
        return self._link.weather(columns, self.slot) if self.slot else self._link.weather(columns)

    def __repr__(self) -> str:
        return f"<sample {self.step} of episode {self.episode} at {self.message.time[self.slot]}>"


def is_after(new: Sample, old: Sample) -> bool:
    """Return whether any slot of the same episodes has advanced."""
    return new.step > old.step or any(step > before for step, before in zip(new.step, old.step, strict=True))
