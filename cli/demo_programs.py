"""Programs of a demonstration: a monitor, and controllers of whole episodes."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

from zenostat.bridge.runtime.processes import ZENOSTAT
from zenostat.cli.console import out
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from rich.progress import Progress

    from zenostat import Bus
    from zenostat.metrics.episode_metrics import EpisodeMetrics
    from zenostat.metrics.trajectory import Trajectory
    from zenostat.views.report import Comparison


def write_demo_report(comparison: Comparison, path: Path) -> list[str]:
    """Write the report; return why it cannot be written, if so: the recording does not depend on it."""
    from zenostat.views.report import write_report

    path.unlink(missing_ok=True)  # of an earlier run
    try:
        write_report(comparison, path)
    except InvalidConfig as error:  # without Matplotlib
        return [str(error)]
    return []


def start_program(*arguments: object, wait: bool = False) -> subprocess.Popen[str]:
    """Start a command of `zenostat`; with `wait`, return once it is connected."""
    process = subprocess.Popen(
        [*ZENOSTAT, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if wait and process.stdout is not None:
        for line in process.stdout:
            if "Ctrl-C" in line:  # connected
                break
            out.print(line.rstrip())
    return process


def remaining_lines(process: subprocess.Popen[str]) -> list[str]:
    """Return the lines that a program has yet to print, after its end."""
    output, _ = process.communicate(timeout=240)
    return [line.strip() for line in output.splitlines() if line.strip()]


def run_episode(
    bus: Bus, endpoint: str, node: str, controller: str, title: str, bars: Progress, *, seed: int | None = None
) -> tuple[EpisodeMetrics, Trajectory, float]:
    """Run one episode with a controller in its own process; return metrics, samples and timesteps per second.

    Args:
        bus: of the node.
        endpoint: of the bus.
        node: name of the node.
        controller: of `zenostat run`.
        title: of the progress bar and of the controller's values.
        bars: where the progress is shown.
        seed: of a new episode; None: the present one, if it waits at its first sample.
    """
    from zenostat.metrics.episode_metrics import MetricsAccumulator
    from zenostat.metrics.trajectory_recorder import TrajectoryRecorder

    manifest = bus.manifest(node)
    metrics, bar = MetricsAccumulator(manifest), bars.add_task(title, total=manifest.steps, rate="")
    recorder, start = TrajectoryRecorder(manifest), 0.0
    options = [] if seed is None else ["--reset", "--seed", seed]
    with bus.listen(node) as samples:
        if seed is None and (first := bus.read(node)).step == 0:  # published before: the node waits at it
            recorder.add(first)
        process = start_program("run", "--node", node, "--controller", controller, "--connect", endpoint, *options)
        for sample in samples:
            if sample.step == 1:
                start = time.monotonic()
            metrics.add(sample)
            recorder.add(sample)
            if sample.step % 24 == 0 or sample.truncated:
                rate = (sample.step - 1) / max(time.monotonic() - start, 1e-9) if sample.step > 1 else 0.0
                bars.update(bar, completed=sample.step, rate=f"{rate:,.0f} steps/s")
            if sample.truncated:
                break
    steps_per_s = (manifest.steps - 1) / (time.monotonic() - start)
    process.communicate(timeout=60)
    return metrics.result(), recorder.trajectory({controller: title}), steps_per_s
