"""The scripts of the paper's experiments run, and write what their figures need."""

import importlib
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from support.csv_files import csv_rows
from support.run_cli import run_program

from zenostat.models import data_packs
from zenostat.topics import yaml12

PAPER = Path(__file__).parents[2] / "examples" / "paper"
DOCS = PAPER.parents[1] / "docs"
YEAR = 35_040


@pytest.mark.slow
def test_paper_training_file__trains_and_evaluates_by_episodes(scratch: Path) -> None:
    pytest.importorskip("stable_baselines3")
    data_packs.add("sinergym-paper")
    day = ["--set", "arguments.begin=07-01", "--set", "arguments.end=07-01", "--steps", "192"]
    day += [
        "--set",
        "evaluation.every_episodes=1",
        "--set",
        "parameters.n_steps=96",
        "--set",
        "parameters.batch_size=32",
    ]
    done = run_program("train", str(PAPER / "ppo.yaml"), *day, cwd=scratch)
    assert done.returncode == 0, done.stderr
    rows = csv_rows(scratch / "runs" / "ppo" / "evaluations.csv")
    assert [(int(row["step"]), row["seed"]) for row in rows] == [(96, "1000"), (192, "1000")]
    for row in rows:
        power_w = -float(row["mean_reward.energy"]) / (0.5 * 5e-5)
        assert float(row["mean_reward"]) == pytest.approx(-0.5 * (5e-5 * power_w + float(row["mean_deviation_k"])))
        assert float(row["mean_power_w"]) > power_w  # that of the whole building; the reward has its HVAC alone


@pytest.mark.slow
def test_paper_search__best_combinations_continue_their_trainings(scratch: Path) -> None:
    pytest.importorskip("optuna")
    data_packs.add("sinergym-paper")
    training = yaml12.read_mapping(PAPER / "ppo.yaml") | {"arguments": {"begin": "07-01", "end": "07-01"}}
    search = yaml12.read_mapping(PAPER / "search.yaml")
    one = {name: values[:1] for name, values in search["parameters"].items()}
    small = {"steps": [96], "evaluation.every_episodes": [1], "parameters.n_steps": [96], "parameters.batch_size": [32]}
    parameters = one | small | {"parameters.gamma": [0.9, 0.99]}
    (scratch / "search.yaml").write_text(yaml12.dump(search | {"training": training, "parameters": parameters}))
    done = run_program("tune", "search.yaml", cwd=scratch)
    assert done.returncode == 0, done.stderr
    trials = {int(row["trial"]): float(row["reward"]) for row in csv_rows(scratch / "runs" / "search" / "trials.csv")}
    (scratch / "best_ten.py").write_text((PAPER / "best_ten.py").read_text().replace("YEAR = 35_040", "YEAR = 96"))
    script = [sys.executable, "best_ten.py", "runs/search", "--count", "1", "--years", "2"]
    done = subprocess.run(script, cwd=scratch, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    steps = {
        trial: [int(row["step"]) for row in csv_rows(folder / "training" / "evaluations.csv")]
        for trial in trials
        if (folder := scratch / "runs" / "search" / "trials" / f"{trial:04d}").is_dir()
    }
    best = max(trials, key=lambda trial: trials[trial])
    assert steps == {trial: [96, 192] if trial == best else [96] for trial in trials}


def test_paper_search__has_108_combinations_of_two_years() -> None:
    pytest.importorskip("stable_baselines3")
    from support.tuning import load_tuning

    config = load_tuning(PAPER / "search.yaml")
    assert len(config.grid()) == 108
    assert config.parameters["steps"].choices == (2 * 35_040,)


@pytest.mark.slow
def test_the_pages_first_command_and_its_figures__work_in_an_empty_folder_on_part_of_a_year(scratch: Path) -> None:
    pytest.importorskip("matplotlib")
    data_packs.add("sinergym-paper")
    page = (PAPER.parents[1] / "docs" / "paper.md").read_text()
    command = next(line for line in page.splitlines() if line.startswith("zenostat evaluate"))
    (scratch / "examples").symlink_to(PAPER.parent)
    period = ["--begin", "06-30", "--end", "07-01"]
    done = run_program(*command.split()[1:], *period, cwd=scratch)
    assert done.returncode == 0, done.stderr
    assert (scratch / "runs" / "year.csv").is_file()
    script = [sys.executable, "-W", "error", str(PAPER / "figures.py"), "runs", "--out", "figures"]
    drawn = subprocess.run(script, cwd=scratch, capture_output=True, text=True, timeout=280)
    assert (drawn.returncode, drawn.stderr) == (0, "")
    assert (scratch / "figures" / "paper-months.png").is_file()


def test_published_trainings__tables_of_the_page_are_those_of_the_files(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(PAPER))
    script = importlib.import_module("trainings")
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    assert script.page_text(page, DOCS / "paper") == page


def test_published_trainings__evaluations_are_of_whole_years_and_follow_the_reward() -> None:
    for path in (DOCS / "paper").glob("*/evaluations.csv"):
        rows = csv_rows(path)
        assert [int(row["step"]) for row in rows] == [5 * YEAR * count for count in range(1, len(rows) + 1)]
        for row in rows:
            assert (int(row["steps"]), row["seed"]) == (YEAR, "1000")
            power_w, deviation_k = float(row["hvac_electricity_kwh"]) / 8.76, float(row["mean_deviation_k"])
            # With the building's meters, the energy is theirs; the reward has the power at the end of each timestep.
            tolerance = 0.02 if row["electricity_kwh"] else 1e-9
            assert float(row["mean_reward"]) == pytest.approx(-0.5 * (5e-5 * power_w + deviation_k), abs=tolerance)
            assert float(row["mean_reward.comfort"]) == pytest.approx(-0.5 * deviation_k, abs=1e-9)


def test_published_curves__have_each_episode_once() -> None:
    for path in (DOCS / "paper").glob("*/curve.csv"):
        steps = [int(row["step"]) for row in csv_rows(path)]
        assert steps == [YEAR * count for count in range(1, len(steps) + 1)]


def test_published_search__has_each_evaluation_once_and_follows_the_reward() -> None:
    rows = csv_rows(DOCS / "paper" / "search.csv")
    grid = yaml12.read_mapping(PAPER / "search.yaml")["parameters"]
    names = ("learning_rate", "n_steps", "batch_size", "gamma")
    combinations = {values: [] for values in product(*(map(float, grid[f"parameters.{name}"]) for name in names))}
    for row in rows:
        combinations[tuple(float(row[name]) for name in names)].append(int(row["step"]))
    for steps in combinations.values():
        assert steps == [2 * YEAR * count for count in range(1, len(steps) + 1)]
    for row in rows:
        energy, deviation_k = float(row["mean_reward.energy"]), float(row["mean_deviation_k"])
        assert int(row["steps"]) == YEAR
        assert float(row["mean_reward"]) == pytest.approx(energy - 0.5 * deviation_k, abs=1e-9)
        metered_w = float(row["hvac_electricity_kwh"]) / 8.76
        # The reward has the rate at the end of each timestep, which policies learn to keep below the mean.
        most = 1.009 if int(row["step"]) == 2 * YEAR else 1.04
        assert 1.002 < metered_w / (-energy / (0.5 * 5e-5)) < most
