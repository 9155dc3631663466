"""`zenostat demo district`: a district without control and with a coordinator, in separate processes."""

from __future__ import annotations

from pathlib import Path

import typer

from zenostat.cli.console import out
from zenostat.cli.demo_programs import Demonstration, demonstrate, show_outputs
from zenostat.cli.tables import show
from zenostat.topics.extras import requires_extra

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
    from zenostat.bridge.runtime.affinity import Affinity
    from zenostat.cosim.demo import copy_files
    from zenostat.metrics.district_kpis import district_kpis, points_of
    from zenostat.views.district_figure import draw_district

    libraries = "power-grid-model, matplotlib, mcap and zstandard"
    with requires_extra("grid,plots,recording", "the demonstration of a district", libraries):
        import matplotlib.figure  # noqa: F401
        import power_grid_model  # noqa: F401

        from zenostat.cosim.verify_recording import verify_district
    file = copy_files(folder)
    recording, picture = folder / "district.mcap", folder / "district.png"
    settings = {"district": str(file.absolute()), "name": NODE}
    demonstration = Demonstration(
        settings={**settings, "record": str(recording.absolute()), "record_overwrite": True},
        affinity=Affinity.OFF,
        status="starting three buildings and a feeder",
        controllers=RUNS,
        recording=folder / "district.rrd",
        screenshot=folder / "district-live.png",
        picture_options=("--tab", "Grid", "--at", PICTURE_TIME),
        report=folder / "district.html",
        seed=SEED,
    )
    outcome = demonstrate(demonstration)
    trajectories = {run.name: run.trajectory for run in outcome.runs}
    points = points_of(outcome.runs[0].trajectory.manifest, GENERATION)
    draw_district(trajectories, picture, points.limits or {})
    show_kpis({title: district_kpis(run, points) for title, run in trajectories.items()})
    with out.status("verifying the recording: all plants are simulated again"):
        result = verify_district(recording, file)
    out.print(f"recording: {result}")
    files = {"district": file, "recording": recording, "live view": demonstration.recording}
    files |= {"report": demonstration.report, "picture": picture}
    show_outputs(demonstration, outcome, files)
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
