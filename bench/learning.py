"""Train PPO with absolute actions and with actions relative to the baseline, on the benchmark's buildings.

    python -m bench.learning --out docs/training --page docs/training.md
    python -m bench.learning --building ref-small-office --season summer --steps 20000

Each training sees the benchmark's training weather and is evaluated on held-out weather, in the same episodes as
baseline control and the rule-based controller. It writes `curves.csv` and `curves.svg`, and the table of a page.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.lab.benchmark.definition import ARGUMENTS, BUILDINGS, HELD_OUT_WEATHERS, SEASONS, TRAINING_WEATHERS
from zenostat.lab.evaluate import evaluate

FORMS: dict[str, dict[str, Any]] = {"absolute": {}, "relative": {"relative": 3.0}}
REFERENCES = ("baseline", "rbc")
FIELDS = ("building", "season", "controller", "seed", "step", "reward")
EPISODES, SEED, EVERY = 2, 20_001, 10_752
"""Evaluation episodes, the seed of the first one, and the training steps between evaluations: 16 episodes."""

PARAMETERS = {
    "n_steps": 168,
    "batch_size": 96,
    "n_epochs": 10,
    "gamma": 0.98,
    "learning_rate": 3e-4,
    "policy_kwargs": {"log_std_init": -1.5},
}
BEGIN, END = "<!-- learning -->", "<!-- /learning -->"

Row = dict[str, Any]


def arguments(building: str, season: str, weathers: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of `BuildingEnv` for a building in a week of a season."""
    begin, end = SEASONS[season]
    scenario = f"{building}-{weathers[0]}-continuous-v1"
    return {"scenario": scenario, "weather": list(weathers), "begin": begin, "end": end, **ARGUMENTS}


def references(building: str, season: str) -> list[Row]:
    """Return the mean rewards of controllers that are not trained."""
    result = evaluate(arguments(building, season, HELD_OUT_WEATHERS[:1]), REFERENCES, episodes=EPISODES, seed=SEED)
    rewards: dict[str, list[float]] = {}
    for row in result.rows:
        rewards.setdefault(row.controller, []).append(row.result.reward or 0.0)
    return [
        _row(building, season, controller, "", "", float(np.mean(values))) for controller, values in rewards.items()
    ]


def train_form(building: str, season: str, form: str, seed: int, steps: int) -> list[Row]:
    """Train one form of actions; return a row for each evaluation."""
    from zenostat.training import read_training, train

    fields = arguments(building, season, TRAINING_WEATHERS) | FORMS[form]
    with tempfile.TemporaryDirectory() as folder:
        config = {
            "algorithm": "ppo",
            "scenario": fields.pop("scenario"),
            "arguments": fields,
            "wrappers": [{"wrapper": "CyclicTime", "fields": ["day_of_week", "hour"]}],
            "slots": 4,
            "steps": steps,
            "seed": seed,
            "parameters": PARAMETERS,
            "evaluation": {
                "every_steps": EVERY,
                "episodes": EPISODES,
                "seed": SEED,
                "arguments": {"weather": HELD_OUT_WEATHERS[0]},
            },
            "threads": 1,
            "output": folder,
        }
        train(read_training(config, f"{building}/{season}/{form}"))
        with (Path(folder) / "evaluations.csv").open(newline="") as file:
            rewards: dict[int, list[float]] = {}
            for row in csv.DictReader(file):
                rewards.setdefault(int(row["step"]), []).append(float(row["reward"]))
    return [_row(building, season, form, seed, step, float(np.mean(values))) for step, values in rewards.items()]


def _row(building: str, season: str, controller: str, seed: int | str, step: int | str, reward: float) -> Row:
    return dict(zip(FIELDS, (building, season, controller, seed, step, round(reward, 3)), strict=True))


def run(buildings: Iterable[str], seasons: Iterable[str], seeds: int, steps: int, jobs: int) -> list[Row]:
    """Return all rows, in an order that does not depend on the time that each takes."""
    tasks = [(building, season) for building in buildings for season in seasons]
    rows: list[Row] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(references, *task): f"{task} references" for task in tasks}
        for task in tasks:
            for form in FORMS:
                for seed in range(seeds):
                    waiting[pool.submit(train_form, *task, form, seed, steps)] = f"{task} {form} {seed}"
        for done in as_completed(waiting):
            rows += done.result()
            print(f"{waiting[done]}: {done.result()[-1]['reward']:.2f}", flush=True)
    names = [*REFERENCES, *FORMS]
    order = {name: index for index, name in enumerate(names)}
    rows.sort(
        key=lambda r: (
            tasks.index((r["building"], r["season"])),
            order[r["controller"]],
            str(r["seed"]),
            r["step"] or 0,
        )
    )
    return rows


def of_task(rows: Iterable[Row], building: str, season: str, controller: str) -> list[Row]:
    """Return the rows of one controller in one task."""
    key = (building, season, controller)
    return [row for row in rows if (row["building"], row["season"], row["controller"]) == key]


def curve(rows: list[Row], building: str, season: str, form: str) -> tuple[list[int], list[float]]:
    """Return steps, and the mean reward of all seeds at each."""
    means: dict[int, list[float]] = {}
    for row in of_task(rows, building, season, form):
        means.setdefault(int(row["step"]), []).append(float(row["reward"]))
    return list(means), [float(np.mean(values)) for values in means.values()]


def table(rows: list[Row]) -> str:
    """Return a Markdown table, mean reward of an episode at the first and the last evaluation, and a summary."""
    tasks = list(dict.fromkeys((row["building"], row["season"]) for row in rows))
    lines = [
        "| building, week | `baseline` | `rbc` | absolute, first | last | relative, first | last |",
        "|---|---|---|---|---|---|---|",
    ]
    for task in tasks:
        known = [float(of_task(rows, *task, name)[0]["reward"]) for name in REFERENCES]
        ends = [curve(rows, *task, form)[1][i] for form in FORMS for i in (0, -1)]
        cells = " | ".join(f"{value:.1f}" for value in (*known, *ends))
        lines.append(f"| {BUILDINGS[task[0]]}, {task[1]} | {cells} |")
    above = {
        form: sum(
            curve(rows, *task, form)[1][-1] > float(of_task(rows, *task, "baseline")[0]["reward"]) for task in tasks
        )
        for form in FORMS
    }
    counts = " and ".join(f"in {count} with {form} actions" for form, count in above.items())
    return "\n".join([*lines, "", f"Of {len(tasks)} tasks, PPO ends above the baseline {counts}."])


def draw(rows: list[Row], path: Path) -> None:
    """Draw a plot for each task: both forms with all their seeds, and the references."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    tasks = list(dict.fromkeys((row["building"], row["season"]) for row in rows))
    columns = min(len(tasks), 3)
    shape = -(-len(tasks) // columns), columns
    figure = Figure(figsize=(3.4 * shape[1], 2.6 * shape[0]), layout="constrained")
    axes = np.atleast_1d(figure.subplots(*shape)).ravel()
    colors = {"absolute": "tab:blue", "relative": "tab:orange"}
    for axis, task in zip(axes, tasks, strict=False):
        for name, style in zip(REFERENCES, ("-", ":"), strict=True):
            axis.axhline(float(of_task(rows, *task, name)[0]["reward"]), color="0.4", linestyle=style, label=name)
        for form, color in colors.items():
            for seed in dict.fromkeys(row["seed"] for row in of_task(rows, *task, form)):
                points = [(int(r["step"]), float(r["reward"])) for r in of_task(rows, *task, form) if r["seed"] == seed]
                axis.plot(*zip(*points, strict=True), color=color, alpha=0.35, linewidth=0.8)
            axis.plot(*curve(rows, *task, form), color=color, label=f"PPO, {form}")
        axis.set_title(f"{BUILDINGS[task[0]]}, {task[1]}", fontsize=9)
        axis.tick_params(labelsize=7)
        axis.xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}k")
    for axis in axes[len(tasks) :]:
        axis.set_visible(False)
    for axis in axes[::columns]:
        axis.set_ylabel("reward of an episode", fontsize=8)
    axes[0].legend(fontsize=6)
    figure.supxlabel("training steps", fontsize=8)
    with rc_context({"svg.hashsalt": "zenostat"}):
        figure.savefig(path, metadata={"Date": None})


def write_page(text: str, path: Path) -> None:
    """Replace what is between the markers of a page."""
    page = path.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    path.write_text(f"{head}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--building", action="append", choices=[*BUILDINGS])
    parser.add_argument("--season", action="append", choices=[*SEASONS])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("learning"))
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    rows = run(
        options.building or BUILDINGS,
        options.season or ("winter", "summer"),
        options.seeds,
        options.steps,
        options.jobs,
    )
    options.out.mkdir(parents=True, exist_ok=True)
    with (options.out / "curves.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    draw(rows, options.out / "curves.svg")
    print(table(rows))
    if options.page:
        write_page(table(rows), options.page)


if __name__ == "__main__":
    main()
