"""One sample of all slots, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agent_sdk.bus.sample import SampleView
from agent_sdk.envs.time_features import time_features
from topics import codec
from topics.messages import Ack, Flag, Manifest, WeatherSeries

Floats = NDArray[np.float64]
_TRUNCATED = int(Flag.TRUNCATED)


class Link(Protocol):
    """What an environment steps: samples in, commands out."""

    manifest: Manifest
    accepted: Ack
    name: str

    def reset(self, *, seed: int | None = None) -> SampleView:
        """Starts a new episode; its sample 0."""

    def receive(self) -> SampleView:
        """Waits for the next sample."""

    def send(self, values: NDArray[np.float64], operations: bytes | None = None) -> None:
        """Answers the present sample: a value for each actuator, and what is done with it (None: all are set)."""

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Columns of the weather that the present episode reads."""

    def close(self) -> None:
        """Lets go; twice is fine."""


class VectorLink(Protocol):
    """What a vector environment steps: frames in, commands for all slots out."""

    manifest: Manifest
    accepted: Ack
    name: str

    def reset(
        self, *, seed: int | list[int | None] | None = None, slots: list[int] | None = None, snapshot: str = ""
    ) -> SampleView:
        """Starts new episodes, in these slots or in all; a frame in which they are at sample 0."""

    def receive(self) -> SampleView:
        """Waits for the next frame."""

    def send(self, values: Floats, operations: bytes | None = None, *, still: Sequence[int] = ()) -> None:
        """Answers the present frame: shape (slots, actuators); those that are `still` do not go on."""

    def weather(self, columns: Sequence[str], slot: int = 0) -> WeatherSeries:
        """Columns of the weather that a slot's present episode reads."""

    def close(self) -> None:
        """Lets go; twice is fine."""


class VectorSample:
    """All slots of one sample.

    Attributes:
        sample: as the link gave it.
        message: as it came.
        values: sensors, then meters, shape (slots, points), in manifest order and units; read-only.
        fault_free_values: what EnergyPlus said: `values`, but for the faults that the node injects into them.
        truncated: of which slots the run period is over, shape (slots,).
    """

    __slots__ = ("_manifest", "fault_free_values", "message", "sample", "truncated", "values")

    def __init__(self, sample: SampleView) -> None:
        self.sample, wire, manifest = sample, sample.message, sample.manifest
        self.message, self._manifest = wire, manifest
        shape = manifest.slots, len(manifest.sensors) + len(manifest.meters)
        self.values = self.fault_free_values = codec.floats(wire.values, shape, "values")
        if wire.fault_free_values:
            self.fault_free_values = codec.floats(wire.fault_free_values, shape, "fault_free_values")
        self.truncated = np.array([flag & _TRUNCATED for flag in wire.flags], np.bool_)

    @property
    def effective(self) -> Floats:
        """What each actuator really was, shape (slots, actuators); NaN where EnergyPlus does not tell."""
        return self._of_actuators(self.message.effective, "effective")

    @property
    def baseline(self) -> dict[str, Floats]:
        """Points (`baseline`) and actuators (`baseline_effective`) of the building left to its own control, if it runs.

        Shapes (slots, points) and (slots, actuators).
        """
        wire = self.message
        if not wire.baseline:
            return {}
        points = codec.floats(wire.baseline, self.values.shape, "baseline")
        own = self._of_actuators(wire.baseline_effective, "baseline_effective")
        return {"baseline": points, "baseline_effective": own}

    def _of_actuators(self, raw: bytes, what: str) -> Floats:
        return codec.floats(raw, (self._manifest.slots, len(self._manifest.actuators)), what)

    @property
    def times(self) -> list[datetime]:
        """Local standard time at the end of each slot's timestep, naive."""
        told = self.message.time
        if told.count(told[0]) == len(told):
            return [datetime.fromisoformat(told[0])] * len(told)
        known = {text: datetime.fromisoformat(text) for text in set(told)}
        return [known[text] for text in told]

    def value_source(self, names: Sequence[str]) -> NDArray[np.object_]:
        """Who set each actuator of each slot: a tuple for each slot, of these names in the order of `sources`."""
        shape = (self._manifest.slots, len(self._manifest.actuators))
        told = np.empty(shape[0], object)
        for slot, row in enumerate(codec.indices(self.message.source_index, shape, "source_index").tolist()):
            told[slot] = tuple(names[i] for i in row)
        return told

    def observed(self, begins: Sequence[datetime], ends: Sequence[datetime]) -> NDArray[np.float32]:
        """What an agent observes, shape (slots, time fields + points)."""
        values, fields = self.values, self._manifest.task.time
        slots, points = values.shape
        observed = np.empty((slots, len(fields) + points), np.float32)
        observed[:, len(fields) :] = values
        if fields and begins.count(begins[0]) == slots == ends.count(ends[0]):
            observed[:, : len(fields)] = time_features(fields, begins[0], ends[0])
        elif fields:
            known = {span: time_features(fields, *span) for span in set(zip(begins, ends, strict=True))}
            observed[:, : len(fields)] = [known[span] for span in zip(begins, ends, strict=True)]
        return observed


def timestep(manifest: Manifest) -> timedelta:
    """Length of a timestep."""
    return timedelta(hours=1 / manifest.steps_per_hour)
