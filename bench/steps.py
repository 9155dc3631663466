"""Part `steps`: cost of `env.step` across processes, compared with EnergyPlus in a thread with two queues."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

SCENES = {"five-zone": 8000, "office-small": 3000, "office-medium": 2000}
"""Steps per burst by scene: enough for some seconds, so that each side has adapted its polling to the other."""
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "EnergyPlus alone": ("bare", {}),
    "callback in its process": ("callback", {}),
    "thread and two queues": ("queues", {}),
    "env.step, default (apart)": ("env", {"affinity": "apart"}),
    "env.step, node and engine on one core": ("env", {"affinity": "node"}),
    "env.step, controller there too": ("env", {"affinity": "together"}),
    "env.step, not placed": ("env", {"affinity": "off"}),
    "bare bytes, node and engine on one core": ("chain", {"affinity": "node"}),
    "bare bytes, controller there too": ("chain", {"affinity": "together"}),
}
REFERENCE = "thread and two queues"


def measure(*, quick: bool) -> dict[str, Any]:
    """Return microseconds per step of each kind, and the ratio to the reference."""
    return {scene: _measure(scene, steps, 3 if quick else 9) for scene, steps in SCENES.items()}


def _measure(scene: str, steps: int, count: int) -> dict[str, Any]:
    with ExitStack() as stack:
        workers = {
            title: stack.enter_context(Worker(kind, scene, **options)) for title, (kind, options) in KINDS.items()
        }
        rounds = pace.rounds({title: pace.steps_of(worker, steps) for title, worker in workers.items()}, count)
        memory = workers["env.step, default (apart)"].about["memory_mb"]
    return {
        "us": {title: pace.figures(rounds, title) for title in KINDS},
        "ratio": {title: pace.figures(rounds, title, REFERENCE) for title in KINDS},
        "memory_mb": memory,
        "others": pace.other_load(rounds),
        "rounds": [result.figures for result in rounds],
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table for each scene."""
    for scene, result in results.items():
        table = Table("", "µs per step", "ratio to queues", "quartiles", title=scene)
        for title in KINDS:
            ratio = result["ratio"][title]
            quartiles = f"{ratio['low']:.2f} to {ratio['high']:.2f}"
            table.add_row(title, f"{result['us'][title]['median']:.0f}", f"{ratio['median']:.2f}", quartiles)
        console.print(table)
        console.print(f"node and engines: {result['memory_mb']:.0f} MB; other load {result['others']['median']:.0%}")
