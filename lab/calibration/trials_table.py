"""The trials of a calibration as a table."""

from __future__ import annotations

import csv
from pathlib import Path

from zenostat.lab.calibration.calibrate import CalibrationResult
from zenostat.topics.atomic_file import atomic_file


def write_trials(result: CalibrationResult) -> Path:
    """Write `trials.csv` with state, error, values and the reason of its end of each trial; return its path."""
    path, names = result.config.folder / "trials.csv", list(result.config.parameters)
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trial", "state", "error", *names, "reason"])
        for trial in result.ended:
            error = trial.error if trial.is_complete else ""
            values = [trial.values[name] for name in names]
            writer.writerow([trial.number, trial.result["state"], error, *values, trial.result.get("reason", "")])
    return path
