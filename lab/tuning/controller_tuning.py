"""Tuning of a controller within one process, without a database: the same result each time."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from zenostat.agent_sdk.controllers import ControllerProtocol, load_controller
from zenostat.lab.tuning.controller_episodes import ControllerEpisodes
from zenostat.lab.tuning.controller_study import check_names
from zenostat.lab.tuning.search_space import DEFAULT, ask, decode
from zenostat.lab.tuning.study_config import (
    Direction,
    Pruner,
    Range,
    SearchSpace,
    check_metric,
    default_direction,
    starting_point,
)
from zenostat.lab.tuning.trial import Pruned, TrialReport
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

with requires_extra("tune", "tuning", "Optuna"):
    import optuna
    from optuna.trial import TrialState

    from zenostat.lab.tuning.study_sampler import make_sampler
    from zenostat.lab.tuning.study_storage import make_pruner

Progress = Callable[[int, int, float, float], None]
"""Callback for each trial that has ended: its number from 1, the number of all, its value, and the best so far."""


@dataclass(frozen=True)
class TrialRecord:
    """A trial of a tuning.

    Attributes:
        parameters: values of the searched parameters; empty for the controller's defaults.
        value: mean of the metric over the episodes; of a pruned trial, over those that it had.
        pruned: whether it was ended early.
    """

    parameters: dict[str, Any]
    value: float
    pruned: bool = False


@dataclass(frozen=True)
class TunedController:
    """The result of a tuning.

    Attributes:
        controller: text of the controller, as for `load_controller`; the name of a class.
        parameters: the best parameters, with the fixed ones; all others have their defaults.
        value: mean of the metric over the episodes with these.
        default_value: the same with the controller's defaults and the fixed parameters.
        trials: all trials, in order.
    """

    controller: str
    parameters: dict[str, Any]
    value: float
    default_value: float
    trials: tuple[TrialRecord, ...] = field(repr=False)

    def plain(self) -> dict[str, Any]:
        """Return the content of a controller file, which `load_controller` reads."""
        return {"controller": self.controller, "parameters": dict(self.parameters)}


def tune_controller(
    controller: str | Callable[..., ControllerProtocol],
    arguments: Mapping[str, Any],
    parameters: Mapping[str, Any],
    *,
    weathers: Sequence[str] = (),
    seeds: Sequence[int] = (0,),
    fixed: Mapping[str, Any] | None = None,
    trials: int = 60,
    sampler: Literal["tpe", "random", "cma-es"] = "tpe",
    seed: int = 0,
    metric: str = "reward",
    direction: Direction | None = None,
    prune: bool = True,
    progress: Progress | None = None,
) -> TunedController:
    """Search the parameters of a controller, one trial after another in one environment.

    The value of a parameter set is the mean of the metric over an episode for each seed and weather. The first trial
    has the controller's defaults, so the result is never worse than these on the episodes of the tuning. Equal
    arguments and versions give equal trials, to the bit; they are those of a study of one worker with these settings.

    Args:
        controller: text as for `load_controller`, or a class.
        arguments: of `gym.make`, with the scenario's id as `scenario`, or its file as `file`.
        parameters: what to search, by the controller's parameters, each as in a tuning file: `{"low": 0, "high": 3}`
            (with `log`, `step` or `start` as well), or a list of choices.
        weathers: weather files, each with an episode for each seed; by default those of the scenario.
        seeds: seeds of the episodes.
        fixed: parameters that are not searched.
        trials: number of trials.
        sampler: `tpe`, `random` or `cma-es` of Optuna.
        seed: seed of the sampler.
        metric: a metric of `EpisodeMetrics.metrics`.
        direction: whether it is maximized or minimized; by default rewards are maximized, and all others minimized.
        prune: end trials that are worse than the median of the others, after an episode of each weather; with `cma-es`
            no trial is ended.
        progress: callback for each trial.

    Raises:
        InvalidConfig: an argument, the scenario, or a value of a parameter is invalid.
        SimulatorError: a simulation failed.
    """
    if trials < 1 or not seeds:
        raise InvalidConfig(f"trials={trials}, seeds={list(seeds)}: expected at least one of each")
    check_metric(metric)
    searched, fixed = read_search_space(parameters), dict(fixed or {})
    factory = load_controller(controller) if isinstance(controller, str) else controller
    check_names(factory, searched, fixed)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    pruner = make_pruner(Pruner(warmup_steps=max(len(weathers), 1)) if prune and sampler != "cma-es" else None)
    direction = direction or default_direction(metric)
    study = optuna.create_study(direction=direction, sampler=make_sampler(sampler, seed, searched), pruner=pruner)
    study.enqueue_trial({}, user_attrs={DEFAULT: True})
    if start := starting_point(searched):
        study.enqueue_trial(start)
    records: list[TrialRecord] = []
    with closing(ControllerEpisodes(arguments, weathers, seeds)) as episodes, warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        for number in range(1, trials + 1):
            trial = ask(study, searched)
            values = decode(searched, trial.params)
            records.append(_run(study, trial, episodes, factory, {**fixed, **values}, metric, values))
            if progress is not None:
                progress(number, trials, records[-1].value, study.best_value)
    best = records[study.best_trial.number]
    name = controller if isinstance(controller, str) else getattr(controller, "__name__", str(controller))
    return TunedController(name, {**fixed, **best.parameters}, best.value, records[0].value, tuple(records))


def _run(
    study: optuna.Study,
    trial: optuna.Trial,
    episodes: ControllerEpisodes,
    factory: Callable[..., ControllerProtocol],
    parameters: Mapping[str, Any],
    metric: str,
    values: dict[str, Any],
) -> TrialRecord:
    """Run a trial to its end, or until it is pruned."""
    report = TrialReport(trial)
    try:
        value = episodes.value(factory, parameters, metric, report)
    except Pruned:
        study.tell(trial, state=TrialState.PRUNED)
        return TrialRecord(values, report.values[-1], pruned=True)
    study.tell(trial, value)
    return TrialRecord(values, value)


def read_search_space(parameters: Mapping[str, Any]) -> dict[str, Range]:
    """Validate a search space.

    Raises:
        InvalidConfig: lists all errors.
    """
    try:
        return TypeAdapter(SearchSpace).validate_python(dict(parameters))
    except ValidationError as error:
        raise InvalidConfig(f"parameters: {describe_validation_errors(error, list(parameters))}") from None
