"""A demonstration and its programs: a node, a monitor, and controllers of whole episodes."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zenostat.bridge.runtime.processes import ZENOSTAT
from zenostat.cli.console import out, progress
from zenostat.cli.reports import command_line
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from rich.progress import Progress

    from zenostat import Bus
    from zenostat.bridge.runtime.affinity import Affinity
    from zenostat.metrics.episode_metrics import EpisodeMetrics
    from zenostat.metrics.trajectory import Trajectory
    from zenostat.views.report import Comparison, Run


@dataclass(frozen=True)
class Demonstration:
    """Runs of controllers on one node, beside a monitor.

    Attributes:
        settings: arguments of the node; its name among them.
        affinity: cores of the node and of this process.
        status: text while the node starts.
        controllers: controllers of `zenostat run`, with the title of each run.
        recording: the monitor's recording.
        screenshot: its picture, if there is a Vulkan driver.
        picture_options: further options of the picture.
        report: page that compares the runs.
        seed: as for `run_episode`.
    """

    settings: Mapping[str, Any]
    affinity: Affinity
    status: str
    controllers: Sequence[tuple[str, str]]
    recording: Path
    screenshot: Path
    picture_options: Sequence[str]
    report: Path
    seed: int | None = None


@dataclass(frozen=True)
class Outcome:
    """Results of a demonstration.

    Attributes:
        runs: one for each controller.
        rates: timesteps per second of each run.
        monitor_lines: what the monitor has printed at its end.
        notes: why there is no report, if so.
    """

    runs: tuple[Run, ...]
    rates: tuple[float, ...]
    monitor_lines: list[str]
    notes: list[str]


def demonstrate(demo: Demonstration) -> Outcome:
    """Run the node, the monitor and each controller in processes of their own, and write the report."""
    from zenostat import connect
    from zenostat.bridge.client.local_node import LocalNode
    from zenostat.metrics.episode_weather import query_weather
    from zenostat.views.live.viewer import has_vulkan
    from zenostat.views.report import Comparison, Run

    runs, rates, name = [], [], demo.settings["name"]
    with ExitStack() as stack, progress() as bars:
        with out.status(demo.status):
            node = LocalNode(dict(demo.settings), demo.affinity)
        stack.callback(node.close)
        outputs: list[object] = ["--save", demo.recording]
        demo.screenshot.unlink(missing_ok=True)  # of an earlier run
        if has_vulkan():
            outputs += ["--screenshot", demo.screenshot, *demo.picture_options]
        monitor = start_program("monitor", "--connect", node.endpoint, *outputs, "--once", wait=True)
        stack.callback(monitor.terminate)
        bus = stack.enter_context(connect(node.endpoint, core=node.core, affinity=demo.affinity))
        for controller, title in demo.controllers:
            metrics, trajectory, rate = run_episode(bus, node.endpoint, name, controller, title, bars, seed=demo.seed)
            rates.append(rate)
            known: dict[str, Any] = {}
            if (weather := query_weather(bus, trajectory.manifest)) is not None:
                known = {"weather_names": (trajectory.manifest.weather,), "weathers": (weather,)}
            runs.append(Run(title, (metrics,), trajectory, **known))
        scenario = bus.scenario(name)
        bus.stop(name)
        node.close()
        notes = write_demo_report(Comparison(tuple(runs), scenario, command_line()), demo.report)
        return Outcome(tuple(runs), tuple(rates), remaining_lines(monitor), notes)


def show_outputs(demo: Demonstration, outcome: Outcome, files: Mapping[str, Path]) -> None:
    """Print what the programs have reported, and those of these files and the screenshot that exist."""
    from zenostat.views.live.viewer import NO_VULKAN, has_vulkan

    for line in outcome.monitor_lines:
        out.print(f"monitor: {line}")
    if not has_vulkan():
        out.print(f"no screenshot: {NO_VULKAN}")
    elif not demo.screenshot.exists():
        command = f"zenostat view {demo.recording} --screenshot {demo.screenshot}"
        out.print(f"no screenshot; to try it again: {command}")
    for line in outcome.notes:
        out.print(f"report: {line}")
    files = {**files, "screenshot": demo.screenshot}
    out.print(", ".join(f"{name}: {path}" for name, path in files.items() if path.exists()))


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
