"""`zenostat calibrate` from a file of measured data to the calibrated model."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.run_cli import ZENOSTAT, error_of, output_of

from zenostat.models.building.model import read_building
from zenostat.models.calibration.model_edits import read_parameter
from zenostat.models.calibration.runs import ModelRuns
from zenostat.models.calibration.targets import TargetFinder
from zenostat.models.catalog import find_building, find_weather
from zenostat.topics import yaml12

pytest.importorskip("optuna")

BUILDING, WEATHER, DAYS = "ref-quick-service-restaurant", "USA_IL_Chicago", (date(2017, 1, 9), date(2017, 1, 9))
HELD_OUT = (date(2017, 1, 12), date(2017, 1, 12))
TRUTH = {"lighting": 1.4, "equipment": 0.8}
FIELDS: dict[str, Any] = {
    "timestamps": "end",
    "periods": [list(map(str, DAYS))],
    "held_out": [list(map(str, HELD_OUT))],
    "parameters": {name: {"edit": name, "low": 0.5, "high": 2.0, "truth": value} for name, value in TRUTH.items()},
    "trials": 6,
    "batch": 3,
    "refine": 1,
}


def measured_file(folder: Path) -> Path:
    """Write the electricity of the true model in kWh."""
    weather = find_weather(WEATHER).path
    target = TargetFinder(read_building(find_building(BUILDING)), weather).find("a column", "electricity_facility")
    runs = ModelRuns(BUILDING, weather, tuple(read_parameter(name, name) for name in TRUTH), (target,))
    path = folder / "measured.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "electricity_facility [kWh]"])
        for days in (DAYS, HELD_OUT):
            begin = datetime(days[0].year, days[0].month, days[0].day)
            values = runs.simulate(TRUTH, days)[:, 0] / 3.6e6
            writer.writerows([begin + timedelta(hours=hour + 1), value] for hour, value in enumerate(values.tolist()))
    return path


def parameters_file(folder: Path, **changes: Any) -> Path:
    path = folder / "parameters.yaml"
    path.write_text(yaml12.dump({**FIELDS, **changes}))
    return path


@pytest.mark.slow
@pytest.mark.process
def test_calibrate__continues_after_ctrl_c_and_writes_the_calibrated_model(tmp_path: Path) -> None:
    measured, file = measured_file(tmp_path), parameters_file(tmp_path)
    call = ["calibrate", BUILDING, str(measured), "--parameters", str(file), "--weather", WEATHER, "--output"]
    program = [*ZENOSTAT, *call, str(tmp_path / "parts"), "--workers", "2"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, cwd=tmp_path, process_group=0) as running:
        assert running.stdout is not None
        while "trial" not in running.stdout.readline():
            assert running.poll() is None
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does, to all processes
        assert running.wait(60) == 130
    assert not (tmp_path / "parts" / "result.json").exists()
    output_of(*call, str(tmp_path / "parts"), cwd=tmp_path)
    output_of(*call, str(tmp_path / "whole"), cwd=tmp_path)
    parts, whole = (json.loads((tmp_path / name / "result.json").read_text()) for name in ("parts", "whole"))
    assert parts == whole
    assert whole["values"] == pytest.approx(TRUTH, abs=0.05)
    names = {path.name for path in (tmp_path / "parts").iterdir()}
    assert {"calibrated.idf", "report.html", "trials.csv", "profiles.svg", "profiles.png"} <= names
    assert "runs" not in names
    page = (tmp_path / "parts" / "report.html").read_text()
    assert "multiply watts_per_floor_area of" in page
    assert "http" not in page.replace("http://www.w3.org/", "").replace("http-equiv", "")
    weather = find_weather(WEATHER).path
    targets = (TargetFinder(read_building(find_building(BUILDING)), weather).find("", "electricity_facility"),)
    fitted = ModelRuns(str(tmp_path / "parts" / "calibrated.idf"), weather, (), targets)
    original = ModelRuns(BUILDING, weather, tuple(read_parameter(name, name) for name in TRUTH), targets)
    assert np.array_equal(fitted.simulate({}, DAYS), original.simulate(whole["values"], DAYS))


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"parameters": {"light": {"edit": "lightning", "low": 0, "high": 1}}}, "there is no kind 'lightning'"),
        ({"sources": {"model": "x"}}, "sources: there is no such field"),
        ({"trials": 0}, "trials"),
    ],
)
def test_calibrate__errors_come_before_anything_starts(tmp_path: Path, changes: dict[str, Any], error: str) -> None:
    measured, file = tmp_path / "measured.csv", parameters_file(tmp_path, **changes)
    measured.write_text("time,electricity_facility [kWh]\n2017-01-09 01:00,1\n")
    call = ["calibrate", BUILDING, str(measured), "--parameters", str(file), "--weather", WEATHER]
    assert error in error_of(*call, cwd=tmp_path)
    assert not (tmp_path / "calibration").exists()
