"""`zenostat demo`: a week under baseline control and under a rule-based controller, in separate processes."""

from __future__ import annotations

from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import out, progress
from zenostat.cli.demo_programs import remaining_lines, run_episode, start_program, write_demo_report
from zenostat.cli.node_options import argument
from zenostat.cli.reports import command_line
from zenostat.cli.results import show_results
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from zenostat.metrics.episode_metrics import EpisodeMetrics
    from zenostat.views.report import Run

NODE = "office"
_DEFAULTS = ("office-medium", "USA_CO_Denver", "07-01", "07-07")
PICTURE_TIME = "15:30"
"""Time of the last day at which the screenshot shows the building: in working hours, with the sun up."""


class Subject(StrEnum):
    """Subject of the demonstration."""

    BUILDING = "building"
    DISTRICT = "district"


def demo(
    subject: Annotated[
        Subject,
        typer.Argument(help="A building; or a district of three buildings with PV, a battery and two chargers."),
    ] = Subject.BUILDING,
    folder: Annotated[
        Path, typer.Option(help="Output folder for the recording, the report and the screenshot.")
    ] = Path("demo"),
    building: Annotated[str, argument("building")] = _DEFAULTS[0],
    weather: Annotated[
        str, typer.Option(help="Short name, EPW file, or any unique part of a listed name.")
    ] = _DEFAULTS[1],
    begin: Annotated[str, typer.Option(help="First day, MM-DD or YYYY-MM-DD.")] = _DEFAULTS[2],
    end: Annotated[str, typer.Option(help="Last day, MM-DD or YYYY-MM-DD.")] = _DEFAULTS[3],
) -> None:
    """Run a node, a controller and a monitor in separate processes, and compare two controllers.

    Example: `zenostat demo --begin 01-08 --end 01-14`

    Example: `zenostat demo district`
    """
    if subject is Subject.DISTRICT:
        if (building, weather, begin, end) != _DEFAULTS:
            raise InvalidConfig("the district's buildings and days are those of its file; leave out other options")
        from zenostat.cli.demo_district import demo_district

        demo_district(folder)
        return
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
        screenshot.unlink(missing_ok=True)  # of an earlier run
        if has_vulkan():
            outputs += ["--screenshot", screenshot, "--at", f"{end}T{PICTURE_TIME}"]
        monitor = start_program("monitor", "--connect", local_node.endpoint, *outputs, "--once", wait=True)
        stack.callback(monitor.terminate)
        bus = stack.enter_context(connect(local_node.endpoint, core=local_node.core))
        for controller, title in (("baseline", "baseline control"), ("rbc", "rule-based control")):
            metrics, trajectory, rate = run_episode(bus, local_node.endpoint, NODE, controller, title, bars)
            results[title] = (metrics, rate)
            weathers = (query_weather(bus, trajectory.manifest),)
            runs.append(
                Run(title, (metrics,), trajectory, weather_names=(trajectory.manifest.weather,), weathers=weathers)
            )
        scenario = bus.scenario(NODE)
        bus.stop(NODE)
        local_node.close()
        notes = write_demo_report(Comparison(tuple(runs), scenario, command_line()), report)
        monitor_lines = remaining_lines(monitor)
    show_results(results, f"{building}, {weather}, {begin} to {end}")
    for line in monitor_lines:
        out.print(f"monitor: {line}")
    if not has_vulkan():
        out.print(f"no screenshot: {NO_VULKAN}")
    elif not screenshot.exists():
        out.print(f"no screenshot; to try it again: zenostat view {recording} --screenshot {screenshot}")
    for line in notes:
        out.print(f"report: {line}")
    files = {"recording": recording, "report": report, "screenshot": screenshot}
    text = ", ".join(f"{name}: {path}" for name, path in files.items() if path.exists())
    out.print(text)
