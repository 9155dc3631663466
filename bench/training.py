"""Part `training`: the time in which PPO reaches the same return here and in Sinergym, on the paper's data center.

Both train with the same arguments of stable-baselines3 on a July with weather noise, here in the slots of one node and
in Sinergym in a `SubprocVecEnv`. Measured if `SINERGYM_PYTHON` is an interpreter that has Sinergym and
stable-baselines3; its `EPLUS_PATH` has to be set as well.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.machine import OtherLoad

PROGRAM = Path(__file__).with_name("training_worker.py")
OURS, PEER, SLOTS = "zenostat", "sinergym", 8
COLUMNS = ("steps", "s", "cpu_s", "us", "cpu_us")
WINDOW = SLOTS
"""Number of episodes in a moving mean of returns: one of each slot."""
EPISODE = 2_976
"""Timesteps of an episode."""
MONTHS = 6
"""Episodes of each slot."""
SHARE = 0.9
"""The return to reach, as a share of what all kinds have gained at their best."""

Episode = tuple[int, float, float, float]
"""Training step, seconds, processor seconds and return of a finished episode."""


def measure(*, quick: bool) -> dict[str, Any]:
    """Train both once per round, in turn; the round's number is the seed."""
    steps, count = (2 * SLOTS * EPISODE, 1) if quick else (MONTHS * SLOTS * EPISODE, 3)
    kinds = {OURS: sys.executable}
    if peer := os.environ.get("SINERGYM_PYTHON"):
        kinds[PEER] = peer
    rounds, all_curves = [], []
    for number in range(count):
        load = OtherLoad()
        order = list(kinds) if number % 2 == 0 else list(reversed(kinds))
        curves = {kind: _train(kind, kinds[kind], steps, number) for kind in order}
        all_curves.append({kind: curves[kind] for kind in kinds})
        rounds.append(pace.Round(_figures(curves), load.share()))
    results = {
        "kinds": [*kinds],
        "steps": steps,
        "others": pace.spread([one.other_load for one in rounds]),
        "curves": all_curves,
    }
    figures = [one.figures for one in rounds]  # of all rounds: each has another seed
    results |= {name: pace.spread([each[name] for each in figures]) for name in figures[0]}
    if PEER in kinds:
        ratios = {name: [each[f"{OURS} {name}"] / each[f"{PEER} {name}"] for each in figures] for name in COLUMNS}
        results |= {f"{name} ratio": pace.spread(values) for name, values in ratios.items()}
        results["ratios"] = ratios
    return results


def _train(kind: str, interpreter: str, steps: int, seed: int) -> list[Episode]:
    with tempfile.TemporaryDirectory(prefix="zenostat-bench-") as folder:
        done = subprocess.run(
            [interpreter, "-P", str(PROGRAM), kind, str(steps), str(SLOTS), str(seed)],
            capture_output=True, text=True, check=False, env={**os.environ, "TMPDIR": folder},
        )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{kind} failed:\n{done.stderr[-3000:]}")
    episodes: list[Episode] = [tuple(row) for row in json.loads(done.stdout.splitlines()[-1])]
    if [episode[0] for episode in episodes[:SLOTS]] != [SLOTS * EPISODE] * SLOTS:
        raise RuntimeError(f"{kind}: the first episodes end at {episodes[:SLOTS]}, not at {SLOTS * EPISODE:,} steps")
    return episodes


def smoothed(episodes: list[Episode]) -> list[float]:
    """Return the mean return of each `WINDOW` episodes in a row."""
    returns = [episode[3] for episode in episodes]
    return [statistics.fmean(returns[end - WINDOW : end]) for end in range(WINDOW, len(returns) + 1)]


def first_at(episodes: list[Episode], level: float) -> Episode:
    """Return the episode at which the moving mean has reached a level for the first time."""
    means = smoothed(episodes)
    return episodes[WINDOW - 1 + next(place for place, mean in enumerate(means) if mean >= level)]


def _figures(curves: dict[str, list[Episode]]) -> dict[str, float]:
    """Return, for each kind, steps and times up to a mean return that all have reached, and in all."""
    means = [smoothed(curve) for curve in curves.values()]
    first, best = statistics.fmean(mean[0] for mean in means), min(max(mean) for mean in means)
    level = first + SHARE * (best - first)
    figures = {"level": level}
    for kind, curve in curves.items():
        reached, end = first_at(curve, level), curve[-1]
        figures |= {f"{kind} steps": reached[0], f"{kind} s": reached[1], f"{kind} cpu_s": reached[2]}
        figures |= {f"{kind} us": 1e6 * end[1] / end[0], f"{kind} cpu_us": 1e6 * end[2] / end[0]}
    return figures


def plot(results: dict[str, Any], folder: Path) -> list[Path]:
    """Write `perf-training.png`: the mean return by the time since the start, of each round."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for place, kind in enumerate(results["kinds"]):
        for number, curves in enumerate(results["curves"]):
            minutes = [episode[1] / 60 for episode in curves[kind][WINDOW - 1 :]]
            label = kind if number == 0 else None
            axes.plot(minutes, smoothed(curves[kind]), color=f"C{place}", label=label)
    axes.axhline(results["level"]["median"], color="0.5", linestyle="--", label="level of the table")
    axes.set(xlabel="minutes since the start", ylabel=f"mean return of {WINDOW} episodes", xlim=(0, None))
    axes.legend()
    axes.grid(alpha=0.3)
    target = folder / "perf-training.png"
    figure.savefig(target, dpi=120)
    return [target]


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    level = results["level"]["median"]
    table = Table(
        "", "steps", "s", "processor s", "us a step", "processor us a step",
        title=f"PPO on the data center until the mean return is {level:,.0f}; {results['steps']:,} steps in all",
    )  # fmt: skip
    for kind in results["kinds"]:
        values = [results[f"{kind} {name}"]["median"] for name in COLUMNS]
        table.add_row(kind, *(f"{value:,.0f}" for value in values))
    if PEER in results["kinds"]:
        table.add_row("ratio", *(f"{results[f'{name} ratio']['median']:.2f}" for name in COLUMNS))
        for seed, ratios in enumerate(zip(*results["ratios"].values(), strict=True)):
            table.add_row(f"ratio of seed {seed}", *(f"{ratio:.2f}" for ratio in ratios))
    console.print(table)
