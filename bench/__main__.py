"""`python -m bench`: what a step costs, all in one run, as a table and as JSON in `bench/results/`.

Each round measures every kind once, in a process of its own, so that whatever else the machine does falls on
all of them; a kind's figure is the median over the rounds.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from topics import VERSION

BUILDINGS = ("office-small", "office-medium")
KINDS = {
    "EnergyPlus alone": ("bare", 0),
    "callback in its process": ("callback", 0),
    "thread and two queues": ("queues", 0),
    "env.step, default (apart)": ("apart", 0),
    "env.step, 1 monitor": ("apart", 1),
    "env.step, 3 monitors": ("apart", 3),
    "env.step, node and engine on one core": ("node", 0),
    "env.step, controller there too": ("together", 0),
    "env.step, not placed": ("off", 0),
}
REFERENCE = "thread and two queues"
MORE_RESETS = ("outpatient",)
"""A building that takes long to its first step."""


IMPORT = """
import sys, time
start = time.perf_counter()
import agent_sdk
print(time.perf_counter() - start, [m for m in ("rerun", "pyenergyplus") if m in sys.modules])
"""


def import_time() -> tuple[float, str]:
    """Median seconds of `import agent_sdk`, and which of Rerun and EnergyPlus it loads."""
    said = [
        subprocess.run([sys.executable, "-c", IMPORT], capture_output=True, text=True, check=True).stdout.split(" ", 1)
        for _ in range(5)
    ]
    return statistics.median(float(seconds) for seconds, _ in said), said[0][1].strip()


def measure(kind: str, building: str, days: int, monitors: int) -> tuple[float, float | None]:
    """Mean microseconds a step of one run, and the memory of node and engine where there are such."""
    command = [sys.executable, "-m", "bench.worker", kind, building, str(days), str(monitors)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed:\n{done.stderr[-2000:]}")
    figures = json.loads(done.stdout.splitlines()[-1])
    return figures["mean_us"], figures["memory_mb"]


def measure_resets(building: str) -> dict[str, float]:
    """Median milliseconds of a reset that forks and of one that starts an engine."""
    done = subprocess.run([sys.executable, "-m", "bench.resets", building], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"bench.resets {building} failed:\n{done.stderr[-2000:]}")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--days", type=int, default=20)
    parser.add_argument("--building", action="append", help="short names; both offices by default")
    asked = parser.parse_args()
    buildings = asked.building or list(BUILDINGS)
    console = Console()
    results: dict[str, dict[str, list[float]]] = {b: {k: [] for k in KINDS} for b in buildings}
    memory = dict.fromkeys(buildings, 0.0)
    with Progress(console=console) as progress:
        bar = progress.add_task("measuring", total=asked.rounds * len(buildings) * len(KINDS))
        for _ in range(asked.rounds):
            for building in buildings:
                for title, (kind, monitors) in KINDS.items():
                    spent_us, memory_mb = measure(kind, building, asked.days, monitors)
                    results[building][title].append(spent_us)
                    memory[building] = max(memory[building], memory_mb or 0.0)
                    progress.advance(bar)
    for building, kinds in results.items():
        console.print(_table(building, kinds))
        console.print(f"node and engine of {building}: {memory[building]:.0f} MB")
    resets = {building: measure_resets(building) for building in (*buildings, *MORE_RESETS)}
    console.print(_reset_table(resets))
    seconds, loads = import_time()
    console.print(f"import agent_sdk: {seconds:.2f} s; of Rerun and EnergyPlus it loads {loads}")
    target = Path(__file__).parent / "results"
    target.mkdir(exist_ok=True)
    now = datetime.now(UTC)
    written = target / f"{now:%Y%m%dT%H%M%S}.json"
    about = {"version": VERSION, "python": platform.python_version(), "machine": platform.machine()}
    written.write_text(
        json.dumps(
            {
                **about,
                "days": asked.days,
                "us_per_step": results,
                "memory_mb": memory,
                "reset_ms": resets,
                "import_s": seconds,
            },
            indent=1,
        )
    )
    console.print(f"written to {written.relative_to(Path.cwd())}" if written.is_relative_to(Path.cwd()) else written)


def _table(building: str, kinds: dict[str, list[float]]) -> Table:
    table = Table("", "us a step", "times queues", "spread of ratio", title=building)
    for title, figures in kinds.items():
        ratios = [a / b for a, b in zip(figures, kinds[REFERENCE], strict=True)]
        spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
        table.add_row(title, f"{statistics.median(figures):.0f}", f"{statistics.median(ratios):.2f}", spread)
    return table


def _reset_table(resets: dict[str, dict[str, float]]) -> Table:
    table = Table("", "forked (ms)", "started (ms)", "times", title="env.reset")
    for building, ms in resets.items():
        cells = (f"{ms['forked']:.1f}", f"{ms['started']:.0f}", f"{ms['started'] / ms['forked']:.0f}")
        table.add_row(building, *cells)
    return table


if __name__ == "__main__":
    main()
