"""Search spaces as distributions of Optuna, and trials with values from them."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from typing import Any

from zenostat.lab.tuning.study_config import Range
from zenostat.topics.extras import requires_extra

with requires_extra("tune", "tuning", "Optuna"):
    import optuna

DEFAULT = "default"
"""Attribute of a trial that searches nothing: its subject has its own defaults."""


def distribution(searched: Range) -> optuna.distributions.BaseDistribution:
    """Return the distribution of a searched parameter; choices that are lists or mappings are searched as JSON.

    Where steps do not end at `high`, the last multiple below it is the highest number.
    """
    if searched.choices is not None:
        return optuna.distributions.CategoricalDistribution([encode(choice) for choice in searched.choices])
    assert searched.low is not None
    assert searched.high is not None
    low, high, log, step = searched.low, searched.high, searched.log, searched.step
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The distribution is specified by")
        if searched.is_integer:
            return optuna.distributions.IntDistribution(int(low), int(high), log=log, step=int(step or 1))
        return optuna.distributions.FloatDistribution(low, high, log=log, step=step)


def distributions(searched: Mapping[str, Range]) -> dict[str, optuna.distributions.BaseDistribution]:
    """Return the distributions of all searched parameters by name."""
    return {name: distribution(parameter) for name, parameter in searched.items()}


def encode(choice: Any) -> Any:
    """Return a choice as Optuna stores it: a scalar, or JSON text of a list or mapping."""
    return json.dumps(choice) if isinstance(choice, list | tuple | Mapping) else choice


def decode(searched: Mapping[str, Range], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a trial as they were before `encode`."""
    by_text = {
        name: {
            encode(choice): choice for choice in parameter.choices or () if isinstance(choice, list | tuple | Mapping)
        }
        for name, parameter in searched.items()
    }
    return {
        name: by_text[name].get(value, value) if isinstance(value, str) else value for name, value in values.items()
    }


def ask(study: optuna.Study, searched: Mapping[str, Range]) -> optuna.Trial:
    """Return the next trial, with a value for each searched parameter, or with none if it is that of the defaults."""
    trial = study.ask()
    if DEFAULT not in trial.user_attrs:
        for name, parameter in distributions(searched).items():
            trial._suggest(name, parameter)  # noqa: SLF001  # as `Study.ask` does
    return trial
