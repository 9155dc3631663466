"""Trials of a calibration: drawn in batches, simulated in processes, reported in order.

All trials of a batch are drawn before any of their results is known, and their results are reported in the order
of their numbers. So the trials are the same, to the bit, for any number of processes, and after any interruption.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from zenostat.bridge.engine.system_calls import die_with_parent
from zenostat.lab.calibration.config import Calibration
from zenostat.lab.calibration.measured import MeasuredData
from zenostat.lab.calibration.objective import Days, Hours, Scales, column_errors, compare, objective
from zenostat.lab.tuning.search_space import ask
from zenostat.lab.tuning.study_config import Pruner, starting_point
from zenostat.lab.workers import RunAll
from zenostat.topics.arrays import Floats
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, SimulatorError
from zenostat.topics.extras import requires_extra
from zenostat.topics.file_lock import locked

with requires_extra("tune", "calibration", "Optuna"):
    import optuna
    from optuna.trial import TrialState

    from zenostat.lab.tuning.study_sampler import make_sampler

Result = dict[str, Any]
OnResult = Callable[[int, Mapping[str, float], Result], None]
"""Callback with the number, the values and the result of each trial that has ended."""

SETTINGS = "settings.json"
"""File of what must not change while a calibration exists."""

_STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "fail": TrialState.FAIL}


@dataclass(frozen=True)
class TrialResult:
    """A trial that has ended: its number, its values and its result."""

    number: int
    values: dict[str, float]
    result: Result

    @property
    def is_complete(self) -> bool:
        """Whether it was simulated to its end."""
        return bool(self.result["state"] == "complete")

    @property
    def error(self) -> float:
        """Error after the last period that was simulated."""
        return float(self.result["stages"][-1])


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
    """A period to simulate with some values."""

    simulator: Simulator
    values: Mapping[str, float]
    days: Days
    place: int
    parent: int

    def __str__(self) -> str:
        return f"simulation with {dict(self.values)}"


def run_simulation(simulation: Simulation) -> tuple[int, Days, Floats]:
    """Return the place of a simulation, its period and its hours."""
    leave_signals_to(simulation.parent)
    return simulation.place, simulation.days, simulation.simulator.simulate(simulation.values, simulation.days)


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
    if os.getpid() != parent:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        die_with_parent(parent)


class Trials:
    """The trials of a calibration: a study of Optuna in memory, and a file for each result.

    A study that continues draws its trials again, and reads the results that it had.

    Args:
        setting: what they share.
        on_result: called with each result that is new.

    Raises:
        InvalidConfig: the folder has a calibration with other settings.
    """

    def __init__(self, setting: Setting, on_result: OnResult | None = None) -> None:
        self._setting, self._on_result = setting, on_result
        self.config = config = setting.config
        self._folder = config.folder / "trials"
        self._check_settings()
        self._folder.mkdir(exist_ok=True)
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        sampler = make_sampler(config.sampler, config.seed, config.parameters)
        self.study = optuna.create_study(sampler=sampler, direction="minimize")
        start = starting_point(config.parameters)
        for point in config.grid() if config.sampler == "grid" else [start] if start else []:
            self.study.enqueue_trial(point)
        self.results: list[TrialResult] = []

    def _check_settings(self) -> None:
        path, identity = self.config.folder / SETTINGS, json.loads(json.dumps(self.config.identity()))
        self._identity = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]
        try:
            saved = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            with atomic_file(path) as temporary:
                temporary.write_text(json.dumps(identity, indent=1) + "\n", encoding="utf-8")
            return
        if differing := [name for name in identity if saved.get(name) != identity[name]]:
            raise InvalidConfig(
                f"{self.config.folder} has a calibration with other settings ({', '.join(differing)}): choose another "
                "--output, or restore them"
            )

    def run(self, run_all: RunAll) -> None:
        """Run batches until the study has its number of trials.

        Raises:
            InvalidConfig: all trials of the first batch failed.
            SimulatorError: a worker process was killed.
        """
        size, total = self.config.batch_size, self.config.total
        for first in range(0, total, size):
            batch = [ask(self.study, self.config.parameters) for _ in range(first, min(first + size, total))]
            results = self._results(batch, run_all)
            for trial in batch:
                result = results[trial.number]
                for step, value in enumerate(result["stages"], 1):
                    trial.report(value, step)
                value = result["stages"][-1] if result["state"] == "complete" else None
                self.study.tell(trial, value, state=_STATES[result["state"]])
                self.results.append(TrialResult(trial.number, dict(trial.params), result))
            if not first and all(result["state"] == "fail" for result in results.values()):
                raise InvalidConfig(f"no trial can be simulated: {results[0]['reason']}")

    def _results(self, batch: Sequence[optuna.Trial], run_all: RunAll) -> dict[int, Result]:
        """Return the results of a batch, those that are known from files and those of new simulations."""
        thresholds, values = self._thresholds(), {trial.number: dict(trial.params) for trial in batch}
        known = {number: self._read(number, values[number]) for number in values}
        results = {number: result for number, result in known.items() if result is not None}
        missing = [
            Job(self._setting, number, values[number], thresholds, os.getpid())
            for number in values if number not in results
        ]  # fmt: skip
        errors: list[str] = []
        for number, result in run_all(run_trial, missing, "trials", None, errors):
            with atomic_file(self._path(number)) as temporary:
                text = json.dumps({"settings": self._identity, "values": values[number], **result})
                temporary.write_text(text, encoding="utf-8")
            results[number] = result
            if self._on_result is not None:
                self._on_result(number, values[number], result)
        if errors:
            raise SimulatorError(errors[0])
        return results

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:04}.json"

    def _read(self, number: int, values: Mapping[str, float]) -> Result | None:
        """Return the result that a trial had before an interruption; None if it had none."""
        try:
            result: Result = json.loads(self._path(number).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        known = result.pop("settings", None), result.pop("values", None)
        return result if known == (self._identity, values) else None

    def _thresholds(self) -> dict[int, float]:
        """Return the medians of finished trials by period, above which a trial is ended, as `LatestMedianPruner`."""
        pruner = self.config.pruner
        complete = [each.result["stages"] for each in self.results if each.is_complete]
        if not isinstance(pruner, Pruner) or len(complete) < max(pruner.startup_trials, 1):
            return {}
        steps = range(max(pruner.warmup_steps, 1), len(self.config.periods))
        return {step: float(np.median([stages[step - 1] for stages in complete])) for step in steps}


def simulate_all(
    simulator: Simulator, values: Sequence[Mapping[str, float]], periods: Sequence[Days], run_all: RunAll
) -> list[Hours]:
    """Return the hours of the model with each of some values.

    Raises:
        SimulatorError: one of them failed.
    """
    errors: list[str] = []
    hours = [each for each in _simulate(simulator, values, periods, run_all, errors) if each is not None]
    if errors:
        raise SimulatorError(errors[0])
    return hours


def simulate_those_possible(
    simulator: Simulator, values: Sequence[Mapping[str, float]], periods: Sequence[Days], run_all: RunAll
) -> list[Hours | None]:
    """Return the hours of the model with each of some values; None where a simulation failed."""
    return _simulate(simulator, values, periods, run_all, [])


def _simulate(
    simulator: Simulator, values: Sequence[Mapping[str, float]], periods: Sequence[Days], run_all: RunAll,
    errors: list[str],
) -> list[Hours | None]:  # fmt: skip
    jobs = [
        Simulation(simulator, each, days, place, os.getpid()) for place, each in enumerate(values) for days in periods
    ]
    hours = {(place, days): table for place, days, table in run_all(run_simulation, jobs, "simulations", None, errors)}
    return [
        {days: hours[place, days] for days in periods} if all((place, days) in hours for days in periods) else None
        for place in range(len(values))
    ]


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
