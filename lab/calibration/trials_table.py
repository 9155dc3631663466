"""The trials of a calibration as a table."""

from __future__ import annotations

import csv
from pathlib import Path

from zenostat.lab.calibration.calibrate import CalibrationResult
from zenostat.topics.atomic_file import atomic_file


def write_trials(result: CalibrationResult) -> Path:
    """Write `trials.csv` with error and values of each trial that was simulated to its end; return its path."""
    path, names = result.config.folder / "trials.csv", list(result.config.parameters)
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["error", *names])
        writer.writerows([error, *(values[name] for name in names)] for values, error in result.trials)
    return path
