"""Part `noise`: resets and short episodes with weather noise, from the third day, from the first hour, and Sinergym's.

Sinergym is measured if `SINERGYM_PYTHON` is an interpreter that has it; its `EPLUS_PATH` has to be set as well.
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

from bench import pace, programs
from bench.machine import OtherLoad

OURS = ("third_day", "episode")
PEER = "sinergym"
PROGRAM = Path(__file__).with_name("noise_worker.py")


def measure(*, quick: bool) -> dict[str, Any]:
    """Measure each kind once per round, in processes of its own."""
    resets, episodes, count = ("3", "1", 1) if quick else ("10", "3", 5)
    kinds = dict.fromkeys(OURS, sys.executable)
    if peer := os.environ.get("SINERGYM_PYTHON"):
        kinds[PEER] = peer
    rounds = []
    for number in range(count):
        load, figures = OtherLoad(), {}
        titles = [*kinds]
        for kind in titles[number % len(titles) :] + titles[: number % len(titles)]:
            figures |= _run(kind, kinds[kind], resets, episodes)
        rounds.append(pace.Round(figures, load.share()))
    results: dict[str, Any] = {"others": pace.other_load(rounds), "kinds": [*kinds]}
    for kind in kinds:
        for name in ("reset_ms", "set_up_s", "per_second"):
            key = f"{kind} {name}"
            results[key] = pace.figures(rounds, key)
            results[f"{key} ratio"] = pace.figures(rounds, key, f"third_day {name}")
    return results


def _run(kind: str, interpreter: str, resets: str, episodes: str) -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="zenostat-bench-") as folder:
        done = subprocess.run(
            [interpreter, str(PROGRAM), kind, resets, episodes],
            capture_output=True,
            text=True,
            check=False,
            env={**(programs.environment() if kind in OURS else os.environ), "TMPDIR": folder},
        )
    if done.returncode:
        raise RuntimeError(f"{kind} failed:\n{done.stderr[-3000:]}")
    fields = json.loads(done.stdout.splitlines()[-1])
    return {
        f"{kind} reset_ms": statistics.median(fields["resets_ms"]),
        f"{kind} set_up_s": fields["set_up_s"],
        f"{kind} per_second": fields["per_second"],
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    table = Table(
        "", "reset, ms", "set-up of 8 slots, s", "transitions/s with resets", "ratio to third_day (reset; transitions)",
        title=f"weather noise, five zones, episodes of three days; other load {results['others']['median']:.0%}",
    )  # fmt: skip
    for kind in results["kinds"]:
        reset, slots = results[f"{kind} reset_ms ratio"], results[f"{kind} per_second ratio"]
        table.add_row(
            kind,
            *(f"{results[f'{kind} {name}']['median']:,.1f}" for name in ("reset_ms", "set_up_s", "per_second")),
            f"{reset['median']:.1f}; {slots['median']:.2f}",
        )
    console.print(table)
