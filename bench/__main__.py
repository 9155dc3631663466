"""Measure the costs of steps (wall and processor time), resets, branches, vector steps, monitors and recordings.

The results are printed as tables and written as JSON to `bench/results/`.

Each round measures every kind once, in bursts of a fraction of a second. Each kind has processes of its own, which are
idle between its bursts, so that other load on the machine affects all kinds alike. Results are the ratios within a
round, over the half of the rounds in which other processes used the least processor time.
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

from bench import (
    boptest,
    branches,
    growth,
    loops,
    monitors,
    noise,
    peers,
    plans,
    plants,
    processor,
    recording,
    resets,
    rooms,
    steps,
    training,
    vector,
)
from zenostat.topics import VERSION

PARTS: Mapping[str, Any] = {
    "steps": steps,
    "processor": processor,
    "plants": plants,
    "resets": resets,
    "noise": noise,
    "branches": branches,
    "plans": plans,
    "loops": loops,
    "peers": peers,
    "vector": vector,
    "training": training,
    "monitors": monitors,
    "rooms": rooms,
    "recording": recording,
    "growth": growth,
    "boptest": boptest,
}
IMPORT = """
import sys, time
start = time.perf_counter()
import zenostat
print(time.perf_counter() - start, [m for m in ("rerun", "pyenergyplus") if m in sys.modules])
"""


def import_time() -> tuple[float, str]:
    """Return the median seconds of `import zenostat`, and which of Rerun and EnergyPlus it loads."""
    outputs = [
        subprocess.run([sys.executable, "-P", "-c", IMPORT], capture_output=True, text=True, check=True).stdout.split(
            " ", 1
        )
        for _ in range(5)
    ]
    return statistics.median(float(seconds) for seconds, _ in outputs), outputs[0][1].strip()


def main() -> None:
    """Run the benchmarks, print the tables, write the results."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; default: all")
    parser.add_argument("--quick", action="store_true", help="few rounds; the figures are not reliable")
    parser.add_argument("--plot", type=Path, metavar="FOLDER", help="plot the results of growth and training here")
    options = parser.parse_args()
    if unknown := [part for part in options.parts if part not in PARTS]:
        parser.error(f"unknown part {', '.join(unknown)}; choose from {', '.join(PARTS)}")
    console, results = Console(), {}
    for part in options.parts or PARTS:
        with console.status(f"measuring {part}"):
            results[part] = PARTS[part].measure(quick=options.quick)
        PARTS[part].show(results[part], console)
    seconds, loads = import_time()
    console.print(f"import zenostat: {seconds:.2f} s; loads of Rerun and EnergyPlus: {loads}")
    for part in ("growth", "training"):
        if options.plot and part in results:
            for path in PARTS[part].plot(results[part], options.plot):
                console.print(f"plot written to {path}")
    console.print(f"results written to {_write({**results, 'quick': options.quick, 'import_s': seconds})}")


def _write(results: dict[str, Any]) -> Path:
    target = Path(__file__).parent / "results"
    target.mkdir(exist_ok=True)
    path = target / f"{datetime.now(UTC):%Y%m%dT%H%M%S}.json"
    environment = {"version": VERSION, "python": platform.python_version(), "machine": platform.machine()}
    path.write_text(json.dumps({**environment, **results}, indent=1))
    return path


if __name__ == "__main__":
    main()
