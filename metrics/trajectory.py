"""Trajectory: one run in arrays, with names, units and times."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.client.history import first_step, last_step, sample_times
from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.metrics.labels import unused_name
from zenostat.metrics.parquet import write_table
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.messages import Aggregation, Manifest

_PER_STEP = ("actions", "rewards")
_COLUMNS = frozenset(("episode", "slot", "step", "time", "wall_time", "reward"))
"""Columns of tables that no point's column replaces."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """One run of a slot, from its first sample to its last; `trajectory["core_zn_air_temperature"]` is a column.

    Row k of each array is a sample. Row 0 is the state before the first timestep; `actions`, `rewards` and `terms` have
    an entry for each timestep, so that entry k belongs to row k + 1. Rows of samples that were not received are NaN.
    What was not recorded is None, or empty.

    Attributes:
        manifest: Of the node: names, units and times of what the columns are.
        step: Steps, shape (samples,).
        values: Sensors, then meters, as published, shape (samples, points).
        effective: Effective values of the actuators, shape (samples, actuators); NaN where unknown.
        source_index: Index into `sources` by actuator, shape (samples, actuators).
        sources: Names of value sources; the first, `""`, is baseline control.
        fault_free_values: `values` without injected faults; the same array if none were injected.
        orders: Actuator values that the plant received for the timestep that ends with the sample, shape (samples,
            actuators); NaN where relinquished, and in the first row.
        baseline, baseline_effective: As `values` and `effective`, under baseline control.
        wall_time: UTC at which the node published each sample, shape (samples,).
        flags: `zenostat.topics.messages.Flag`, shape (samples,).
        not_accepted: Commands that were late, and commands that were rejected, since the node started, shape
            (samples, 2).
        actions: Of the agent, shape (steps, actions), or (steps,) for a single discrete action.
        rewards: Shape (steps,).
        terms: Terms of the reward by name, each of shape (steps,).
        outdoor: Outdoor temperature and solar radiation, for the whole episode.
        number: Number of the episode on its node.
        slot: Number of the slot.
        seed: Of the reset; None if it had none, or if the episode began before the recording.
        weather: Name of the weather file; empty if the plant has none, or if the episode began before the recording.
        snapshot: Snapshot that the episode continues; empty if it began at step 0.
    """

    manifest: Manifest = field(repr=False)
    step: NDArray[np.int64] = field(repr=False)
    values: Floats = field(repr=False)
    effective: Floats = field(repr=False)
    source_index: NDArray[np.uint16] = field(repr=False)
    sources: tuple[str, ...] = field(repr=False)
    fault_free_values: Floats = field(default=None, repr=False)  # type: ignore[arg-type]
    orders: Floats | None = field(default=None, repr=False)
    baseline: Floats | None = field(default=None, repr=False)
    baseline_effective: Floats | None = field(default=None, repr=False)
    wall_time: NDArray[np.datetime64] | None = field(default=None, repr=False)
    flags: NDArray[np.int64] | None = field(default=None, repr=False)
    not_accepted: NDArray[np.int64] | None = field(default=None, repr=False)
    actions: NDArray[Any] | None = field(default=None, repr=False)
    rewards: Floats | None = field(default=None, repr=False)
    terms: Mapping[str, Floats] = field(default_factory=dict, repr=False)
    outdoor: EpisodeWeather | None = field(default=None, repr=False)
    number: int = 0
    slot: int = 0
    seed: int | None = None
    weather: str = ""
    snapshot: str = ""

    def __post_init__(self) -> None:
        if self.fault_free_values is None:
            object.__setattr__(self, "fault_free_values", self.values)

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

    @property
    def units(self) -> dict[str, str]:
        """Unit of each point by its name."""
        return {point.name: point.unit for point in (*self.manifest.points, *self.manifest.actuators)}

    @property
    def steps(self) -> int:
        """Number of timesteps."""
        return len(self.step) - 1

    @property
    def incomplete_steps(self) -> int:
        """Number of timesteps that lack a value of a point which has values in others."""
        missing = np.isnan(self.fault_free_values[1:])
        return int(missing[:, ~missing.all(axis=0)].any(axis=1).sum())

    @property
    def step_h(self) -> float:
        """Length of a timestep in hours."""
        return self.manifest.step_h

    @property
    def time(self) -> NDArray[np.datetime64]:
        """Simulated local standard time at the end of each timestep, shape (samples,), in microseconds."""
        return sample_times(self.manifest, self.step)

    @property
    def begin(self) -> datetime:
        """Time of the first row, naive local standard time."""
        return self.manifest.time_at(int(self.step[0]))

    @property
    def end(self) -> datetime:
        """Time of the last row."""
        return self.begin + self.steps * self.manifest.timestep

    def begins(self) -> list[datetime]:
        """Return the time at which each timestep begins, shape (steps,)."""
        return [self.begin + k * self.manifest.timestep for k in range(self.steps)]

    def value_source(self, actuator: str) -> NDArray[np.str_]:
        """Return the name of the value source of an actuator at each sample, shape (samples,).

        Raises:
            UnknownName: There is no such actuator.
        """
        if actuator not in self.actuators:
            raise UnknownName(f"no actuator {actuator!r} in the recording; {did_you_mean(actuator, self.actuators)}")
        return np.array(self.sources)[self.source_index[:, self.actuators.index(actuator)]]

    # Parts

    def between_steps(self, first: int | None = None, last: int | None = None) -> Trajectory:
        """Return the samples from one step to another, both inclusive; the arrays are views."""
        low, high = np.searchsorted(self.step, (self.step[0] if first is None else first, self.step[-1] + 1))
        stop = high if last is None else np.searchsorted(self.step, last, side="right")
        return _mapped(self, lambda rows: rows[low:stop], lambda entries: entries[low : max(stop - 1, low)])

    def between(self, start: datetime | str | None = None, end: datetime | str | None = None) -> Trajectory:
        """Return the samples from one simulated time to another, both inclusive; the arrays are views.

        Args:
            start: Time, or a text such as `07-03T06:00`; None is the first sample.
            end: As `start`; None is the last sample.

        Raises:
            InvalidConfig: A text is no time, the end is before the episode, or there is no sample between the times.
        """
        part = self.between_steps(first_step(self.manifest, start), last_step(self.manifest, end))
        if not len(part):
            raise InvalidConfig(
                f"no sample from {start or self.begin} to {end or self.end}: the run has those from {self.begin} to "
                f"{self.end}"
            )
        return part

    def resample(self, interval: timedelta) -> Trajectory:
        """Return the run in longer timesteps, which its manifest has as well; what fills no timestep is left out.

        Of the timesteps that form one, sensors and values of actuators are means; meters, sensors that are sums,
        rewards and terms are sums; and all else is that of the last one. Actions are left out.

        Raises:
            InvalidConfig: The interval is not a multiple of the timestep, or longer than the run.
        """
        manifest, count = self.manifest, max(round(interval / self.manifest.timestep), 1)
        first = -int(self.step[0]) % count
        steps = (self.steps - first) // count
        if interval != count * manifest.timestep or steps < 1:
            raise InvalidConfig(
                f"cannot resample {self.steps} timesteps of {manifest.step_s:g} s to {interval.total_seconds():g} s"
            )
        stop = first + steps * count
        is_sum = [sensor.aggregation is Aggregation.SUM for sensor in manifest.sensors] + [True] * len(manifest.meters)

        def summed(entries: Floats) -> Floats:
            sums: Floats = entries[first:stop].reshape(steps, count, *entries.shape[1:]).sum(axis=1)
            return sums

        def means(rows: Floats | None) -> Any:
            return None if rows is None else np.concatenate([rows[first : first + 1], summed(rows[1:]) / count])

        def points(rows: Floats | None) -> Any:
            table = means(rows)
            if table is not None:
                table[1:, is_sum] *= count
            return table

        plain = replace(self, actions=None, rewards=None, terms={})
        last = _mapped(plain, lambda rows: rows[first : stop + 1 : count], lambda entries: entries)
        values = points(self.values)
        has_faults = self.fault_free_values is not self.values
        return replace(
            last,
            manifest=manifest.model_copy(update={"step_s": manifest.step_s * count, "steps": manifest.steps // count}),
            step=last.step // count,
            values=values,
            fault_free_values=points(self.fault_free_values) if has_faults else values,
            effective=means(self.effective),
            orders=means(self.orders),
            baseline=points(self.baseline),
            baseline_effective=means(self.baseline_effective),
            rewards=None if self.rewards is None else summed(self.rewards),
            terms={name: summed(term) for name, term in self.terms.items()},
        )

    def under_baseline(self) -> Trajectory:
        """Return the run of the same building under baseline control, which the node simulated as well.

        Raises:
            InvalidConfig: The node simulated no baseline.
        """
        if self.baseline is None or self.baseline_effective is None:
            raise InvalidConfig(f"the node {self.manifest.node} simulated no baseline")
        return replace(
            self, values=self.baseline, fault_free_values=self.baseline, effective=self.baseline_effective,
            source_index=np.zeros_like(self.source_index), orders=None, actions=None, rewards=None, terms={},
            not_accepted=None,
        )  # fmt: skip

    # Tables

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return a table of what was recorded, with a row for each sample; all arrays have the shape (samples,).

        Fault-free values are in the columns `{point}.fault_free` if faults were injected, the value source of each
        actuator in `{actuator}.source`, rewards and their terms in `reward` and `reward.{term}`, NaN in the first row.
        A column whose name is in use has another one: the point `time` is in `time_2` (see `renamed`).
        """
        return {name: column for name, (_, column) in self._table().items()}

    @property
    def renamed(self) -> dict[str, str]:
        """Points and actuators whose column has another name, by this name."""
        return {name: point for name, (point, _) in self._table().items() if point not in ("", name)}

    @property
    def column_units(self) -> dict[str, str]:
        """Unit of each column of `columns` that has one."""
        units = self.units
        return {name: units[point] for name, (point, _) in self._table().items() if point}

    def _table(self) -> dict[str, tuple[str, NDArray[Any]]]:
        """Return the columns by name, each with the point or actuator whose values it has ("" for others)."""
        count = len(self)
        table: dict[str, tuple[str, NDArray[Any]]] = {
            "episode": ("", np.full(count, self.number)),
            "slot": ("", np.full(count, self.slot)),
            "step": ("", self.step),
            "time": ("", self.time),
        }
        if self.wall_time is not None:
            table["wall_time"] = "", self.wall_time
        rewards = {} if self.rewards is None else {"reward": self.rewards}
        rewards |= {f"reward.{name}": term for name, term in self.terms.items()}
        fixed, used = {*_COLUMNS, *rewards}, {*_COLUMNS, *rewards, *self.manifest.names, *self.actuators}

        def add(name: str, column: NDArray[Any], point: str = "") -> None:
            if not point or name in fixed:
                name = unused_name(name, used)
                used.add(name)
            table[name] = point, column

        for index, name in enumerate(self.manifest.names):
            add(name, self.values[:, index], name)
        if self.fault_free_values is not self.values:
            for index, name in enumerate(self.manifest.names):
                add(f"{name}.fault_free", self.fault_free_values[:, index])
        for index, name in enumerate(self.actuators):
            add(name, self.effective[:, index], name)
            add(f"{name}.source", self.value_source(name))
        return table | {name: ("", np.insert(entries, 0, np.nan)) for name, entries in rewards.items()}

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

    def to_parquet(self, path: str | Path) -> None:
        """Write `columns` to a Parquet file, with the units of points in the metadata of its fields.

        Raises:
            InvalidConfig: pyarrow is not installed.
        """
        write_table(self.columns(), self.column_units, {"node": self.manifest.node}, Path(path))


def _mapped(trajectory: Trajectory, rows: Callable[[Any], Any], entries: Callable[[Any], Any]) -> Trajectory:
    """Return a copy, with a function applied to each array of samples, and another to each array of timesteps."""
    arrays = {f.name: getattr(trajectory, f.name) for f in fields(trajectory)}
    arrays = {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}
    changed = {name: (entries if name in _PER_STEP else rows)(array) for name, array in arrays.items()}
    if trajectory.fault_free_values is trajectory.values:
        changed["fault_free_values"] = changed["values"]
    return replace(trajectory, **changed, terms={name: entries(term) for name, term in trajectory.terms.items()})
