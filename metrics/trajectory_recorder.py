"""Recorder of trajectories, from the samples of an episode as they come."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.client.sample import SampleView
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import UsageError
from zenostat.topics.messages import Manifest

_ROWS = 256
_TERM = "term "


class TrajectoryRecorder:
    """Records the samples of an episode; a sample 0, or one before the first one, starts again.

    Arrays grow to twice their size, at most to that of the episode, so that a further sample only costs its copy.

    Args:
        manifest: Of the node.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._first, self._count = -1, 0
        self._identity: dict[str, Any] = {}
        self._sources: dict[str, int] = {"": 0}
        self._message_sources: list[str] = [""]
        self._numbers = np.zeros(1, np.uint16)
        self._arrays: dict[str, NDArray[Any]] = {}

    def __len__(self) -> int:
        """Return the number of samples so far."""
        return self._count

    def add(self, sample: SampleView, terms: Mapping[str, Any] | None = None, *, orders: Floats | None = None) -> None:
        """Add a sample, with the reward terms and the actuator values of the timestep that it closes."""
        step, message, manifest = sample.step, sample.message, self._manifest
        if self._first < 0 or step == 0 or step < self._first:
            self._first, self._count, self._arrays = step, 0, {}
            self._identity = {"number": sample.episode, "slot": sample.slot}
        row = step - self._first
        self._put("values", row, sample.values)
        if message.fault_free_values and "fault_free_values" not in self._arrays:
            self._arrays["fault_free_values"] = self._arrays["values"].copy()
        if "fault_free_values" in self._arrays:
            self._put("fault_free_values", row, sample.fault_free_values)
        self._put("effective", row, sample.effective)
        if message.sources != self._message_sources:
            self._message_sources = list(message.sources)
            numbers = [self._sources.setdefault(name, len(self._sources)) for name in self._message_sources]
            self._numbers = np.array(numbers, np.uint16)
        shape = (manifest.slots, len(manifest.actuators))
        self._put(
            "source_index", row,
            self._numbers[codec.indices(message.source_index, shape, "source_index")[sample.slot]],
        )  # fmt: skip
        if manifest.baseline:
            self._put("baseline", row, sample.baseline)
            self._put("baseline_effective", row, sample.baseline_effective)
        if orders is not None:
            self._put("orders", row, orders)
        for name, term in (terms or {}).items() if row else ():
            self._put(_TERM + name, row - 1, np.float64(term))
        self._count = row + 1

    def _put(self, name: str, row: int, value: Any) -> None:
        array = self._arrays.get(name)
        if array is None or row >= len(array):
            whole = self._manifest.steps - self._first + 1
            rows = max(min(2 * len(array), whole) if array is not None else min(_ROWS, whole), row + 1)
            like = np.asarray(value) if array is None else array[0]
            array = self._arrays[name] = _extended(array, rows, like)
        array[row] = value

    def trajectory(self, source_names: Mapping[str, str] | None = None, *, min_steps: int = 1) -> Trajectory:
        """Return the samples so far; the arrays are views, which later samples of the episode do not change.

        Args:
            source_names: Names to show instead of those of value sources on the bus.
            min_steps: Number of timesteps that are needed.

        Raises:
            UsageError: Fewer timesteps have been recorded.
        """
        count = self._count
        if count < min_steps + 1:
            raise UsageError("no timestep was recorded")
        arrays: dict[str, Any] = {
            name: array[:count] if len(array) >= count else _extended(array, count, array[0])
            for name, array in [*self._arrays.items()]  # another thread may add samples
        }
        terms = {name.removeprefix(_TERM): arrays.pop(name)[:-1] for name in [*arrays] if name.startswith(_TERM)}
        return Trajectory(
            self._manifest, np.arange(self._first, self._first + count),
            sources=tuple((source_names or {}).get(name, name) for name in self._sources), terms=terms,
            **arrays, **self._identity,
        )  # fmt: skip

    def copy(self) -> TrajectoryRecorder:
        """Return a recorder that continues from the same samples, independent of this one."""
        other = TrajectoryRecorder(self._manifest)
        other._first, other._count, other._identity = self._first, self._count, self._identity
        other._sources, other._message_sources = dict(self._sources), self._message_sources
        other._numbers = self._numbers
        other._arrays = {name: array[: self._count].copy() for name, array in self._arrays.items()}
        return other


def _extended(array: NDArray[Any] | None, rows: int, like: NDArray[Any]) -> NDArray[Any]:
    """Return an array of more rows of one shape, NaN or 0 where there was none."""
    more = np.full((rows, *like.shape), np.nan if like.dtype.kind == "f" else 0, like.dtype)
    if array is not None:
        more[: len(array)] = array
    return more
