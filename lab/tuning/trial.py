"""Trials in their process: what is asked for, intermediate values, and the result."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, UsageError, ZenostatError, did_you_mean

REQUEST, RESULT = "trial.json", "result.json"


class Pruned(Exception):  # an outcome
    """The pruner ends the trial."""


class TrialReport:
    """Intermediate values of a trial.

    Attributes:
        values: those reported so far.
        step: that of the last one.

    Args:
        trial: a trial of Optuna.
        url: URL of its database, for errors.
    """

    def __init__(self, trial: Any, url: str = "") -> None:
        self._trial, self._url = trial, url
        self.values: list[float] = []
        self.step = 0

    def add(self, value: float, step: int, *, is_last: bool = False) -> None:
        """Report a value; after the last one there is nothing to end.

        Raises:
            Pruned: the pruner ends the trial.
        """
        from zenostat.lab.tuning.study_storage import database_errors

        self.values.append(value)
        self.step = step
        with database_errors(self._url):
            self._trial.report(value, step)
            if not is_last and self._trial.should_prune():
                raise Pruned


def report_of(request: dict[str, Any]) -> TrialReport:
    """Return the report of the trial that a request describes by the study's URL and name, its id and the pruner.

    Raises:
        InvalidConfig: the database cannot be used.
    """
    import optuna

    from zenostat.lab.tuning.study_config import Pruner
    from zenostat.lab.tuning.study_storage import database_errors, make_pruner, open_storage

    url, settings = request["url"], request["pruner"] and Pruner.model_validate(request["pruner"])
    with database_errors(url):
        study = optuna.load_study(study_name=request["study"], storage=open_storage(url), pruner=make_pruner(settings))
        return TrialReport(optuna.trial.Trial(study, request["trial_id"]), url)


def pruned_result(report: TrialReport) -> dict[str, Any]:
    """Return the result of a trial that the pruner has ended."""
    return {"state": "pruned", "value": report.values[-1], "step": report.step}


def mean_metric(results: Sequence[Any], metric: str) -> float:
    """Return the mean of a metric over episodes.

    Raises:
        InvalidConfig: the episodes do not have it, or it is not a number in one of them.
    """
    import numpy as np

    values = [result.metrics().get(metric) for result in results]
    if None in values:
        names = [name for name, value in results[0].metrics().items() if value is not None]
        raise InvalidConfig(f"metric: the evaluations have no {metric!r}; {did_you_mean(metric, names)}")
    numbers = np.array(values, np.float64)
    if np.isnan(numbers).any():
        raise InvalidConfig(f"metric: {metric} is NaN in episode {int(np.isnan(numbers).argmax()) + 1}")
    return float(np.mean(numbers))


def run_request(folder: Path, run: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Run the trial that is described in a folder, and write its result there; without a result it has failed."""
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    try:
        result = run(request)
    except ZenostatError as error:
        result = {
            "state": "fail",
            "reason": str(error) or type(error).__name__,
            "invalid": isinstance(error, UsageError),
        }
    with atomic_file(folder / RESULT) as temporary:
        temporary.write_text(json.dumps(result), encoding="utf-8")
