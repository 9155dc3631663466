"""The scripts of the paper's experiments run, and write what their figures need."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest

from models import data_packs

SCRIPTS = Path(__file__).parents[2] / "examples" / "paper"


@pytest.mark.slow
def test_a_short_training_writes_its_curve_its_best_model_and_a_recording(scratch: Path) -> None:
    pytest.importorskip("stable_baselines3")
    data_packs.add("sinergym-paper")
    call = ["ppo", "--begin", "07-01", "--end", "07-01", "--episodes", "2", "--evaluate-every", "1", "--out", "run"]
    call += ["--set", "n_steps=96", "--set", "batch_size=32"]
    script = [sys.executable, str(SCRIPTS / "train.py")]
    done = subprocess.run([*script, *call], cwd=scratch, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    with (scratch / "run" / "curve.csv").open(newline="") as file:
        rows = [{name: float(text) for name, text in row.items()} for row in csv.DictReader(file)]
    assert [(row["step"], row["episode"]) for row in rows] == [(96.0, 1.0), (192.0, 2.0)]
    for row in rows:
        assert row["mean_reward"] == pytest.approx(-(0.5 * 5e-5 * row["power_w"] + 0.5 * row["deviation_k"]))
    best = max(row["mean_reward"] for row in rows)
    assert f"best: episode 0.0000  mean_reward {best:.4f}" in done.stdout
    assert {path.suffix for path in (scratch / "run").iterdir()} == {".zip", ".pkl", ".csv", ".json", ".mcap"}
