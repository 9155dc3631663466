"""Search for the best sequence of actions of an episode on its true model.

A *sweep* goes through the episode once: at each block it compares the best sequence so far with changed ones over the
next hours, as a model predictive controller does, and continues with the best. A stage of *windows* compares whole
episodes: several windows change at the same time, so far apart that the costs of each show what its change is worth,
and the best change of each is kept. The charge for the peak, which couples them, is counted exactly (`combine`). Both
keep only what improves the return of the whole episode.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zenostat.lab.benchmark.bound_moves import Actions, SequenceSpace, Windows, changed, changed_plans, combine
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import SimulatorError

BATCH = 8
"""Sequences that are simulated at the same time; results depend on it, so it is not an option."""
STAGES_H: tuple[float | None, ...] = (4.0, 8.0, None, 16.0, None)
"""Horizons of the sweeps in h, and None for a stage of windows; the search repeats them."""
WINDOW_SIMULATIONS = 64
"""Simulations of a stage of windows."""
_BLOCK_H = 1.0
"""Time between two comparisons of a sweep."""
_LEAST_GAIN = 1e-9


@dataclass(frozen=True)
class Simulated:
    """The outcomes of several sequences.

    Attributes:
        returns: sums of the rewards, shape (sequences,).
        rewards: rewards without the charge for the peak, shape (sequences, timesteps).
        demand: mean power whose peak is charged, kW; 0 where there is no charge; same shape.
        charge: charge per kW of the episode's peak.
    """

    returns: Floats
    rewards: Floats
    demand: Floats
    charge: float


class Model(Protocol):
    """The model of an episode; `SimulatorError` if actions make it fail."""

    def simulate(self, sequences: Sequence[Actions]) -> Simulated:
        """Simulate at most `BATCH` whole episodes."""

    def begin(self) -> None:
        """Go to the first sample of the episode."""

    def compare(self, plans: Actions) -> Floats:
        """Return the returns of plans from the present sample on; shape (plans, timesteps, actions) to (plans,)."""

    def advance(self, actions: Actions) -> float:
        """Simulate the next timesteps with actions of shape (timesteps, actions), and return the sum of rewards."""


@dataclass(frozen=True)
class Best:
    """The best sequence so far.

    Attributes:
        actions: the sequence.
        value: its return.
        simulations: simulated timesteps of the search so far, in episodes.
        stages: number of finished stages.
        curve: simulations and return at each improvement.
    """

    actions: Actions
    value: float
    simulations: int = 0
    stages: int = 0
    curve: tuple[tuple[int, float], ...] = ()

    def improved(self, actions: Actions, value: float, simulations: int) -> Best:
        """Return a better sequence, or the same one if this one is not better."""
        if value <= self.value + _LEAST_GAIN:
            return self
        return Best(actions, value, self.simulations, self.stages, (*self.curve, (simulations, value)))


def search(space: SequenceSpace, model: Model, start: Best, *, simulations: int, seed: int) -> Iterator[Best]:
    """Improve a sequence; yield the best one after each stage.

    A stage depends on the seed, its number and the best sequence before it only, so a search that continues from what
    it yielded last gives the same results as one without interruption.

    Args:
        space: bounds and days.
        model: simulates the episode.
        start: a sequence with its return; its simulations count.
        simulations: total at which the search ends. A sweep that would exceed it is replaced by windows.
        seed: seed of the search.
    """
    best = start
    while best.simulations < simulations:
        random = np.random.default_rng([seed, best.stages])
        left, horizon_h = simulations - best.simulations, STAGES_H[best.stages % len(STAGES_H)]
        horizon = None if horizon_h is None else max(1, round(horizon_h / 24.0 * space.day))
        if horizon is None or _sweep_simulations(space, horizon) > left:
            used = min(WINDOW_SIMULATIONS, left)
            stage_best = _search_windows(space, model, best, used, random)
        else:
            used = _sweep_simulations(space, horizon)
            stage_best = _sweep(space, model, best, horizon, random)
        total = best.simulations + used
        best = Best(stage_best.actions, stage_best.value, total, best.stages + 1, stage_best.curve)
        yield best


def _block(space: SequenceSpace) -> int:
    return max(1, round(_BLOCK_H / 24.0 * space.day))


def _sweep_simulations(space: SequenceSpace, horizon: int) -> int:
    """Return the simulated timesteps of a sweep, in episodes: those of the plans and the episode itself."""
    starts = np.arange(0, space.timesteps, _block(space))
    timesteps = BATCH * np.minimum(horizon, space.timesteps - starts).sum() + space.timesteps
    return int(-(-timesteps // space.timesteps))


def _sweep(space: SequenceSpace, model: Model, best: Best, horizon: int, random: np.random.Generator) -> Best:
    actions, total, block = best.actions.copy(), 0.0, _block(space)
    model.begin()
    for first in range(0, space.timesteps, block):
        end = min(first + horizon, space.timesteps)
        plans = changed_plans(actions, first, end, BATCH - 1, space, random)
        try:
            top = int(model.compare(plans).argmax())  # of equals, the first one, which is unchanged
        except SimulatorError:
            top = 0
        actions[first:end] = plans[top]
        total += model.advance(actions[first : first + block])
    return best.improved(actions, total, best.simulations + _sweep_simulations(space, horizon))


def _search_windows(
    space: SequenceSpace, model: Model, start: Best, simulations: int, random: np.random.Generator
) -> Best:
    """Change windows; the first sequence of each batch has the best changes of the batch before it."""
    best, count, end = start, start.simulations, start.simulations + simulations
    center = best.actions
    while count < end:
        windows = Windows.at(space, int(random.integers(2 * space.day)))
        options = [center]
        options += [changed(center, windows, space, random) for _ in range(min(BATCH, end - count) - 1)]
        count += len(options)
        try:
            outcome = model.simulate(options)
        except SimulatorError:
            center = best.actions
            continue
        top = int(outcome.returns.argmax())
        former, best = best, best.improved(options[top], float(outcome.returns[top]), count)
        if best is former and outcome.returns[0] < best.value - _LEAST_GAIN:
            center = best.actions  # together, the changes are not worth what each is alone
            continue
        chosen = combine(windows.costs(outcome.rewards), windows.peaks(outcome.demand), outcome.charge)
        center = windows.joined(options, chosen)
    return best
