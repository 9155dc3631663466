"""What a step, a reset, a branch, a vector step cost; all in one run, as tables and as JSON in `bench/results/`.

Each round measures every kind once, in bursts of a fraction of a second, each kind in processes of its own that stand
still meanwhile; whatever else the machine does falls on all of them. What counts are the ratios within a round, over
the half of the rounds in which others took least of the cores.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from bench import branches, growth, monitors, resets, steps, vector
from topics import VERSION

PARTS: Mapping[str, Any] = {
    "steps": steps,
    "resets": resets,
    "branches": branches,
    "vector": vector,
    "monitors": monitors,
    "growth": growth,
}
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


def main() -> None:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all if left out")
    parser.add_argument("--quick", action="store_true", help="few rounds: a look, no figures to keep")
    parser.add_argument("--plot", type=Path, metavar="FOLDER", help="draw the part growth there")
    asked = parser.parse_args()
    if unknown := [part for part in asked.parts if part not in PARTS]:
        parser.error(f"no part {', '.join(unknown)}; there are: {', '.join(PARTS)}")
    console, results = Console(), {}
    for part in asked.parts or PARTS:
        with console.status(f"measuring {part}"):
            results[part] = PARTS[part].measure(quick=asked.quick)
        PARTS[part].show(results[part], console)
    seconds, loads = import_time()
    console.print(f"import agent_sdk: {seconds:.2f} s; of Rerun and EnergyPlus it loads {loads}")
    if asked.plot and "growth" in results:
        for path in growth.plot(results["growth"], asked.plot):
            console.print(f"drawn: {path}")
    console.print(f"written to {_write({**results, 'quick': asked.quick, 'import_s': seconds})}")


def _write(results: dict[str, Any]) -> Path:
    target = Path(__file__).parent / "results"
    target.mkdir(exist_ok=True)
    written = target / f"{datetime.now(UTC):%Y%m%dT%H%M%S}.json"
    about = {"version": VERSION, "python": platform.python_version(), "machine": platform.machine()}
    written.write_text(json.dumps({**about, **results}, indent=1))
    return written


if __name__ == "__main__":
    main()
