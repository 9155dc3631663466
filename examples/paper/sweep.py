"""Search the parameters of PPO on the data center of the Sinergym paper: a grid of 108 combinations.

    python examples/paper/sweep.py --episodes 20 --out runs/sweep
    python examples/paper/sweep.py --episodes 20 --out runs/sweep --part 1/4     # on the first of four machines

Each combination has a folder as of `train.py`; one that is complete is not run again. `results.csv` has a row for each,
best first. Shorter tries: `--count 4 --begin 07-01 --end 07-07 --episodes 2`.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
from pathlib import Path
from typing import Any

from train import SCENARIO, Settings, train, write_rows

GRID = {
    "learning_rate": (1e-4, 3e-4, 1e-3),
    "n_steps": (1024, 2048, 4096),
    "batch_size": (64, 128, 256),
    "gamma": (0.9, 0.95, 0.99, 0.995),
}
COMPLETE = "complete"
"""An empty file in the folder of a combination that has been trained to the end."""


def combinations() -> list[dict[str, Any]]:
    """Return the parameters of all combinations."""
    return [dict(zip(GRID, values, strict=True)) for values in itertools.product(*GRID.values())]


def is_complete(folder: Path) -> bool:
    """Whether a combination has been trained to the end."""
    return (folder / COMPLETE).exists()


def best_row(folder: Path, settings: Settings) -> dict[str, Any]:
    """Return the evaluation with the highest reward of a combination, trained now if it has not been."""
    if not is_complete(folder):
        train(settings, folder)
        (folder / COMPLETE).touch()
    with (folder / "curve.csv").open(newline="") as file:
        rows = [{name: float(text) for name, text in row.items()} for row in csv.DictReader(file)]
    return max(rows, key=lambda row: row["mean_reward"])


def collect(folder: Path) -> list[dict[str, Any]]:
    """Write `results.csv` of all complete combinations in a folder, and return its rows, best first."""
    rows = []
    for part in sorted(folder.glob("[0-9][0-9][0-9]")):
        if is_complete(part):
            settings = Settings(**json.loads((part / "settings.json").read_text()))
            rows.append({"number": part.name, **settings.parameters, **best_row(part, settings)})
    rows.sort(key=lambda row: -row["mean_reward"])
    write_rows(rows, folder / "results.csv")
    return rows


def main() -> None:
    """Read the command line, train what is missing, and print the best combinations."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--evaluate-every", type=int, default=5, metavar="EPISODES")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--begin", metavar="MM-DD")
    parser.add_argument("--end", metavar="MM-DD")
    parser.add_argument("--part", default="1/1", metavar="K/N", help="every N-th combination, from the K-th on")
    parser.add_argument("--count", type=int, help="only so many combinations, spread evenly over the grid")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    options = parser.parse_args()
    period = {name: value for name in ("begin", "end") if (value := getattr(options, name))}
    grid = list(enumerate(combinations()))
    if options.count:
        grid = grid[:: len(grid) // options.count][: options.count]
    part, parts = map(int, options.part.split("/"))
    for number, parameters in grid[part - 1 :: parts]:
        settings = Settings(
            "ppo", SCENARIO, period, parameters, options.episodes, options.evaluate_every, seed=options.seed
        )
        row = best_row(options.out / f"{number:03}", settings)
        print(number, parameters, f"reward {row['mean_reward']:.4f}", flush=True)
    for rank, row in enumerate(collect(options.out)[:10], 1):
        print(rank, {name: row[name] for name in GRID}, f"{row['mean_reward']:.4f}, {row['power_w']:,.0f} W")


if __name__ == "__main__":
    main()
