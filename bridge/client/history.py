"""The history of a node's present episode in arrays, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.calendar import parse_moment_within
from zenostat.topics.errors import BadMessage, EpisodeChanged, InvalidConfig, RequestRejected, UnknownName, did_you_mean
from zenostat.topics.messages import MAX_HISTORY_POINTS, HistorySeries, Manifest

_ROUNDING = 1e-6
"""Part of a timestep by which a time may miss a sample: decimal fractions of seconds are not exact."""


@dataclass(frozen=True, slots=True)
class History:
    """Values of the present episode of a slot; `history["core_zn_air_temperature"]` is a column.

    It is a reply to a query, and not the whole run as `zenostat.recording.Trajectory` is: some of the points, and every
    k-th sample, with the extremes between.

    Attributes:
        manifest: Of the node.
        episode: Number of the episode.
        slot: Number of the slot.
        points: Names of the columns of `values`.
        units: Their units.
        stride: 1 if all samples are there; else each row stands for itself and the `stride - 1` samples before it.
        oldest_step: The earliest sample that the node keeps.
        step: Steps, shape (samples,).
        values: As published: with injected faults, and NaN where there is no value; shape (samples, points).
        lows, highs: The smallest and the largest of the values that each row stands for, shape (samples, points); None
            unless they were requested.
    """

    manifest: Manifest = field(repr=False)
    episode: int
    slot: int
    points: tuple[str, ...]
    units: tuple[str, ...]
    stride: int
    oldest_step: int
    step: NDArray[np.int64] = field(repr=False)
    values: Floats = field(repr=False)
    lows: Floats | None = field(default=None, repr=False)
    highs: Floats | None = field(default=None, repr=False)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.step)

    def __getitem__(self, name: str) -> Floats:
        """Return the values of a point, shape (samples,); `UnknownName` lists similar names."""
        if name not in self.points:
            raise UnknownName(f"no point {name!r} in this history; {did_you_mean(name, self.points)}")
        return self.values[:, self.points.index(name)]

    @property
    def time(self) -> NDArray[np.datetime64]:
        """Simulated local standard time at the end of each timestep, shape (samples,), in microseconds."""
        return sample_times(self.manifest, self.step)


def sample_times(manifest: Manifest, step: NDArray[np.int64]) -> NDArray[np.datetime64]:
    """Return simulated local standard times of samples, in microseconds, in the shape of their steps."""
    step_us = round(manifest.step_s * 1e6)
    return np.datetime64(manifest.begin, "us") + step * np.timedelta64(step_us, "us")


def first_step(manifest: Manifest, start: datetime | str | None) -> int | None:
    """Return the first step at or after a simulated time; None if there is none given."""
    return None if start is None else max(0, ceil(_steps(manifest, start, "start") - _ROUNDING))


def last_step(manifest: Manifest, end: datetime | str | None) -> int | None:
    """Return the last step at or before a simulated time; None if there is none given.

    Raises:
        InvalidConfig: The time is before the episode, or has another form.
    """
    if end is None:
        return None
    steps = floor(_steps(manifest, end, "end") + _ROUNDING)
    if steps < 0:
        raise InvalidConfig(f"end {end} is before the episode, which begins at {manifest.begin}")
    return steps


def _steps(manifest: Manifest, moment: datetime | str, what: str) -> float:
    """Return the timesteps from the begin of the episode to a time, not rounded."""
    begin = manifest.time_at(0)
    if isinstance(moment, str):
        try:
            moment = parse_moment_within(moment, begin, datetime.fromisoformat(manifest.end))
        except ValueError as error:
            raise InvalidConfig(f"{what} {moment!r}: {error}") from None
    return (moment - begin) / timedelta(seconds=manifest.step_s)


def row_count(reply: HistorySeries) -> int:
    """Return the number of samples in a reply."""
    return len(reply.values) // (codec.FLOAT.itemsize * len(reply.points))


def groups(points: Sequence[str]) -> list[Sequence[str]]:
    """Return points in groups that a query can have, of equal size but for one."""
    if len(points) <= MAX_HISTORY_POINTS:
        return [points]
    size = ceil(len(points) / ceil(len(points) / MAX_HISTORY_POINTS))
    return [points[first : first + size] for first in range(0, len(points), size)]


def join_points(parts: Sequence[History]) -> History:
    """Return one history of the points of several ones, which have the same samples.

    Raises:
        EpisodeChanged: A new episode began while they were read.
        RequestRejected: The samples are not the same.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    node = first.manifest.node
    if any(part.episode != first.episode for part in parts):
        raise EpisodeChanged(f"node {node!r} began a new episode while its history was read")
    if any(not np.array_equal(part.step, first.step) for part in parts):
        raise RequestRejected(
            f"node {node!r} replaced samples while they were read; request at most {MAX_HISTORY_POINTS} points at once"
        )

    def table(name: str) -> Floats:
        return np.concatenate([getattr(part, name) for part in parts], axis=1)

    return replace(
        first,
        points=tuple(point for part in parts for point in part.points),
        units=tuple(unit for part in parts for unit in part.units),
        values=table("values"),
        lows=table("lows") if first.lows is not None else None,
        highs=table("highs") if first.highs is not None else None,
    )


def join_replies(manifest: Manifest, slot: int, replies: Sequence[HistorySeries]) -> History:
    """Return the content of consecutive replies."""
    first = replies[0]

    def table(name: str) -> Floats:
        rows = [codec.floats(getattr(r, name), (row_count(r), len(first.points)), name) for r in replies]
        return rows[0] if len(rows) == 1 else np.concatenate(rows)

    values = table("values")
    if not len(values):
        raise BadMessage("a history without samples")
    return History(
        manifest=manifest,
        episode=first.episode,
        slot=slot,
        points=tuple(first.points),
        units=tuple(first.units),
        stride=first.stride,
        oldest_step=first.oldest_step,
        step=first.first_step + first.stride * np.arange(len(values), dtype=np.int64),
        values=values,
        lows=table("lows") if first.lows else None,
        highs=table("highs") if first.highs else None,
    )
