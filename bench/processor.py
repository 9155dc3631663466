"""Part `processor`: processor time per step beside wall time, by how long the controller computes for an action.

A side that polls is quicker and uses processor time that others on the machine lack.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

SCENE = "five-zone"
STEPS = {0.0: 3000, 0.5: 1500, 5.0: 300}
"""Steps per burst by the milliseconds for which the controller computes."""
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "thread and two queues": ("queues", {}),
    "env.step, default (apart)": ("env", {"affinity": "apart"}),
    "env.step, node and engine on one core": ("env", {"affinity": "node"}),
    "env.step, not placed": ("env", {"affinity": "off"}),
}
REFERENCE = "thread and two queues"
_CPU = ", processor"


def measure(*, quick: bool) -> dict[str, Any]:
    """Return microseconds per step of each kind, without the controller's own, and the ratio to the reference."""
    return {f"{compute_ms:g}": _measure(compute_ms, steps, 3 if quick else 9) for compute_ms, steps in STEPS.items()}


def _measure(compute_ms: float, steps: int, count: int) -> dict[str, Any]:
    compute_us = 1e3 * compute_ms
    with ExitStack() as stack:
        workers = {
            title: stack.enter_context(Worker(kind, SCENE, compute_s=compute_ms / 1e3, **options))
            for title, (kind, options) in KINDS.items()
        }

        def processor() -> dict[str, float]:
            return {title + _CPU: worker.latest.cpu_us - compute_us for title, worker in workers.items()}

        kinds = {title: pace.steps_of(worker, steps, less_us=compute_us) for title, worker in workers.items()}
        rounds = pace.rounds(kinds, count, also=processor)
    return {
        "wall_us": {title: pace.figures(rounds, title) for title in KINDS},
        "wall_ratio": {title: pace.figures(rounds, title, REFERENCE) for title in KINDS},
        "cpu_us": {title: pace.figures(rounds, title + _CPU) for title in KINDS},
        "cpu_ratio": {title: pace.figures(rounds, title + _CPU, REFERENCE + _CPU) for title in KINDS},
        "others": pace.other_load(rounds),
        "rounds": [result.figures for result in rounds],
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table for each controller."""
    for compute_ms, result in results.items():
        title = f"{SCENE}, controller computes {compute_ms} ms (not included)"
        table = Table("", "µs per step", "to queues", "processor µs", "to queues", title=title)
        for kind in KINDS:
            cells = [
                cell
                for us, ratio in (("wall_us", "wall_ratio"), ("cpu_us", "cpu_ratio"))
                for cell in (f"{result[us][kind]['median']:.0f}", _ratio(result[ratio][kind]))
            ]
            table.add_row(kind, *cells)
        console.print(table)
        console.print(f"other load {result['others']['median']:.0%}")


def _ratio(figures: dict[str, float]) -> str:
    return f"{figures['median']:.2f} ({figures['low']:.2f}-{figures['high']:.2f})"
