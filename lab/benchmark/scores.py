"""Scores relative to the baseline control, and their interquartile means with bootstrap intervals.

Source of the aggregation: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
NeurIPS 2021. Buildings and seasons are the benchmark's and are not resampled. Weather files, seeds and trainings are,
as crossed factors, because all trainings meet the same episodes, and a weather file and a seed of its noise raise or
lower the scores in all buildings together: Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 2007.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.lab.benchmark.definition import BASELINE, Episode, Task
from zenostat.lab.benchmark.results_file import Row
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

CONFIDENCE = 0.95
RESAMPLES = 4_000
FEWEST = 3
"""Fewest weather files, and seeds, of which there is an interval."""
SEED = 20_170_101
"""Seed of the bootstrap: the same rows give the same intervals."""
_BATCH = 500
"""Resamples at a time, which bounds the memory."""

Stratum = tuple[str, str]
"""A building in a season."""
Matrix = NDArray[np.float64]
"""Scores in a stratum, shape (trainings, weather files, seeds); one training for a controller that is not trained.

NaN where an episode has no score, or not all controllers have it.
"""
Score = Callable[[Row, Row], float | None]
"""Function from a row and that of the baseline control in the same episode to a score; None: the episode has none."""


@dataclass(frozen=True)
class Interval:
    """An interquartile mean with its confidence interval; low and high are NaN where there is none."""

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

    def episodes(self, building: str) -> Floats:
        """Return the score of each episode in a building, the mean over trainings."""
        of_building = [matrix.mean(axis=0) for stratum, matrix in self.strata.items() if stratum[0] == building]
        return _known(of_building)


def relative_score(reward: float, baseline: float) -> float | None:
    """Return (reward - baseline) / |baseline|: 0 as the baseline control, positive if better; 1 is a reward of 0.

    Returns:
        None where the baseline's reward is 0: such a task has no score for any controller.
    """
    return None if baseline == 0.0 else (reward - baseline) / abs(baseline)


def interquartile_mean(scores: Sequence[float] | Floats, axis: int = -1) -> Any:
    """Return the mean of the middle half: a quarter of the scores, rounded down, is cut off at each end."""
    with _requires_scipy():
        from scipy.stats import trim_mean
    return trim_mean(np.asarray(scores, np.float64), 0.25, axis=axis)


def _requires_scipy() -> AbstractContextManager[None]:
    return requires_extra("benchmark", "the benchmark's scores", "SciPy")


def bootstrap_interval(strata: Sequence[Matrix]) -> Interval:
    """Return the interquartile mean over all strata, with an interval from a bootstrap of crossed factors.

    Each resample draws, with replacement, as many weather files and seeds as there are, the same ones in all strata,
    and in each stratum as many trainings as it has. The interval is the mean plus and minus the standard deviation of
    the resamples' means times the quantile of Student's t and sqrt(n / (n - 1)), where n is the number of weather files
    or seeds, whichever is less, and the degrees of freedom are n - 1: few levels of a factor vary too little among
    themselves, and percentiles would cover some 85 % instead of 95 %.

    Args:
        strata: matrices of scores of one shape.

    Returns:
        No interval if there are fewer than `FEWEST` weather files or seeds, or an episode of them is missing.
    """
    with _requires_scipy():
        from scipy.special import stdtrit
    values = _known(strata)
    value = float(interquartile_mean(values))
    _, weathers, seeds = strata[0].shape
    fewest = min(weathers, seeds)
    if fewest < FEWEST or len(values) < sum(matrix.size for matrix in strata):
        return Interval(value, float("nan"), float("nan"), len(values))
    random = np.random.default_rng(SEED)
    means = np.concatenate([
        interquartile_mean(_resample(strata, _BATCH, random)) for _ in range(RESAMPLES // _BATCH)
    ])  # fmt: skip
    quantile = float(stdtrit(fewest - 1, 0.5 + CONFIDENCE / 2.0))
    half = quantile * float(means.std(ddof=1)) * (fewest / (fewest - 1)) ** 0.5
    return Interval(value, value - half, value + half, len(values))


def _known(strata: Iterable[Matrix]) -> Floats:
    values = np.concatenate([matrix.ravel() for matrix in strata])
    known: Floats = values[~np.isnan(values)]
    return known


def _resample(strata: Sequence[Matrix], count: int, random: np.random.Generator) -> Floats:
    """Return resamples of all strata, shape (count, values)."""
    _, weathers, seeds = strata[0].shape
    weather = random.integers(weathers, size=(count, 1, weathers, 1))
    seed = random.integers(seeds, size=(count, 1, 1, seeds))
    parts = []
    for matrix in strata:
        training = random.integers(len(matrix), size=(count, len(matrix), 1, 1))
        parts.append(matrix[training, weather, seed].reshape(count, -1))
    return np.concatenate(parts, axis=1)


def relative_reward(row: Row, baseline: Row) -> float | None:
    """Return the score of the task's reward."""
    return relative_score(row.reward, baseline.reward)


def relative_linear(row: Row, baseline: Row) -> float | None:
    """Return the score of the linear reward."""
    return relative_score(row.linear, baseline.linear)


def score_rows(rows: Iterable[Row], score: Score = relative_reward) -> list[Scores]:
    """Return the scores of each controller, the best first.

    Only episodes that all controllers have are compared, of a trained controller with all trainings that it has in any
    stratum: otherwise strata would weigh by their trainings.

    Args:
        rows: rows of a set, with those of the baseline control.
        score: the score of a row; `relative_reward` or `relative_linear`, or another function.

    Raises:
        InvalidConfig: there are no rows of the baseline control, or none that all controllers have.
    """
    rows = list(rows)
    by_controller = _by_controller(rows)
    if BASELINE not in by_controller:
        raise InvalidConfig(f"scores are relative to the baseline control: run the controller {BASELINE!r} too")
    shared = _shared(by_controller)
    if not shared:
        raise InvalidConfig(
            f"no episode has rows of all controllers and trainings: run the rest, such as {absent_episodes(rows)[0]}, "
            "or choose --controllers"
        )
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


def absent_episodes(rows: Iterable[Row]) -> list[Episode]:
    """Return the episodes of controllers and trainings whose rows are missing, where another controller has one."""
    by_controller = _by_controller(rows)
    episodes = sorted({key[:4] for keyed in by_controller.values() for key in keyed})
    return [
        Episode(name, Task(*episode[:3]), episode[3], number)
        for name, keyed in by_controller.items()
        for episode in episodes
        for number in _trainings(keyed)
        if (*episode, number) not in keyed
    ]


def _by_controller(rows: Iterable[Row]) -> dict[str, dict[tuple[Any, ...], Row]]:
    by_controller: dict[str, dict[tuple[Any, ...], Row]] = {}
    for row in rows:
        key = (row.building, row.season, row.weather, row.seed, row.training_seed)
        by_controller.setdefault(row.controller, {})[key] = row
    return by_controller


def _shared(by_controller: Mapping[str, Mapping[tuple[Any, ...], Row]]) -> set[tuple[Any, ...]]:
    episodes = [_complete(keyed) for keyed in by_controller.values()]
    return set.intersection(*episodes) if episodes else set()


def _trainings(keyed: Mapping[tuple[Any, ...], Row]) -> list[int | None]:
    """Return the numbers of the trainings of a controller in all strata, in order."""
    return sorted({key[4] for key in keyed}, key=lambda number: -1 if number is None else number)


def _complete(keyed: Mapping[tuple[Any, ...], Row]) -> set[tuple[Any, ...]]:
    """Return the episodes (building, season, weather, seed) that have rows of all trainings of the controller."""
    trainings = _trainings(keyed)
    return {key[:4] for key in keyed if all((*key[:4], number) in keyed for number in trainings)}


def _strata(
    keyed: Mapping[tuple[Any, ...], Row],
    baseline: Mapping[tuple[Any, ...], Row],
    shared: Collection[tuple[Any, ...]],
    score: Score,
) -> dict[Stratum, Matrix]:
    numbers = _trainings(keyed)
    weathers, seeds = (sorted({episode[place] for episode in shared}) for place in (2, 3))
    strata: dict[Stratum, Matrix] = {}
    for episode in sorted(shared):
        values = [score(keyed[(*episode, number)], baseline[episode]) for number in numbers]
        if None not in values:
            shape = (len(numbers), len(weathers), len(seeds))
            matrix = strata.setdefault(episode[:2], np.full(shape, np.nan))
            matrix[:, weathers.index(episode[2]), seeds.index(episode[3])] = values
    return strata


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
