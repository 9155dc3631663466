"""Publish the trainings of the paper's agents: their curves, figures, and the tables of a page.

    python examples/paper/trainings.py runs --out docs/paper --page docs/paper.md

Copies `curve.csv` (return of each episode), `evaluations.csv` and `training.yaml` of each training (`runs/ppo`,
`runs/ppo-1`, `runs/sac`, …), and `runs/agents.csv`: years of other weather noise with the best policies. The completed
combinations of the search (`runs/search`, and parts of its grid in `runs/search-1` and so on) are added to those of
`search.csv`, with all their evaluations. The tables of the page are made of these files;
`trainings.py docs/paper --page docs/paper.md` writes them again.
"""

from __future__ import annotations

import argparse
import csv
import math
import shutil
import statistics
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
from figures import (
    SEARCHED,
    TRAINED,
    YEAR,
    draw_continued,
    draw_search,
    draw_training,
    identity,
    metered_w,
    power_w,
    read_rows,
    trainings,
)

from zenostat.topics import yaml12
from zenostat.views.report import theme

FILES = ("curve.csv", "evaluations.csv", "references.csv", "training.yaml")
YEARS = 40
"""Length of a training in episodes."""
_PARAMETERS = yaml12.read_mapping(Path(__file__).with_name("search.yaml"))["parameters"]
GRID = {name: _PARAMETERS[f"parameters.{name}"] for name in SEARCHED}
"""The grid of the search."""
COMBINATIONS = math.prod(map(len, GRID.values()))
RESULTS = ("step", "mean_reward", "mean_reward.energy", "mean_deviation_k", "hvac_electricity_kwh", "steps")
"""Columns of `search.csv` from an evaluation, beside those of the combination."""
MINUS = "\N{MINUS SIGN}"
IDENTITY = f"{MINUS}(0.5 · 5·10⁻⁵ · W + 0.5 · K)"
BEGIN, END = "<!-- {} -->", "<!-- /{} -->"


def publish(runs: Path, out: Path) -> None:
    """Copy the files of all trainings, without policies and checkpoints."""
    for folder in trainings(runs):
        (out / folder.name).mkdir(parents=True, exist_ok=True)
        for name in FILES:
            shutil.copyfile(folder / name, out / folder.name / name)
    if (runs / "agents.csv").is_file():
        shutil.copyfile(runs / "agents.csv", out / "agents.csv")


def publish_search(runs: Path, out: Path) -> None:
    """Add the evaluations of the completed combinations of searches to `search.csv`."""
    path = out / "search.csv"
    rows = {(*combination(row), row["step"]): row for row in read_rows(path)} if path.is_file() else {}
    for folder in sorted(runs.glob("search*")):
        for trial in read_rows(folder / "trials.csv"):
            if trial["state"] == "COMPLETE":
                parameters = {name: trial[f"parameters.{name}"] for name in SEARCHED}
                for row in read_rows(folder / "trials" / f"{int(trial['trial']):04d}/training/evaluations.csv"):
                    key = (*combination(parameters), row["step"])
                    rows[key] = parameters | {name: row[name] for name in RESULTS}
    if rows:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, [*SEARCHED, *RESULTS], lineterminator="\n")
            writer.writeheader()
            for key in sorted(rows):
                writer.writerow({
                    name: int(value) if value.is_integer() else value for name, value in rows[key].items()
                })  # fmt: skip


def combination(row: dict[str, Any]) -> tuple[float, ...]:
    """Return the values of the parameters that were searched."""
    return tuple(row[name] for name in SEARCHED)


def read_search(path: Path) -> tuple[list[dict[str, Any]], list[list[dict[str, Any]]]]:
    """Read `search.csv`: the first evaluation of all combinations, and all of those continued, the best first."""
    groups = [list(group) for _, group in groupby(read_rows(path), combination)]
    continued = [group for group in groups if len(group) > 1]
    return [group[0] for group in groups], sorted(continued, key=lambda group: -group[0]["mean_reward"])


def label(name: str) -> str:
    """Return the label of a training by the name of its folder: `ppo-1` is PPO with the seed 1."""
    algorithm, _, seed = name.partition("-")
    return f"{algorithm.upper()}, seed {seed or 0}"


def cells(rows: list[dict[str, Any]]) -> str:
    """Return the mean reward, power and deviation of years, and the reward's identity, as cells of a table."""
    reward = statistics.fmean(row["mean_reward"] for row in rows)
    power = statistics.fmean(power_w(row) for row in rows)
    deviation_k = statistics.fmean(row["mean_deviation_k"] for row in rows)
    return f"{reward:.4f} | {power:,.0f} | {deviation_k:.4f} | {identity(power, deviation_k):.4f} |".replace("-", MINUS)


def training_table(folders: list[Path]) -> list[str]:
    """Return a table with the best and the last evaluation of each training, in the year of the evaluations."""
    header = f"| training | evaluation, years | reward | W | K | {IDENTITY} | power against `baseline` |"
    lines = [header, "|---|---|---|---|---|---|---|"]
    reference = read_rows(folders[0] / "references.csv")[:1]
    lines.append(f"| `baseline` | | {cells(reference)} |")
    for folder in folders:
        rows = read_rows(folder / "evaluations.csv")
        best = max(rows, key=lambda row: row["mean_reward"])
        for row, kind in ((best, "best"), (rows[-1], "last")):
            change = 100.0 * (power_w(row) / power_w(reference[0]) - 1.0)
            lines.append(
                f"| {label(folder.name)} | {kind}: {row['step'] / YEAR:.0f} | {cells([row])} {change:+.1f} % |".replace(
                    "-", MINUS
                )
            )
    return lines


def agent_table(path: Path) -> list[str]:
    """Return a table of the mean over years whose weather noise no training and no choice of a policy has seen."""
    rows = read_rows(path)
    lines = [
        f"| controller | years | reward | W | K | {IDENTITY} | building, MWh a year |",
        "|---|---|---|---|---|---|---|",
    ]
    by_controller: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_controller.setdefault(Path(str(row["controller"])).name, []).append(row)
    for name, years in by_controller.items():
        title = f"{label(name)}, best policy" if name.startswith(TRAINED) else f"`{name}`"
        building = statistics.fmean(row["electricity_kwh"] for row in years) / 1e3
        lines.append(f"| {title} | {len(years)} | {cells(years)} {building:,.1f} |")
    return lines


def search_table(rows: list[dict[str, Any]]) -> list[str]:
    """Return tables with the mean reward after two years by the value of each parameter, and the best combinations."""
    lines = [f"Completed: {len(rows)} of {COMBINATIONS} combinations.", ""]
    lines += ["| parameter | value | combinations | reward, mean | reward, best |", "|---|---|---|---|---|"]
    for name, values in GRID.items():
        for value in values:
            rewards = [row["mean_reward"] for row in rows if row[name] == value]
            if rewards:
                numbers = f"{statistics.fmean(rewards):.4f} | {max(rewards):.4f}".replace("-", MINUS)
                lines.append(f"| `{name}` | {value:g} | {len(rewards)} | {numbers} |")
    lines += ["", f"| the best combinations | reward | W | K | {IDENTITY} |", "|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: -row["mean_reward"])[:5]:
        lines.append(f"| {title(row)} | {cells([row])}")
    return lines


def title(row: dict[str, Any]) -> str:
    """Return the parameters of a combination as words of a table."""
    return ", ".join(f"`{name}` {row[name]:g}" for name in SEARCHED)


def continued_table(trained: list[list[dict[str, Any]]], baseline: dict[str, Any]) -> list[str]:
    """Return a table with the first, the best and the last evaluation of the combinations that were continued."""

    def line(name: str, years: str, row: dict[str, Any]) -> str:
        reward = f"{row['mean_reward']:.4f}".replace("-", MINUS)
        numbers = f"{power_w(row):,.0f} | {metered_w(row):,.0f} | {row['mean_deviation_k']:.4f}"
        return f"| {name} | {years} | {reward} | {numbers} |"

    lines = ["| combination | years | reward | W | W, meter | K |", "|---" * 6 + "|", line("`baseline`", "", baseline)]
    for evaluated in trained:
        best = max(evaluated, key=lambda row: row["mean_reward"])
        shown = {row["step"]: row for row in (evaluated[0], best, evaluated[-1])}
        lines += [line(title(row), f"{row['step'] / YEAR:.0f}", row) for row in shown.values()]
    first, last = (statistics.fmean(rows[place]["mean_reward"] for rows in trained) for place in (0, -1))
    best = max((row for rows in trained for row in rows), key=lambda row: row["mean_reward"])
    change = 100.0 * (metered_w(best) / metered_w(baseline) - 1.0)
    text = (
        f"Mean of the first evaluations: {first:.4f}, of the last ones: {last:.4f}. The best of all evaluations, "
        f"{best['mean_reward']:.4f} after {best['step'] / YEAR:.0f} years, needs {abs(change):.1f} % "
        f"{'less' if change < 0.0 else 'more'} energy by the meters than the baseline."
    )
    return [*lines, "", text.replace("-", MINUS)]


def replace_block(text: str, name: str, lines: list[str]) -> str:
    """Return a page with other lines between two comments.

    Raises:
        ValueError: the page lacks them.
    """
    before, _, rest = text.partition(BEGIN.format(name))
    _, end, after = rest.partition(END.format(name))
    if not end:
        raise ValueError(f"the page needs {BEGIN.format(name)} and {END.format(name)}")
    return "\n".join([before + BEGIN.format(name), "", *lines, "", END.format(name) + after])


def page_text(text: str, published: Path) -> str:
    """Return the page with the tables of published files."""
    folders = trainings(published)
    years = ", ".join(
        f"{folder.name.upper()} {read_rows(folder / 'curve.csv')[-1]['step'] / YEAR:.0f}" for folder in folders
    )
    text = replace_block(text, "trainings", [*training_table(folders), "", f"Years trained of {YEARS}: {years}."])
    text = replace_block(text, "agents", agent_table(published / "agents.csv"))
    first, trained = read_search(published / "search.csv")
    text = replace_block(text, "search", search_table(first))
    baseline = read_rows(published / "ppo" / "references.csv")[0]
    return replace_block(text, "continued", continued_table(trained, baseline))


def main() -> None:
    """Read the command line and write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="copy the files here")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the tables into this page")
    options = parser.parse_args()
    published = options.out or options.runs
    if options.out:
        publish(options.runs, options.out)
        publish_search(options.runs, options.out)
    if options.page:
        options.page.write_text(page_text(options.page.read_text(encoding="utf-8"), published), encoding="utf-8")
        with mpl.rc_context(theme.style("paper")):
            images = options.page.parent / "images"
            draw_training(trainings(published), images / "paper-training.png")
            first, trained = read_search(published / "search.csv")
            draw_search(first, images / "paper-search.png")
            baseline = read_rows(published / "ppo" / "references.csv")[0]["mean_reward"]
            draw_continued(trained, baseline, images / "paper-continued.png")


if __name__ == "__main__":
    main()
