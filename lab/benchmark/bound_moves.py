"""Sequences of the actions of an episode, and changes of parts of them.

A sequence has an action for each timestep of an episode, shape (timesteps, actions), float32.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

Actions = NDArray[np.float32]

LONGEST_CHANGE_H = 12.0
_RESOLUTION = 32.0
"""Changed values are multiples of 1/32 of the unit, which float32 represents exactly and which compress well."""
_SMALLEST, _LARGEST = 0.01, 0.3
"""Standard deviation of a shift, as a share of an action's range."""


@dataclass(frozen=True)
class SequenceSpace:
    """The sequences of one episode.

    Attributes:
        low, high: bounds of the actions, shape (actions,).
        days: days of the episode.
        day: timesteps of a day.
        pairs: positions of heating and cooling setpoints that must not cross.
    """

    low: Floats
    high: Floats
    days: int
    day: int
    pairs: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, manifest: Manifest, low: Floats, high: Floats, pairs: Sequence[tuple[int, int]] = ()) -> SequenceSpace:
        """Return the episode of a node.

        Raises:
            InvalidConfig: an action has no bounds, or the episode is not one of whole days.
        """
        if not (len(low) and np.isfinite(low).all() and np.isfinite(high).all()):
            raise InvalidConfig("a bound is searched between the bounds of continuous actions, which are missing")
        day = round(86400.0 / manifest.step_s)
        if manifest.steps % day or day * manifest.step_s != 86400.0:
            raise InvalidConfig(f"{manifest.steps} timesteps of {manifest.step_s:g} s; whole days expected")
        return cls(low.astype(np.float64), high.astype(np.float64), manifest.steps // day, day, tuple(pairs))

    @property
    def timesteps(self) -> int:
        """Number of timesteps."""
        return self.day * self.days

    def allowed(self, values: NDArray[np.floating]) -> Actions:
        """Return values clipped to the bounds, with crossed setpoints moved apart to their middle."""
        clipped = np.clip(np.asarray(values, np.float64), self.low, self.high)
        for heating, cooling in self.pairs:
            middle = (clipped[..., heating] + clipped[..., cooling]) / 2.0
            crossed = clipped[..., heating] > clipped[..., cooling]
            for index in (heating, cooling):
                clipped[..., index] = np.where(crossed, middle, clipped[..., index])
        # Rounding to float32 may leave the bounds by a unit in the last place.
        return np.clip(clipped.astype(np.float32), self.low.astype(np.float32), self.high.astype(np.float32))


@dataclass(frozen=True)
class Windows:
    """Parts of an episode whose costs are compared, each with a window that may change in it.

    A part begins with its window, at most a day long, and ends a day later, since what a change costs shows until then.

    Attributes:
        bounds: first timestep of each part and the end of the last one.
        changing: first timestep and end of each part's window.
    """

    bounds: tuple[int, ...]
    changing: tuple[tuple[int, int], ...]

    @classmethod
    def at(cls, space: SequenceSpace, phase: int) -> Windows:
        """Return windows whose first whole part begins at a timestep from 0 to two days."""
        timesteps, day = space.timesteps, space.day
        inner = range(phase % (2 * day), timesteps, 2 * day)
        bounds = sorted({0, *inner, timesteps})
        changing = []
        for first, end in pairwise(bounds):
            # The part before the first whole one is shorter; the last one ends with the episode.
            window = first + day if first or not phase else max(first, end - day)
            changing.append((first, min(window, end)))
        return cls(tuple(bounds), tuple(changing))

    def costs(self, rewards: Floats) -> Floats:
        """Return the cost of each part, shape (..., parts), of rewards of shape (..., timesteps)."""
        return -np.add.reduceat(rewards, self.bounds[:-1], axis=-1)

    def peaks(self, demand: Floats) -> Floats:
        """Return the highest demand in each part, shape (..., parts)."""
        return np.maximum.reduceat(demand, self.bounds[:-1], axis=-1)

    def joined(self, options: Sequence[Actions], chosen: NDArray[np.intp]) -> Actions:
        """Return the sequence that has in each part the actions of the chosen option."""
        parts = zip(pairwise(self.bounds), chosen, strict=True)
        return np.concatenate([options[option][first:end] for (first, end), option in parts])


def combine(costs: Floats, peaks: Floats, charge: float) -> NDArray[np.intp]:
    """Choose an option for each part so that the sum of costs and the charge for the highest peak are least.

    For each limit on the peak, the cheapest option below it is the best one of each part, so that trying all limits is
    exact. Of equal options, the first one is chosen.

    Args:
        costs: without the charge, shape (options, parts).
        peaks: shape (options, parts).
        charge: per unit of the highest peak of all parts, at least 0.

    Returns:
        Shape (parts,).
    """
    parts = np.arange(costs.shape[1])
    best, least = np.zeros(len(parts), np.intp), math.inf
    for limit in np.unique(peaks)[::-1]:
        options = np.where(peaks <= limit, costs, math.inf)
        chosen = options.argmin(axis=0)
        total = options[chosen, parts].sum() + charge * peaks[chosen, parts].max()
        if total < least:
            best, least = chosen, total
    return best


def changed(actions: Actions, windows: Windows, space: SequenceSpace, random: np.random.Generator) -> Actions:
    """Return a sequence with one random change in each window."""
    values = actions.astype(np.float64)
    for first, end in windows.changing:
        if first < end:
            _change(values, first, end, space, random)
    return space.allowed(values)


def changed_plans(
    actions: Actions, first: int, end: int, count: int, space: SequenceSpace, random: np.random.Generator
) -> Actions:
    """Return a part of a sequence, and variants of it with one or two random changes.

    Args:
        actions: the sequence.
        first: first timestep of the part.
        end: its end.
        count: number of variants.
        space: bounds and days.
        random: generator of the changes.

    Returns:
        Shape (1 + count, end - first, actions); the first one is unchanged.
    """
    plans = [actions[first:end]]
    for _ in range(count):
        values = actions.astype(np.float64)
        for _ in range(1 if random.random() < 0.7 else 2):
            _change(values, first, first + max(1, int(random.uniform(0.1, 1.0) * (end - first))), space, random)
        plans.append(space.allowed(values[first:end]))
    return np.stack(plans)


def _change(values: Floats, first: int, end: int, space: SequenceSpace, random: np.random.Generator) -> None:
    """Change an interval within a window in place: shift it, continue its neighbor, copy a day, or go to a bound."""
    longest = min(end - first, round(LONGEST_CHANGE_H / 24.0 * space.day))
    length = int(np.exp(random.uniform(0.0, math.log(longest + 1))))
    begin = int(random.integers(first, end - length + 1))
    until = begin + length
    span = space.high - space.low
    is_single = random.random() < 0.6
    columns = [int(random.integers(len(span)))] if is_single else list(range(len(span)))
    kind = random.random()
    if kind < 0.2:  # the edge of a block moves
        neighbor = begin - 1 if random.random() < 0.5 else until
        if 0 <= neighbor < len(values):
            values[begin:until, columns] = values[neighbor, columns]
            return
    elif kind < 0.35:
        days = int(random.integers(1, max(2, space.days)))
        source = begin + (days if random.random() < 0.5 else -days) * space.day
        if 0 <= source <= len(values) - length:
            values[begin:until, columns] = values[source : source + length, columns]
            return
    elif kind < 0.45:
        column = int(random.integers(len(span)))
        values[begin:until, column] = (space.low if random.random() < 0.5 else space.high)[column]
        return
    size = math.exp(random.uniform(math.log(_SMALLEST), math.log(_LARGEST)))
    shift = random.normal(size=len(columns)) * size * span[columns]
    values[begin:until, columns] += _at_least_one(_rounded(shift))


def _rounded(values: Floats) -> Floats:
    rounded: Floats = np.round(values * _RESOLUTION) / _RESOLUTION
    return rounded


def _at_least_one(shift: Floats) -> Floats:
    return np.where(shift == 0.0, 1.0 / _RESOLUTION, shift)
