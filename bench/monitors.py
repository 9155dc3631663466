"""Part `monitors`: cost per step of monitors that record to Rerun."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

SCENES = {"five-zone": 4000, "office-small": 2000}
COUNTS = (0, 1, 3, 10)
_SETTLE_S = 0.5
"""Pause in which monitors work off their backlog, which would slow the next kind."""


def measure(*, quick: bool) -> dict[str, Any]:
    """Return microseconds per step by number of monitors, and the ratio to no monitors."""
    return {scene: _measure(scene, steps, 3 if quick else 9) for scene, steps in SCENES.items()}


def _measure(scene: str, steps: int, count: int) -> dict[str, Any]:
    with ExitStack() as stack:
        workers = {str(m): stack.enter_context(Worker("env", scene, monitors=m)) for m in COUNTS}
        kinds = {title: pace.steps_of(worker, steps) for title, worker in workers.items()}
        rounds = pace.rounds(kinds, count, settle_s=_SETTLE_S)
    return {
        "us": {title: pace.figures(rounds, title) for title in workers},
        "ratio": {title: pace.figures(rounds, title, "0") for title in workers},
        "others": pace.other_load(rounds),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    table = Table("", *(f"{count} monitors" for count in COUNTS), title="env.step, ratio to no monitor")
    for scene, result in results.items():
        ratios = (result["ratio"][str(count)] for count in COUNTS)
        table.add_row(scene, *(f"{r['median']:.2f} ({r['low']:.2f}-{r['high']:.2f})" for r in ratios))
    console.print(table)
