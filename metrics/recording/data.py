"""The content of a recording."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.metrics.recording.log import LogEntry
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.messages import Event, Manifest

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Episode:
    """The samples of one episode in one slot; `episode["core_zn_air_temperature"]` is a column.

    Attributes:
        manifest: Of the node, at the begin of the recording.
        number: Number of the episode on its node.
        slot: Number of the slot.
        seed: Of the reset; None if it had none, or if the episode began before the recording.
        weather: Name of the weather file; empty if the plant has none, or if the episode began before the recording.
        snapshot: Snapshot that the episode continues; empty if it began at step 0.
        step: Steps, shape (samples,).
        time: Simulated local standard time at the end of each timestep, shape (samples,), in microseconds.
        wall_time: UTC at which the node published each sample, shape (samples,).
        values: Sensors and meters as published, shape (samples, points).
        fault_free_values: The same without injected faults; the same array if none were injected.
        effective: Effective values of the actuators, shape (samples, actuators); NaN where unknown.
        orders: Actuator values that the plant received for the timestep that ends with the sample, shape (samples,
            actuators); NaN where relinquished, and in the first row.
        source_index: Index into `sources` by actuator, shape (samples, actuators).
        sources: Names of value sources; the first is baseline control.
        flags: `zenostat.topics.messages.Flag`, shape (samples,).
        baseline, baseline_effective: As `values` and `effective`, under baseline control; None without a baseline.
    """

    manifest: Manifest = field(repr=False)
    number: int
    slot: int
    seed: int | None
    weather: str
    snapshot: str
    step: NDArray[np.int64] = field(repr=False)
    time: NDArray[np.datetime64] = field(repr=False)
    wall_time: NDArray[np.datetime64] = field(repr=False)
    values: Floats = field(repr=False)
    fault_free_values: Floats = field(repr=False)
    effective: Floats = field(repr=False)
    orders: Floats = field(repr=False)
    source_index: NDArray[np.intp] = field(repr=False)
    sources: tuple[str, ...] = field(repr=False)
    flags: NDArray[np.int64] = field(repr=False)
    baseline: Floats | None = field(repr=False)
    baseline_effective: Floats | None = field(repr=False)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.step)

    def __getitem__(self, name: str) -> Floats:
        """Return the values of a sensor or meter, or the effective values of an actuator, shape (samples,).

        Raises:
            UnknownName: There is no such point; the text lists similar names.
        """
        names, actuators = self.manifest.names, self.actuators
        if name in names:
            return self.values[:, names.index(name)]
        if name in actuators:
            return self.effective[:, actuators.index(name)]
        raise UnknownName(f"no point {name!r} in the recording; {did_you_mean(name, (*names, *actuators))}")

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of the columns of `effective`, `orders` and `source_index`."""
        return tuple(actuator.name for actuator in self.manifest.actuators)

    def value_source(self, actuator: str) -> NDArray[np.str_]:
        """Return the name of the value source of an actuator at each sample, shape (samples,).

        Raises:
            UnknownName: There is no such actuator.
        """
        if actuator not in self.actuators:
            raise UnknownName(f"no actuator {actuator!r} in the recording; {did_you_mean(actuator, self.actuators)}")
        return np.array(self.sources)[self.source_index[:, self.actuators.index(actuator)]]

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return a table of the episode: identity, values, fault-free values where they differ, effective values.

        The value source of each actuator is in the column `{actuator}.source`.
        """
        count = len(self)
        table: dict[str, NDArray[Any]] = {
            "episode": np.full(count, self.number),
            "slot": np.full(count, self.slot),
            "step": self.step,
            "time": self.time,
            "wall_time": self.wall_time,
        }
        table |= {name: self.values[:, index] for index, name in enumerate(self.manifest.names)}
        if self.fault_free_values is not self.values:
            free = self.fault_free_values
            table |= {f"{name}.fault_free": free[:, index] for index, name in enumerate(self.manifest.names)}
        for index, name in enumerate(self.actuators):
            table[name] = self.effective[:, index]
            table[f"{name}.source"] = self.value_source(name)
        return table

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` of `columns` with the simulated time as its index.

        Raises:
            InvalidConfig: pandas is not installed.
        """
        try:
            pandas = importlib.import_module("pandas")
        except ImportError as error:
            raise InvalidConfig(f"to_pandas() needs pandas ({error}): {sys.executable} -m pip install pandas") from None
        return pandas.DataFrame(self.columns()).set_index("time")


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording of a node.

    Attributes:
        path: Of the file.
        manifest: Of the node, at the begin of the recording.
        scenario: Text of the scenario file; empty for a plant without one.
        provenance: What creates the same plant again, and the SHA-256 of the files that it read.
        episodes: In the order of their numbers, then of their slots.
        events: The events that the node published, with the UTC of each.
        log: What was requested of the node, with the results.
        is_complete: Whether the recorder completed the file.
        note: Why the recording ends early; empty if it does not.
    """

    path: Path
    manifest: Manifest = field(repr=False)
    scenario: str = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    episodes: tuple[Episode, ...] = field(repr=False)
    events: tuple[tuple[datetime, Event], ...] = field(repr=False)
    log: tuple[LogEntry, ...] = field(repr=False)
    is_complete: bool
    note: str
