"""Trials of a calibration: drawn in batches, simulated in processes, told in order.

All trials of a batch are drawn before any of their results is known, and their results are told in the order of their
numbers. So the trials are the same, to the bit, for any number of processes, and after any interruption.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from zenostat.bridge.engine.system_calls import die_with_parent
from zenostat.lab.benchmark.workers import RunAll
from zenostat.lab.calibration.config import Calibration
from zenostat.lab.calibration.measured import MeasuredData
from zenostat.lab.calibration.objective import Days, Floats, Hours, Scales, column_errors, compare, objective
from zenostat.lab.tuning.search_space import ask, distributions
from zenostat.lab.tuning.study import REASON, open_study
from zenostat.lab.tuning.study_config import Pruner
from zenostat.lab.tuning.study_storage import database_errors
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, SimulatorError
from zenostat.topics.extras import requires_extra
from zenostat.topics.file_lock import locked

with requires_extra("tune", "calibration", "Optuna"):
    import optuna
    from optuna.trial import FrozenTrial, TrialState

Result = dict[str, Any]
OnResult = Callable[[int, Mapping[str, float], Result], None]
"""Callback with the number, the values and the result of each trial that has ended."""

_STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "fail": TrialState.FAIL}


class Simulator(Protocol):
    """Simulates the model; it is sent to other processes."""

    def simulate(self, values: Mapping[str, float], days: Days) -> Floats:
        """Return the hourly values of all columns' points, shape (hours, columns).

        Raises:
            SimulatorError: the simulation failed.
        """


@dataclass(frozen=True)
class Setting:
    """Configuration, data and model that all trials of a calibration share."""

    config: Calibration
    data: MeasuredData
    simulator: Simulator
    scales: Scales


@dataclass(frozen=True)
class Job:
    """A trial to run.

    Attributes:
        values: values of the parameters.
        thresholds: errors by period, from 1, above which the trial is ended there.
        parent: id of the process that waits for it.
    """

    setting: Setting
    number: int
    values: Mapping[str, float]
    thresholds: Mapping[int, float]
    parent: int

    def __str__(self) -> str:
        return f"trial {self.number}"


@dataclass(frozen=True)
class Simulation:
    """Periods to simulate with some values."""

    simulator: Simulator
    values: Mapping[str, float]
    periods: tuple[Days, ...]
    place: int
    parent: int

    def __str__(self) -> str:
        return f"simulation with {dict(self.values)}"


def run_simulation(simulation: Simulation) -> tuple[int, Hours]:
    """Return the place of a simulation and its hours."""
    leave_signals_to(simulation.parent)
    return simulation.place, {
        days: simulation.simulator.simulate(simulation.values, days) for days in simulation.periods
    }


def run_trial(job: Job) -> tuple[int, Result]:
    """Return the number and the result of a trial: its state, its error after each period, and those of its columns."""
    leave_signals_to(job.parent)
    config, data = job.setting.config, job.setting.data
    hours: dict[Days, Floats] = {}
    stages: list[float] = []
    try:
        for step, days in enumerate(config.periods, 1):
            hours[days] = job.setting.simulator.simulate(job.values, days)
            compared = compare(data, hours)
            stages.append(objective(compared, job.setting.scales, config.adjustable))
            if step < len(config.periods) and stages[-1] > job.thresholds.get(step, math.inf):
                reason = f"worse than the median of the trials before after period {step}"
                return job.number, {"state": "pruned", "stages": stages, "reason": reason}
    except (SimulatorError, InvalidConfig) as error:
        return job.number, {"state": "fail", "stages": stages, "reason": str(error)}
    columns = {each.header: each.plain() for each in column_errors(data, compared, config.adjustable)}
    return job.number, {"state": "complete", "stages": stages, "columns": columns}


def leave_signals_to(parent: int) -> None:
    """In a worker process, end with the parent in whatever way it ends, and ignore Ctrl-C, which it handles."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        die_with_parent(parent)


class Trials:
    """The trials of a calibration.

    Args:
        setting: what they share.
        on_result: called with each result.

    Raises:
        InvalidConfig: the folder has a study with other settings.
    """

    def __init__(self, setting: Setting, on_result: OnResult | None = None) -> None:
        self._setting, self._on_result = setting, on_result
        self.config = setting.config
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.study = open_study(self.config)
        self._storage: Any = self.study._storage  # noqa: SLF001  # a trial of an ended process can be told only there
        self._folder = self.config.folder / "trials"
        self._folder.mkdir(exist_ok=True)

    def ended(self) -> int:
        """Return the number of trials that have ended."""
        return sum(trial.state.is_finished() for trial in self.study.get_trials(deepcopy=False))

    def run(self, run_all: RunAll) -> None:
        """Run batches until the study has its number of trials.

        Raises:
            InvalidConfig: all trials of the first batch failed.
            SimulatorError: a worker process was killed.
        """
        with database_errors(self.config.url), warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            warnings.filterwarnings("ignore", "Heartbeat of storage")  # the folder has a lock instead
            self._run(run_all)

    def _run(self, run_all: RunAll) -> None:
        while batch := self._next_batch():
            results = self._results(batch, run_all)
            for trial in batch:
                self._tell(trial, results[trial.number])
            if batch[0].number < self.config.batch_size and all(r["state"] == "fail" for r in results.values()):
                raise InvalidConfig(f"no trial can be simulated: {results[batch[0].number]['reason']}")

    def _next_batch(self) -> list[FrozenTrial]:
        """Return the trials to run next, drawn now or before an interruption; none if the study has all."""
        size, trials = self.config.batch_size, self.study.get_trials(deepcopy=False)
        asked = [trial for trial in trials if trial.state is not TrialState.WAITING]
        running = [trial for trial in asked if trial.state is TrialState.RUNNING]
        first = (running[0].number if running else len(asked)) // size * size
        end = min(first + size, self.config.total)
        if not any(trial.state.is_finished() and trial.number >= first for trial in asked):
            searched = self.config.parameters
            for trial in running:
                if len(trial.params) < len(searched):  # the process ended while it was drawn
                    again = optuna.trial.Trial(self.study, trial._trial_id)  # noqa: SLF001
                    for name, space in distributions(searched).items():
                        again._suggest(name, space)  # noqa: SLF001
            for _ in range(len(asked), end):
                ask(self.study, searched)
        trials = self.study.get_trials(deepcopy=False)
        return [trial for trial in trials if trial.state is TrialState.RUNNING]

    def _results(self, batch: Sequence[FrozenTrial], run_all: RunAll) -> dict[int, Result]:
        thresholds = self._thresholds()
        results, missing = {}, []
        for trial in batch:
            known = self._read(trial)
            if known is None:
                missing.append(Job(self._setting, trial.number, trial.params, thresholds, os.getpid()))
            else:
                results[trial.number] = known
        errors: list[str] = []
        values = {trial.number: trial.params for trial in batch}
        for number, result in run_all(run_trial, missing, "trials", None, errors):
            with atomic_file(self._path(number)) as temporary:
                temporary.write_text(json.dumps({"values": values[number], **result}), encoding="utf-8")
            results[number] = result
            if self._on_result is not None:
                self._on_result(number, values[number], result)
        if errors:
            raise SimulatorError(errors[0])
        return results

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:04}.json"

    def _read(self, trial: FrozenTrial) -> Result | None:
        """Return the result that a trial had before an interruption; None if it had none."""
        try:
            result: Result = json.loads(self._path(trial.number).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return result if result.pop("values", None) == trial.params else None

    def _thresholds(self) -> dict[int, float]:
        """Return the medians of finished trials by period, above which a trial is ended, as Optuna's median pruner."""
        pruner = self.config.pruner
        complete = [t for t in self.study.get_trials(deepcopy=False) if t.state is TrialState.COMPLETE]
        if not isinstance(pruner, Pruner) or len(complete) < max(pruner.startup_trials, 1):
            return {}
        steps = range(max(pruner.warmup_steps, 1), len(self.config.periods))
        return {step: float(np.median([trial.intermediate_values[step] for trial in complete])) for step in steps}

    def _tell(self, trial: FrozenTrial, result: Result) -> None:
        identity = trial._trial_id  # noqa: SLF001
        for step, value in enumerate(result["stages"], 1):
            self._storage.set_trial_intermediate_value(identity, step, value)
        if "reason" in result:
            self._storage.set_trial_user_attr(identity, REASON, result["reason"])
        value = result["stages"][-1] if result["state"] == "complete" else None
        self.study.tell(trial.number, value, state=_STATES[result["state"]])

    def complete(self) -> list[FrozenTrial]:
        """Return the trials that were simulated to their end, in order."""
        return [t for t in self.study.get_trials(deepcopy=False) if t.state is TrialState.COMPLETE]


def simulate_all(
    simulator: Simulator, values: Sequence[Mapping[str, float]], periods: Sequence[Days], run_all: RunAll
) -> list[Hours]:
    """Return the hours of the model with each of some values.

    Raises:
        SimulatorError: one of them failed.
    """
    jobs = [Simulation(simulator, each, tuple(periods), place, os.getpid()) for place, each in enumerate(values)]
    errors: list[str] = []
    results = dict(run_all(run_simulation, jobs, "simulations", None, errors))
    if errors:
        raise SimulatorError(errors[0])
    return [results[place] for place in range(len(jobs))]


@contextmanager
def study_folder(config: Calibration) -> Iterator[Path]:
    """Create the folder of a calibration, and hold its lock.

    Raises:
        InvalidConfig: another process works there.
    """
    folder = config.folder
    folder.mkdir(parents=True, exist_ok=True)
    with locked(
        folder / ".lock", f"{folder}: another process works on this calibration; wait, or choose another --output"
    ):
        yield folder
