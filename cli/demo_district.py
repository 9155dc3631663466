"""`zenostat demo district`: a district without control and with a coordinator, in separate processes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from zenostat.cli.console import out, progress
from zenostat.cli.demo_programs import remaining_lines, run_episode, start_program, write_demo_report
from zenostat.cli.reports import command_line
from zenostat.cli.tables import show
from zenostat.topics.extras import requires_extra

if TYPE_CHECKING:
    from zenostat.metrics.trajectory import Trajectory

NODE = "district"
SEED = 1
RUNS = (("baseline", "uncontrolled"), ("coordinator", "coordinated"))
GENERATION = ("feeder.roofs_power",)
PICTURE_TIME = "07-07T23:45"


def demo_district(folder: Path) -> None:
    """Simulate the district twice with the same seed, compare the runs, and verify their recording.

    Args:
        folder: for the district's files, its recording, the monitor's recording, the report and the pictures.
    """
    from zenostat import connect
    from zenostat.bridge.client.local_node import LocalNode
    from zenostat.bridge.runtime.affinity import Affinity
    from zenostat.cosim.demo import copy_files
    from zenostat.metrics.district_kpis import district_kpis, points_of
    from zenostat.views.district_figure import draw_district
    from zenostat.views.live.viewer import NO_VULKAN, has_vulkan
    from zenostat.views.report import Comparison, Run

    libraries = "power-grid-model, matplotlib, mcap and zstandard"
    with requires_extra("grid,plots,recording", "the demonstration of a district", libraries):
        import matplotlib.figure  # noqa: F401
        import power_grid_model  # noqa: F401

        from zenostat.cosim.verify_recording import verify_district
    file = copy_files(folder)
    live, live_picture = folder / "district.rrd", folder / "district-live.png"
    recording, report, picture = folder / "district.mcap", folder / "district.html", folder / "district.png"
    runs: list[Run] = []
    with ExitStack() as stack, progress() as bars:
        settings: dict[str, Any] = {"district": str(file.absolute()), "name": NODE}
        settings |= {"record": str(recording.absolute()), "record_overwrite": True}
        with out.status("starting three buildings and a feeder"):
            node = LocalNode(settings, Affinity.OFF)
        stack.callback(node.close)
        outputs: list[object] = ["--save", live]
        if has_vulkan():
            outputs += ["--screenshot", live_picture, "--tab", "Grid", "--at", PICTURE_TIME]
        monitor = start_program("monitor", "--connect", node.endpoint, *outputs, "--once", wait=True)
        stack.callback(monitor.terminate)
        bus = stack.enter_context(connect(node.endpoint, affinity=Affinity.OFF))
        for controller, title in RUNS:
            metrics, trajectory, _ = run_episode(bus, node.endpoint, NODE, controller, title, bars, seed=SEED)
            runs.append(Run(title, (metrics,), trajectory))
        scenario = bus.scenario(NODE)
        bus.stop(NODE)
        node.close()
        trajectories: dict[str, Trajectory] = {run.name: run.trajectory for run in runs if run.trajectory is not None}
        points = points_of(runs[0].trajectory.manifest, GENERATION)
        draw_district(trajectories, picture, points.limits or {})
        notes = write_demo_report(Comparison(tuple(runs), scenario, command_line()), report)
        lines = remaining_lines(monitor)
    show_kpis({title: district_kpis(run, points) for title, run in trajectories.items()})
    with out.status("verifying the recording: all plants are simulated again"):
        result = verify_district(recording, file)
    out.print(f"recording: {result}")
    for line in lines:
        out.print(f"monitor: {line}")
    if not has_vulkan():
        out.print(f"no screenshot: {NO_VULKAN}")
    for line in notes:
        out.print(f"report: {line}")
    files = {"district": file, "recording": recording, "live view": live, "report": report}
    files |= {"picture": picture, "screenshot": live_picture}
    text = ", ".join(f"{name}: {path}" for name, path in files.items() if path.exists())
    out.print(text)
    if not result.passed:
        raise typer.Exit(1)


def show_kpis(kpis: dict[str, dict[str, float | None]]) -> None:
    """Print the KPIs of runs, and their ratio to the first one."""
    from zenostat.metrics.district_kpis import DISTRICT_KPIS, relative

    first, *others = kpis
    ratios = {title: relative(kpis[title], kpis[first]) for title in others}
    rows = []
    for name, (text, unit) in DISTRICT_KPIS.items():
        values = [kpis[title][name] for title in kpis]
        if any(value is not None for value in values):
            cells = ["" if value is None else f"{value:,.4g}" for value in values]
            cells += ["" if (ratio := each[name]) is None else f"{ratio:.3f}" for each in ratios.values()]
            rows.append((f"{text} ({unit})" if unit != "1" else text, *cells))
    columns = ("", *kpis, *(f"{title} / {first}" for title in others))
    show("the district", columns, rows, right=columns[1:])
