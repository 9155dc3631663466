"""Samplers of studies, whose draws depend on the trial and not on the process that asks for it."""

from __future__ import annotations

import importlib.util
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from zenostat.lab.tuning.search_space import DEFAULT, distributions
from zenostat.lab.tuning.study_config import Range, starting_point
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import install_command

RETRY_OF = "retry_of"
"""Attribute of a trial that repeats another one: the number of the first."""


class TrialSeededSampler(BaseSampler):
    """A sampler with a seed of its own for each trial, from the study's seed and the number of trials before.

    The trial of the defaults is not sampled. A sampler of Optuna with a fixed seed draws the same first trials in each
    process: on each machine of a study, and again when a study continues. Trials that repeat others are not counted, so
    a study that was interrupted draws what it would have drawn otherwise.

    Args:
        make: makes the sampler from a seed.
        seed: seed of the study.
        jointly: what is sampled jointly; None: what the sampler infers from finished trials, of which that of the
            defaults has no values.
    """

    def __init__(
        self, make: Callable[[int], BaseSampler], seed: int, jointly: dict[str, BaseDistribution] | None = None
    ) -> None:
        self._make, self._seed, self._jointly = make, seed, jointly
        self._sampler = make(seed)

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Make the sampler of this trial."""
        earlier = (other for other in study.get_trials(deepcopy=False) if other.number < trial.number)
        index = sum(RETRY_OF not in other.user_attrs for other in earlier)
        self._sampler = self._make(int(np.random.SeedSequence([self._seed, index]).generate_state(1)[0]))
        self._sampler.before_trial(study, trial)

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Return what is sampled jointly."""
        if DEFAULT in trial.user_attrs:
            return {}
        if self._jointly is not None:
            return self._jointly
        return self._sampler.infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Sample jointly."""
        return self._sampler.sample_relative(study, trial, search_space)

    def sample_independent(
        self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """Sample one parameter."""
        return self._sampler.sample_independent(study, trial, param_name, param_distribution)

    def after_trial(
        self, study: optuna.Study, trial: FrozenTrial, state: TrialState, values: Sequence[float] | None
    ) -> None:
        """Pass the end of a trial on."""
        self._sampler.after_trial(study, trial, state, values)


def make_sampler(name: str, seed: int, searched: Mapping[str, Range]) -> BaseSampler:
    """Return the sampler of a study; the points of a grid are queued when the study is created.

    Raises:
        InvalidConfig: the package that CMA-ES needs is missing.
    """
    if name == "tpe":
        return TrialSeededSampler(lambda trial_seed: optuna.samplers.TPESampler(seed=trial_seed), seed)
    if name != "cma-es":
        return TrialSeededSampler(lambda trial_seed: optuna.samplers.RandomSampler(seed=trial_seed), seed)
    if importlib.util.find_spec("cmaes") is None:
        raise InvalidConfig(f"sampler: cma-es needs the package cmaes: {install_command('tune')}")
    jointly = {name: space for name, space in sorted(distributions(searched).items()) if not space.single()}
    start = starting_point(searched)
    middle = {name: start.get(name, _middle(searched[name])) for name in jointly} if start else None

    def make(trial_seed: int) -> BaseSampler:
        with warnings.catch_warnings():  # Optuna 6 will have no `x0`
            warnings.simplefilter("ignore", FutureWarning)
            return optuna.samplers.CmaEsSampler(x0=middle, seed=trial_seed, warn_independent_sampling=False)

    return TrialSeededSampler(make, seed, jointly)


def _middle(searched: Range) -> float:
    assert searched.low is not None
    assert searched.high is not None
    return math.sqrt(searched.low * searched.high) if searched.log else (searched.low + searched.high) / 2
