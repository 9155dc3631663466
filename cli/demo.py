"""`zenostat demo`: a week under baseline control and under a rule-based controller, in separate processes."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import out, progress
from zenostat.cli.node_options import argument
from zenostat.cli.reports import command_line
from zenostat.cli.results import show_results
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from rich.progress import Progress

    from zenostat import Bus
    from zenostat.metrics.episode_metrics import EpisodeMetrics
    from zenostat.metrics.trajectory import Trajectory
    from zenostat.views.report import Comparison, Run

NODE = "office"
PICTURE_TIME = "15:30"
"""Time of the last day at which the screenshot shows the building: in working hours, with the sun up."""

ZENOSTAT = [sys.executable, "-P", "-m", "zenostat.cli.main"]


def demo(
    folder: Annotated[
        Path, typer.Option(help="Output folder for the recording, the report and the screenshot.")
    ] = Path("demo"),
    building: Annotated[str, argument("building")] = "office-medium",
    weather: Annotated[str, argument("weather")] = "USA_CO_Denver",
    begin: Annotated[str, argument("begin")] = "07-01",
    end: Annotated[str, argument("end")] = "07-07",
) -> None:
    """Run a node, a controller and a monitor in separate processes, and compare two controllers.

    Example: `zenostat demo --begin 01-08 --end 01-14`
    """
    from zenostat import connect
    from zenostat.bridge.client.local_node import LocalNode
    from zenostat.bridge.runtime.affinity import Affinity
    from zenostat.metrics.episode_weather import query_weather
    from zenostat.views.live.viewer import NO_VULKAN, has_vulkan
    from zenostat.views.report import Comparison, Run

    folder.mkdir(parents=True, exist_ok=True)
    recording, screenshot, report = folder / "run.rrd", folder / "run.png", folder / "report.html"
    results: dict[str, tuple[EpisodeMetrics, float]] = {}
    runs: list[Run] = []
    with ExitStack() as stack, progress() as bars:
        settings: dict[str, Any] = {"building": building, "weather": weather, "begin": begin, "end": end, "name": NODE}
        settings["monitoring"] = True  # for the report
        with out.status("starting the node"):
            local_node = LocalNode(settings, Affinity.SEPARATE_CORES)
        stack.callback(local_node.close)
        outputs: list[object] = ["--save", recording]
        if has_vulkan():
            outputs += ["--screenshot", screenshot, "--at", f"{end}T{PICTURE_TIME}"]
        monitor = _start("monitor", "--connect", local_node.endpoint, *outputs, "--once", wait=True)
        stack.callback(monitor.terminate)
        bus = stack.enter_context(connect(local_node.endpoint, core=local_node.core))
        for controller, title in (("baseline", "baseline control"), ("rbc", "rule-based control")):
            metrics, trajectory, rate = _episode(bus, local_node.endpoint, controller, title, bars)
            results[title] = (metrics, rate)
            weathers = (query_weather(bus, trajectory.manifest),)
            runs.append(
                Run(title, (metrics,), trajectory, weather_names=(trajectory.manifest.weather,), weathers=weathers)
            )
        scenario = bus.scenario(NODE)
        bus.stop(NODE)
        local_node.close()
        notes = _write_report(Comparison(tuple(runs), scenario, command_line()), report)
        monitor_lines = _remaining_lines(monitor)
    show_results(results, f"{building}, {weather}, {begin} to {end}")
    for line in monitor_lines:
        out.print(f"monitor: {line}", markup=False, soft_wrap=True)
    if not has_vulkan():
        out.print(f"no screenshot: {NO_VULKAN}", soft_wrap=True, markup=False)
    for line in notes:
        out.print(f"report: {line}", markup=False, soft_wrap=True)
    files = {"recording": recording, "report": report, "screenshot": screenshot}
    text = ", ".join(f"{name}: {path}" for name, path in files.items() if path.exists())
    out.print(text, markup=False, soft_wrap=True)


def _write_report(comparison: Comparison, path: Path) -> list[str]:
    """Write the report; return why it cannot be written, if so: the recording does not depend on it."""
    from zenostat.views.report import write_report

    path.unlink(missing_ok=True)  # of an earlier run
    try:
        write_report(comparison, path)
    except InvalidConfig as error:  # without Matplotlib
        return [str(error)]
    return []


def _start(*arguments: object, wait: bool = False) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [*ZENOSTAT, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if wait and process.stdout is not None:
        for line in process.stdout:
            if "Ctrl-C" in line:  # connected
                break
            out.print(line.rstrip(), markup=False, soft_wrap=True)
    return process


def _remaining_lines(process: subprocess.Popen[str]) -> list[str]:
    output, _ = process.communicate(timeout=240)
    return [line.strip() for line in output.splitlines() if line.strip()]


def _episode(
    bus: Bus, endpoint: str, controller: str, title: str, bars: Progress
) -> tuple[EpisodeMetrics, Trajectory, float]:
    """Run one episode with a controller in its own process; return metrics, samples and timesteps per second."""
    from zenostat.metrics.episode_metrics import MetricsAccumulator
    from zenostat.metrics.trajectory_recorder import TrajectoryRecorder

    manifest = bus.manifest(NODE)
    metrics, bar = MetricsAccumulator(manifest), bars.add_task(title, total=manifest.steps, rate="")
    recorder, start = TrajectoryRecorder(manifest), 0.0
    with bus.listen(NODE) as samples:
        if (first := bus.read(NODE)).step == 0:  # published before: the node waits at it
            recorder.add(first)
        process = _start("run", "--node", NODE, "--controller", controller, "--connect", endpoint)
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
