"""Synthetic samples: plausible random values for the points of a manifest."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np

from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Flag, Manifest, Meter, Sample, Sensor
from zenostat.topics.points import bounds, value_index

_RANGES = {"degC": (10.0, 35.0), "percent": (0.0, 100.0), "W": (0.0, 2e4), "J": (0.0, 1e7), "W/m2": (0.0, 900.0)}
_MAX_PEOPLE = 6


def values(manifest: Manifest, count: int, seed: int) -> Floats:
    """Return values of shape (count, points) within the points' bounds; zones are unoccupied half of the time."""
    random = np.random.default_rng([seed, 1])
    columns: Floats = np.empty((count, len(manifest.points)))
    for index, point in enumerate(manifest.points):
        columns[:, index] = _column(point, count, random)
    return columns


def _column(point: Sensor | Meter, count: int, random: np.random.Generator) -> Floats:
    if isinstance(point, Sensor) and point.variable.endswith("Occupant Count"):
        people: Floats = random.integers(1, _MAX_PEOPLE, count) * random.integers(0, 2, count).astype(float)
        return people
    low, high = _RANGES.get(point.unit, (0.0, 1.0))
    minimum, maximum = bounds(point)
    low, high = max(low, minimum), min(high, maximum)
    column: Floats = random.uniform(low, max(low, high), count)
    return column


def episode_starts(manifest: Manifest, count: int, shift_h: float = 0.0) -> list[datetime]:
    """Return the start times of `count` timesteps of an episode, moved by `shift_h` hours."""
    first = manifest.time_at(0) + timedelta(hours=shift_h)
    return [first + timedelta(seconds=k * manifest.step_s) for k in range(count)]


def samples(manifest: Manifest, count: int, seed: int) -> list[SampleView]:
    """Return new samples 0 to `count` - 1 of an episode that ends with the last of them."""
    rows = np.repeat(values(manifest, count, seed)[:, None, :], manifest.slots, axis=1)
    effective = np.full((manifest.slots, len(manifest.actuators)), np.nan)
    index = value_index(manifest)
    views = []
    for step, (row, time) in enumerate(zip(rows, episode_starts(manifest, count), strict=True)):
        flag = Flag.FIRST if step == 0 else Flag.TRUNCATED if step == count - 1 else Flag.NONE
        wire = Sample(
            episode=[seed] * manifest.slots,
            step=[step] * manifest.slots,
            time=[time.isoformat()] * manifest.slots,
            elapsed_s=[step * manifest.step_s] * manifest.slots,
            flags=[flag] * manifest.slots,
            values=row.astype("<f8").tobytes(),
            effective=effective.astype("<f8").tobytes(),
            source_index=bytes(2 * effective.size),
            sources=[""],
        )
        views.append(SampleView(wire, manifest, index))
    return views
