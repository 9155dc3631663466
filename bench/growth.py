"""Part `growth`: cost by the number of points in a sample, slots in a node and nodes on a machine."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

POINTS = (10, 100, 1000)
POINTS_SCENE, POINTS_STEPS = "office-medium", 200
SLOTS = (1, 2, 4, 8, 16, 32)
NODES = (1, 2, 4, 8)
SCENE = "five-zone"
_UNITS = {
    "points": ("sensors in a sample", "µs per step"),
    "slots": ("slots", "transitions/s"),
    "nodes": ("nodes", "transitions/s"),
}


def measure(*, quick: bool) -> dict[str, Any]:
    """Return, for each of the three, figures by kind and number."""
    count, seconds = (3, 0.2) if quick else (12, 0.4)
    return {"points": _points(count), "slots": _slots(count, seconds), "nodes": _nodes(count, seconds)}


def _summary(rounds: list[pace.Round], kinds: dict[str, dict[int, str]]) -> dict[str, Any]:
    lines = {
        kind: {str(number): pace.figures(rounds, title) for number, title in titles.items()}
        for kind, titles in kinds.items()
    }
    return {"lines": lines, "others": pace.other_load(rounds)}


def _points(count: int) -> dict[str, Any]:
    kinds = {"thread and two queues": "queues", "env.step": "env"}
    titles = {kind: {number: f"{kind} {number}" for number in POINTS} for kind in kinds}
    with ExitStack() as stack:
        measures = {}
        for kind, worker in kinds.items():
            for number in POINTS:
                process = stack.enter_context(Worker(worker, POINTS_SCENE, sensors=number))
                measures[titles[kind][number]] = pace.steps_of(process, POINTS_STEPS)
        return _summary(pace.rounds(measures, count), titles)


def _slots(count: int, seconds: float) -> dict[str, Any]:
    titles = {"vector environment": {number: f"slots {number}" for number in SLOTS}}
    titles["engines alone"] = {number: f"bare {number}" for number in SLOTS}
    cores = sorted(os.sched_getaffinity(0))
    with ExitStack() as stack:
        bare = [
            stack.enter_context(Worker("bare", SCENE, core=cores[index % len(cores)])) for index in range(max(SLOTS))
        ]
        measures = {}
        for number in SLOTS:
            envs = stack.enter_context(Worker("vector", SCENE, count=number, mode="vector_entry_point"))
            measures[f"slots {number}"] = pace.rate_of([envs], seconds, each=number)
            measures[f"bare {number}"] = pace.rate_of(bare[:number], seconds)
        return _summary(pace.rounds(measures, count), titles)


def _nodes(count: int, seconds: float) -> dict[str, Any]:
    titles = {"env.step": {number: f"nodes {number}" for number in NODES}}
    with ExitStack() as stack:
        envs = [stack.enter_context(Worker("env", SCENE)) for _ in range(max(NODES))]
        measures = {f"nodes {number}": pace.rate_of(envs[:number], seconds) for number in NODES}
        return _summary(pace.rounds(measures, count), titles)


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table for each of the three."""
    for part, result in results.items():
        label, unit = _UNITS[part]
        numbers = [*next(iter(result["lines"].values()))]
        table = Table(label, *numbers, title=unit)
        for kind, line in result["lines"].items():
            table.add_row(kind, *(f"{line[number]['median']:.0f}" for number in numbers))
        console.print(table)


def plot(results: dict[str, Any], folder: Path) -> list[Path]:
    """Write `perf-points.png`, `perf-slots.png` and `perf-nodes.png`: medians as lines, quartiles as bands."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for part, result in results.items():
        figure = Figure(figsize=(6.4, 3.6), layout="constrained")
        axes = figure.subplots()
        for kind, line in result["lines"].items():
            numbers = [int(number) for number in line]
            axes.plot(numbers, [figures["median"] for figures in line.values()], marker="o", label=kind)
            low, high = ([figures[end] for figures in line.values()] for end in ("low", "high"))
            axes.fill_between(numbers, low, high, alpha=0.2)
        axes.set_xscale("log", base=10 if part == "points" else 2)
        axes.set_xticks(numbers, [str(number) for number in numbers])
        axes.set(xlabel=_UNITS[part][0], ylabel=_UNITS[part][1], ylim=(0, None))
        axes.legend()
        axes.grid(alpha=0.3)
        target = folder / f"perf-{part}.png"
        figure.savefig(target, dpi=120)
        paths.append(target)
    return paths
