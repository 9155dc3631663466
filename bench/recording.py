"""Part `recording`: cost per step of a recording, its size, and the speed of its verification."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import pace
from bench.pace import Worker

SCENES = {"five-zone": 4000, "office-small": 2000}
YEAR = 35_040
_BLOCK = 500
"""Timesteps of the verification that are timed together."""


def measure(*, quick: bool) -> dict[str, Any]:
    """Return microseconds per step with and without a recording, the recording's size, and the verification's speed."""
    return {scene: _measure(scene, steps, 3 if quick else 15) for scene, steps in SCENES.items()}


def _measure(scene: str, steps: int, count: int) -> dict[str, Any]:
    with ExitStack() as stack:
        folder = Path(tempfile.mkdtemp(prefix="zenostat-bench-"))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        path = folder / "run.mcap"
        workers = {
            "not recorded": stack.enter_context(Worker("env", scene, monitoring=True)),
            "recorded": stack.enter_context(Worker("env", scene, monitoring=True, record=str(path))),
            "engine": stack.enter_context(Worker("engines", scene, count=1)),
        }
        kinds = {title: pace.steps_of(worker, steps) for title, worker in workers.items()}
        rounds = pace.rounds(kinds, count)
        # The engine runs right before and after the verification, so that both have the same load.
        before = kinds["engine"]()
        file = _file(path)
        return {
            "us": {title: pace.figures(rounds, title) for title in kinds},
            "ratio": pace.figures(rounds, "recorded", "not recorded"),
            "others": pace.other_load(rounds),
            **file,
            "engine_us": pace.spread([before, kinds["engine"]()]),
        }


def _file(path: Path) -> dict[str, Any]:
    """Return the size of a recording for a year, and microseconds per step of its verification."""
    from zenostat.bridge.recording.reader import RecordingReader
    from zenostat.eplus_node.verify_recording import verify

    with RecordingReader(path) as reader:
        samples = sum(1 for _ in reader.messages({"Sample"}))
        points, actuators = len(reader.manifest.points), len(reader.manifest.actuators)
    times = [0.0]

    def note(steps: int, _total: int) -> None:
        if steps % _BLOCK == 0:
            times.append(perf_counter())

    result = verify(path, progress=note)
    blocks = [1e6 * (end - begin) / _BLOCK for begin, end in pairwise(times[1:])]
    return {
        "points": points,
        "actuators": actuators,
        "year_mb": path.stat().st_size / samples * YEAR / 1e6,
        "identical": result.passed,
        "verify_us": pace.spread(blocks),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    table = Table("", "ratio to none", "MB a year", "points", "verify (engine)", title="recordings, env.step")
    for scene, result in results.items():
        ratio, verify, engine = result["ratio"], result["verify_us"], result["engine_us"]
        table.add_row(
            scene,
            f"{ratio['median']:.3f} ({ratio['low']:.3f}-{ratio['high']:.3f})",
            f"{result['year_mb']:.1f}",
            f"{result['points']} + {result['actuators']}",
            f"{verify['median']:.0f} µs ({engine['median']:.0f} µs)" if result["identical"] else "DIFFERENT",
        )
    console.print(table)
