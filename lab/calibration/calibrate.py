"""Calibrate a model: trials, the best one before and after on all periods, and how well it is determined."""

from __future__ import annotations

import json
import math
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.lab.calibration.config import Calibration
from zenostat.lab.calibration.derivatives import Derivatives, derivatives, points
from zenostat.lab.calibration.determination import Determined, Linearization, determine, linearize, stepped
from zenostat.lab.calibration.measured import MeasuredData
from zenostat.lab.calibration.objective import (
    ColumnErrors,
    Compared,
    Days,
    Hours,
    check_comparable,
    column_errors,
    compare,
    objective,
    scales_of,
)
from zenostat.lab.calibration.trials import (
    OnResult,
    Setting,
    Simulator,
    TrialResult,
    Trials,
    simulate_all,
    simulate_those_possible,
    study_folder,
)
from zenostat.lab.workers import RunAll, worker_pool
from zenostat.topics.arrays import Floats
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.json_numbers import finite

_GAIN = 0.001
"""Share by which a step has to lower the error, so that another one follows.

Near the optimum the error is that of the noise, and changes little: of n residuals, one standard deviation of a
parameter raises it by about 1 / (2 n).
"""

SCRATCH = "runs"
"""Folder of running simulations, below that of the calibration."""


@dataclass(frozen=True)
class Fit:
    """A model against measured data.

    Attributes:
        error: the objective.
        columns: errors of each column.
        compared: measured and simulated values of each column.
    """

    error: float
    columns: list[ColumnErrors]
    compared: list[Compared]

    def plain(self) -> dict[str, Any]:
        """Return the errors as JSON."""
        return {"error": self.error, "columns": {each.header: each.plain() for each in self.columns}}


@dataclass(frozen=True)
class CalibrationResult:
    """The result of a calibration.

    Attributes:
        config: the calibration.
        data: measured data.
        values: best values of the parameters.
        fits: by `before`, `after`, `held-out before` and `held-out after`; the last two only with a held-out period.
        parameters: how well each parameter is determined.
        ended: all trials, in order.
    """

    config: Calibration
    data: MeasuredData
    values: dict[str, float]
    fits: dict[str, Fit]
    parameters: list[Determined]
    ended: list[TrialResult]

    @property
    def trials(self) -> list[tuple[dict[str, float], float]]:
        """Values and error of each trial that was simulated to its end, in order."""
        return [(each.values, each.error) for each in self.ended if each.is_complete]

    @property
    def states(self) -> dict[str, int]:
        """Number of trials of each state."""
        return dict(Counter(each.result["state"] for each in self.ended))

    def plain(self) -> dict[str, Any]:
        """Return the result as JSON; what is not a number is null."""
        plain: dict[str, Any] = finite(self._plain())
        return plain

    def _plain(self) -> dict[str, Any]:
        return {
            "values": self.values,
            "parameters": {each.name: each.plain() for each in self.parameters},
            "fits": {name: fit.plain() for name, fit in self.fits.items()},
            "trials": self.states,
        }

    def write(self, path: Path) -> None:
        """Write the result as JSON."""
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(self.plain(), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def calibrate(
    config: Calibration, data: MeasuredData, simulator: Simulator, on_result: OnResult | None = None
) -> CalibrationResult:
    """Run the trials of a calibration, or continue them, and return its result.

    The result is the same, to the bit, for any number of workers, and after any interruption.

    Args:
        config: the calibration.
        data: measured data.
        simulator: the model; picklable.
        on_result: called with each trial that has ended.

    Raises:
        InvalidConfig: the data cannot be compared with the model, no trial can be simulated, the folder has a
            calibration with other settings, or another process works there.
        SimulatorError: the model as it is cannot be simulated, or a worker process was killed.
    """
    periods = [*config.periods, *config.held_out]
    with study_folder(config) as folder, worker_pool(config.workers) as run_all:
        scratch = folder / SCRATCH
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        try:
            (before,) = simulate_all(simulator, [{}], periods, run_all)
            check_comparable(data, compare(data, _part(before, config.periods)), config.adjustable)
            setting = Setting(config, data, simulator, scales_of(data, config.periods))
            trials = Trials(setting, on_result)
            trials.run(run_all)
            ended = trials.results
            complete = [(each.values, each.error) for each in ended if each.is_complete]
            if not complete:
                raise InvalidConfig("no trial was simulated to its end: allow more trials, or set pruner: false")
            best, linear, failing = _refine(setting, min(complete, key=lambda each: each[1]), run_all)
            (after,) = simulate_all(simulator, [best[0]], periods, run_all)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
        fits = {
            f"{prefix}{name}": _fit(setting, _part(hours, chosen))
            for prefix, chosen in (("", config.periods), ("held-out ", config.held_out))
            for name, hours in (("before", before), ("after", after))
            if chosen
        }
        determined = determine(config, best[0], linear, [*complete, best], failing)
        return CalibrationResult(config, data, best[0], fits, determined, ended)


def _refine(
    setting: Setting, best: tuple[dict[str, float], float], run_all: RunAll
) -> tuple[tuple[dict[str, float], float], Linearization, frozenset[str]]:
    """Return the best values and their error after steps from the best trial, and the objective around them.

    Returned last are the parameters that cannot be simulated with values nearby.

    The derivatives serve for further steps until one does not lower the error; then they are computed anew, as in the
    end. A step to values that cannot be simulated is not taken.
    """
    config, data, scales = setting.config, setting.data, setting.scales

    def simulate(values: Sequence[Mapping[str, float]]) -> list[Hours | None]:
        return simulate_those_possible(setting.simulator, values, config.periods, run_all)

    def derive() -> tuple[list[Derivatives], frozenset[str]]:
        return derivatives(config, data, best[0], center, simulate(points(config, best[0])))

    def around() -> Linearization:
        return linearize(compare(data, center), derived, scales, config.adjustable)

    (center,) = simulate_all(setting.simulator, [best[0]], config.periods, run_all)
    (derived, failing), has_moved = derive(), False
    for _ in range(config.refine):
        linear = around()
        middle = np.array([parameter.to_unit(best[0][name]) for name, parameter in config.parameters.items()])
        near = [stepped(config, best[0], step) for step in linear.bounded_steps(middle)]
        reached = [
            (objective(compare(data, hours), scales, config.adjustable), place, hours)
            for place, hours in enumerate(simulate(near))
            if hours is not None
        ]
        error, place, hours = min(reached, key=lambda each: each[:2], default=(math.inf, 0, center))
        if error <= best[1] * (1.0 - _GAIN):
            best, center, has_moved = (near[place], error), hours, True
        elif has_moved:
            (derived, failing), has_moved = derive(), False
        else:
            break
    if has_moved:
        derived, failing = derive()
    return best, around(), failing


def _part(hours: Hours, periods: Sequence[Days]) -> Mapping[Days, Floats]:
    return {days: hours[days] for days in periods}


def _fit(setting: Setting, hours: Hours) -> Fit:
    compared, adjustable = compare(setting.data, hours), setting.config.adjustable
    return Fit(
        objective(compared, setting.scales, adjustable), column_errors(setting.data, compared, adjustable), compared
    )
