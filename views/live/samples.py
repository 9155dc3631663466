"""Batches of samples as arrays, with the comfort band of each zone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.comfort import Comfort, deviations
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest, Sample

BASELINE = "baseline control"
"""Name of the value source of actuators that nobody sets."""

UNRECORDED = "not recorded"
"""Value source in samples of a node's history, which does not have the sources."""


class RewardTerms(Protocol):
    """The reward terms of a running episode."""

    def __call__(self, values: Floats, begin: datetime) -> Mapping[str, float]:
        """Return the terms of the timestep that starts at `begin` and ends with the sample `values`."""
        ...


ComfortFactory = Callable[[Manifest], Comfort | None]
RewardFactory = Callable[[Manifest], RewardTerms | None]


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """Consecutive samples of slot 0 of an episode.

    Attributes:
        steps: shape (n,).
        times: simulated time, datetime64[ns], shape (n,).
        values: the points' values, shape (n, points).
        plant_values: the same without injected faults.
        effective: the actuators' effective values, shape (n, actuators).
        commanded: the commands in effect, NaN where relinquished, shape (n, actuators).
        sources: name of each actuator's value source, shape (n, actuators); empty for baseline control.
        low, high: limits of the comfort band in degC, infinite for none, shape (n, zones); no zones without a comfort
            band.
        deviations: deviation from the band in K, without injected faults: negative below the band, 0 within, NaN if
            unknown, shape (n, zones).
        is_occupied: whether each zone is occupied, shape (n, zones); True for a zone without an occupant count.
    """

    steps: NDArray[np.int64]
    times: NDArray[np.datetime64]
    values: Floats
    plant_values: Floats
    effective: Floats
    commanded: Floats
    sources: NDArray[np.object_]
    low: Floats
    high: Floats
    deviations: Floats
    is_occupied: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.steps)

    def outer_limits(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest limit of all zones, each of shape (n,); NaN where no zone has one."""
        low, high = (np.where(np.isfinite(limits), limits, np.nan) for limits in (self.low, self.high))
        return np.fmin.reduce(low, axis=1, initial=np.nan), np.fmax.reduce(high, axis=1, initial=np.nan)


class BlockReader:
    """Converts samples of one node to blocks.

    Args:
        manifest: manifest of the node.
        comfort: comfort bands of its zones, if it has zone temperatures.
    """

    def __init__(self, manifest: Manifest, comfort: Comfort | None) -> None:
        self._points = len(manifest.points)
        self._actuators = len(manifest.actuators)
        self._slots = manifest.slots
        self._relinquished = codec.RELINQUISHED * (manifest.slots * len(manifest.actuators))
        self._timestep = timedelta(seconds=manifest.step_s)
        self._comfort = comfort or Comfort("", (), (), lambda *_: (0.0, 0.0))

    def block(self, samples: Sequence[Sample]) -> SampleBlock:
        """Return the first slot of the samples as arrays."""
        values = self._rows((s.values for s in samples), self._points, "values")
        plant = (s.fault_free_values or s.values for s in samples)
        plant_values = self._rows(plant, self._points, "fault_free_values")
        low, high = self._comfort.limits_of_samples(plant_values, self._begins(samples))
        return SampleBlock(
            steps=np.array([s.step[0] for s in samples], np.int64),
            times=np.array([s.time[0] for s in samples], "datetime64[ns]"),
            values=values,
            plant_values=plant_values,
            effective=self._rows((s.effective for s in samples), self._actuators, "effective"),
            commanded=self._rows((s.commanded or self._relinquished for s in samples), self._actuators, "commanded"),
            sources=self._sources(samples),
            low=low,
            high=high,
            deviations=deviations(plant_values[:, self._comfort.zones], low, high),
            is_occupied=self._comfort.is_occupied(plant_values),
        )

    def history_block(self, manifest: Manifest, first_step: int, table: Floats) -> SampleBlock:
        """Return samples of a node's history: without commands and sources, and as if no faults were injected.

        Args:
            manifest: manifest of the node.
            first_step: step of the first sample.
            table: the points' values and the actuators' effective values, shape (n, points + actuators).
        """
        values, effective = table[:, : self._points], table[:, self._points :]
        steps = first_step + np.arange(len(table), dtype=np.int64)
        timestep_ns = round(manifest.step_s * 1e9)
        times = np.datetime64(manifest.begin, "ns") + steps * np.timedelta64(timestep_ns, "ns")
        begins = (times.astype("M8[us]") - np.timedelta64(round(manifest.step_s * 1e6), "us")).tolist()
        low, high = self._comfort.limits_of_samples(values, begins)
        return SampleBlock(
            steps=steps,
            times=times,
            values=values,
            plant_values=values,
            effective=effective,
            commanded=np.full(effective.shape, np.nan),
            sources=np.full(effective.shape, UNRECORDED, object),
            low=low,
            high=high,
            deviations=deviations(values[:, self._comfort.zones], low, high),
            is_occupied=self._comfort.is_occupied(values),
        )

    def _rows(self, raw: Iterable[bytes], width: int, what: str) -> Floats:
        rows = [codec.row(data, 0, self._slots, width, what) for data in raw]
        return np.array(rows, np.float64).reshape(len(rows), width)

    def _begins(self, samples: Sequence[Sample]) -> list[datetime]:
        return [datetime.fromisoformat(sample.time[0]) - self._timestep for sample in samples]

    def _sources(self, samples: Sequence[Sample]) -> NDArray[np.object_]:
        shape = (self._slots, self._actuators)
        table = np.empty((len(samples), self._actuators), object)
        for row, sample in zip(table, samples, strict=True):
            names = np.array(["", *sample.sources[1:]], object)
            row[:] = names[codec.indices(sample.source_index, shape, "source_index")[0]]
        return table
