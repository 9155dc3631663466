"""Scores relative to the baseline control, and their interquartile means with bootstrap intervals.

Source of the aggregation: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
NeurIPS 2021.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.lab.benchmark.results import Row
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

BASELINE = "baseline"
CONFIDENCE = 0.95
RESAMPLES = 10_000
SEED = 20_170_101
"""Seed of the bootstrap: the same rows give the same intervals."""


@dataclass(frozen=True)
class Interval:
    """An interquartile mean with its confidence interval; low and high are NaN if it has fewer than two rows."""

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
        values: scores by building.
    """

    controller: str
    overall: Interval
    buildings: dict[str, Interval]
    values: dict[str, tuple[float, ...]]


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


def bootstrap_interval(strata: Sequence[Sequence[float]]) -> Interval:
    """Return the interquartile mean over all strata, with a percentile interval of a stratified bootstrap.

    Each resample draws from each stratum, with replacement, as many scores as it has.
    """
    known = [np.array(stratum, np.float64) for stratum in strata if len(stratum)]
    count = sum(map(len, known))
    value = float(interquartile_mean(np.concatenate(known)))
    if count < 2 or any(len(stratum) < 2 for stratum in known):
        return Interval(value, float("nan"), float("nan"), count)
    with requires_extra("benchmark", "the benchmark's scores", "SciPy"):
        from scipy.stats import bootstrap
    result = bootstrap(
        known, lambda *samples, axis: interquartile_mean(np.concatenate(samples, axis=axis), axis), vectorized=True,
        n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="percentile", rng=np.random.default_rng(SEED),
    ).confidence_interval  # fmt: skip
    return Interval(value, float(result.low), float(result.high), count)


def score_rows(rows: Iterable[Row], reward: str = "reward") -> list[Scores]:
    """Return the scores of each controller, the best first.

    Only the tasks and seeds that all controllers have are compared.

    Args:
        rows: rows of a set, with those of the baseline control.
        reward: `reward` or `linear`.

    Raises:
        InvalidConfig: there are no rows of the baseline control, or none that all controllers have.
    """
    rewards: dict[str, dict[tuple[Any, ...], float]] = {}
    for row in rows:
        rewards.setdefault(row.controller, {})[row.key[1:]] = getattr(row, reward)
    if BASELINE not in rewards:
        raise InvalidConfig(f"scores are relative to the baseline control: run the controller {BASELINE!r} too")
    shared = sorted(set.intersection(*(set(episodes) for episodes in rewards.values())))
    if not shared:
        raise InvalidConfig("no episode has rows of all controllers: run the rest, or choose --controllers")
    scored = [_scores(name, episodes, rewards[BASELINE], shared) for name, episodes in rewards.items()]
    return sorted(scored, key=lambda scores: -scores.overall.value)


def _scores(
    name: str,
    episodes: Mapping[tuple[Any, ...], float],
    baseline: Mapping[tuple[Any, ...], float],
    shared: Sequence[tuple[Any, ...]],
) -> Scores:
    values: dict[str, list[float]] = {}
    for episode in shared:
        score = relative_score(episodes[episode], baseline[episode])
        if score is not None:
            values.setdefault(str(episode[0]), []).append(score)
    if not values:
        raise InvalidConfig("the baseline control has a reward of 0 in every episode: there is nothing to compare with")
    by_building = {building: bootstrap_interval([scores]) for building, scores in values.items()}
    overall = bootstrap_interval(list(values.values()))
    return Scores(name, overall, by_building, {building: tuple(scores) for building, scores in values.items()})
