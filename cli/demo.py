"""`zenostat demo`: a week under baseline control and under a rule-based controller, in separate processes."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.console import out, progress
from cli.node_options import argument
from cli.results import show_results

if TYPE_CHECKING:
    from rich.progress import Progress

    from agent_sdk import Bus
    from agent_sdk.evaluation.metrics import EpisodeMetrics

NODE = "office"
ZENOSTAT = [sys.executable, "-P", "-m", "cli.main"]


def demo(
    folder: Annotated[Path, typer.Option(help="Output folder for the recording and the screenshot.")] = Path("demo"),
    building: Annotated[str, argument("building")] = "office-medium",
    weather: Annotated[str, argument("weather")] = "USA_CO_Denver",
    begin: Annotated[str, argument("begin")] = "07-01",
    end: Annotated[str, argument("end")] = "07-07",
) -> None:
    """Run a node, a controller and a monitor in separate processes, and compare two controllers.

    Example: `zenostat demo --begin 01-08 --end 01-14`
    """
    from agent_sdk import connect
    from agent_sdk.bus.local_node import LocalNode
    from bridge.rerun.viewer import NO_VULKAN, has_vulkan
    from bridge.runtime.affinity import Affinity

    folder.mkdir(parents=True, exist_ok=True)
    recording, screenshot = folder / "run.rrd", folder / "run.png"
    results: dict[str, tuple[EpisodeMetrics, float]] = {}
    with ExitStack() as stack, progress() as bars:
        settings = {"building": building, "weather": weather, "begin": begin, "end": end, "name": NODE}
        with out.status("starting the node"):
            local_node = LocalNode(settings, Affinity.SEPARATE_CORES)
        stack.callback(local_node.close)
        outputs = ["--save", recording, *(["--screenshot", screenshot] if has_vulkan() else [])]
        monitor = _start("monitor", "--connect", local_node.endpoint, *outputs, "--once", wait=True)
        stack.callback(monitor.terminate)
        bus = stack.enter_context(connect(local_node.endpoint, core=local_node.core))
        for controller, title in (("baseline", "baseline control"), ("rbc", "rule-based control")):
            results[title] = _episode(bus, local_node.endpoint, controller, title, bars)
        bus.stop(NODE)
        local_node.close()
        monitor_lines = _remaining_lines(monitor)
    show_results(results, f"{building}, {weather}, {begin} to {end}")
    for line in monitor_lines:
        out.print(f"monitor: {line}", markup=False, soft_wrap=True)
    if not has_vulkan():
        out.print(f"no screenshot: {NO_VULKAN}", soft_wrap=True, markup=False)


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


def _episode(bus: Bus, endpoint: str, controller: str, title: str, bars: Progress) -> tuple[EpisodeMetrics, float]:
    """Run one episode with a controller in its own process; return its metrics and its timesteps per second."""
    from agent_sdk.evaluation.metrics import MetricsAccumulator

    manifest = bus.manifest(NODE)
    metrics, bar = MetricsAccumulator(manifest), bars.add_task(title, total=manifest.steps, rate="")
    start = 0.0
    with bus.listen(NODE) as samples:
        process = _start("run", "--node", NODE, "--controller", controller, "--connect", endpoint)
        for sample in samples:
            if sample.step == 1:
                start = time.monotonic()
            metrics.add(sample)
            if sample.step % 24 == 0 or sample.truncated:
                rate = (sample.step - 1) / max(time.monotonic() - start, 1e-9) if sample.step > 1 else 0.0
                bars.update(bar, completed=sample.step, rate=f"{rate:,.0f} steps/s")
            if sample.truncated:
                break
    steps_per_s = (manifest.steps - 1) / (time.monotonic() - start)
    process.communicate(timeout=60)
    return metrics.result(), steps_per_s
