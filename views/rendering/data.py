"""The recorded samples of an episode as arrays."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np

from zenostat.agent_sdk.envs.episode_history import EpisodeHistory
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest
from zenostat.views.rendering.scale import time_ticks


class Window:
    """The samples that a picture shows; everything that is drawn derives from it.

    Attributes:
        times: End of each timestep.
        begins: Beginning of each timestep; that of an episode's first sample is its end.
        hours: `times` in hours since the midnight before the first sample, shape (samples,).
        origin: That midnight.
        limits: The first and last hour of the time axis.
        ticks: Its round times.
        values: Shape (samples, points).
        effective: Shape (samples, actuators); NaN where EnergyPlus does not report it.
        actions: Shape (samples, dimensions); NaN before the first timestep.
        rewards: Shape (samples,); NaN before the first timestep.
        terms: Each term of the reward, shape (samples,).
        total: Sum of the rewards since the reset.
    """

    def __init__(self, history: EpisodeHistory, manifest: Manifest, dimensions: int) -> None:
        times, values, effective, actions, rewards, terms = zip(*history.rows, strict=True)
        self.times: tuple[datetime, ...] = times
        self.begins = [t if action is None else t - manifest.timestep for t, action in zip(times, actions, strict=True)]
        self.origin = times[0].replace(hour=0, minute=0, second=0, microsecond=0)
        self.hours = np.array([(time - self.origin) / timedelta(hours=1) for time in times])
        first = float(self.hours[0])
        self.limits = first, first + history.span / timedelta(hours=1)
        self.ticks = time_ticks(*self.limits)
        self.values = finite(values, len(manifest.points))
        self.effective = finite(effective, len(manifest.actuators))
        none = np.full(dimensions, np.nan)
        self.actions = finite([none if action is None else action.reshape(-1) for action in actions], dimensions)
        self.rewards = finite(rewards, 1)[:, 0]
        self.rewards[[action is None for action in actions]] = np.nan
        self.terms = {name: finite([row.get(name, np.nan) for row in terms], 1)[:, 0] for name in term_names(history)}
        self.total = history.total


def term_names(history: EpisodeHistory) -> tuple[str, ...]:
    """Return the names of the reward's terms in the latest timestep; empty if its only term is the reward itself."""
    names = tuple(history.rows[-1][5])
    return names if len(names) > 1 else ()


def finite(rows: Any, columns: int) -> Floats:
    """Return rows as an array of shape (rows, columns), with NaN for infinite values."""
    table = np.array(rows, np.float64).reshape(len(rows), columns)
    table[~np.isfinite(table)] = np.nan
    return table


def lowest(table: Floats) -> Floats:
    """Return the minimum of each row, NaN for rows without values."""
    return np.asarray(np.fmin.reduce(table, axis=1, initial=np.nan))


def highest(table: Floats) -> Floats:
    """Return the maximum of each row, NaN for rows without values."""
    return np.asarray(np.fmax.reduce(table, axis=1, initial=np.nan))


def median(table: Floats) -> Floats:
    """Return the median of each row, NaN for rows without values."""
    result = np.full(len(table), np.nan)
    known = ~np.isnan(table).all(axis=1)
    result[known] = np.nanmedian(table[known], axis=1)
    return result
