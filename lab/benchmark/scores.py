"""Scores relative to the baseline control, and their interquartile means with bootstrap intervals.

Source of the aggregation: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
NeurIPS 2021. The stratum of a resample is a building in a season; within it, trainings and episodes (weather and seed)
are resampled independently, because all trainings meet the same weather: a two-way bootstrap, as in Owen, "The
pigeonhole bootstrap", Annals of Applied Statistics 2007.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.lab.benchmark.definition import BASELINE
from zenostat.lab.benchmark.results_file import Row
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

CONFIDENCE = 0.95
RESAMPLES = 10_000
SEED = 20_170_101
"""Seed of the bootstrap: the same rows give the same intervals."""
_BATCH = 500
"""Resamples at a time, which bounds the memory."""

Stratum = tuple[str, str]
"""A building in a season."""
Matrix = NDArray[np.float64]
"""Scores in a stratum, shape (trainings, episodes); one training for a controller that is not trained."""
Score = Callable[[Row, Row], float | None]
"""Function from a row and that of the baseline control in the same episode to a score; None: the episode has none."""


@dataclass(frozen=True)
class Interval:
    """An interquartile mean with its confidence interval; low and high are NaN where a stratum has a single episode."""

    value: float
    low: float
    high: float
    rows: int


@dataclass(frozen=True)
class Scores:
    """Scores of one controller under one reward.

    Attributes:
        controller: its name.
        overall: interquartile mean over all rows.
        buildings: interquartile means by building.
        strata: matrices of scores by stratum.
    """

    controller: str
    overall: Interval
    buildings: dict[str, Interval]
    strata: dict[Stratum, Matrix]

    def episodes(self, building: str) -> NDArray[np.float64]:
        """Return the score of each episode in a building, the mean over trainings."""
        of_building = [matrix.mean(axis=0) for stratum, matrix in self.strata.items() if stratum[0] == building]
        return np.concatenate(of_building)


def relative_score(reward: float, baseline: float) -> float | None:
    """Return (reward - baseline) / |baseline|: 0 as the baseline control, positive if better; 1 is a reward of 0.

    Returns:
        None where the baseline's reward is 0: such a task has no score for any controller.
    """
    return None if baseline == 0.0 else (reward - baseline) / abs(baseline)


def interquartile_mean(scores: Sequence[float] | NDArray[np.float64], axis: int = -1) -> Any:
    """Return the mean of the middle half: a quarter of the scores, rounded down, is cut off at each end."""
    with requires_extra("benchmark", "the benchmark's scores", "SciPy"):
        from scipy.stats import trim_mean
    return trim_mean(np.asarray(scores, np.float64), 0.25, axis=axis)


def bootstrap_interval(strata: Sequence[Matrix]) -> Interval:
    """Return the interquartile mean over all strata, with a percentile interval of a stratified two-way bootstrap.

    Each resample draws, in each stratum, as many trainings and as many episodes as it has, with replacement, and takes
    the scores of all drawn trainings in all drawn episodes.

    Args:
        strata: matrices of scores, shape (trainings, episodes).
    """
    known = [np.asarray(stratum, np.float64) for stratum in strata if np.size(stratum)]
    count = sum(stratum.size for stratum in known)
    value = float(interquartile_mean(np.concatenate([stratum.ravel() for stratum in known])))
    if any(stratum.shape[1] < 2 for stratum in known):
        return Interval(value, float("nan"), float("nan"), count)
    random = np.random.default_rng(SEED)
    means = np.concatenate([
        interquartile_mean(np.concatenate([_resample(stratum, _BATCH, random) for stratum in known], axis=1))
        for _ in range(RESAMPLES // _BATCH)
    ])  # fmt: skip
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(means, [tail, 100.0 - tail])
    return Interval(value, float(low), float(high), count)


def _resample(stratum: Matrix, count: int, random: np.random.Generator) -> Matrix:
    """Return resamples of a matrix, shape (count, trainings x episodes)."""
    trainings, episodes = stratum.shape
    rows = random.integers(trainings, size=(count, trainings, 1))
    columns = random.integers(episodes, size=(count, 1, episodes))
    return stratum[rows, columns].reshape(count, -1)


def relative_reward(row: Row, baseline: Row) -> float | None:
    """Return the score of the task's reward."""
    return relative_score(row.reward, baseline.reward)


def relative_linear(row: Row, baseline: Row) -> float | None:
    """Return the score of the linear reward."""
    return relative_score(row.linear, baseline.linear)


def score_rows(rows: Iterable[Row], score: Score = relative_reward) -> list[Scores]:
    """Return the scores of each controller, the best first.

    Only episodes that all controllers have are compared, of a trained controller with all its trainings.

    Args:
        rows: rows of a set, with those of the baseline control.
        score: the score of a row; `relative_reward` or `relative_linear`, or another function.

    Raises:
        InvalidConfig: there are no rows of the baseline control, or none that all controllers have.
    """
    by_controller = _by_controller(rows)
    if BASELINE not in by_controller:
        raise InvalidConfig(f"scores are relative to the baseline control: run the controller {BASELINE!r} too")
    shared = _shared(by_controller)
    if not shared:
        raise InvalidConfig("no episode has rows of all controllers: run the rest, or choose --controllers")
    baseline = {key[:4]: row for key, row in by_controller[BASELINE].items()}
    scored = [_scores(name, _strata(keyed, baseline, shared, score)) for name, keyed in by_controller.items()]
    return sorted(scored, key=lambda scores: -scores.overall.value)


def differences(scores: Scores, reference: Scores) -> tuple[Interval, dict[str, Interval]]:
    """Return how much better one controller is than another in the same episodes, over all and by building.

    Args:
        scores: scores of the controller.
        reference: those of the other one, of whose trainings the mean counts; both from one call of `score_rows`.

    Returns:
        Interquartile means of the differences of the scores, with intervals as of `bootstrap_interval`.
    """
    by_building: dict[str, list[Matrix]] = {}
    for stratum, matrix in scores.strata.items():
        other = reference.strata[stratum].mean(axis=0, keepdims=True)
        by_building.setdefault(stratum[0], []).append(matrix - other)
    everything = [matrix for matrices in by_building.values() for matrix in matrices]
    return bootstrap_interval(everything), {
        building: bootstrap_interval(matrices) for building, matrices in by_building.items()
    }


def compared_rows(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Return by controller the rows of the episodes that all controllers have."""
    by_controller = _by_controller(rows)
    shared = _shared(by_controller)
    return {name: [row for key, row in keyed.items() if key[:4] in shared] for name, keyed in by_controller.items()}


def _by_controller(rows: Iterable[Row]) -> dict[str, dict[tuple[Any, ...], Row]]:
    by_controller: dict[str, dict[tuple[Any, ...], Row]] = {}
    for row in rows:
        key = (row.building, row.season, row.weather, row.seed, row.training_seed)
        by_controller.setdefault(row.controller, {})[key] = row
    return by_controller


def _shared(by_controller: Mapping[str, Mapping[tuple[Any, ...], Row]]) -> set[tuple[Any, ...]]:
    return set.intersection(*(_complete(keyed) for keyed in by_controller.values()))


def _trainings(keys: Iterable[tuple[Any, ...]]) -> dict[Stratum, set[int | None]]:
    trainings: dict[Stratum, set[int | None]] = {}
    for key in keys:
        trainings.setdefault(key[:2], set()).add(key[4])
    return trainings


def _complete(keyed: Mapping[tuple[Any, ...], Row]) -> set[tuple[Any, ...]]:
    """Return the episodes (building, season, weather, seed) that have rows of all trainings of their stratum."""
    trainings = _trainings(keyed)
    return {key[:4] for key in keyed if all((*key[:4], seed) in keyed for seed in trainings[key[:2]])}


def _strata(
    keyed: Mapping[tuple[Any, ...], Row],
    baseline: Mapping[tuple[Any, ...], Row],
    shared: Iterable[tuple[Any, ...]],
    score: Score,
) -> dict[Stratum, Matrix]:
    trainings = _trainings(keyed)
    columns: dict[Stratum, list[list[float]]] = {}
    for episode in sorted(shared):
        seeds = sorted(trainings[episode[:2]], key=lambda seed: -1 if seed is None else seed)
        values = [score(keyed[(*episode, seed)], baseline[episode]) for seed in seeds]
        known = [value for value in values if value is not None]
        if len(known) == len(values):
            columns.setdefault(episode[:2], []).append(known)
    return {stratum: np.array(values, np.float64).T for stratum, values in columns.items()}


def _scores(name: str, strata: dict[Stratum, Matrix]) -> Scores:
    if not strata:
        raise InvalidConfig("the baseline control has a reward of 0 in every episode: there is nothing to compare with")
    by_building: dict[str, list[Matrix]] = {}
    for (building, _), matrix in strata.items():
        by_building.setdefault(building, []).append(matrix)
    return Scores(
        name,
        bootstrap_interval(list(strata.values())),
        {building: bootstrap_interval(matrices) for building, matrices in by_building.items()},
        strata,
    )
