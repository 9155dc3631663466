"""One sample of all slots as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.envs.time_features import time_features
from zenostat.bridge.client.sample import SampleView
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Flag

_TRUNCATED = int(Flag.TRUNCATED)


class VectorSample:
    """All slots of one sample.

    Attributes:
        sample: The sample as returned by the link.
        message: The sample message.
        values: Values of sensors, then meters, shape (slots, points), in manifest order and units; read-only.
        fault_free_values: Values as the plant computed them: `values` without injected faults; same shape.
        truncated: Whether each slot is at the end of its run period, shape (slots,).
    """

    __slots__ = ("_manifest", "fault_free_values", "message", "sample", "truncated", "values")

    def __init__(self, sample: SampleView) -> None:
        message, manifest = sample.message, sample.manifest
        self.sample, self.message, self._manifest = sample, message, manifest
        shape = manifest.slots, len(manifest.sensors) + len(manifest.meters)
        self.values = self.fault_free_values = codec.floats(message.values, shape, "values")
        if message.fault_free_values:
            self.fault_free_values = codec.floats(message.fault_free_values, shape, "fault_free_values")
        self.truncated = np.array([flag & _TRUNCATED for flag in message.flags], np.bool_)

    @property
    def effective(self) -> Floats:
        """Effective value of each actuator, shape (slots, actuators); NaN where the plant does not report it."""
        return self._actuator_values(self.message.effective, "effective")

    @property
    def baseline(self) -> dict[str, Floats]:
        """Values of points and effective values of actuators under baseline control; empty without a baseline.

        `baseline` has shape (slots, points), `baseline_effective` (slots, actuators).
        """
        message = self.message
        if not message.baseline:
            return {}
        points = codec.floats(message.baseline, self.values.shape, "baseline")
        actuators = self._actuator_values(message.baseline_effective, "baseline_effective")
        return {"baseline": points, "baseline_effective": actuators}

    def _actuator_values(self, raw: bytes, field: str) -> Floats:
        return codec.floats(raw, (self._manifest.slots, len(self._manifest.actuators)), field)

    @property
    def times(self) -> list[datetime]:
        """Local standard time at the end of each slot's timestep, naive."""
        texts = self.message.time
        if texts.count(texts[0]) == len(texts):
            return [datetime.fromisoformat(texts[0])] * len(texts)
        parsed = {text: datetime.fromisoformat(text) for text in set(texts)}
        return [parsed[text] for text in texts]

    def value_source(self, names: Sequence[str]) -> NDArray[np.object_]:
        """Return the value sources of each slot as a tuple in actuator order; `names` replaces `sources`."""
        shape = (self._manifest.slots, len(self._manifest.actuators))
        sources = np.empty(shape[0], object)
        for slot, row in enumerate(codec.indices(self.message.source_index, shape, "source_index").tolist()):
            sources[slot] = tuple(names[i] for i in row)
        return sources

    def observed(
        self, begins: Sequence[datetime], ends: Sequence[datetime], indices: NDArray[np.intp] | None = None
    ) -> NDArray[np.float32]:
        """Return the agent's observations, shape (slots, time fields + observed points).

        Args:
            begins: Local standard time at which each slot's timestep begins.
            ends: Local standard time at which it ends.
            indices: Indices of the observed points, see `zenostat.topics.points.observed_indices`; None: all.
        """
        values, fields = self.values if indices is None else self.values[:, indices], self._manifest.task.time
        slots, points = values.shape
        observed = np.empty((slots, len(fields) + points), np.float32)
        observed[:, len(fields) :] = values
        if fields and begins.count(begins[0]) == slots == ends.count(ends[0]):
            observed[:, : len(fields)] = time_features(fields, begins[0], ends[0])
        elif fields:
            features = {span: time_features(fields, *span) for span in set(zip(begins, ends, strict=True))}
            observed[:, : len(fields)] = [features[span] for span in zip(begins, ends, strict=True)]
        return observed
