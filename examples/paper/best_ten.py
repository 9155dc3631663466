"""Continue the ten best combinations of a finished `search.yaml` to 20 years each.

    python examples/paper/best_ten.py runs/search

A training that was interrupted continues where it was; one that is finished is skipped.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from zenostat.training import resume_training, train

YEAR = 35_040


def best(study: Path, count: int) -> list[Path]:
    """Return the training folders of the trials with the highest reward, best first."""
    with (study / "trials.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["state"] == "COMPLETE"]
    rows.sort(key=lambda row: -float(row["reward"]))
    return [study / "trials" / f"{int(row['trial']):04d}" / "training" for row in rows[:count]]


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--years", type=int, default=20)
    options = parser.parse_args()
    for folder in best(options.study, options.count):
        result = train(resume_training(folder, options.years * YEAR), resume=True)
        print(f"{folder}: {result.step:,} steps, best evaluation {result.best_reward:,.2f}", flush=True)


if __name__ == "__main__":
    main()
