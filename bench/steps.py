"""Part `steps`: what `env.step` costs across processes, against EnergyPlus in a thread with two queues."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

SCENES = {"five-zone": 8000, "office-small": 3000, "office-medium": 2000}
"""And the steps of a burst: some seconds, so that what each side has learnt of the other's waiting counts."""
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
    """Microseconds a step of each kind, and times the reference."""
    return {scene: _of(scene, steps, 3 if quick else 9) for scene, steps in SCENES.items()}


def _of(scene: str, steps: int, count: int) -> dict[str, Any]:
    with ExitStack() as stack:
        workers = {
            title: stack.enter_context(Worker(kind, scene, **options)) for title, (kind, options) in KINDS.items()
        }
        found = pace.rounds({title: pace.steps_of(worker, steps) for title, worker in workers.items()}, count)
        memory = workers["env.step, default (apart)"].about["memory_mb"]
    return {
        "us": {title: pace.figures(found, title) for title in KINDS},
        "ratio": {title: pace.figures(found, title, REFERENCE) for title in KINDS},
        "memory_mb": memory,
        "others": pace.others(found),
        "rounds": [one.figures for one in found],
    }


def show(results: dict[str, Any], console: Console) -> None:
    """A table for each building."""
    for scene, found in results.items():
        table = Table("", "us a step", "times queues", "quartiles", title=scene)
        for title in KINDS:
            times = found["ratio"][title]
            quartiles = f"{times['low']:.2f} to {times['high']:.2f}"
            table.add_row(title, f"{found['us'][title]['median']:.0f}", f"{times['median']:.2f}", quartiles)
        console.print(table)
        console.print(f"node and engines: {found['memory_mb']:.0f} MB; others took {found['others']['median']:.0%}")
