"""The scripts of the paper's experiments run, and write what their figures need."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from support.run_cli import run_program

from zenostat.models import data_packs

SCRIPTS = Path(__file__).parents[2] / "examples" / "paper"


@pytest.mark.slow
def test_paper_examples__short_training_writes_its_curve_its_best_model_and_a_recording(scratch: Path) -> None:
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
    best = max(rows, key=lambda row: row["mean_reward"])
    assert f"best: episode {best['episode']:.4f}  mean_reward {best['mean_reward']:.4f}" in done.stdout
    assert {path.suffix for path in (scratch / "run").iterdir()} == {".zip", ".pkl", ".yaml", ".csv", ".json", ".mcap"}


@pytest.mark.slow
def test_the_pages_first_command_and_its_figures__work_in_an_empty_folder_on_part_of_a_year(scratch: Path) -> None:
    pytest.importorskip("matplotlib")
    data_packs.add("sinergym-paper")
    page = (SCRIPTS.parents[1] / "docs" / "paper.md").read_text()
    command = next(line for line in page.splitlines() if line.startswith("zenostat evaluate"))
    (scratch / "examples").symlink_to(SCRIPTS.parent)
    period = ["--begin", "06-30", "--end", "07-01"]
    done = run_program(*command.split()[1:], *period, cwd=scratch)
    assert done.returncode == 0, done.stderr
    assert (scratch / "runs" / "year.csv").is_file()
    script = [sys.executable, "-W", "error", str(SCRIPTS / "figures.py"), "runs", "--out", "figures"]
    drawn = subprocess.run(script, cwd=scratch, capture_output=True, text=True, timeout=280)
    assert (drawn.returncode, drawn.stderr) == (0, "")
    assert (scratch / "figures" / "paper-months.png").is_file()
